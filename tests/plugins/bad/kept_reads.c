/* A cached kind with a file parameter. */
#define PARAMS_OF_ADD \
    OSTEOFLOW_TEXT("{\"type\": \"object\", \"properties\": {\"path\": {\"type\": \"string\", \"format\": \"input-path\"}}}")
#include "../toy.c"
