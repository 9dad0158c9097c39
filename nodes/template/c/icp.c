/*
 * A node in C as a starting point: my_plugin.point_to_plane is an ICP. Change it, run make, run the graph. Read from the end,
 * where the kinds of the plugin are listed.
 */
#include "osteoflow_geometry.h"

#include <math.h>
#include <stdio.h>

/* Fewer pairs determine six unknowns, but leave no redundancy. */
#define MIN_PAIRS 10

/* The state of a node: its parameters. */
typedef struct icp {
    double max_pair_distance_mm, stop_step_mm;
    uint64_t max_iterations, n_points;
} icp;

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    icp *self = malloc(sizeof *self);
    if (self == NULL) {
        return osteoflow_fail(firing, "there is no memory for the node");
    }
    /* All exist: the program has checked them against the schema below, which has the defaults. */
    self->max_pair_distance_mm = osteoflow_param_number(firing, "max_pair_distance_mm", NAN);
    self->stop_step_mm = osteoflow_param_number(firing, "stop_step_mm", NAN);
    self->max_iterations = (uint64_t)osteoflow_param_number(firing, "max_iterations", 1);
    self->n_points = (uint64_t)osteoflow_param_number(firing, "n_points", 1);
    *node = self;
    return OSTEOFLOW_OK;
}

/* A point of the target, and its row. */
typedef struct place {
    double p[3];
    uint64_t row;
} place;

static int by_x(const void *a, const void *b) {
    const double x = ((const place *)a)->p[0], y = ((const place *)b)->p[0];
    return (x > y) - (x < y);
}

/* The row of the place nearest to p; n if none has a squared distance below `limit`. The places are sorted by x, so only those
 * on either side whose x alone is not too far off are looked at. */
static uint64_t nearest(const place *places, uint64_t n, const double p[3], double limit) {
    uint64_t low = 0, high = n, found = n;
    while (low < high) {
        const uint64_t middle = low + (high - low) / 2;
        if (places[middle].p[0] < p[0]) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    for (int up = 0; up < 2; up++) {
        for (uint64_t i = low; up ? i < n : i > 0; i = up ? i + 1 : i - 1) {
            const place *q = &places[up ? i : i - 1];
            const double x = q->p[0] - p[0], y = q->p[1] - p[1], z = q->p[2] - p[2], square = x * x + y * y + z * z;
            if (x * x >= limit) {
                break;
            }
            if (square < limit) {
                limit = square;
                found = q->row;
            }
        }
    }
    return found;
}

static double norm(const double v[3]) {
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* The sums of the pairs of a step: six equations, and their right-hand side in the last column. */
typedef struct sums {
    double rows[6][7], squares, reach;
    uint64_t n;
} sums;

/* Adds a moved point, its pair on the target and the normal there. Turns are about `centre`. */
static void add(sums *s, const double p[3], const double q[3], const double normal[3], const double centre[3]) {
    const double a[3] = { p[0] - centre[0], p[1] - centre[1], p[2] - centre[2] };
    const double row[7] = { a[1] * normal[2] - a[2] * normal[1],
                            a[2] * normal[0] - a[0] * normal[2],
                            a[0] * normal[1] - a[1] * normal[0],
                            normal[0],
                            normal[1],
                            normal[2],
                            (q[0] - p[0]) * normal[0] + (q[1] - p[1]) * normal[1] + (q[2] - p[2]) * normal[2] };
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j < 7; j++) {
            s->rows[i][j] += row[i] * row[j];
        }
    }
    s->squares += row[6] * row[6];
    s->reach = fmax(s->reach, norm(a));
    s->n++;
}

/* The turn (rad) and the shift (mm) that minimise the distances along the normals, by Gauss-Jordan elimination; 0 if the pairs
 * leave a motion free. */
static int solve(double rows[6][7], double x[6]) {
    for (int k = 0; k < 6; k++) {
        int pivot = k;
        for (int i = k + 1; i < 6; i++) {
            pivot = fabs(rows[i][k]) > fabs(rows[pivot][k]) ? i : pivot;
        }
        if (!(fabs(rows[pivot][k]) > 1e-9)) {
            return 0;
        }
        for (int j = 0; j < 7; j++) {
            const double other = rows[k][j];
            rows[k][j] = rows[pivot][j];
            rows[pivot][j] = other;
        }
        for (int i = 0; i < 6; i++) {
            const double factor = i == k ? 0.0 : rows[i][k] / rows[k][k];
            for (int j = k; j < 7; j++) {
                rows[i][j] -= factor * rows[k][j];
            }
        }
    }
    for (int k = 0; k < 6; k++) {
        x[k] = rows[k][6] / rows[k][k];
    }
    return 1;
}

/* Turns a pose about a centre, by a vector of the length of the angle, then shifts it. */
static void move(double t[7], const double turn[3], const double shift[3], const double centre[3]) {
    const double angle = norm(turn), s = angle > 0.0 ? sin(angle / 2.0) / angle : 0.5;
    const double r[7] = { 0.0, 0.0, 0.0, turn[0] * s, turn[1] * s, turn[2] * s, cos(angle / 2.0) };
    const double arm[3] = { t[0] - centre[0], t[1] - centre[1], t[2] - centre[2] };
    const double *a = r + 3, *b = t + 3;
    const double q[4] = { a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
                          a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
                          a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
                          a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2] };
    const double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    osteoflow_move(r, arm, t);
    for (int k = 0; k < 4; k++) {
        t[k] += k < 3 ? centre[k] + shift[k] : 0.0;
        t[3 + k] = q[k] / length;
    }
}

static int same(osteoflow_text a, osteoflow_text b) {
    return a.length == b.length && memcmp(a.data, b.data, a.length) == 0;
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    const icp *self = node;
    osteoflow_view source, target, init;
    if (osteoflow_input_view(firing, 0, &source) != OSTEOFLOW_OK || osteoflow_input_view(firing, 1, &target) != OSTEOFLOW_OK ||
        osteoflow_input_view(firing, 2, &init) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "an input cannot be read");
    }
    osteoflow_pose pose = *(const osteoflow_pose *)init.head;
    char message[256];
    const osteoflow_text to = ((const osteoflow_target *)target.head)->frame, from = ((const osteoflow_cloud *)source.head)->frame;
    if (!same(pose.to, to) || !same(pose.from, from)) {
        snprintf(message, sizeof message, "init maps %.*s -> %.*s, but source is in %.*s and target in %.*s",
                 (int)pose.from.length, pose.from.data, (int)pose.to.length, pose.to.data, (int)from.length, from.data,
                 (int)to.length, to.data);
        return osteoflow_fail(firing, message);
    }
    const osteoflow_column *points = osteoflow_find_column(&target, "points", OSTEOFLOW_F64, 3);
    const osteoflow_column *normals = osteoflow_find_column(&target, "normals", OSTEOFLOW_F64, 3);
    const osteoflow_column *scan = osteoflow_find_column(&source, "points", OSTEOFLOW_F64, 3);
    if (points == NULL || normals == NULL || scan == NULL || scan->n_rows < MIN_PAIRS) {
        return osteoflow_fail(firing, "the source has no ten points, or the target no normals; is the crop empty?");
    }
    place *places = malloc((points->n_rows + 1) * sizeof *places);
    if (places == NULL) {
        return osteoflow_fail(firing, "there is no memory for the points of the target");
    }
    for (uint64_t i = 0; i < points->n_rows; i++) {
        memcpy(places[i].p, (const double *)points->data + 3 * i, sizeof places[i].p);
        places[i].row = i;
    }
    qsort(places, points->n_rows, sizeof *places, by_x);
    const double *all = scan->data, *at = points->data, *up = normals->data;
    const double limit = self->max_pair_distance_mm * self->max_pair_distance_mm;
    const uint64_t stride = scan->n_rows > self->n_points ? scan->n_rows / self->n_points : 1;
    const char *fault = NULL;
    int converged = 0;
    uint64_t iterations = 0;
    sums s = { 0 };
    while (!converged && fault == NULL && iterations < self->max_iterations) {
        double centre[3], p[3], step[6];
        memset(&s, 0, sizeof s);
        osteoflow_move(pose.isometry, all + 3 * (scan->n_rows / 2), centre);
        for (uint64_t i = 0; i < scan->n_rows; i += stride) {
            osteoflow_move(pose.isometry, all + 3 * i, p);
            const uint64_t found = nearest(places, points->n_rows, p, limit);
            if (found < points->n_rows) {
                add(&s, p, at + 3 * found, up + 3 * found, centre);
            }
        }
        if (firing->host->cancelled(firing->run)) {
            fault = "interrupted";
        } else if (s.n < MIN_PAIRS) {
            fault = "fewer than ten source points lie near the target; is init right, and are both in mm?";
        } else if (!solve(s.rows, step)) {
            fault = "the pairs leave a motion free, as on a plane; scan more of the bone";
        } else {
            move(pose.isometry, step, step + 3, centre);
            /* No point moves by more. */
            converged = norm(step + 3) + norm(step) * s.reach < self->stop_step_mm;
            iterations++;
        }
    }
    free(places);
    if (fault != NULL) {
        return osteoflow_fail(firing, fault);
    }
    pose.stamp_ns = firing->host->stamp_ns(firing->run);
    const osteoflow_view answer = { &pose, sizeof pose, NULL, 0 };
    if (firing->host->emit(firing->run, 0, &answer) != OSTEOFLOW_OK) {
        return OSTEOFLOW_FAILED;
    }
    /* The verdict of a run reads `converged` and `stop_reason`. */
    snprintf(message, sizeof message,
             "{\"converged\":%s,\"stop_reason\":\"%s\",\"iterations\":%llu,\"n_pairs\":%llu,\"rms_mm\":%.17g}",
             converged ? "true" : "false", converged ? "step" : "max_iterations", (unsigned long long)iterations,
             (unsigned long long)s.n, sqrt(s.squares / (double)s.n));
    const osteoflow_json json = { osteoflow_text_of(message) };
    const osteoflow_view report = { &json, sizeof json, NULL, 0 };
    return firing->host->emit(firing->run, 1, &report);
}

/* The ports of every ICP, so that graphs can switch to this one by its kind. */
static const osteoflow_input inputs[] = {
    { .name = OSTEOFLOW_TEXT("source"),
      .doc = OSTEOFLOW_TEXT("The scan, cropped."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION },
    { .name = OSTEOFLOW_TEXT("target"),
      .doc = OSTEOFLOW_TEXT("The CT surface."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_TARGET),
      .version = OSTEOFLOW_TARGET_VERSION,
      .join = OSTEOFLOW_JOIN_ONCE,
      .frame = OSTEOFLOW_TEXT("init.to") },
    { .name = OSTEOFLOW_TEXT("init"),
      .doc = OSTEOFLOW_TEXT("The start."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_POSE),
      .version = OSTEOFLOW_POSE_VERSION,
      .to = OSTEOFLOW_TEXT("target"),
      .from = OSTEOFLOW_TEXT("source") },
};

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("t_target_source"),
      .doc = OSTEOFLOW_TEXT("The registration."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_POSE),
      .version = OSTEOFLOW_POSE_VERSION,
      .to = OSTEOFLOW_TEXT("target"),
      .from = OSTEOFLOW_TEXT("source") },
    { .name = OSTEOFLOW_TEXT("report"),
      .doc = OSTEOFLOW_TEXT("Convergence of the fit."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_JSON),
      .version = OSTEOFLOW_JSON_VERSION },
};

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("my_plugin.point_to_plane"),
      .doc = OSTEOFLOW_TEXT("Registers a scan onto the CT surface by point-to-plane ICP.\n\n"
                            "Each step pairs points of the scan with the nearest points of the surface, and minimises the "
                            "distances along its normals."),
      .params_schema = OSTEOFLOW_TEXT(
          "{ \"type\": \"object\", \"additionalProperties\": false, \"properties\": { "
          "\"max_pair_distance_mm\": { \"type\": \"number\", \"default\": 5.0, \"minimum\": 0.001, \"maximum\": 1000.0, "
          "\"description\": \"Pairs farther apart are left out. 5: less than half the bone.\" }, "
          "\"stop_step_mm\": { \"type\": \"number\", \"default\": 1e-3, \"minimum\": 1e-9, \"maximum\": 10.0, "
          "\"description\": \"Converged if a step moves no point by more. 1e-3: far below the noise of a camera.\" }, "
          "\"max_iterations\": { \"type\": \"integer\", \"default\": 500, \"minimum\": 1, \"maximum\": 100000, "
          "\"description\": \"Largest number of steps. 500: more than real bones need.\" }, "
          "\"n_points\": { \"type\": \"integer\", \"default\": 2000, \"minimum\": 10, \"maximum\": 1000000, "
          "\"description\": \"Number of points of the scan that are used, about. 2000: a tenth of a scan "
          "averages its noise out.\" } } }"),
      .example = OSTEOFLOW_TEXT("kind = \"my_plugin.point_to_plane\"\n"
                                "in   = { source = \"to_bone.cloud\", target = \"ct_surface.target\", "
                                "init = \"coarse.t_target_source\" }\n"
                                "max_pair_distance_mm = 5.0\n"),
      .inputs = inputs,
      .n_inputs = 3,
      .outputs = outputs,
      .n_outputs = 2,
      .role = OSTEOFLOW_ROLE_NODE,
      .create = create,
      .fire = fire,
      .destroy = free },
};

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
