/* What panics ends the program. */
#define PANIC OSTEOFLOW_PANIC_ABORT
#include "../toy.c"
