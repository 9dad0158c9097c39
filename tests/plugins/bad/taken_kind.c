/* A kind that the program has. */
#define KIND_OF_ADD OSTEOFLOW_TEXT("icp.point_to_point")
#include "../toy.c"
