/* A struct smaller than in minor 0. */
#define SIZES { sizeof(osteoflow_plugin), 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0 }
#include "../toy.c"
