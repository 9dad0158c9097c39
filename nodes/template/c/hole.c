/*
 * A node in C as a starting point: my_plugin.difference is a hole detector. Change it, run make, run the graph. Read from the
 * end, where the kinds of the plugin are listed.
 */
#include "osteoflow_geometry.h"

#include <math.h>
#include <stdio.h>

/* Missing points at most this many times `radius_mm` apart are of one hole: more than the spacing of a scan. */
#define LINK 1.5

/* The state of a node: its parameters. */
typedef struct detector {
    double radius_mm;
    uint64_t min_points;
} detector;

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    detector *self = malloc(sizeof *self);
    if (self == NULL) {
        return osteoflow_fail(firing, "there is no memory for the node");
    }
    /* Both exist: the program has checked them against the schema below, which has the defaults. */
    self->radius_mm = osteoflow_param_number(firing, "radius_mm", NAN);
    self->min_points = (uint64_t)osteoflow_param_number(firing, "min_points", 3);
    *node = self;
    return OSTEOFLOW_OK;
}

static double square_distance(const double p[3], const double q[3]) {
    const double x = q[0] - p[0], y = q[1] - p[1], z = q[2] - p[2];
    return x * x + y * y + z * z;
}

/* Writes the points of `reference` that have no point of `cloud` nearer than a radius and returns their number; `missing` has
 * room for all. */
static uint64_t find_missing(const double *reference, uint64_t n, const double *cloud, uint64_t n_cloud, double radius,
                             const double **missing) {
    uint64_t n_missing = 0, at = 0;
    for (uint64_t i = 0; i < n; i++) {
        /* Neighbours follow each other, so the search begins where the last one ended. */
        uint64_t seen = 0;
        while (seen < n_cloud && square_distance(reference + 3 * i, cloud + 3 * at) > radius * radius) {
            at = (at + 1) % n_cloud;
            seen++;
        }
        if (seen == n_cloud) {
            missing[n_missing++] = reference + 3 * i;
        }
    }
    return n_missing;
}

static void swap(const double **points, uint64_t i, uint64_t j) {
    const double *other = points[i];
    points[i] = points[j];
    points[j] = other;
}

/* Orders points so that those connected by steps of at most `link` follow each other; returns the length of the largest such
 * patch, and its first point. */
static uint64_t largest_patch(const double **points, uint64_t n, double link, uint64_t *first) {
    uint64_t largest = 0;
    for (uint64_t begin = 0, end = 0; begin < n; begin = end) {
        end = begin + 1;
        for (uint64_t next = begin; next < end; next++) {
            for (uint64_t i = end; i < n; i++) {
                if (square_distance(points[next], points[i]) <= link * link) {
                    swap(points, i, end++);
                }
            }
        }
        if (end - begin > largest) {
            largest = end - begin;
            *first = begin;
        }
    }
    return largest;
}

/* Emits the centre of a hole, and the report. */
static int32_t emit_hole(const osteoflow_firing *firing, const osteoflow_cloud *cloud, const double **hole, uint64_t n,
                         uint64_t n_missing, double radius_mm) {
    double centre[3] = { 0.0, 0.0, 0.0 }, squares = 0.0;
    for (uint64_t i = 0; i < n; i++) {
        for (int k = 0; k < 3; k++) {
            centre[k] += hole[i][k] / (double)n;
        }
    }
    for (uint64_t i = 0; i < n; i++) {
        squares += square_distance(hole[i], centre);
    }
    const osteoflow_text name = cloud->label.data != NULL ? cloud->label : osteoflow_text_of("hole");
    const osteoflow_points point = { cloud->frame, cloud->stamp_ns, name };
    const double no_confidence = NAN;
    const osteoflow_column columns[] = {
        osteoflow_copied_column("positions", OSTEOFLOW_F64, 3, centre, 1),
        osteoflow_copied_column("stamps_ns", OSTEOFLOW_I64, 1, &cloud->stamp_ns, 1),
        osteoflow_copied_column("confidences", OSTEOFLOW_F64, 1, &no_confidence, 1),
    };
    const osteoflow_view out = { &point, sizeof point, columns, 3 };
    if (firing->host->emit(firing->run, 0, &out) != OSTEOFLOW_OK) {
        return OSTEOFLOW_FAILED;
    }
    /* A disc of radius r has a mean squared distance of r * r / 2 from its centre; points at its rim are not missing. */
    const double numbers[] = { (double)n_missing, (double)n, sqrt(2.0 * squares / (double)n) + radius_mm };
    const osteoflow_metrics report = { OSTEOFLOW_TEXT("n_missing\nn_hole\nhole_radius"), OSTEOFLOW_TEXT("\n\nmm") };
    const osteoflow_column values = osteoflow_copied_column("values", OSTEOFLOW_F64, 1, numbers, 3);
    const osteoflow_view answer = { &report, sizeof report, &values, 1 };
    return firing->host->emit(firing->run, 1, &answer);
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    const detector *self = node;
    osteoflow_view reference, cloud;
    if (osteoflow_input_view(firing, 0, &reference) != OSTEOFLOW_OK || osteoflow_input_view(firing, 1, &cloud) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "an input cannot be read");
    }
    char message[256];
    const osteoflow_cloud *head = cloud.head;
    const osteoflow_text frame = ((const osteoflow_cloud *)reference.head)->frame;
    if (frame.length != head->frame.length || memcmp(frame.data, head->frame.data, frame.length) != 0) {
        snprintf(message, sizeof message, "the scan with the laser is in %.*s, but the full scan in %.*s",
                 (int)head->frame.length, head->frame.data, (int)frame.length, frame.data);
        return osteoflow_fail(firing, message);
    }
    const osteoflow_column *all = osteoflow_find_column(&reference, "points", OSTEOFLOW_F64, 3);
    const osteoflow_column *left = osteoflow_find_column(&cloud, "points", OSTEOFLOW_F64, 3);
    const double **missing = all != NULL && left != NULL ? malloc((all->n_rows + 1) * sizeof *missing) : NULL;
    if (missing == NULL) {
        return osteoflow_fail(firing, "a cloud has no column \"points\" of three doubles, or there is no memory");
    }
    const uint64_t n_missing = find_missing(all->data, all->n_rows, left->data, left->n_rows, self->radius_mm, missing);
    uint64_t first = 0;
    const uint64_t n = largest_patch(missing, n_missing, LINK * self->radius_mm, &first);
    int32_t answer;
    if (n >= self->min_points) {
        answer = emit_hole(firing, head, missing + first, n, n_missing, self->radius_mm);
    } else {
        snprintf(message, sizeof message,
                 "%llu points are missing, %llu of them in one place, %llu are needed; is the laser on the bone?",
                 (unsigned long long)n_missing, (unsigned long long)n, (unsigned long long)self->min_points);
        answer = osteoflow_fail(firing, message);
    }
    free(missing);
    return answer;
}

/* The ports of every hole detector, so that graphs can switch to this one by its kind. */
static const osteoflow_input inputs[] = {
    { .name = OSTEOFLOW_TEXT("reference"),
      .doc = OSTEOFLOW_TEXT("The full scan."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION,
      .join = OSTEOFLOW_JOIN_ONCE,
      .frame = OSTEOFLOW_TEXT("cloud") },
    { .name = OSTEOFLOW_TEXT("cloud"),
      .doc = OSTEOFLOW_TEXT("A scan with the laser spot, labelled with the landmark's name."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION,
      .frame = OSTEOFLOW_TEXT("reference") },
};

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("point"),
      .doc = OSTEOFLOW_TEXT("The landmark under the spot, with its name."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_POINTS),
      .version = OSTEOFLOW_POINTS_VERSION,
      .frame = OSTEOFLOW_TEXT("cloud") },
    { .name = OSTEOFLOW_TEXT("report"),
      .doc = OSTEOFLOW_TEXT("Missing points, those of the hole, and its radius."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_METRICS),
      .version = OSTEOFLOW_METRICS_VERSION },
};

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("my_plugin.difference"),
      .doc = OSTEOFLOW_TEXT("The landmark under a laser spot: the centre of the largest patch of the full scan that the scan with "
                            "the laser lacks."),
      .params_schema = OSTEOFLOW_TEXT(
          "{ \"type\": \"object\", \"additionalProperties\": false, \"properties\": { "
          "\"radius_mm\": { \"type\": \"number\", \"default\": 1.0, \"minimum\": 0.01, \"maximum\": 20.0, "
          "\"description\": \"A point of the full scan is missing if the scan with the laser has none nearer. 1: twice the "
          "spacing of a scan.\" }, "
          "\"min_points\": { \"type\": \"integer\", \"default\": 15, \"minimum\": 3, \"maximum\": 100000, "
          "\"description\": \"Minimum number of points of a hole. 15: a spot of 2 mm radius leaves thirty.\" } } }"),
      .example = OSTEOFLOW_TEXT("kind = \"my_plugin.difference\"\n"
                                "in   = { reference = \"to_bone.cloud\", cloud = \"to_bone_laser.cloud\" }\n"
                                "radius_mm = 1.0\n"),
      .inputs = inputs,
      .n_inputs = 2,
      .outputs = outputs,
      .n_outputs = 2,
      .role = OSTEOFLOW_ROLE_NODE,
      .create = create,
      .fire = fire,
      .destroy = free },
};

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
