/* Hands a pose on with its quaternion multiplied: with a scale of 1 the very same pose. */
#include "osteoflow_geometry.h"

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    double *scale = malloc(sizeof *scale);
    *scale = osteoflow_param_number(firing, "scale", 1.0);
    *node = scale;
    return OSTEOFLOW_OK;
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "there is no pose");
    }
    osteoflow_pose pose = *(const osteoflow_pose *)view.head;
    for (int k = 3; k < 7; k++) {
        pose.isometry[k] *= *(const double *)node;
    }
    osteoflow_view out = { &pose, sizeof pose, NULL, 0 };
    return firing->host->emit(firing->run, 0, &out);
}

static const osteoflow_input inputs[] = {
    { .name = OSTEOFLOW_TEXT("pose"),
      .doc = OSTEOFLOW_TEXT("A pose."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_POSE),
      .version = OSTEOFLOW_POSE_VERSION,
      .join = OSTEOFLOW_JOIN_EACH },
};
static const osteoflow_output outputs[] = {
    { .name = OSTEOFLOW_TEXT("pose"),
      .doc = OSTEOFLOW_TEXT("The pose."),
      .payload = OSTEOFLOW_TEXT(OSTEOFLOW_POSE),
      .version = OSTEOFLOW_POSE_VERSION,
      .to = OSTEOFLOW_TEXT("pose.to"),
      .from = OSTEOFLOW_TEXT("pose.from") },
};
static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("toy.lengthen"),
      .doc = OSTEOFLOW_TEXT("Multiplies the quaternion of a pose."),
      .params_schema = OSTEOFLOW_TEXT("{\"type\": \"object\", \"properties\": {\"scale\": {\"description\": \"The factor.\", "
                                      "\"type\": \"number\", \"default\": 1}}, \"additionalProperties\": false}"),
      .inputs = inputs,
      .n_inputs = 1,
      .outputs = outputs,
      .n_outputs = 1,
      .role = OSTEOFLOW_ROLE_NODE,
      .create = create,
      .fire = fire,
      .destroy = free },
};

OSTEOFLOW_PLUGIN("lengthen", "1.0.0", kinds)
