/* A source of three acme/Spline payloads with 2, 3 and 4 points. */
#include "acme_spline.h"

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    *node = calloc(1, sizeof(int));
    return *node == NULL ? osteoflow_fail(firing, "there is no memory") : OSTEOFLOW_OK;
}

static int32_t next(void *node, const osteoflow_firing *firing) {
    int *given = node;
    if (*given == 3) {
        return OSTEOFLOW_END;
    }
    const uint64_t n = 2 + (uint64_t)(*given)++;
    double *rows = malloc(3 * n * sizeof *rows);
    if (rows == NULL) {
        return osteoflow_fail(firing, "there is no memory");
    }
    for (uint64_t i = 0; i < n; i++) {
        rows[3 * i] = 3.0 * (double)i;
        rows[3 * i + 1] = 4.0 * (double)i;
        rows[3 * i + 2] = 0.1;
    }
    const double knots[] = { 0.0, 0.5, 1.0 };
    acme_spline head = { osteoflow_text_of("ct"), 2, { knots, 3 } };
    if (n == 3) {
        head.knots.data = NULL;
        head.knots.length = 0;
    }
    const osteoflow_column control =
        osteoflow_malloced_column(osteoflow_text_of("control"), OSTEOFLOW_F64, 3, rows, n);
    const osteoflow_view view = { &head, sizeof head, &control, 1 };
    firing->host->set_stamp_ns(firing->run, *given);
    return firing->host->emit(firing->run, 0, &view);
}

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("spline"), .doc = OSTEOFLOW_TEXT("A spline."), .payload = OSTEOFLOW_TEXT(ACME_SPLINE),
      .version = ACME_SPLINE_VERSION },
};

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("acme.splines"), .doc = OSTEOFLOW_TEXT("Three splines."), .outputs = outputs,
      .n_outputs = 1, .role = OSTEOFLOW_ROLE_SOURCE, .create = create, .fire = next, .destroy = free },
};

OSTEOFLOW_PLUGIN_WITH("spline_give", "1", kinds, acme_payloads)
