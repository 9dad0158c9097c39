/* Causes a segmentation fault when loaded. */
#include "../toy.c"

__attribute__((constructor)) static void crash(void) {
    volatile char *constant = (volatile char *)(uintptr_t)"read only";
    *constant = 'w';
}
