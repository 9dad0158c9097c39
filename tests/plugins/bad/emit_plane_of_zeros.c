/* Emits two planes, the second of which is all zeros. */
#include "osteoflow_geometry.h"

static const double rows[14] = { 1, 2, 3, 0, 0, 0, 1 };

static int32_t emit_bad(const osteoflow_firing *firing, double value) {
    (void)value;
    osteoflow_planes head = { .frame = OSTEOFLOW_TEXT("ct"), .names = OSTEOFLOW_TEXT("distal\nproximal"),
                              .unknown = OSTEOFLOW_TEXT("\n") };
    osteoflow_column column = { OSTEOFLOW_TEXT("isometries"), rows, 2, 56, OSTEOFLOW_F64, 7, { NULL, NULL, NULL } };
    osteoflow_view out = { &head, sizeof head, &column, 1 };
    return firing->host->emit(firing->run, 0, &out);
}

#define EMIT emit_bad
#define GIVEN OSTEOFLOW_TEXT(OSTEOFLOW_PLANES)
#include "../toy.c"
