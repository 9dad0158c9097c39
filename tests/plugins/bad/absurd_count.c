/* More kinds than fit in memory. */
#define KINDS kinds, UINT64_MAX / 2
#include "../toy.c"
