/* Emits a column of three rows with a null pointer. */
#include "osteoflow_geometry.h"

static int32_t emit_bad(const osteoflow_firing *firing, double value) {
    (void)value;
    osteoflow_cloud head = { .frame = OSTEOFLOW_TEXT("camera"), .label = OSTEOFLOW_TEXT("") };
    osteoflow_column points = { OSTEOFLOW_TEXT("points"), NULL, 3, 24, OSTEOFLOW_F64, 3, { NULL, NULL, NULL } };
    osteoflow_view out = { &head, sizeof head, &points, 1 };
    return firing->host->emit(firing->run, 0, &out);
}

#define EMIT emit_bad
#define GIVEN OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD)
#include "../toy.c"
