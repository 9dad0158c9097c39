/*
 * A source that gives payloads which are not what they say: HOW names the lie. Two items, each with one value that is sound
 * but for the lie. And a node that writes into the cloud that it was lent.
 */
#include "osteoflow_geometry.h"

#include <math.h>

enum { CLOUD, POSE, TARGET, PLANES, POINTS, MESH, N_PORTS };

typedef struct source {
    char how[32];
    int given;
    uint64_t port;
} source;

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    source *self = calloc(1, sizeof *self);
    osteoflow_param how;
    firing->host->param(firing->run, osteoflow_text_of("how"), &how);
    if (how.what == OSTEOFLOW_PARAM_TEXT && how.text.length < sizeof self->how) {
        memcpy(self->how, how.text.data, how.text.length);
    }
    self->port = (uint64_t)osteoflow_param_number(firing, "port", 0.0);
    *node = self;
    return OSTEOFLOW_OK;
}

static int is(const source *self, const char *how) {
    return strcmp(self->how, how) == 0;
}

static osteoflow_column rows(const char *name, uint32_t width, const double *data, uint64_t n_rows) {
    const uint64_t stride = width * sizeof(double);
    const osteoflow_column column = { osteoflow_text_of(name), data, n_rows, stride, OSTEOFLOW_F64, width,
                                      { NULL, NULL, NULL } };
    return column;
}

/* The unit quaternion, or the one of the lie. */
static void rotation(const source *self, double *xyzw) {
    const double w = is(self, "quaternion of length 2") ? 2.0 : is(self, "quaternion of zeros") ? 0.0
                   : is(self, "quaternion of NaN") ? NAN : is(self, "quaternion, 5e-6 too long") ? 1.000005 : 1.0;
    xyzw[0] = xyzw[1] = xyzw[2] = 0.0;
    xyzw[3] = w;
}

static int32_t give(void *node, const osteoflow_firing *firing) {
    source *self = node;
    if (self->given == 2) {
        return OSTEOFLOW_END;
    }
    const int item = self->given++;
    int64_t stamp_ns = 1000 * item;
    if (is(self, "stamps that run backwards")) {
        stamp_ns = -stamp_ns;
    } else if (is(self, "stamp of the end of time")) {
        stamp_ns = INT64_MAX;
    } else if (is(self, "stamp of the begin of time")) {
        stamp_ns = INT64_MIN;
    }
    firing->host->set_stamp_ns(firing->run, stamp_ns);
    const int64_t stamp_of_value = is(self, "value of the end of time") ? INT64_MAX : stamp_ns;
    /* The program reads the rows after the firing. */
    static double points[6], normals[6], isometry[7], confidences[1];
    static const int64_t stamps[1];
    static const uint32_t faces[3] = { 0, 1, 1 };
    double values[6] = { 1, 2, 3, 4, is(self, "point of NaN") ? NAN : is(self, "point of infinity") ? INFINITY : 5, 6 };
    memcpy(points, values, sizeof points);
    double directions[6] = { 0, 0, 1, 0, 0, is(self, "normal of length 0.5") ? 0.5 : is(self, "normal of NaN") ? NAN : 1 };
    memcpy(normals, directions, sizeof normals);
    isometry[0] = is(self, "translation of infinity") ? INFINITY : 10;
    rotation(self, isometry + 3);

    const osteoflow_column two[] = { rows("points", 3, points, 2), rows("normals", 3, normals, 2) };
    const osteoflow_cloud cloud = { OSTEOFLOW_TEXT("camera"), stamp_of_value, OSTEOFLOW_NO_TEXT, { isometry, 7 } };
    osteoflow_pose pose = { OSTEOFLOW_TEXT("world"), OSTEOFLOW_TEXT("camera"), stamp_of_value, { 0 } };
    memcpy(pose.isometry, isometry, sizeof isometry);
    const osteoflow_target target = { OSTEOFLOW_TEXT("ct"), OSTEOFLOW_TEXT("user"), NAN };
    const osteoflow_planes planes = { OSTEOFLOW_TEXT("ct"), stamp_of_value, OSTEOFLOW_TEXT("distal"), OSTEOFLOW_TEXT("") };
    const osteoflow_column place = rows("isometries", 7, isometry, 1);
    const osteoflow_points named = { OSTEOFLOW_TEXT("ct"), stamp_of_value, OSTEOFLOW_TEXT("P1") };
    osteoflow_column of_points[] = { rows("positions", 3, points + 3, 1), rows("stamps_ns", 1, NULL, 1),
                                     rows("confidences", 1, confidences, 1) };
    of_points[1].data = stamps;
    of_points[1].type = OSTEOFLOW_I64;
    const osteoflow_mesh mesh = { OSTEOFLOW_TEXT("ct"), OSTEOFLOW_TEXT("user") };
    osteoflow_column of_mesh[] = { rows("vertices", 3, points, 2), rows("faces", 3, NULL, 1) };
    of_mesh[1].data = faces;
    of_mesh[1].type = OSTEOFLOW_U32;
    of_mesh[1].stride = sizeof faces;

    const osteoflow_view views[N_PORTS] = {
        [CLOUD] = { &cloud, sizeof cloud, two, 2 },      [POSE] = { &pose, sizeof pose, NULL, 0 },
        [TARGET] = { &target, sizeof target, two, 2 },   [PLANES] = { &planes, sizeof planes, &place, 1 },
        [POINTS] = { &named, sizeof named, of_points, 3 }, [MESH] = { &mesh, sizeof mesh, of_mesh, 2 },
    };
    return firing->host->emit(firing->run, self->port, &views[self->port]);
}

/* Answers the number of points, and moves the second one by 1 mm where it lies. */
static int32_t write_into(void *node, const osteoflow_firing *firing) {
    const source *self = node;
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "the cloud cannot be read");
    }
    const osteoflow_column *points = osteoflow_find_column(&view, "points", OSTEOFLOW_F64, 3);
    if (is(self, "column")) {
        ((double *)points->data)[3] += 1.0;
    } else if (is(self, "head")) {
        ((osteoflow_cloud *)view.head)->stamp_ns += 1;
    }
    const osteoflow_words head = { OSTEOFLOW_TEXT("read") };
    const osteoflow_view out = { &head, sizeof head, NULL, 0 };
    return firing->host->emit(firing->run, 0, &out);
}

#define PARAMS                                                                                                             \
    OSTEOFLOW_TEXT("{ \"type\": \"object\", \"properties\": { \"how\": { \"type\": \"string\" }, "                          \
                   "\"port\": { \"type\": \"integer\" } } }")
#define OUTPUT(NAME, PAYLOAD)                                                                                              \
    { .name = OSTEOFLOW_TEXT(NAME), .doc = OSTEOFLOW_TEXT("A value."), .payload = OSTEOFLOW_TEXT(OSTEOFLOW_##PAYLOAD),     \
      .version = OSTEOFLOW_##PAYLOAD##_VERSION }

static const osteoflow_output outputs[] = {
    OUTPUT("cloud", CLOUD),   OUTPUT("pose", POSE),     OUTPUT("target", TARGET),
    OUTPUT("planes", PLANES), OUTPUT("points", POINTS), OUTPUT("mesh", MESH),
};
static const osteoflow_input cloud_in[] = {
    { .name = OSTEOFLOW_TEXT("cloud"), .doc = OSTEOFLOW_TEXT("A cloud."), .payload = OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      .version = OSTEOFLOW_CLOUD_VERSION },
};
static const osteoflow_output text_out[] = { OUTPUT("text", WORDS) };

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("lies.give"), .doc = OSTEOFLOW_TEXT("Values that are not what they say."),
      .params_schema = PARAMS, .outputs = outputs, .n_outputs = N_PORTS, .role = OSTEOFLOW_ROLE_SOURCE,
      .create = create, .fire = give, .destroy = free },
    { .kind = OSTEOFLOW_TEXT("lies.write"), .doc = OSTEOFLOW_TEXT("Writes into its input."),
      .params_schema = PARAMS, .inputs = cloud_in, .n_inputs = 1, .outputs = text_out, .n_outputs = 1,
      .create = create, .fire = write_into, .destroy = free },
};

OSTEOFLOW_PLUGIN("lies", "1.0.0", kinds)
