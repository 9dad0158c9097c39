/*
 * A node in C as a starting point: my_plugin.tre is a metric. Change it, run make, run the graph. Read from the end, where the
 * kinds of the plugin are listed.
 */
#include "osteoflow_geometry.h"

#include <math.h>
#include <stdio.h>

/* The state of a node: its parameter. */
typedef struct tre {
    double limit_mm;
} tre;

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    tre *self = malloc(sizeof *self);
    if (self == NULL) {
        return osteoflow_fail(firing, "there is no memory for the node");
    }
    /* It exists: the program has checked it against the schema below, which has the default. */
    self->limit_mm = osteoflow_param_number(firing, "limit_mm", NAN);
    *node = self;
    return OSTEOFLOW_OK;
}

/* The distance from a point to the place where a registration takes it, if the true one is `truth`. */
static double error_mm(const double pose[7], const double truth[7], const double p[3]) {
    const double back[7] = { 0.0, 0.0, 0.0, -truth[3], -truth[4], -truth[5], truth[6] };
    double q[3] = { p[0] - truth[0], p[1] - truth[1], p[2] - truth[2] };
    osteoflow_move(back, q, q);
    osteoflow_move(pose, q, q);
    const double x = q[0] - p[0], y = q[1] - p[1], z = q[2] - p[2];
    return sqrt(x * x + y * y + z * z);
}

static int same(osteoflow_text a, osteoflow_text b) {
    return a.length == b.length && memcmp(a.data, b.data, a.length) == 0;
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    const tre *self = node;
    osteoflow_view planned, found, known;
    if (osteoflow_input_view(firing, 0, &planned) != OSTEOFLOW_OK || osteoflow_input_view(firing, 1, &found) != OSTEOFLOW_OK ||
        osteoflow_input_view(firing, 2, &known) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "an input cannot be read");
    }
    const osteoflow_pose *pose = found.head, *truth = known.head;
    const osteoflow_text frame = ((const osteoflow_points *)planned.head)->frame;
    if (!same(pose->to, truth->to) || !same(pose->from, truth->from) || !same(pose->to, frame)) {
        char message[256];
        snprintf(message, sizeof message, "the poses map %.*s -> %.*s and %.*s -> %.*s, which does not fit points in %.*s",
                 (int)pose->from.length, pose->from.data, (int)pose->to.length, pose->to.data, (int)truth->from.length,
                 truth->from.data, (int)truth->to.length, truth->to.data, (int)frame.length, frame.data);
        return osteoflow_fail(firing, message);
    }
    const osteoflow_column *points = osteoflow_find_column(&planned, "positions", OSTEOFLOW_F64, 3);
    if (points == NULL || points->n_rows == 0) {
        return osteoflow_fail(firing, "there are no points to evaluate the error at; does the plan have some?");
    }
    double sum = 0.0, max = 0.0, n_good = 0.0;
    for (uint64_t i = 0; i < points->n_rows; i++) {
        const double off_mm = error_mm(pose->isometry, truth->isometry, (const double *)points->data + 3 * i);
        sum += off_mm;
        max = fmax(max, off_mm);
        n_good += off_mm <= self->limit_mm;
    }
    /* Numbers of results.json: names and units, one a line. */
    const double n = (double)points->n_rows, numbers[] = { sum / n, max, n_good / n };
    const osteoflow_metrics report = { OSTEOFLOW_TEXT("mean\nmax\nshare_good"), OSTEOFLOW_TEXT("mm\nmm\n") };
    const osteoflow_column values = osteoflow_copied_column("values", OSTEOFLOW_F64, 1, numbers, 3);
    const osteoflow_view answer = { &report, sizeof report, &values, 1 };
    return firing->host->emit(firing->run, 0, &answer);
}

static const osteoflow_input inputs[] = {
    { .name = OSTEOFLOW_TEXT("planned"),
      .doc = OSTEOFLOW_TEXT("Points on the bone at which the error is evaluated."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_POINTS),
      .version = OSTEOFLOW_POINTS_VERSION,
      .join = OSTEOFLOW_JOIN_ONCE },
    { .name = OSTEOFLOW_TEXT("t_ct_world"),
      .doc = OSTEOFLOW_TEXT("The registration."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_POSE),
      .version = OSTEOFLOW_POSE_VERSION,
      .to = OSTEOFLOW_TEXT("planned"),
      .from = OSTEOFLOW_TEXT("t_ct_world_true.from") },
    { .name = OSTEOFLOW_TEXT("t_ct_world_true"),
      .doc = OSTEOFLOW_TEXT("The true registration."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_POSE),
      .version = OSTEOFLOW_POSE_VERSION,
      .join = OSTEOFLOW_JOIN_ONCE,
      .to = OSTEOFLOW_TEXT("planned"),
      .from = OSTEOFLOW_TEXT("t_ct_world.from") },
};

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("report"),
      .doc = OSTEOFLOW_TEXT("Mean and largest error, and the share of good points."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_METRICS),
      .version = OSTEOFLOW_METRICS_VERSION },
};

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("my_plugin.tre"),
      .doc = OSTEOFLOW_TEXT("Target registration error: the distances by which a registration misplaces points, where the true "
                            "one is known."),
      .params_schema = OSTEOFLOW_TEXT(
          "{ \"type\": \"object\", \"additionalProperties\": false, \"properties\": { "
          "\"limit_mm\": { \"type\": \"number\", \"default\": 1.5, \"minimum\": 0.0, \"maximum\": 1000.0, "
          "\"description\": \"Points off by at most this much are good. 1.5: half of what a cut may be off.\" } } }"),
      .example = OSTEOFLOW_TEXT("kind = \"my_plugin.tre\"\n"
                                "in   = { planned = \"plan.assessment\", t_ct_world = \"planes_at_scan.t_ct_world\", "
                                "t_ct_world_true = \"recording.t_ct_world_true\" }\n"
                                "limit_mm = 1.5\n"),
      .inputs = inputs,
      .n_inputs = 3,
      .outputs = outputs,
      .n_outputs = 1,
      .role = OSTEOFLOW_ROLE_NODE,
      .create = create,
      .fire = fire,
      .destroy = free },
};

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
