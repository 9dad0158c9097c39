// The mean of a cloud's points, as a pose: little work on many rows.
#include "osteoflow_geometry.h"

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *, osteoflow_text, void **node) {
    *node = const_cast<osteoflow_kind *>(kind);
    return OSTEOFLOW_OK;
}

static int32_t fire(void *, const osteoflow_firing *firing) {
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "the cloud cannot be read");
    }
    const osteoflow_cloud *cloud = static_cast<const osteoflow_cloud *>(view.head);
    const osteoflow_column *points = osteoflow_find_column(&view, "points", OSTEOFLOW_F64, 3);
    const osteoflow_column *normals = osteoflow_find_column(&view, "normals", OSTEOFLOW_F64, 3);
    if (points == nullptr || normals == nullptr) {
        return osteoflow_fail(firing, "the cloud has no points with normals");
    }
    double mean[3] = { 0.0, 0.0, 0.0 };
    for (uint64_t i = 0; i < points->n_rows; i++) {
        for (int k = 0; k < 3; k++) {
            mean[k] += static_cast<const double *>(points->data)[3 * i + k] / static_cast<double>(points->n_rows);
        }
    }
    osteoflow_pose pose = osteoflow_pose();
    pose.to = cloud->frame;
    pose.from = osteoflow_text_of("centre");
    pose.stamp_ns = cloud->stamp_ns;
    pose.isometry[6] = 1.0;
    for (int k = 0; k < 3; k++) {
        pose.isometry[k] = mean[k];
    }
    const osteoflow_view out = { &pose, sizeof pose, nullptr, 0 };
    return firing->host->emit(firing->run, 0, &out);
}

static void destroy(void *) {}

static const osteoflow_input inputs[] = {
    { OSTEOFLOW_TEXT("cloud"), OSTEOFLOW_TEXT("The cloud."), OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD), OSTEOFLOW_CLOUD_VERSION, 0,
      OSTEOFLOW_JOIN_EACH, 0, 0, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_output outputs[] = {
    { OSTEOFLOW_TEXT("pose"), OSTEOFLOW_TEXT("Its centre."), OSTEOFLOW_TEXT(OSTEOFLOW_POSE), OSTEOFLOW_POSE_VERSION, 0,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_TEXT("cloud"), OSTEOFLOW_TEXT("@centre") },
};
static const osteoflow_kind kinds[] = {
    { OSTEOFLOW_TEXT("centre.mean"), OSTEOFLOW_TEXT("The mean of a cloud's points."), OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, NULL, 0, inputs, 1, outputs, 1, OSTEOFLOW_ROLE_NODE, OSTEOFLOW_KEPT_NO, 0,
      0, NULL, create, fire, destroy, NULL, NULL },
};

OSTEOFLOW_PLUGIN("centre", "1", kinds)
