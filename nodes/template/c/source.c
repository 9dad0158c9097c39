/*
 * A source in C as a starting point: my_plugin.xyz reads a file of points. Change it, run make, run the graph. Read from the end,
 * where the kinds of the plugin are listed.
 */
#include "osteoflow_geometry.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>

/* The state of a node: its parameters, and whether it has given its cloud. */
typedef struct xyz {
    char *path, *frame;
    double unit_mm;
    int done;
} xyz;

static void destroy(void *node) {
    xyz *self = node;
    free(self->path);
    free(self->frame);
    free(self);
}

/* A copy of a text parameter, which lives no longer than create() runs. */
static char *text_param(const osteoflow_firing *firing, const char *name) {
    osteoflow_param param;
    firing->host->param(firing->run, osteoflow_text_of(name), &param);
    char *copy = calloc(param.text.length + 1, 1);
    if (copy != NULL) {
        memcpy(copy, param.text.data, param.text.length);
    }
    return copy;
}

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    xyz *self = calloc(1, sizeof *self);
    if (self == NULL) {
        return osteoflow_fail(firing, "there is no memory for the node");
    }
    /* All exist: the program has checked them against the schema below, which has the defaults. */
    self->path = text_param(firing, "path");
    self->frame = text_param(firing, "frame");
    self->unit_mm = osteoflow_param_number(firing, "unit_mm", NAN);
    if (self->path == NULL || self->frame == NULL) {
        destroy(self);
        return osteoflow_fail(firing, "there is no memory for the node");
    }
    *node = self;
    return OSTEOFLOW_OK;
}

/* Reads the points of a file, three numbers in mm each, into a block from malloc. NULL with a message, if there is a fault. */
static double *read_points(const char *path, double unit_mm, uint64_t *n, char *message, size_t size) {
    FILE *file = fopen(path, "r");
    if (file == NULL) {
        snprintf(message, size, "%s: cannot be read: %s", path, strerror(errno));
        return NULL;
    }
    double *points = NULL;
    uint64_t room = 0;
    char line[512];
    *n = 0;
    message[0] = '\0';
    for (unsigned long number = 1; message[0] == '\0' && fgets(line, sizeof line, file) != NULL; number++) {
        if (strchr(line, '\n') == NULL) {
            snprintf(message, size, "%s:%lu: the last line does not end, or is too long; is the file whole?", path, number);
            break;
        }
        line[strcspn(line, "#\r\n")] = '\0';
        char *at = line + strspn(line, " \t");
        if (*at == '\0') {
            continue;
        }
        if (*n == room) {
            room = 2 * room + 1000;
            double *more = realloc(points, room * 3 * sizeof *points);
            if (more == NULL) {
                snprintf(message, size, "%s:%lu: there is no memory for more points", path, number);
                break;
            }
            points = more;
        }
        int good = 1;
        for (int k = 0; k < 3; k++) {
            char *end = at;
            const double coordinate = strtod(at, &end) * unit_mm;
            good = good && end > at && isfinite(coordinate);
            points[3 * *n + (uint64_t)k] = coordinate;
            at = end;
        }
        if (!good || at[strspn(at, " \t")] != '\0') {
            snprintf(message, size, "%s:%lu: three numbers are expected, found \"%s\"", path, number, line);
        }
        ++*n;
    }
    if (ferror(file)) {
        snprintf(message, size, "%s: cannot be read to its end: %s", path, strerror(errno));
    } else if (message[0] == '\0' && *n == 0) {
        snprintf(message, size, "%s:1: the file has no points", path);
    }
    fclose(file);
    if (message[0] != '\0') {
        free(points);
        return NULL;
    }
    return points;
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    xyz *self = node;
    if (self->done) {
        return OSTEOFLOW_END;
    }
    self->done = 1;
    char message[4096];
    uint64_t n;
    double *points = read_points(self->path, self->unit_mm, &n, message, sizeof message);
    if (points == NULL) {
        return osteoflow_fail(firing, message);
    }
    /* Neither stamp nor label nor viewpoint. */
    const osteoflow_cloud cloud = { .frame = osteoflow_text_of(self->frame) };
    const osteoflow_column column = osteoflow_malloced_column(osteoflow_text_of("points"), OSTEOFLOW_F64, 3, points, n);
    const osteoflow_view answer = { &cloud, sizeof cloud, &column, 1 };
    return firing->host->emit(firing->run, 0, &answer);
}

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("cloud"),
      .doc = OSTEOFLOW_TEXT("The points, once, in the order of the file."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION,
      .frame = OSTEOFLOW_TEXT("$frame") },
};

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("my_plugin.xyz"),
      .doc = OSTEOFLOW_TEXT("The points of a text file: one per line, x y z, separated by spaces; `#` begins a comment.\n\n"
                            "The last line must end, since a file that was cut within its last number would otherwise give a "
                            "wrong point."),
      .params_schema = OSTEOFLOW_TEXT(
          "{ \"type\": \"object\", \"additionalProperties\": false, \"required\": [\"path\"], \"properties\": { "
          "\"path\": { \"type\": \"string\", \"format\": \"input-path\", \"description\": \"The file.\" }, "
          "\"frame\": { \"type\": \"string\", \"default\": \"camera\", \"description\": \"The frame of its coordinates. camera: "
          "a scan is in the frame of the camera that made it.\" }, "
          "\"unit_mm\": { \"type\": \"number\", \"default\": 1.0, \"minimum\": 1e-6, \"maximum\": 1e6, "
          "\"description\": \"Millimetres in the file's unit. 1: the file is in mm; 1000: in metres.\" } } }"),
      .example = OSTEOFLOW_TEXT("kind  = \"my_plugin.xyz\"\n"
                                "path  = \"points.xyz\"\n"
                                "frame = \"bone_marker\"\n"),
      .outputs = outputs,
      .n_outputs = 1,
      .role = OSTEOFLOW_ROLE_SOURCE,
      /* One item, which other nodes may join once. */
      .flags = OSTEOFLOW_KIND_CONSTANT,
      .create = create,
      .fire = fire,
      .destroy = destroy },
};

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
