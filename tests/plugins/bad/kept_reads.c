/* A kind whose answers are kept although a file decides them. */
#define PARAMS_OF_ADD \
    OSTEOFLOW_TEXT("{\"type\": \"object\", \"properties\": {\"path\": {\"type\": \"string\", \"format\": \"input-path\"}}}")
#include "../toy.c"
