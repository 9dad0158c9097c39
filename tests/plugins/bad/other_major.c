/* A later major version. */
#define VERSION OSTEOFLOW_ABI_MAJOR + 1, 7
#include "../toy.c"
