/*
 * osteoflow_geometry.h: the heads of the geometry payloads, and what their columns are called.
 *
 * Cast the head of a view to the struct of its payload; look its columns up by name (osteoflow_find_column). To answer,
 * fill such a struct and point a view to it: the head and its texts are copied while emit runs, columns are taken over.
 *
 * Lengths are millimetres, times nanoseconds since 1970 (0: no time), coordinates double. All frames are right-handed;
 * CT is LPS. A frame is a name: "world", "camera", "ct". A pose is seven numbers: translation x y z in mm, then the unit
 * quaternion x y z w; it takes coordinates in `from` to coordinates in `to`. All are finite, and quaternions and normals
 * have length 1 within 1e-6: an answer with others is refused. Normalise what you compute in single precision.
 *
 * A column is written here as name: type[width], and its unit. All columns of a payload that say so have as many rows.
 */
#ifndef OSTEOFLOW_GEOMETRY_H
#define OSTEOFLOW_GEOMETRY_H

#include "osteoflow.h"

#include <stdlib.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---- Heads ---------------------------------------------------------------------------------------------------------- */

/*
 * A surface as a camera saw it.
 * points: double[3], mm, all finite
 * normals: double[3], of length 1, one for each point; optional
 * extra/NAME: double[1], one for each point; any number of them
 */
#define OSTEOFLOW_CLOUD "geometry/Cloud"
#define OSTEOFLOW_CLOUD_VERSION 1
typedef struct osteoflow_cloud {
    osteoflow_text frame;
    int64_t stamp_ns;
    /* What it shows, where a stream carries several: "P1"; may be missing. */
    osteoflow_text label;
    /* The sensor's pose in the cloud's frame, seven numbers; may be missing. */
    osteoflow_numbers viewpoint;
} osteoflow_cloud;

/*
 * An image, in the frame of its camera (x right, y down, z forward).
 * pixels: uint8_t[1], row by row from the top left, channels bytes for each pixel
 */
#define OSTEOFLOW_IMAGE "geometry/Image"
#define OSTEOFLOW_IMAGE_VERSION 2
typedef struct osteoflow_image {
    osteoflow_text frame;
    int64_t stamp_ns;
    /* What it shows, where a stream carries several: "P1"; may be missing. */
    osteoflow_text label;
    int64_t width;
    int64_t height;
    /* 1: grey, 3: red, green, blue. */
    int64_t channels;
    /* fx, fy, cx, cy, pixels; the centre of the top left pixel is 0, 0. */
    double intrinsics[4];
    /* "plumb_bob", "rational_polynomial" or "equidistant"; missing of a pinhole without distortion. */
    osteoflow_text distortion_model;
    /* Its coefficients, in OpenCV's order; may be missing. */
    osteoflow_numbers distortion;
} osteoflow_image;

/*
 * Triangles.
 * vertices: double[3], mm
 * faces: uint32_t[3], indices of the corners
 */
#define OSTEOFLOW_MESH "geometry/Mesh"
#define OSTEOFLOW_MESH_VERSION 1
typedef struct osteoflow_mesh {
    osteoflow_text frame;
    /* Where the surface comes from: "exact", "simulated_ct" or "user". */
    osteoflow_text origin;
} osteoflow_mesh;

/* A rigid motion between two frames. */
#define OSTEOFLOW_POSE "geometry/Pose"
#define OSTEOFLOW_POSE_VERSION 1
typedef struct osteoflow_pose {
    osteoflow_text to;
    osteoflow_text from;
    int64_t stamp_ns;
    double isometry[7];
} osteoflow_pose;

/*
 * Named points.
 * positions: double[3], mm
 * stamps_ns: int64_t[1], one for each point
 * confidences: double[1], one for each point, NaN for none
 */
#define OSTEOFLOW_POINTS "geometry/Points"
#define OSTEOFLOW_POINTS_VERSION 1
typedef struct osteoflow_points {
    osteoflow_text frame;
    int64_t stamp_ns;
    /* One a line. */
    osteoflow_text names;
} osteoflow_points;

/*
 * Named planes, each the plane z = 0 of its pose in the frame.
 * isometries: double[7], poses; NaN where the place is unknown
 */
#define OSTEOFLOW_PLANES "geometry/Planes"
#define OSTEOFLOW_PLANES_VERSION 1
typedef struct osteoflow_planes {
    osteoflow_text frame;
    int64_t stamp_ns;
    /* One a line. */
    osteoflow_text names;
    /* For each plane a line: why its place is unknown, or nothing. */
    osteoflow_text unknown;
} osteoflow_planes;

/* A box along the axes of its frame, mm. */
#define OSTEOFLOW_REGION "geometry/Region"
#define OSTEOFLOW_REGION_VERSION 1
typedef struct osteoflow_region {
    osteoflow_text frame;
    double min[3];
    double max[3];
} osteoflow_region;

/* Axes of a bone: a centre in mm, and the axes x, y, z, three numbers each. */
#define OSTEOFLOW_AXES "geometry/Axes"
#define OSTEOFLOW_AXES_VERSION 1
typedef struct osteoflow_axes {
    osteoflow_text frame;
    double centre[3];
    double columns[9];
} osteoflow_axes;

/*
 * A surface prepared for registration. Read its points and normals; the rest is an index of the program's own, which it
 * builds again for a target that comes without.
 * points: double[3], mm
 * normals: double[3], one for each point; optional
 * cells/blocks: uint32_t[1]; optional
 * cells/starts: uint32_t[1]; optional
 * cells/items: uint32_t[1]; optional
 * mesh/vertices: double[3], mm, of the mesh that the points were drawn from; optional
 * mesh/faces: uint32_t[3]; optional
 * sensor: uint8_t[1], a JSON text, what measured the scans; optional
 * field/head: double[1]; optional
 * field/index: uint32_t[1]; optional
 * field/nodes: float[1]; optional
 */
#define OSTEOFLOW_TARGET "algorithms/Target"
#define OSTEOFLOW_TARGET_VERSION 1
typedef struct osteoflow_target {
    osteoflow_text frame;
    /* As of a mesh. */
    osteoflow_text origin;
    /* NaN in a target that comes without cells. */
    double cell_mm;
} osteoflow_target;

/* A word or sentence of a result. */
#define OSTEOFLOW_WORDS "report/Text"
#define OSTEOFLOW_WORDS_VERSION 1
typedef struct osteoflow_words {
    osteoflow_text text;
} osteoflow_words;

/* A yes (1) or no (0) of a result. */
#define OSTEOFLOW_FLAG "report/Flag"
#define OSTEOFLOW_FLAG_VERSION 1
typedef struct osteoflow_flag {
    uint8_t flag;
} osteoflow_flag;

/* Any JSON. The reports of built-in nodes ("report/Icp", "report/Tre") have this head, too; each is JSON of its own form,
 * as in results.json, and refuses any other. */
#define OSTEOFLOW_JSON "report/Json"
#define OSTEOFLOW_JSON_VERSION 1
typedef struct osteoflow_json {
    osteoflow_text json;
} osteoflow_json;

/*
 * Numbers by name.
 * values: double[1], one for each name, all finite
 */
#define OSTEOFLOW_METRICS "report/Metrics"
#define OSTEOFLOW_METRICS_VERSION 1
typedef struct osteoflow_metrics {
    /* One a line. */
    osteoflow_text names;
    /* One a line, nothing for a count or a ratio. */
    osteoflow_text units;
} osteoflow_metrics;

/* ---- For use by hand ------------------------------------------------------------------------------------------------ */

/* Bytes of a value of this type; 0 for a type that there is not. */
static inline uint32_t osteoflow_type_size(uint32_t type) {
    switch (type) {
    case OSTEOFLOW_F64:
    case OSTEOFLOW_I64:
        return 8;
    case OSTEOFLOW_F32:
    case OSTEOFLOW_U32:
        return 4;
    case OSTEOFLOW_U8:
        return 1;
    default:
        return 0;
    }
}

/* A column over rows that lie end to end in a block from malloc. The program frees it once emit has taken the column. */
static inline osteoflow_column osteoflow_malloced_column(osteoflow_text name, uint32_t type, uint32_t width, void *rows,
                                                         uint64_t n_rows) {
    osteoflow_column column;
    column.name = name;
    column.data = rows;
    column.n_rows = n_rows;
    column.stride = (uint64_t)osteoflow_type_size(type) * width;
    column.type = type;
    column.width = width;
    column.owner.self = rows;
    column.owner.hold = NULL;
    column.owner.release = free;
    return column;
}

/* A column over a copy of rows that lie end to end. Without memory it has no rows, and the program refuses the payload. */
static inline osteoflow_column osteoflow_copied_column(const char *name, uint32_t type, uint32_t width, const void *rows,
                                                       uint64_t n_rows) {
    const size_t size = (size_t)(osteoflow_type_size(type) * width * n_rows);
    void *copy = malloc(size > 0 ? size : 1);
    if (copy != NULL && size > 0) {
        memcpy(copy, rows, size);
    }
    return osteoflow_malloced_column(osteoflow_text_of(name), type, width, copy, copy != NULL ? n_rows : 0);
}

/* A column of an input, to be emitted or kept without a copy: emit takes it over, else call owner.release(owner.self). */
static inline osteoflow_column osteoflow_held_column(const osteoflow_column *lent) {
    osteoflow_column column = *lent;
    column.owner.self = lent->owner.hold(lent->owner.self);
    column.owner.hold = NULL;
    return column;
}

/* The point moved by a pose's seven numbers; `moved` may be `point`. */
static inline void osteoflow_move(const double isometry[7], const double point[3], double moved[3]) {
    const double *t = isometry, *q = isometry + 3;
    const double w = isometry[6];
    const double x = point[0], y = point[1], z = point[2];
    const double u[3] = { 2.0 * (q[1] * z - q[2] * y), 2.0 * (q[2] * x - q[0] * z), 2.0 * (q[0] * y - q[1] * x) };
    moved[0] = x + w * u[0] + (q[1] * u[2] - q[2] * u[1]) + t[0];
    moved[1] = y + w * u[1] + (q[2] * u[0] - q[0] * u[2]) + t[1];
    moved[2] = z + w * u[2] + (q[0] * u[1] - q[1] * u[0]) + t[2];
}

/* ---- Layout --------------------------------------------------------------------------------------------------------- */

#if UINTPTR_MAX == UINT64_MAX
#ifdef __cplusplus
#define OSTEOFLOW_ASSERT(what) static_assert(what, #what)
#else
#define OSTEOFLOW_ASSERT(what) _Static_assert(what, #what)
#endif
/* begin of layout */
OSTEOFLOW_ASSERT(sizeof(osteoflow_target) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_target, frame) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_target, origin) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_target, cell_mm) == 32);
OSTEOFLOW_ASSERT(sizeof(osteoflow_axes) == 112);
OSTEOFLOW_ASSERT(offsetof(osteoflow_axes, frame) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_axes, centre) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_axes, columns) == 40);
OSTEOFLOW_ASSERT(sizeof(osteoflow_cloud) == 56);
OSTEOFLOW_ASSERT(offsetof(osteoflow_cloud, frame) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_cloud, stamp_ns) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_cloud, label) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_cloud, viewpoint) == 40);
OSTEOFLOW_ASSERT(sizeof(osteoflow_image) == 128);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, frame) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, stamp_ns) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, label) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, width) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, height) == 48);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, channels) == 56);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, intrinsics) == 64);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, distortion_model) == 96);
OSTEOFLOW_ASSERT(offsetof(osteoflow_image, distortion) == 112);
OSTEOFLOW_ASSERT(sizeof(osteoflow_mesh) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_mesh, frame) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_mesh, origin) == 16);
OSTEOFLOW_ASSERT(sizeof(osteoflow_planes) == 56);
OSTEOFLOW_ASSERT(offsetof(osteoflow_planes, frame) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_planes, stamp_ns) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_planes, names) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_planes, unknown) == 40);
OSTEOFLOW_ASSERT(sizeof(osteoflow_points) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_points, frame) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_points, stamp_ns) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_points, names) == 24);
OSTEOFLOW_ASSERT(sizeof(osteoflow_pose) == 96);
OSTEOFLOW_ASSERT(offsetof(osteoflow_pose, to) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_pose, from) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_pose, stamp_ns) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_pose, isometry) == 40);
OSTEOFLOW_ASSERT(sizeof(osteoflow_region) == 64);
OSTEOFLOW_ASSERT(offsetof(osteoflow_region, frame) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_region, min) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_region, max) == 40);
OSTEOFLOW_ASSERT(sizeof(osteoflow_json) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_json, json) == 0);
OSTEOFLOW_ASSERT(sizeof(osteoflow_flag) == 1);
OSTEOFLOW_ASSERT(offsetof(osteoflow_flag, flag) == 0);
OSTEOFLOW_ASSERT(sizeof(osteoflow_metrics) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_metrics, names) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_metrics, units) == 16);
OSTEOFLOW_ASSERT(sizeof(osteoflow_words) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_words, text) == 0);
/* end of layout */
#undef OSTEOFLOW_ASSERT
#endif

#ifdef __cplusplus
}
#endif

#endif
