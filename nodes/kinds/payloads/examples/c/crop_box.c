/*
 * crop_c.box: the built-in crop.box, written in C. It gives the same cloud to the last bit.
 *
 *   cc -std=c11 -O2 -shared -fPIC -I engine/node/include -I nodes/kinds/payloads/include \
 *      nodes/kinds/payloads/examples/c/crop_box.c -o libcrop_box.so
 *
 * Read from the end, which describes the plugin and refers to the functions above.
 */
#include "osteoflow_geometry.h"

#include <math.h>
#include <stdio.h>

/* A node: its parameters. */
typedef struct box {
    double min[3];
    double max[3];
} box;

/* The corner of a parameter, or no bound if the graph does not set it. */
static void corner(const osteoflow_firing *firing, const char *name, double unbounded, double out[3]) {
    osteoflow_param param;
    firing->host->param(firing->run, osteoflow_text_of(name), &param);
    for (int k = 0; k < 3; k++) {
        /* The schema below has been checked: a list has three numbers. */
        out[k] = param.what == OSTEOFLOW_PARAM_NUMBERS ? param.numbers.data[k] : unbounded;
    }
}

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    box *self = malloc(sizeof *self);
    if (self == NULL) {
        return osteoflow_fail(firing, "there is no memory for the node");
    }
    corner(firing, "min_mm", -INFINITY, self->min);
    corner(firing, "max_mm", INFINITY, self->max);
    for (int k = 0; k < 3; k++) {
        if (self->min[k] >= self->max[k]) {
            char message[128];
            snprintf(message, sizeof message, "%c reaches from %g to %g; min is below max", "xyz"[k], self->min[k],
                     self->max[k]);
            /* The parameter at fault is named, so that the program can point at its line. */
            firing->host->fail(firing->run, osteoflow_text_of("min_mm"), osteoflow_text_of(message));
            free(self);
            return OSTEOFLOW_FAILED;
        }
    }
    *node = self;
    return OSTEOFLOW_OK;
}

static void destroy(void *node) {
    free(node);
}

static int inside(const double min[3], const double max[3], const double point[3]) {
    for (int k = 0; k < 3; k++) {
        if (!(min[k] <= point[k] && point[k] <= max[k])) {
            return 0;
        }
    }
    return 1;
}

/* Copies the chosen rows of a column. */
static int select_rows(const osteoflow_column *from, const uint64_t *chosen, uint64_t n, osteoflow_column *to) {
    const size_t row = (size_t)osteoflow_type_size(from->type) * from->width;
    char *rows = malloc(n * row);
    if (rows == NULL) {
        return 0;
    }
    for (uint64_t i = 0; i < n; i++) {
        memcpy(rows + i * row, (const char *)from->data + chosen[i] * from->stride, row);
    }
    *to = osteoflow_malloced_column(from->name, from->type, from->width, rows, n);
    return 1;
}

/* Answers with the chosen rows of every column, and the head unchanged. */
static int32_t emit_selected(const osteoflow_firing *firing, const osteoflow_view *cloud, const uint64_t *chosen,
                             uint64_t n) {
    osteoflow_column *columns = malloc(cloud->n_columns * sizeof *columns);
    uint64_t made = 0;
    while (columns != NULL && made < cloud->n_columns &&
           select_rows(&cloud->columns[made], chosen, n, &columns[made])) {
        made++;
    }
    int32_t answer;
    if (made == cloud->n_columns) {
        const osteoflow_view out = { cloud->head, cloud->head_size, columns, made };
        /* From here on the program frees the rows, also if it refuses the cloud. */
        answer = firing->host->emit(firing->run, 0, &out);
    } else {
        for (uint64_t i = 0; i < made; i++) {
            free(columns[i].owner.self);
        }
        answer = osteoflow_fail(firing, "there is no memory for the cropped cloud");
    }
    free(columns);
    return answer;
}

/* Fails with the reason for an empty crop. */
static int32_t fail_empty(const osteoflow_firing *firing, const osteoflow_cloud *cloud, uint64_t n_points) {
    char message[256];
    snprintf(message, sizeof message,
             "none of %llu points lies in the region of interest; is it given in mm, in %.*s?",
             (unsigned long long)n_points, (int)cloud->frame.length, cloud->frame.data);
    return osteoflow_fail(firing, message);
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    const box *self = node;
    osteoflow_view view, drawn;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "the cloud cannot be read");
    }
    const osteoflow_cloud *cloud = view.head;
    const osteoflow_column *points = osteoflow_find_column(&view, "points", OSTEOFLOW_F64, 3);
    if (points == NULL) {
        return osteoflow_fail(firing, "the cloud has no column \"points\" of three doubles");
    }
    /* The second port is optional: there may be no region. */
    const osteoflow_region *region = NULL;
    if (osteoflow_input_view(firing, 1, &drawn) == OSTEOFLOW_OK) {
        region = drawn.head;
        if (region->frame.length != cloud->frame.length ||
            memcmp(region->frame.data, cloud->frame.data, cloud->frame.length) != 0) {
            return osteoflow_fail(firing, "the region of interest is not in the frame of the cloud");
        }
    }
    uint64_t *chosen = malloc((points->n_rows + 1) * sizeof *chosen);
    if (chosen == NULL) {
        return osteoflow_fail(firing, "there is no memory for the choice of points");
    }
    uint64_t n = 0;
    for (uint64_t i = 0; i < points->n_rows; i++) {
        const double *point = (const double *)points->data + 3 * i;
        if (inside(self->min, self->max, point) && (region == NULL || inside(region->min, region->max, point))) {
            chosen[n++] = i;
        }
    }
    int32_t answer;
    if (n == 0) {
        answer = fail_empty(firing, cloud, points->n_rows);
    } else if (n == points->n_rows) {
        /* All points are inside: the input is passed on without a copy. */
        answer = firing->host->emit_value(firing->run, 0, firing->slots[0].items[0].value);
    } else {
        answer = emit_selected(firing, &view, chosen, n);
    }
    free(chosen);
    return answer;
}

/* The ports of crop.box, so that one word in a graph swaps the two. */
static const osteoflow_input inputs[] = {
    { .name = OSTEOFLOW_TEXT("cloud"),
      .doc = OSTEOFLOW_TEXT("The cloud to crop."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION,
      .join = OSTEOFLOW_JOIN_EACH },
    { .name = OSTEOFLOW_TEXT("region"),
      .doc = OSTEOFLOW_TEXT("A region that was drawn beside the recording; only what lies in it, too, is kept. None: the "
                            "parameters alone."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_REGION),
      .version = OSTEOFLOW_REGION_VERSION,
      .flags = OSTEOFLOW_INPUT_OPTIONAL,
      .join = OSTEOFLOW_JOIN_ONCE,
      .frame = OSTEOFLOW_TEXT("cloud") },
};

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("cloud"),
      .doc = OSTEOFLOW_TEXT("What lies in the region."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION,
      .frame = OSTEOFLOW_TEXT("cloud") },
};

#define CORNER(name, doc)                                                                                              \
    "\"" name "\": { \"description\": \"" doc "\", \"type\": [\"array\", \"null\"], \"items\": { \"type\": \"number\" }, " \
    "\"minItems\": 3, \"maxItems\": 3, \"default\": null }"

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("crop_c.box"),
      .doc = OSTEOFLOW_TEXT("What lies in a box along the axes of the cloud's frame.\n\n"
                            "Without parameters and without a region everything is kept."),
      .params_schema = OSTEOFLOW_TEXT(
          "{ \"type\": \"object\", \"additionalProperties\": false, \"properties\": { "
          CORNER("min_mm", "The corner with the smallest x, y, z. Unset: no bound.") ", "
          CORNER("max_mm", "The corner with the largest x, y, z. Unset: no bound.") " } }"),
      .example = OSTEOFLOW_TEXT("kind = \"crop_c.box\"\n"
                                "in   = { cloud = \"recording.scan\", region = \"recording.region\" }\n"
                                "min_mm = [-60.0, -40.0, 150.0]\n"
                                "max_mm = [60.0, 40.0, 250.0]\n"),
      .inputs = inputs,
      .n_inputs = 2,
      .outputs = outputs,
      .n_outputs = 1,
      .role = OSTEOFLOW_ROLE_NODE,
      .create = create,
      .fire = fire,
      .destroy = destroy },
};

OSTEOFLOW_PLUGIN("crop_box", "1.0.0", kinds)
