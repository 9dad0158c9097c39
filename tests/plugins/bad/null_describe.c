/* Returns no description. */
#include "osteoflow.h"

const osteoflow_plugin *osteoflow_describe(void) {
    return NULL;
}
