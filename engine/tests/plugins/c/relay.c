/* Two nodes: one passes on its value, one adds one to a number. */
#include "osteoflow.h"
#include <stdlib.h>

typedef struct number_head {
    double value;
} number_head;

static const osteoflow_part number_parts[] = {
    { OSTEOFLOW_TEXT("value"), OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_PART_FLOAT, 0, 0, 0 },
};

static const osteoflow_payload payloads[] = {
    { OSTEOFLOW_TEXT("toy/Number"), number_parts, 1, 1, 0 },
};

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)firing;
    (void)params;
    *node = (void *)kind;
    return OSTEOFLOW_OK;
}

static int32_t relay(void *node, const osteoflow_firing *firing) {
    (void)node;
    return firing->host->emit_value(firing->run, 0, firing->slots[0].items[0].value);
}

static int32_t next(void *node, const osteoflow_firing *firing) {
    (void)node;
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "there is no number");
    }
    number_head head;
    head.value = ((const number_head *)view.head)->value + 1.0;
    osteoflow_view out = { &head, sizeof head, NULL, 0 };
    return firing->host->emit(firing->run, 0, &out);
}

static void destroy(void *node) {
    (void)node;
}

static const osteoflow_input any_in[] = {
    { OSTEOFLOW_TEXT("value"), OSTEOFLOW_TEXT("A value."), OSTEOFLOW_NO_TEXT, 0, 0, OSTEOFLOW_JOIN_EACH, 0, 0,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_output any_out[] = {
    { OSTEOFLOW_TEXT("out"), OSTEOFLOW_TEXT("The same."), OSTEOFLOW_NO_TEXT, 0, 0, OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_input number_in[] = {
    { OSTEOFLOW_TEXT("number"), OSTEOFLOW_TEXT("A number."), OSTEOFLOW_TEXT("toy/Number"), 1, 0,
      OSTEOFLOW_JOIN_EACH, 0, 0, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_output number_out[] = {
    { OSTEOFLOW_TEXT("out"), OSTEOFLOW_TEXT("One more."), OSTEOFLOW_TEXT("toy/Number"), 1, 0, OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};

static const osteoflow_kind kinds[] = {
    { OSTEOFLOW_TEXT("bench.relay"), OSTEOFLOW_TEXT("Passes on its value."),
      OSTEOFLOW_TEXT("{\"type\": \"object\", \"properties\": {\"spin_us\": {\"type\": \"integer\", \"default\": 0}}}"),
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, NULL, 0, any_in, 1, any_out, 1, OSTEOFLOW_ROLE_NODE, OSTEOFLOW_KEPT_NO,
      0, 0, NULL, create, relay, destroy, NULL, NULL },
    { OSTEOFLOW_TEXT("bench.next"), OSTEOFLOW_TEXT("Adds one to a number."),
      OSTEOFLOW_TEXT("{\"type\": \"object\", \"properties\": {\"spin_us\": {\"type\": \"integer\", \"default\": 0}}}"),
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, NULL, 0, number_in, 1, number_out, 1, OSTEOFLOW_ROLE_NODE,
      OSTEOFLOW_KEPT_NO, 0, 0, NULL, create, next, destroy, NULL, NULL },
};

OSTEOFLOW_PLUGIN_WITH("relay", "1", kinds, payloads)
