/* Wrong magic bytes. */
#define MAGIC 'O', 'T', 'H', 'E', 'R', 'P', 'L', 'G'
#include "../toy.c"
