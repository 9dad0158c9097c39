/* A payload of the program, described otherwise. */
#define PAYLOAD "geometry/Pose"
#include "../toy.c"
