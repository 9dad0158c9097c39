/* Two kinds behind a null pointer. */
#define KINDS NULL, 2
#include "../toy.c"
