/* Exits when loaded. */
#include <stdio.h>

#include "../toy.c"

__attribute__((constructor)) static void end(void) {
    fputs("no licence\n", stderr);
    exit(7);
}
