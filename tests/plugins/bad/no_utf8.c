/* A name that is no text. */
#define NAME { "\xff\xfe", 2 }
#include "../toy.c"
