/* A kind without create(). */
#define CREATE NULL
#include "../toy.c"
