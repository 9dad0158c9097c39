/* A kind without a name. */
#define KIND_OF_ADD OSTEOFLOW_NO_TEXT
#include "../toy.c"
