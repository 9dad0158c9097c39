/* Emits a pose of NaN, as a division by zero leaves it. */
#include "osteoflow_geometry.h"

#include <math.h>

static int32_t emit_bad(const osteoflow_firing *firing, double value) {
    (void)value;
    osteoflow_pose head = { .to = OSTEOFLOW_TEXT("ct"), .from = OSTEOFLOW_TEXT("world") };
    for (int k = 0; k < 7; k++) {
        head.isometry[k] = NAN;
    }
    osteoflow_view out = { &head, sizeof head, NULL, 0 };
    return firing->host->emit(firing->run, 0, &out);
}

#define EMIT emit_bad
#define GIVEN OSTEOFLOW_TEXT(OSTEOFLOW_POSE)
#include "../toy.c"
