// An exception leaves the function that the program calls.
#include "osteoflow.h"
#include <stdexcept>

namespace {

int32_t create(const osteoflow_kind *, const osteoflow_firing *, osteoflow_text, void **node) {
    static int one;
    *node = &one;
    return OSTEOFLOW_OK;
}

int32_t fire(void *, const osteoflow_firing *firing) {
    if (firing->host->item(firing->run) == 1) {
        throw std::runtime_error("nothing catches this");
    }
    return firing->host->emit_empty(firing->run, 0, OSTEOFLOW_TEXT("not yet"));
}

void destroy(void *) {}

osteoflow_input input() {
    osteoflow_input port = osteoflow_input();
    port.name = OSTEOFLOW_TEXT("number");
    port.join = OSTEOFLOW_JOIN_EACH;
    return port;
}

osteoflow_output output() {
    osteoflow_output port = osteoflow_output();
    port.name = OSTEOFLOW_TEXT("sum");
    return port;
}

const osteoflow_input inputs[] = { input() };
const osteoflow_output outputs[] = { output() };

osteoflow_kind kind() {
    osteoflow_kind kind = osteoflow_kind();
    kind.kind = OSTEOFLOW_TEXT("toy.throw");
    kind.inputs = inputs;
    kind.n_inputs = 1;
    kind.outputs = outputs;
    kind.n_outputs = 1;
    kind.create = create;
    kind.fire = fire;
    kind.destroy = destroy;
    return kind;
}

const osteoflow_kind kinds[] = { kind() };

} // namespace

OSTEOFLOW_PLUGIN("throw_out", "1.0.0", kinds)
