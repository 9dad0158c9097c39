/*
 * A sink in C as a starting point: my_plugin.xyz writes a file of points. Change it, run make, run the graph. Read from the end,
 * where the kinds of the plugin are listed.
 */
#include "osteoflow_geometry.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>

/* The state of a node: its parameter. */
typedef struct xyz {
    double unit_mm;
} xyz;

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    xyz *self = malloc(sizeof *self);
    if (self == NULL) {
        return osteoflow_fail(firing, "there is no memory for the node");
    }
    /* It exists: the program has checked it against the schema below, which has the default. */
    self->unit_mm = osteoflow_param_number(firing, "unit_mm", NAN);
    *node = self;
    return OSTEOFLOW_OK;
}

/* Writes points as lines of three numbers; 17 digits read back to the same bits. Returns 0 if that fails, see errno. */
static int write_points(const char *path, osteoflow_text frame, double unit_mm, const double *points, uint64_t n) {
    FILE *file = fopen(path, "w");
    if (file == NULL) {
        return 0;
    }
    int good = fprintf(file, "# frame %.*s, unit %.17g mm\n", (int)frame.length, frame.data, unit_mm) > 0;
    for (uint64_t i = 0; good && i < n; i++) {
        const double *p = points + 3 * i;
        good = fprintf(file, "%.17g %.17g %.17g\n", p[0] / unit_mm, p[1] / unit_mm, p[2] / unit_mm) > 0;
    }
    return fclose(file) == 0 && good;
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    const xyz *self = node;
    osteoflow_view cloud;
    if (osteoflow_input_view(firing, 0, &cloud) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "the cloud cannot be read");
    }
    const osteoflow_column *points = osteoflow_find_column(&cloud, "points", OSTEOFLOW_F64, 3);
    if (points == NULL) {
        return osteoflow_fail(firing, "the cloud has no column \"points\" of three doubles");
    }
    const osteoflow_text dir = firing->host->out_dir(firing->run), name = firing->host->node(firing->run);
    if (dir.data == NULL) {
        return osteoflow_fail(firing, "the run has no folder to write into; name one with --out");
    }
    char file[256], path[4096], message[4400];
    snprintf(file, sizeof file, "%.*s-%llu.xyz", (int)name.length, name.data,
             (unsigned long long)firing->host->item(firing->run));
    const int length = snprintf(path, sizeof path, "%.*s/%s", (int)dir.length, dir.data, file);
    if (length < 0 || (size_t)length >= sizeof path) {
        return osteoflow_fail(firing, "the path of the folder is too long; name another one with --out");
    }
    if (!write_points(path, ((const osteoflow_cloud *)cloud.head)->frame, self->unit_mm, points->data, points->n_rows)) {
        snprintf(message, sizeof message, "%s cannot be written: %s", path, strerror(errno));
        return osteoflow_fail(firing, message);
    }
    const osteoflow_words words = { osteoflow_text_of(file) };
    const osteoflow_view answer = { &words, sizeof words, NULL, 0 };
    return firing->host->emit(firing->run, 0, &answer);
}

static const osteoflow_input inputs[] = {
    { .name = OSTEOFLOW_TEXT("cloud"),
      .doc = OSTEOFLOW_TEXT("A cloud; one file for each."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION },
};

static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("file"),
      .doc = OSTEOFLOW_TEXT("The name of the file."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_WORDS),
      .version = OSTEOFLOW_WORDS_VERSION },
};

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("my_plugin.xyz"),
      .doc = OSTEOFLOW_TEXT("Writes clouds as text files of points into the run's folder, named after the node: one point per "
                            "line, x y z.\n\nThe numbers read back to the same bits. The first line is a comment with frame and "
                            "unit."),
      .params_schema = OSTEOFLOW_TEXT(
          "{ \"type\": \"object\", \"additionalProperties\": false, \"properties\": { "
          "\"unit_mm\": { \"type\": \"number\", \"default\": 1.0, \"minimum\": 1e-6, \"maximum\": 1e6, "
          "\"description\": \"Millimetres in the file's unit. 1: the file is in mm; 1000: in metres.\" } } }"),
      .example = OSTEOFLOW_TEXT("kind = \"my_plugin.xyz\"\n"
                                "in   = { cloud = \"to_bone.cloud\" }\n"
                                "unit_mm = 1.0\n"),
      .inputs = inputs,
      .n_inputs = 1,
      .outputs = outputs,
      .n_outputs = 1,
      .role = OSTEOFLOW_ROLE_NODE,
      .create = create,
      .fire = fire,
      .destroy = free },
};

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
