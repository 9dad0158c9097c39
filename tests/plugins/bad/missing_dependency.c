/* Depends on a library that does not exist. */
int dependency(void);

#define ADD dependency()
#include "../toy.c"
