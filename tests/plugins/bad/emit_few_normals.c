/* Emits a cloud of three points with two normals. */
#include "osteoflow_geometry.h"

static const double rows[9] = { 0, 0, 1, 0, 0, 1, 0, 0, 1 };

static int32_t emit_bad(const osteoflow_firing *firing, double value) {
    (void)value;
    osteoflow_cloud head = { .frame = OSTEOFLOW_TEXT("camera"), .label = OSTEOFLOW_TEXT("") };
    osteoflow_column columns[] = {
        { OSTEOFLOW_TEXT("points"), rows, 3, 24, OSTEOFLOW_F64, 3, { NULL, NULL, NULL } },
        { OSTEOFLOW_TEXT("normals"), rows, 2, 24, OSTEOFLOW_F64, 3, { NULL, NULL, NULL } },
    };
    osteoflow_view out = { &head, sizeof head, columns, 2 };
    return firing->host->emit(firing->run, 0, &out);
}

#define EMIT emit_bad
#define GIVEN OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD)
#include "../toy.c"
