/* A payload type of the program with another schema. */
#define PAYLOAD "geometry/Pose"
#include "../toy.c"
