/*
 * osteoflow.h: the C interface between Osteoflow and its plugins.
 *
 * A plugin is a shared library with one exported function, osteoflow_describe, which returns a plain description: the
 * versions it was built with, and its kinds of nodes with ports, parameters and docs. The program reads the description,
 * builds nodes and fires them. Nodes call the program through the function table osteoflow_host. This header needs only
 * C11 or C++11; the heads of geometry payloads are in osteoflow_geometry.h.
 *
 * Rules
 * - Lengths are millimetres, angles radians, times nanoseconds. Texts are UTF-8 with a length, not ended by a zero.
 * - Lent memory is immutable and does not move until the documented time.
 * - Columns are never copied: the side that allocates them releases them, through the release function of the column.
 * - No exception and no panic may leave a function of either side.
 * - A node is used by one thread at a time, not always the same one. Different nodes run at the same time.
 *
 * Compatibility: within one OSTEOFLOW_ABI_MAJOR structs only grow at their end and functions are only added. A library is
 * loaded if it has the major version of the program and its structs are at least as large as those of minor 0; fields that
 * an older library lacks have their default. See docs/extend/writing-a-plugin.md.
 */
#ifndef OSTEOFLOW_H
#define OSTEOFLOW_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

#define OSTEOFLOW_ABI_MAJOR 1
#define OSTEOFLOW_ABI_MINOR 0
/* The first eight bytes of a description. */
#define OSTEOFLOW_MAGIC "OSTEOPLG"

#if defined(_WIN32)
#define OSTEOFLOW_EXPORT __declspec(dllexport)
#else
#define OSTEOFLOW_EXPORT __attribute__((visibility("default")))
#endif

/* ---- Texts and lists ---------------------------------------------------------------------------------------------- */

/* UTF-8 text. data is NULL for a missing text. */
typedef struct osteoflow_text {
    const char *data;
    uint64_t length;
} osteoflow_text;

/* A list of numbers. data is NULL for a missing list. */
typedef struct osteoflow_numbers {
    const double *data;
    uint64_t length;
} osteoflow_numbers;

/* ---- Views of payloads --------------------------------------------------------------------------------------------- */

/* The type of a column's values. */
enum {
    OSTEOFLOW_F64 = 1,
    OSTEOFLOW_F32 = 2,
    OSTEOFLOW_I64 = 3,
    OSTEOFLOW_U32 = 4,
    OSTEOFLOW_U8 = 5
};

/*
 * Lifetime of the rows of a column.
 *
 * In a lent column, hold(self) returns a token that keeps the rows alive until release(token).
 * In a column that a plugin emits, self is such a token: the program calls release(self) once, after the last use of the
 * rows, from any thread. hold is not called. release may be NULL for rows that live as long as the library.
 */
typedef struct osteoflow_owner {
    void *self;
    void *(*hold)(void *self);
    void (*release)(void *token);
} osteoflow_owner;

/* A named column: rows of `width` values of one type. data is aligned to the type; NULL only if there are no rows. */
typedef struct osteoflow_column {
    osteoflow_text name;
    const void *data;
    uint64_t n_rows;
    /* Bytes from one row to the next. Rows that are not contiguous are copied. */
    uint64_t stride;
    uint32_t type;
    uint32_t width;
    osteoflow_owner owner;
} osteoflow_column;

/*
 * A payload: a small head and columns.
 *
 * The head is a C struct with the fields of the schema in their order: uint8_t for BOOL, int64_t for INT, double for FLOAT,
 * double[n] for FLOATS, osteoflow_numbers for FLOAT_LIST, osteoflow_text for TEXT. A missing optional
 * field has data == NULL, or is NaN. Columns are identified by name, in any order.
 */
typedef struct osteoflow_view {
    const void *head;
    uint64_t head_size;
    const osteoflow_column *columns;
    uint64_t n_columns;
} osteoflow_view;

/* The type of a schema entry. */
enum {
    OSTEOFLOW_PART_BOOL = 1,
    OSTEOFLOW_PART_INT = 2,
    OSTEOFLOW_PART_FLOAT = 3,
    OSTEOFLOW_PART_FLOATS = 4,
    OSTEOFLOW_PART_FLOAT_LIST = 5,
    OSTEOFLOW_PART_TEXT = 6,
    OSTEOFLOW_PART_COLUMN = 7
};

enum { OSTEOFLOW_PART_OPTIONAL = 1 };

/* A schema entry: a head field or a column. A column name of "extra/" and a star matches all columns with that prefix. */
typedef struct osteoflow_part {
    osteoflow_text name;
    /* "mm", "rad", "pose" (x y z in mm, quaternion x y z w); may be missing if the name has the unit. */
    osteoflow_text unit;
    osteoflow_text doc;
    uint32_t shape;
    /* Length of FLOATS, values in a row of a COLUMN; otherwise 0. */
    uint32_t width;
    /* Value type of a COLUMN. */
    uint32_t type;
    uint32_t flags;
} osteoflow_part;

/* A payload type. Those of the program need no description. */
typedef struct osteoflow_payload {
    /* "acme/Spline" */
    osteoflow_text name;
    const osteoflow_part *parts;
    uint64_t n_parts;
    uint32_t version;
    uint32_t flags;
} osteoflow_payload;

/* ---- Inputs of a firing -------------------------------------------------------------------------------------------- */

/* A value. Lent until the firing ends; see hold in osteoflow_host. */
typedef struct osteoflow_value osteoflow_value;
/* A firing of the program. Lent until the firing ends. */
typedef struct osteoflow_run osteoflow_run;
/* A time budget. */
typedef struct osteoflow_budget osteoflow_budget;

/* An item of a wire: a value, or the reason why there is none. */
typedef struct osteoflow_item {
    uint64_t number;
    int64_t stamp_ns;
    /* NULL for an empty. */
    const osteoflow_value *value;
    /* The type of the value; NULL for an empty. Lives as long as the program. */
    const osteoflow_payload *payload;
    /* For an empty: the node that gave no result, and the reason. */
    osteoflow_text empty_node;
    osteoflow_text empty_reason;
} osteoflow_item;

enum {
    /* One item: items[0]. */
    OSTEOFLOW_SLOT_ITEM = 0,
    /* The items of a collecting port. */
    OSTEOFLOW_SLOT_ITEMS = 1,
    /* No item: items[0] is an empty with the reason. */
    OSTEOFLOW_SLOT_ABSENT = 2
};

/* The port joins by "once": the same value at every firing. */
enum { OSTEOFLOW_SLOT_CONSTANT = 1 };

/* The input of one port. */
typedef struct osteoflow_slot {
    uint32_t what;
    uint32_t flags;
    const osteoflow_item *items;
    uint64_t n_items;
} osteoflow_slot;

struct osteoflow_host;

/* A firing of a node, a call of a source, or the construction of a node. */
typedef struct osteoflow_firing {
    /* sizeof(osteoflow_firing) of the program. */
    uint64_t size;
    const struct osteoflow_host *host;
    osteoflow_run *run;
    /* One per input, in the order of the description. */
    const osteoflow_slot *slots;
    uint64_t n_slots;
} osteoflow_firing;

/* ---- Functions of the program -------------------------------------------------------------------------------------- */

enum {
    OSTEOFLOW_PARAM_MISSING = 0,
    OSTEOFLOW_PARAM_BOOL = 1,
    OSTEOFLOW_PARAM_NUMBER = 2,
    OSTEOFLOW_PARAM_TEXT = 3,
    OSTEOFLOW_PARAM_NUMBERS = 4,
    /* A table or another list, as json. */
    OSTEOFLOW_PARAM_OTHER = 5
};

/* The value of a parameter: from the graph, or the default of the schema. */
typedef struct osteoflow_param {
    uint32_t what;
    uint32_t boolean;
    double number;
    osteoflow_text text;
    osteoflow_numbers numbers;
    osteoflow_text json;
} osteoflow_param;

/* An output that the graph declares by `out`. */
typedef struct osteoflow_declared {
    osteoflow_text name;
    const osteoflow_payload *payload;
    /* The rest of the table, as JSON. */
    osteoflow_text params;
} osteoflow_declared;

enum {
    OSTEOFLOW_LOG_ERROR = 1,
    OSTEOFLOW_LOG_WARN = 2,
    OSTEOFLOW_LOG_INFO = 3,
    OSTEOFLOW_LOG_DEBUG = 4,
    OSTEOFLOW_LOG_TRACE = 5
};

/* Return codes of the functions of a kind. */
enum {
    OSTEOFLOW_OK = 0,
    /* The source has ended. */
    OSTEOFLOW_END = 1,
    /* Failure; the reason was passed to fail(). */
    OSTEOFLOW_FAILED = 2,
    /* A panic or an exception was caught; its message was passed to fail(). */
    OSTEOFLOW_PANICKED = 3
};

/*
 * The functions of the program. A plugin built with a newer minor version checks `size` before it calls functions that are
 * not in minor 0. Functions that return int32_t return OSTEOFLOW_OK, or OSTEOFLOW_FAILED after recording the reason.
 * Functions with a const osteoflow_run may be called from several threads of the node at once, all others from one at a
 * time; none after the firing has ended.
 */
typedef struct osteoflow_host {
    /* sizeof(osteoflow_host) of the program. */
    uint64_t size;

    /* -- values -- */

    /* The view of a value: lent as long as the value, or as the handle from hold(). */
    int32_t (*view)(const osteoflow_value *value, osteoflow_view *view);
    /* The value in results.json, as JSON: lent as long as the value. */
    osteoflow_text (*result)(const osteoflow_value *value);
    /* A handle that keeps the value after the firing, until release(). */
    const osteoflow_value *(*hold)(const osteoflow_value *value);
    void (*release)(const osteoflow_value *held);

    /* -- answers; a port without one gets an empty from a node, and is silent for a source -- */

    /* Emits a payload of the type of the output. Takes ownership of the columns, also on failure. Copies the head. */
    int32_t (*emit)(osteoflow_run *run, uint64_t port, const osteoflow_view *view);
    /* Like emit, for an output of any payload, or one that the graph declares. */
    int32_t (*emit_as)(osteoflow_run *run, uint64_t port, osteoflow_text payload, uint32_t version,
                       const osteoflow_view *view);
    /* Emits an input value, or a held one. */
    int32_t (*emit_value)(osteoflow_run *run, uint64_t port, const osteoflow_value *value);
    /* Emits a value from hold(), and takes ownership of the handle, also on failure. */
    int32_t (*emit_held)(osteoflow_run *run, uint64_t port, const osteoflow_value *held);
    /* Emits an empty with this reason. */
    int32_t (*emit_empty)(osteoflow_run *run, uint64_t port, osteoflow_text reason);
    /* Reports why the node fails, or cannot be built; in that case with the parameter at fault, if there is one. */
    void (*fail)(osteoflow_run *run, osteoflow_text parameter, osteoflow_text message);

    /* -- the run -- */

    /* The full name of the node; lent as long as the node. */
    osteoflow_text (*node)(const osteoflow_run *run);
    /* The number of this firing, from 0. */
    uint64_t (*item)(const osteoflow_run *run);
    int64_t (*stamp_ns)(const osteoflow_run *run);
    /* For a source: sets the stamp of this answer; must not decrease. */
    void (*set_stamp_ns)(osteoflow_run *run, int64_t stamp_ns);
    uint64_t (*seed)(const osteoflow_run *run);
    /* The index-th 64 random bits of this firing: a function of seed, node, item and index. */
    uint64_t (*random)(const osteoflow_run *run, uint64_t index);
    /* The time of day, ns since 1970: recorded, and answered from the recording in a replay. */
    int64_t (*clock_ns)(osteoflow_run *run);
    /* A time budget, recorded as the number of checks that found time left. Check it from one thread. */
    osteoflow_budget *(*budget)(osteoflow_run *run, uint64_t limit_ns);
    int32_t (*budget_is_over)(osteoflow_budget *budget);
    void (*budget_release)(osteoflow_budget *budget);
    /* Whether the user asked to stop. */
    int32_t (*cancelled)(const osteoflow_run *run);
    /* Warns the user about this item: shown, counted, written to the manifest. */
    void (*warn)(osteoflow_run *run, osteoflow_text message);
    /* Why an optional port got nothing; missing if it got something. Lent until the firing ends. */
    osteoflow_text (*absent_reason)(const osteoflow_run *run, osteoflow_text port);
    /* The folder for files that the node writes; missing if the run has no folder. Lent as long as the node. */
    osteoflow_text (*out_dir)(const osteoflow_run *run);

    /* -- during create(); for a source with declared outputs at any time -- */

    /* A parameter by name, or by a dotted path. Lent until create() returns. */
    void (*param)(osteoflow_run *run, osteoflow_text name, osteoflow_param *param);
    uint64_t (*n_declared)(const osteoflow_run *run);
    /* Lent as long as the node. */
    int32_t (*declared)(const osteoflow_run *run, uint64_t index, osteoflow_declared *declared);

    /* -- log lines -- */

    /* The most detailed enabled level; 0 for none. */
    uint32_t (*log_level)(void);
    void (*log)(uint32_t level, osteoflow_text target, osteoflow_text message);
} osteoflow_host;

/* ---- The description of a plugin ----------------------------------------------------------------------------------- */

/* How the items of a port are chosen for a firing; see docs/use/graph-file.md. */
enum {
    OSTEOFLOW_JOIN_EACH = 0,
    OSTEOFLOW_JOIN_STAMP = 1,
    OSTEOFLOW_JOIN_COLLECT = 2,
    OSTEOFLOW_JOIN_LATEST = 3,
    OSTEOFLOW_JOIN_INTERPOLATE = 4,
    OSTEOFLOW_JOIN_ONCE = 5,
    /* For an optional port: what its wire carried for the firing before. */
    OSTEOFLOW_JOIN_PREVIOUS = 6
};

enum {
    /* May stay unwired, and receives empties instead of skipping the firing. */
    OSTEOFLOW_INPUT_OPTIONAL = 1,
    /* Ignored by this kind, but used by other kinds of its stage. */
    OSTEOFLOW_INPUT_UNUSED = 2
};

typedef struct osteoflow_input {
    osteoflow_text name;
    osteoflow_text doc;
    /* "geometry/Cloud"; missing: any. */
    osteoflow_text payload;
    uint32_t version;
    uint32_t flags;
    uint32_t join;
    /* COLLECT: number of items; 0: all. */
    uint32_t join_n;
    /* STAMP: the tolerance. INTERPOLATE: the maximum gap; negative: unlimited. LATEST: how long after the firing stamp; usually 0. */
    int64_t join_ns;
    /* The expected frames, where known: "source" (the frame of that port), "@ct", "$frame"; see
     * docs/extend/writing-a-node.md. A pose has to and from, everything else frame. */
    osteoflow_text frame;
    osteoflow_text to;
    osteoflow_text from;
} osteoflow_input;

typedef struct osteoflow_output {
    osteoflow_text name;
    osteoflow_text doc;
    osteoflow_text payload;
    uint32_t version;
    uint32_t flags;
    osteoflow_text frame;
    osteoflow_text to;
    osteoflow_text from;
} osteoflow_output;

enum {
    OSTEOFLOW_ROLE_NODE = 0,
    OSTEOFLOW_ROLE_SOURCE = 1,
    OSTEOFLOW_ROLE_LIVE_SOURCE = 2
};

enum {
    OSTEOFLOW_KEPT_NO = 0,
    OSTEOFLOW_KEPT_BY_INPUTS = 1,
    OSTEOFLOW_KEPT_BY_INPUTS_AND_SEED = 2
};

/* A source that gives one item on each output, at stamp 0, and then ends. */
enum { OSTEOFLOW_KIND_CONSTANT = 1 };
/* Its answers may differ though inputs, parameters and seed are the same; a sweep then does not check that they are. */
enum { OSTEOFLOW_KIND_UNSTEADY = 2 };

typedef struct osteoflow_kind {
    /* "stage.variant", as graph files name it. */
    osteoflow_text kind;
    /* The documentation; the first paragraph is the summary. */
    osteoflow_text doc;
    /* JSON Schema of an object: the parameters with types, docs, defaults and ranges. Missing: no parameters. */
    osteoflow_text params_schema;
    /* An example table for a graph file; may be missing. */
    osteoflow_text example;
    /* JSON Schema of the table of an output, if the graph declares the outputs; otherwise missing. */
    osteoflow_text declared_schema;
    /* Paper, section, equation. */
    const osteoflow_text *literature;
    uint64_t n_literature;
    const osteoflow_input *inputs;
    uint64_t n_inputs;
    const osteoflow_output *outputs;
    uint64_t n_outputs;
    uint32_t role;
    /* Whether answers are cached across runs, and what they depend on; see docs/extend/writing-a-node.md. */
    uint32_t kept;
    uint32_t flags;
    uint32_t reserved;
    /* For use by the plugin. */
    const void *data;
    /* Builds a node: `*node` is passed to the functions below. params is JSON. Must not read files or devices yet. */
    int32_t (*create)(const struct osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params,
                      void **node);
    /* One firing of a node, or one call of a source. */
    int32_t (*fire)(void *node, const osteoflow_firing *firing);
    /* Frees the node. */
    void (*destroy)(void *node);
    /* For a live source; may be NULL, for 0 and 5 s. */
    int64_t (*max_delay_ns)(void *node);
    int64_t (*silent_after_ns)(void *node);
} osteoflow_kind;

/* The sizes of the structs when the plugin was compiled. */
typedef struct osteoflow_sizes {
    uint32_t plugin;
    uint32_t kind;
    uint32_t input;
    uint32_t output;
    uint32_t payload;
    uint32_t part;
    uint32_t host;
    uint32_t firing;
    uint32_t slot;
    uint32_t item;
    uint32_t view;
    uint32_t column;
    uint32_t param;
    uint32_t declared;
} osteoflow_sizes;

enum {
    /* There are no panics, or exceptions are caught. */
    OSTEOFLOW_PANIC_NONE = 0,
    /* Panics unwind and are caught. */
    OSTEOFLOW_PANIC_UNWIND = 1,
    /* Panics abort the program: the plugin is refused. */
    OSTEOFLOW_PANIC_ABORT = 2
};

typedef struct osteoflow_plugin {
    char magic[8];
    uint32_t abi_major;
    uint32_t abi_minor;
    osteoflow_sizes sizes;
    uint32_t panic;
    uint32_t flags;
    osteoflow_text name;
    osteoflow_text version;
    /* What it was built with, for messages: "osteoflow.h 1.0", "gcc 14.2". */
    osteoflow_text sdk;
    osteoflow_text compiler;
    const osteoflow_kind *kinds;
    uint64_t n_kinds;
    /* Its own payload types, and those of other plugins that it uses. */
    const osteoflow_payload *payloads;
    uint64_t n_payloads;
    /* Called once per process that runs nodes, before any is built; may be NULL. */
    void (*start)(const osteoflow_host *host);
} osteoflow_plugin;

/* The only function that a plugin exports. The description is immutable and lives as long as the library. */
OSTEOFLOW_EXPORT const osteoflow_plugin *osteoflow_describe(void);
/* clang-format off */

/* ---- Helpers ------------------------------------------------------------------------------------------------------- */

/* A text from a literal, for static descriptions. */
#define OSTEOFLOW_TEXT(literal) { literal, sizeof(literal) - 1 }
#define OSTEOFLOW_NO_TEXT { NULL, 0 }

/* The value of osteoflow_plugin.sizes. */
#define OSTEOFLOW_SIZES \
    { sizeof(osteoflow_plugin), sizeof(osteoflow_kind), sizeof(osteoflow_input), sizeof(osteoflow_output), \
      sizeof(osteoflow_payload), sizeof(osteoflow_part), sizeof(osteoflow_host), sizeof(osteoflow_firing), \
      sizeof(osteoflow_slot), sizeof(osteoflow_item), sizeof(osteoflow_view), sizeof(osteoflow_column), \
      sizeof(osteoflow_param), sizeof(osteoflow_declared) }

/* The compiler as text, for osteoflow_plugin.compiler. */
#if defined(__clang__) || defined(__GNUC__)
#define OSTEOFLOW_COMPILER __VERSION__
#else
#define OSTEOFLOW_COMPILER "unknown compiler"
#endif
#define OSTEOFLOW_SDK "osteoflow.h 1.0"

/*
 * Exports an array of kinds, in C and C++: OSTEOFLOW_PLUGIN("my_crop", "1.0.0", kinds), without a semicolon.
 * OSTEOFLOW_PLUGIN_WITH also exports an array of payload types.
 */
#define OSTEOFLOW_PLUGIN(name, version, kinds) OSTEOFLOW_EXPORT_PLUGIN(name, version, kinds, NULL, 0)
#define OSTEOFLOW_PLUGIN_WITH(name, version, kinds, payloads) \
    OSTEOFLOW_EXPORT_PLUGIN(name, version, kinds, payloads, sizeof(payloads) / sizeof((payloads)[0]))
#define OSTEOFLOW_EXPORT_PLUGIN(its_name, its_version, its_kinds, its_payloads, n_its_payloads) \
    const osteoflow_plugin *osteoflow_describe(void) { \
        static const osteoflow_plugin plugin = { \
            { 'O', 'S', 'T', 'E', 'O', 'P', 'L', 'G' }, OSTEOFLOW_ABI_MAJOR, OSTEOFLOW_ABI_MINOR, OSTEOFLOW_SIZES, \
            OSTEOFLOW_PANIC_NONE, 0, OSTEOFLOW_TEXT(its_name), OSTEOFLOW_TEXT(its_version), \
            OSTEOFLOW_TEXT(OSTEOFLOW_SDK), OSTEOFLOW_TEXT(OSTEOFLOW_COMPILER), its_kinds, \
            sizeof(its_kinds) / sizeof((its_kinds)[0]), its_payloads, n_its_payloads, NULL, \
        }; \
        return &plugin; \
    }

static inline osteoflow_text osteoflow_text_of(const char *zero_terminated) {
    osteoflow_text text;
    text.data = zero_terminated;
    text.length = zero_terminated ? (uint64_t)strlen(zero_terminated) : 0;
    return text;
}

static inline int osteoflow_text_is(osteoflow_text text, const char *zero_terminated) {
    size_t length = strlen(zero_terminated);
    return text.data != NULL && text.length == length && memcmp(text.data, zero_terminated, length) == 0;
}

/* Reports an error and returns OSTEOFLOW_FAILED: `return osteoflow_fail(firing, "the cloud is empty");` */
static inline int32_t osteoflow_fail(const osteoflow_firing *firing, const char *message) {
    firing->host->fail(firing->run, osteoflow_text_of(NULL), osteoflow_text_of(message));
    return OSTEOFLOW_FAILED;
}

/* The view of the single value of an input. Ports that are not optional always have one. */
static inline int32_t osteoflow_input_view(const osteoflow_firing *firing, uint64_t port, osteoflow_view *view) {
    const osteoflow_slot *slot = &firing->slots[port];
    if (slot->n_items != 1 || slot->items[0].value == NULL) {
        return OSTEOFLOW_FAILED;
    }
    return firing->host->view(slot->items[0].value, view);
}

/* The column with this name, type and width; NULL if there is none. The rows of lent columns are contiguous. */
static inline const osteoflow_column *osteoflow_find_column(const osteoflow_view *view, const char *name,
                                                            uint32_t type, uint32_t width) {
    for (uint64_t i = 0; i < view->n_columns; i++) {
        const osteoflow_column *column = &view->columns[i];
        if (osteoflow_text_is(column->name, name) && column->type == type && column->width == width) {
            return column;
        }
    }
    return NULL;
}

/* A number parameter; `otherwise` if neither the graph nor the schema has it. */
static inline double osteoflow_param_number(const osteoflow_firing *firing, const char *name, double otherwise) {
    osteoflow_param param;
    firing->host->param(firing->run, osteoflow_text_of(name), &param);
    return param.what == OSTEOFLOW_PARAM_NUMBER ? param.number : otherwise;
}

/* ---- Layout --------------------------------------------------------------------------------------------------------- */

#if UINTPTR_MAX == UINT64_MAX
#ifdef __cplusplus
#define OSTEOFLOW_ASSERT(what) static_assert(what, #what)
#else
#define OSTEOFLOW_ASSERT(what) _Static_assert(what, #what)
#endif
/* begin of layout */
OSTEOFLOW_ASSERT(sizeof(osteoflow_text) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_text, data) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_text, length) == 8);
OSTEOFLOW_ASSERT(sizeof(osteoflow_numbers) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_numbers, data) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_numbers, length) == 8);
OSTEOFLOW_ASSERT(sizeof(osteoflow_owner) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_owner, self) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_owner, hold) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_owner, release) == 16);
OSTEOFLOW_ASSERT(sizeof(osteoflow_column) == 72);
OSTEOFLOW_ASSERT(offsetof(osteoflow_column, name) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_column, data) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_column, n_rows) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_column, stride) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_column, type) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_column, width) == 44);
OSTEOFLOW_ASSERT(offsetof(osteoflow_column, owner) == 48);
OSTEOFLOW_ASSERT(sizeof(osteoflow_view) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_view, head) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_view, head_size) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_view, columns) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_view, n_columns) == 24);
OSTEOFLOW_ASSERT(sizeof(osteoflow_part) == 64);
OSTEOFLOW_ASSERT(offsetof(osteoflow_part, name) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_part, unit) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_part, doc) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_part, shape) == 48);
OSTEOFLOW_ASSERT(offsetof(osteoflow_part, width) == 52);
OSTEOFLOW_ASSERT(offsetof(osteoflow_part, type) == 56);
OSTEOFLOW_ASSERT(offsetof(osteoflow_part, flags) == 60);
OSTEOFLOW_ASSERT(sizeof(osteoflow_payload) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_payload, name) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_payload, parts) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_payload, n_parts) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_payload, version) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_payload, flags) == 36);
OSTEOFLOW_ASSERT(sizeof(osteoflow_item) == 64);
OSTEOFLOW_ASSERT(offsetof(osteoflow_item, number) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_item, stamp_ns) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_item, value) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_item, payload) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_item, empty_node) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_item, empty_reason) == 48);
OSTEOFLOW_ASSERT(sizeof(osteoflow_slot) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_slot, what) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_slot, flags) == 4);
OSTEOFLOW_ASSERT(offsetof(osteoflow_slot, items) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_slot, n_items) == 16);
OSTEOFLOW_ASSERT(sizeof(osteoflow_firing) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_firing, size) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_firing, host) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_firing, run) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_firing, slots) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_firing, n_slots) == 32);
OSTEOFLOW_ASSERT(sizeof(osteoflow_param) == 64);
OSTEOFLOW_ASSERT(offsetof(osteoflow_param, what) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_param, boolean) == 4);
OSTEOFLOW_ASSERT(offsetof(osteoflow_param, number) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_param, text) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_param, numbers) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_param, json) == 48);
OSTEOFLOW_ASSERT(sizeof(osteoflow_declared) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_declared, name) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_declared, payload) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_declared, params) == 24);
OSTEOFLOW_ASSERT(sizeof(osteoflow_host) == 240);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, size) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, view) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, result) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, hold) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, release) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, emit) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, emit_as) == 48);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, emit_value) == 56);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, emit_held) == 64);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, emit_empty) == 72);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, fail) == 80);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, node) == 88);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, item) == 96);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, stamp_ns) == 104);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, set_stamp_ns) == 112);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, seed) == 120);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, random) == 128);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, clock_ns) == 136);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, budget) == 144);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, budget_is_over) == 152);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, budget_release) == 160);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, cancelled) == 168);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, warn) == 176);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, absent_reason) == 184);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, out_dir) == 192);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, param) == 200);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, n_declared) == 208);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, declared) == 216);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, log_level) == 224);
OSTEOFLOW_ASSERT(offsetof(osteoflow_host, log) == 232);
OSTEOFLOW_ASSERT(sizeof(osteoflow_input) == 120);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, name) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, doc) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, payload) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, version) == 48);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, flags) == 52);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, join) == 56);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, join_n) == 60);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, join_ns) == 64);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, frame) == 72);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, to) == 88);
OSTEOFLOW_ASSERT(offsetof(osteoflow_input, from) == 104);
OSTEOFLOW_ASSERT(sizeof(osteoflow_output) == 104);
OSTEOFLOW_ASSERT(offsetof(osteoflow_output, name) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_output, doc) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_output, payload) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_output, version) == 48);
OSTEOFLOW_ASSERT(offsetof(osteoflow_output, flags) == 52);
OSTEOFLOW_ASSERT(offsetof(osteoflow_output, frame) == 56);
OSTEOFLOW_ASSERT(offsetof(osteoflow_output, to) == 72);
OSTEOFLOW_ASSERT(offsetof(osteoflow_output, from) == 88);
OSTEOFLOW_ASSERT(sizeof(osteoflow_kind) == 192);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, kind) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, doc) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, params_schema) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, example) == 48);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, declared_schema) == 64);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, literature) == 80);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, n_literature) == 88);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, inputs) == 96);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, n_inputs) == 104);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, outputs) == 112);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, n_outputs) == 120);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, role) == 128);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, kept) == 132);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, flags) == 136);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, reserved) == 140);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, data) == 144);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, create) == 152);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, fire) == 160);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, destroy) == 168);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, max_delay_ns) == 176);
OSTEOFLOW_ASSERT(offsetof(osteoflow_kind, silent_after_ns) == 184);
OSTEOFLOW_ASSERT(sizeof(osteoflow_sizes) == 56);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, plugin) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, kind) == 4);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, input) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, output) == 12);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, payload) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, part) == 20);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, host) == 24);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, firing) == 28);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, slot) == 32);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, item) == 36);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, view) == 40);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, column) == 44);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, param) == 48);
OSTEOFLOW_ASSERT(offsetof(osteoflow_sizes, declared) == 52);
OSTEOFLOW_ASSERT(sizeof(osteoflow_plugin) == 184);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, magic) == 0);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, abi_major) == 8);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, abi_minor) == 12);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, sizes) == 16);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, panic) == 72);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, flags) == 76);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, name) == 80);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, version) == 96);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, sdk) == 112);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, compiler) == 128);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, kinds) == 144);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, n_kinds) == 152);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, payloads) == 160);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, n_payloads) == 168);
OSTEOFLOW_ASSERT(offsetof(osteoflow_plugin, start) == 176);
/* end of layout */
#undef OSTEOFLOW_ASSERT
#endif

#ifdef __cplusplus
}
#endif

#endif
