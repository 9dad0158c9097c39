/* Refuses a parameter that its schema allows. */
#include "osteoflow.h"

static int32_t create_or_refuse(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params,
                                void **node) {
    (void)params;
    if (osteoflow_param_number(firing, "at.limit", 0.0) > 1.0) {
        firing->host->fail(firing->run, osteoflow_text_of("at.limit"), osteoflow_text_of("the limit is above 1"));
        return OSTEOFLOW_FAILED;
    }
    *node = (void *)kind;
    return OSTEOFLOW_OK;
}

#define CREATE create_or_refuse
#define PARAMS_OF_ADD                                                                                                  \
    OSTEOFLOW_TEXT("{\"type\": \"object\", \"properties\": {\"at\": {\"type\": \"object\", \"properties\": "               \
                   "{\"limit\": {\"type\": \"number\"}}}}}")
#include "toy.c"
