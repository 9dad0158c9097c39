/* A port that no graph can name. */
#define PORT_OF_ADD OSTEOFLOW_TEXT("a number")
#include "../toy.c"
