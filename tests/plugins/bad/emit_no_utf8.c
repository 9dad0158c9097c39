/* Emits an empty whose reason is not UTF-8. */
#include "osteoflow.h"

static int32_t emit_bad(const osteoflow_firing *firing, double value) {
    (void)value;
    osteoflow_text reason = { "\xff\xfe", 2 };
    return firing->host->emit_empty(firing->run, 0, reason);
}

#define EMIT emit_bad
#include "../toy.c"
