/* Waits forever when loaded. */
#include <unistd.h>

#include "../toy.c"

__attribute__((constructor)) static void hang(void) {
    for (;;) {
        pause();
    }
}
