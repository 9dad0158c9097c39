/* Writes where it may not when it is loaded. */
#include "../toy.c"

__attribute__((constructor)) static void crash(void) {
    volatile char *constant = (volatile char *)(uintptr_t)"read only";
    *constant = 'w';
}
