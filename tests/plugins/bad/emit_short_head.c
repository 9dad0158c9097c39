/* Emits a head of half the size. */
#include "osteoflow.h"

static int32_t emit_bad(const osteoflow_firing *firing, double value) {
    osteoflow_view out = { &value, 4, NULL, 0 };
    return firing->host->emit(firing->run, 0, &out);
}

#define EMIT emit_bad
#include "../toy.c"
