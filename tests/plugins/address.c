/* Addresses of the points of input and output clouds, and the number of output clouds released. */
#include "osteoflow_geometry.h"

#include <math.h>
#include <stdatomic.h>
#include <stdio.h>

static atomic_int n_made, n_released;

static int32_t emit_text(const osteoflow_firing *firing, uint64_t port, const char *said) {
    const osteoflow_words head = { osteoflow_text_of(said) };
    const osteoflow_view view = { &head, sizeof head, NULL, 0 };
    return firing->host->emit(firing->run, port, &view);
}

static int32_t emit_address(const osteoflow_firing *firing, uint64_t port, const void *data) {
    char said[32];
    snprintf(said, sizeof said, "%llu", (unsigned long long)(uintptr_t)data);
    return emit_text(firing, port, said);
}

/* State of a source: whether it has answered; for give, also how it answers. */
typedef struct source {
    int answered;
    char how[16];
} source;

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    source *self = calloc(1, sizeof *self);
    if (self == NULL) {
        return osteoflow_fail(firing, "there is no memory");
    }
    osteoflow_param how;
    firing->host->param(firing->run, osteoflow_text_of("how"), &how);
    if (how.what == OSTEOFLOW_PARAM_TEXT) {
        snprintf(self->how, sizeof self->how, "%.*s", (int)how.text.length, how.text.data);
    }
    *node = self;
    return OSTEOFLOW_OK;
}

static int32_t address(void *node, const osteoflow_firing *firing) {
    (void)node;
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "the cloud cannot be read");
    }
    const osteoflow_column *points = osteoflow_find_column(&view, "points", OSTEOFLOW_F64, 3);
    return points == NULL ? osteoflow_fail(firing, "no points") : emit_address(firing, 0, points->data);
}

/* The same columns with another head. */
static int32_t hand_on(void *node, const osteoflow_firing *firing) {
    (void)node;
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK || view.n_columns != 1) {
        return osteoflow_fail(firing, "the cloud cannot be read");
    }
    osteoflow_cloud head = *(const osteoflow_cloud *)view.head;
    head.label = osteoflow_text_of("handed on");
    const osteoflow_column points = osteoflow_held_column(&view.columns[0]);
    const osteoflow_view out = { &head, sizeof head, &points, 1 };
    return firing->host->emit(firing->run, 0, &out);
}

/* Overwrites released rows, so that a later read is detected. */
static void release(void *rows) {
    memset(rows, 0xff, 9 * sizeof(double));
    atomic_fetch_add(&n_released, 1);
    free(rows);
}

static osteoflow_column make_points(double x) {
    double *rows = malloc(9 * sizeof *rows);
    for (int i = 0; i < 9; i++) {
        rows[i] = i == 4 ? x : i;
    }
    atomic_fetch_add(&n_made, 1);
    osteoflow_column column = osteoflow_malloced_column(osteoflow_text_of("points"), OSTEOFLOW_F64, 3, rows, 3);
    column.owner.release = release;
    return column;
}

static int32_t emit_cloud(const osteoflow_firing *firing, uint64_t port, const osteoflow_column *points) {
    const osteoflow_cloud head = { osteoflow_text_of("camera"), 0, OSTEOFLOW_NO_TEXT, { NULL, 0 } };
    const osteoflow_view view = { &head, sizeof head, points, 1 };
    return firing->host->emit(firing->run, port, &view);
}

static int32_t give(void *node, const osteoflow_firing *firing) {
    source *self = node;
    if (self->answered) {
        return OSTEOFLOW_END;
    }
    self->answered = 1;
    const osteoflow_column points = make_points(strcmp(self->how, "nan") == 0 ? NAN : 4.0);
    if (emit_cloud(firing, strcmp(self->how, "port") == 0 ? 7 : 0, &points) != OSTEOFLOW_OK) {
        return OSTEOFLOW_FAILED;
    }
    if (strcmp(self->how, "twice") == 0) {
        const osteoflow_column more = make_points(4.0);
        return emit_cloud(firing, 0, &more);
    }
    return emit_address(firing, 1, points.data);
}

static int32_t released(void *node, const osteoflow_firing *firing) {
    source *self = node;
    if (self->answered) {
        return OSTEOFLOW_END;
    }
    self->answered = 1;
    char said[64];
    snprintf(said, sizeof said, "%d of %d", atomic_load(&n_released), atomic_load(&n_made));
    return emit_text(firing, 0, said);
}

static const osteoflow_input cloud_in[] = {
    { .name = OSTEOFLOW_TEXT("cloud"), .doc = OSTEOFLOW_TEXT("A cloud."), .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION },
};
static const osteoflow_output text_out[] = {
    { .name = OSTEOFLOW_TEXT("text"), .doc = OSTEOFLOW_TEXT("What was seen."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_WORDS), .version = OSTEOFLOW_WORDS_VERSION },
};
/* Kinds with one output use the first only. */
static const osteoflow_output cloud_out[] = {
    { .name = OSTEOFLOW_TEXT("cloud"), .doc = OSTEOFLOW_TEXT("A cloud."), .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION },
    { .name = OSTEOFLOW_TEXT("text"), .doc = OSTEOFLOW_TEXT("Where its points lie."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_WORDS), .version = OSTEOFLOW_WORDS_VERSION },
};

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("c.address"), .doc = OSTEOFLOW_TEXT("Where the points of a cloud lie."),
      .inputs = cloud_in, .n_inputs = 1, .outputs = text_out, .n_outputs = 1,
      .create = create, .fire = address, .destroy = free },
    { .kind = OSTEOFLOW_TEXT("c.hand_on"), .doc = OSTEOFLOW_TEXT("The same points, labelled."),
      .inputs = cloud_in, .n_inputs = 1, .outputs = cloud_out, .n_outputs = 1,
      .create = create, .fire = hand_on, .destroy = free },
    { .kind = OSTEOFLOW_TEXT("c.give"), .doc = OSTEOFLOW_TEXT("A cloud of its own."),
      .params_schema = OSTEOFLOW_TEXT("{ \"type\": \"object\", \"properties\": { \"how\": { \"type\": \"string\" } } }"),
      .outputs = cloud_out, .n_outputs = 2, .role = OSTEOFLOW_ROLE_SOURCE,
      .create = create, .fire = give, .destroy = free },
    { .kind = OSTEOFLOW_TEXT("c.released"), .doc = OSTEOFLOW_TEXT("How many of the clouds were released."),
      .outputs = text_out, .n_outputs = 1, .role = OSTEOFLOW_ROLE_SOURCE,
      .create = create, .fire = released, .destroy = free },
};

OSTEOFLOW_PLUGIN("address", "1", kinds)
