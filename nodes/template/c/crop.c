/*
 * A node in C as a starting point: my_plugin.sphere keeps the points within a distance of a centre. Change it, run make, run
 * the graph. Read from the end, where the kinds of the plugin are listed. Unchanged, it gives the same points to the last bit as
 * the built-in crop.sphere with the same centre and radius.
 */
#include "osteoflow_geometry.h"

#include <math.h>
#include <stdio.h>

/* The state of a node: its parameters. */
typedef struct sphere {
    double centre[3];
    double radius;
} sphere;

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    sphere *self = malloc(sizeof *self);
    if (self == NULL) {
        return osteoflow_fail(firing, "there is no memory for the node");
    }
    /* Both exist: the program has checked them against the schema below. */
    osteoflow_param centre, radius;
    firing->host->param(firing->run, osteoflow_text_of("centre_mm"), &centre);
    memcpy(self->centre, centre.numbers.data, sizeof self->centre);
    firing->host->param(firing->run, osteoflow_text_of("radius_mm"), &radius);
    self->radius = radius.number;
    *node = self;
    return OSTEOFLOW_OK;
}

static void destroy(void *node) {
    free(node);
}

/* Writes the indices of the points to keep and returns their number; `chosen` has room for all. Change this. */
static uint64_t choose(const sphere *self, const double *points, uint64_t n_points, uint64_t *chosen) {
    uint64_t n = 0;
    for (uint64_t i = 0; i < n_points; i++) {
        const double x = points[3 * i] - self->centre[0];
        const double y = points[3 * i + 1] - self->centre[1];
        const double z = points[3 * i + 2] - self->centre[2];
        if (sqrt(x * x + y * y + z * z) <= self->radius) {
            chosen[n++] = i;
        }
    }
    return n;
}

/* Emits the chosen rows of every column: points, normals and all others. */
static int32_t emit_chosen(const osteoflow_firing *firing, const osteoflow_view *cloud, const uint64_t *chosen,
                           uint64_t n) {
    osteoflow_column *columns = malloc(cloud->n_columns * sizeof *columns);
    uint64_t made = 0;
    for (; columns != NULL && made < cloud->n_columns; made++) {
        const osteoflow_column *from = &cloud->columns[made];
        const size_t row = (size_t)osteoflow_type_size(from->type) * from->width;
        char *rows = malloc(n * row);
        if (rows == NULL) {
            break;
        }
        for (uint64_t i = 0; i < n; i++) {
            memcpy(rows + i * row, (const char *)from->data + chosen[i] * from->stride, row);
        }
        columns[made] = osteoflow_malloced_column(from->name, from->type, from->width, rows, n);
    }
    int32_t answer;
    if (made == cloud->n_columns) {
        /* The program now frees the rows, and copies the head: frame, stamp and viewpoint are unchanged. */
        const osteoflow_view out = { cloud->head, cloud->head_size, columns, made };
        answer = firing->host->emit(firing->run, 0, &out);
    } else {
        while (made > 0) {
            free(columns[--made].owner.self);
        }
        answer = osteoflow_fail(firing, "there is no memory for the cropped cloud");
    }
    free(columns);
    return answer;
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    osteoflow_view cloud;
    if (osteoflow_input_view(firing, 0, &cloud) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "the cloud cannot be read");
    }
    const osteoflow_column *points = osteoflow_find_column(&cloud, "points", OSTEOFLOW_F64, 3);
    if (points == NULL) {
        return osteoflow_fail(firing, "the cloud has no column \"points\" of three doubles");
    }
    uint64_t *chosen = malloc((points->n_rows + 1) * sizeof *chosen);
    if (chosen == NULL) {
        return osteoflow_fail(firing, "there is no memory for the indices");
    }
    const uint64_t n = choose(node, points->data, points->n_rows, chosen);
    int32_t answer;
    if (n > 0) {
        answer = emit_chosen(firing, &cloud, chosen, n);
    } else {
        /* An empty cloud is an error: give the reason and a next step. */
        char message[160];
        snprintf(message, sizeof message, "none of %llu points is within %g mm of the centre; is it given in mm?",
                 (unsigned long long)points->n_rows, ((const sphere *)node)->radius);
        answer = osteoflow_fail(firing, message);
    }
    free(chosen);
    return answer;
}

/* The ports of every crop, so that graphs can switch to this one by its kind. */
static const osteoflow_input inputs[] = {
    { .name = OSTEOFLOW_TEXT("cloud"),
      .doc = OSTEOFLOW_TEXT("The cloud to crop."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION,
      .join = OSTEOFLOW_JOIN_EACH },
    { .name = OSTEOFLOW_TEXT("region"),
      .doc = OSTEOFLOW_TEXT("Ignored."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_REGION),
      .version = OSTEOFLOW_REGION_VERSION,
      .flags = OSTEOFLOW_INPUT_UNUSED,
      .join = OSTEOFLOW_JOIN_ONCE },
};

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("cloud"),
      .doc = OSTEOFLOW_TEXT("The points in the sphere."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION,
      .frame = OSTEOFLOW_TEXT("cloud") },
};

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("my_plugin.sphere"),
      .doc = OSTEOFLOW_TEXT("Points within a distance of a centre."),
      .params_schema = OSTEOFLOW_TEXT(
          "{ \"type\": \"object\", \"additionalProperties\": false, \"required\": [\"centre_mm\", \"radius_mm\"], "
          "\"properties\": { "
          "\"centre_mm\": { \"type\": \"array\", \"items\": { \"type\": \"number\" }, \"minItems\": 3, \"maxItems\": 3, "
          "\"description\": \"The centre in the cloud's frame.\" }, "
          "\"radius_mm\": { \"type\": \"number\", \"minimum\": 0.001, \"maximum\": 1e6, "
          "\"description\": \"The radius.\" } } }"),
      .example = OSTEOFLOW_TEXT("kind = \"my_plugin.sphere\"\n"
                                "in   = { cloud = \"recording.scan\" }\n"
                                "centre_mm = [0.0, 0.0, 200.0]\n"
                                "radius_mm = 80.0\n"),
      .inputs = inputs,
      .n_inputs = 2,
      .outputs = outputs,
      .n_outputs = 1,
      .role = OSTEOFLOW_ROLE_NODE,
      .create = create,
      .fire = fire,
      .destroy = destroy },
};

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
