// Passes on its input, and throws at two items: a std::exception, and another type.
#include "osteoflow_geometry.h"

#include <exception>
#include <stdexcept>

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *, osteoflow_text, void **node) {
    *node = const_cast<osteoflow_kind *>(kind);
    return OSTEOFLOW_OK;
}

static void relay(const osteoflow_firing *firing) {
    if (firing->slots[0].items[0].number == 1) {
        throw std::runtime_error("the spline turned inside out");
    }
    if (firing->slots[0].items[0].number == 2) {
        throw 42;
    }
    firing->host->emit_value(firing->run, 0, firing->slots[0].items[0].value);
}

static int32_t fire(void *, const osteoflow_firing *firing) {
    try {
        relay(firing);
        return OSTEOFLOW_OK;
    } catch (const std::exception &error) {
        return osteoflow_fail(firing, error.what());
    } catch (...) {
        return osteoflow_fail(firing, "an exception was thrown that is no std::exception");
    }
}

static void destroy(void *) {}

static const osteoflow_input inputs[] = {
    { OSTEOFLOW_TEXT("value"), OSTEOFLOW_TEXT("Any."), OSTEOFLOW_NO_TEXT, 0, 0, OSTEOFLOW_JOIN_EACH, 0, 0,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_output outputs[] = {
    { OSTEOFLOW_TEXT("value"), OSTEOFLOW_TEXT("The same."), OSTEOFLOW_NO_TEXT, 0, 0, OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_kind kinds[] = {
    { OSTEOFLOW_TEXT("cpp.throws"), OSTEOFLOW_TEXT("Throws on the second and third item."), OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, NULL, 0, inputs, 1, outputs, 1, OSTEOFLOW_ROLE_NODE, OSTEOFLOW_KEPT_NO, 0,
      0, NULL, create, fire, destroy, NULL, NULL },
};

OSTEOFLOW_PLUGIN("throws", "1", kinds)
