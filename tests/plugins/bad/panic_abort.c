/* Panics that abort. */
#define PANIC OSTEOFLOW_PANIC_ABORT
#include "../toy.c"
