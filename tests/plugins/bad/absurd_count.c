/* More kinds than there can be. */
#define KINDS kinds, UINT64_MAX / 2
#include "../toy.c"
