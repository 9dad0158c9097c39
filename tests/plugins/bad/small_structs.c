/* A struct smaller than it ever was. */
#define SIZES { sizeof(osteoflow_plugin), 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0 }
#include "../toy.c"
