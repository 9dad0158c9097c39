/*
 * A source of numbers, and a node that adds ADD to each. The files in bad/ redefine one of the macros below and include this
 * file.
 */
#include "osteoflow.h"
#include <stdlib.h>

#ifndef ADD
#define ADD 1.0
#endif
#ifndef MAGIC
#define MAGIC 'O', 'S', 'T', 'E', 'O', 'P', 'L', 'G'
#endif
#ifndef VERSION
#define VERSION OSTEOFLOW_ABI_MAJOR, OSTEOFLOW_ABI_MINOR
#endif
#ifndef SIZES
#define SIZES OSTEOFLOW_SIZES
#endif
#ifndef PANIC
#define PANIC OSTEOFLOW_PANIC_NONE
#endif
#ifndef NAME
#define NAME OSTEOFLOW_TEXT("toy")
#endif
#ifndef KINDS
#define KINDS kinds, sizeof kinds / sizeof kinds[0]
#endif
#ifndef KIND_OF_ADD
#define KIND_OF_ADD OSTEOFLOW_TEXT("toy.add")
#endif
/* Port and parameters of the node. */
#ifndef PORT_OF_ADD
#define PORT_OF_ADD OSTEOFLOW_TEXT("number")
#endif
#ifndef PARAMS_OF_ADD
#define PARAMS_OF_ADD OSTEOFLOW_NO_TEXT
#endif
#ifndef CREATE
#define CREATE create_add
#endif
#ifndef DESTROY
#define DESTROY destroy_add
#endif
#ifndef PAYLOAD
#define PAYLOAD "toy/Number"
#endif
/* The payload of the output. */
#ifndef GIVEN
#define GIVEN OSTEOFLOW_TEXT(PAYLOAD)
#endif

typedef struct number_head {
    double value;
} number_head;

static const osteoflow_part parts[] = {
    { OSTEOFLOW_TEXT("value"), OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_PART_FLOAT, 0, 0, 0 },
};
static const osteoflow_payload payloads[] = {
    { OSTEOFLOW_TEXT(PAYLOAD), parts, sizeof parts / sizeof parts[0], 1, 0 },
};

typedef struct give {
    double number;
    int given;
} give;

static int32_t create_give(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params,
                           void **node) {
    (void)kind;
    (void)params;
    give *new = malloc(sizeof *new);
    new->number = osteoflow_param_number(firing, "number", 0.0);
    new->given = 0;
    *node = new;
    return OSTEOFLOW_OK;
}

static int32_t fire_give(void *node, const osteoflow_firing *firing) {
    give *self = node;
    if (self->given == 3) {
        return OSTEOFLOW_END;
    }
    number_head head = { self->number + self->given };
    osteoflow_view out = { &head, sizeof head, NULL, 0 };
    firing->host->set_stamp_ns(firing->run, self->given++);
    return firing->host->emit(firing->run, 0, &out);
}

static void destroy_give(void *node) {
    free(node);
}

/* Emits the answer. */
#ifndef EMIT
#define EMIT emit_number
static int32_t emit_number(const osteoflow_firing *firing, double value) {
    number_head head = { value };
    osteoflow_view out = { &head, sizeof head, NULL, 0 };
    return firing->host->emit(firing->run, 0, &out);
}
#endif

static int32_t create_add(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params,
                          void **node) {
    (void)firing;
    (void)params;
    *node = (void *)kind;
    return OSTEOFLOW_OK;
}

static int32_t fire_add(void *node, const osteoflow_firing *firing) {
    (void)node;
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "there is no number");
    }
    double value = ((const number_head *)view.head)->value + ADD;
    if (value >= 1000.0) {
        return osteoflow_fail(firing, "a thousand is too much");
    }
    return EMIT(firing, value);
}

static void destroy_add(void *node) {
    (void)node;
}

#define NUMBER OSTEOFLOW_TEXT(PAYLOAD), 1
#define NO_FRAMES OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT
static const osteoflow_input add_in[] = {
    { PORT_OF_ADD, OSTEOFLOW_TEXT("A number."), NUMBER, 0, OSTEOFLOW_JOIN_EACH, 0, 0, NO_FRAMES },
};
static const osteoflow_output give_out[] = {
    { OSTEOFLOW_TEXT("number"), OSTEOFLOW_TEXT("Numbers."), NUMBER, 0, NO_FRAMES },
};
static const osteoflow_output add_out[] = {
    { OSTEOFLOW_TEXT("sum"), OSTEOFLOW_TEXT("The sum."), GIVEN, 1, 0, NO_FRAMES },
};

static const osteoflow_kind kinds[] = {
    { OSTEOFLOW_TEXT("toy.give"), OSTEOFLOW_TEXT("Gives three numbers."),
      OSTEOFLOW_TEXT("{\"type\": \"object\", \"properties\": {\"number\": {\"description\": \"The first.\", "
                     "\"type\": \"number\", \"default\": 0, \"maximum\": 5000}}, \"additionalProperties\": false}"),
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, NULL, 0, NULL, 0, give_out, 1, OSTEOFLOW_ROLE_SOURCE, OSTEOFLOW_KEPT_NO,
      0, 0, NULL, create_give, fire_give, destroy_give, NULL, NULL },
    { KIND_OF_ADD, OSTEOFLOW_TEXT("Adds to a number."), PARAMS_OF_ADD, OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, NULL, 0, add_in, 1, add_out, 1, OSTEOFLOW_ROLE_NODE, OSTEOFLOW_KEPT_BY_INPUTS, 0, 0, NULL,
      CREATE, fire_add, DESTROY, NULL, NULL },
};

const osteoflow_plugin *osteoflow_describe(void) {
    static const osteoflow_plugin plugin = {
        { MAGIC }, VERSION, SIZES, PANIC, 0, NAME, OSTEOFLOW_TEXT("1.2.3"), OSTEOFLOW_TEXT(OSTEOFLOW_SDK),
        OSTEOFLOW_TEXT("a compiler"), KINDS, payloads, 1, NULL,
    };
    return &plugin;
}
