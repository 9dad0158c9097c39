/* Emits another payload type than that of its port. */
#include "osteoflow.h"

static int32_t emit_bad(const osteoflow_firing *firing, double value) {
    osteoflow_text head = OSTEOFLOW_TEXT("camera");
    osteoflow_view out = { &head, sizeof head, NULL, 0 };
    (void)value;
    osteoflow_text payload = OSTEOFLOW_TEXT("report/Json");
    return firing->host->emit_as(firing->run, 0, payload, 1, &out);
}

#define EMIT emit_bad
#include "../toy.c"
