/* A kind that nobody can build. */
#define CREATE NULL
#include "../toy.c"
