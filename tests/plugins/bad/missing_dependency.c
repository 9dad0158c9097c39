/* Calls a library that is gone. */
int dependency(void);

#define ADD dependency()
#include "../toy.c"
