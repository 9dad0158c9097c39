/* Two kinds nowhere. */
#define KINDS NULL, 2
#include "../toy.c"
