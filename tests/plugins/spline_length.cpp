// Length of the control polygon of a spline from another plugin.
#include "acme_spline.h"

#include <cmath>

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *, osteoflow_text, void **node) {
    *node = const_cast<osteoflow_kind *>(kind);
    return OSTEOFLOW_OK;
}

static int32_t length(void *, const osteoflow_firing *firing) {
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "there is no spline");
    }
    const acme_spline *spline = static_cast<const acme_spline *>(view.head);
    const osteoflow_column *control = osteoflow_find_column(&view, "control", OSTEOFLOW_F64, 3);
    if (control == NULL || !osteoflow_text_is(spline->frame, "ct") || spline->degree != 2) {
        return osteoflow_fail(firing, "this is not the spline that was given");
    }
    const double *rows = static_cast<const double *>(control->data);
    double sum = 0.0;
    for (uint64_t i = 1; i < control->n_rows; i++) {
        const double *a = rows + 3 * (i - 1), *b = rows + 3 * i;
        sum += std::sqrt((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1]) + (b[2] - a[2]) * (b[2] - a[2]));
    }
    double *values = static_cast<double *>(malloc(2 * sizeof(double)));
    values[0] = sum;
    values[1] = static_cast<double>(spline->knots.data == NULL ? 0 : spline->knots.length);
    const osteoflow_metrics head = { osteoflow_text_of("length\nn_knots"), osteoflow_text_of("mm\n") };
    const osteoflow_column column = osteoflow_malloced_column(osteoflow_text_of("values"), OSTEOFLOW_F64, 1, values, 2);
    const osteoflow_view out = { &head, sizeof head, &column, 1 };
    return firing->host->emit(firing->run, 0, &out);
}

static void destroy(void *) {}

static const osteoflow_input inputs[] = {
    { OSTEOFLOW_TEXT("spline"), OSTEOFLOW_TEXT("A spline."), OSTEOFLOW_TEXT(ACME_SPLINE), ACME_SPLINE_VERSION, 0,
      OSTEOFLOW_JOIN_EACH, 0, 0, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_output outputs[] = {
    { OSTEOFLOW_TEXT("report"), OSTEOFLOW_TEXT("Its length."), OSTEOFLOW_TEXT(OSTEOFLOW_METRICS),
      OSTEOFLOW_METRICS_VERSION, 0, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_kind kinds[] = {
    { OSTEOFLOW_TEXT("acme.length"), OSTEOFLOW_TEXT("How long a spline is."), OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, NULL, 0, inputs, 1, outputs, 1, OSTEOFLOW_ROLE_NODE, OSTEOFLOW_KEPT_NO, 0, 0, NULL, create,
      length, destroy, NULL, NULL },
};

OSTEOFLOW_PLUGIN_WITH("spline_length", "1", kinds, acme_payloads)
