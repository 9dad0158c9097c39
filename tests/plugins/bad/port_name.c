/* A port name that no graph can use. */
#define PORT_OF_ADD OSTEOFLOW_TEXT("a number")
#include "../toy.c"
