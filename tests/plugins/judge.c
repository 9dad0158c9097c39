/* A source of one text of JSON: number `which` of SAYS, a list of literals. */
#include "osteoflow.h"
#include <stdlib.h>

static const char *const says[] = { SAYS };

typedef struct judge {
    double which;
    int given;
} judge;

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    judge *new = malloc(sizeof *new);
    if (new == NULL) {
        return osteoflow_fail(firing, "there is no memory");
    }
    new->which = osteoflow_param_number(firing, "which", 0.0);
    new->given = 0;
    *node = new;
    return OSTEOFLOW_OK;
}

static int32_t next(void *node, const osteoflow_firing *firing) {
    judge *self = node;
    if (self->given++ > 0) {
        return OSTEOFLOW_END;
    }
    osteoflow_text json = osteoflow_text_of(says[(int)self->which]);
    osteoflow_view out = { &json, sizeof json, NULL, 0 };
    firing->host->set_stamp_ns(firing->run, 0);
    return firing->host->emit(firing->run, 0, &out);
}

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("verdict"), .doc = OSTEOFLOW_TEXT("A verdict."), .payload = OSTEOFLOW_TEXT("report/Json"),
      .version = 1 },
};
static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("test.judge"),
      .doc = OSTEOFLOW_TEXT("Gives one verdict."),
      .params_schema = OSTEOFLOW_TEXT("{\"type\": \"object\", \"properties\": {\"which\": {\"description\": \"Its number.\", "
                                      "\"type\": \"number\", \"default\": 0}}, \"additionalProperties\": false}"),
      .outputs = outputs,
      .n_outputs = 1,
      .role = OSTEOFLOW_ROLE_SOURCE,
      .create = create,
      .fire = next,
      .destroy = free },
};

OSTEOFLOW_PLUGIN("judge", "1.0.0", kinds)
