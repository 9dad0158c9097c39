/* A name that is not UTF-8. */
#define NAME { "\xff\xfe", 2 }
#include "../toy.c"
