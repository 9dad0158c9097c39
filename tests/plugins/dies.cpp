// Passes on its input, and at item 1 does what the parameter `how` says: nothing good.
#include "osteoflow_geometry.h"

#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <string>
#include <thread>

struct dies {
    std::string how;
};

static int32_t create(const osteoflow_kind *, const osteoflow_firing *firing, osteoflow_text, void **node) {
    osteoflow_param how;
    dies *self = new dies;
    firing->host->param(firing->run, osteoflow_text_of("how"), &how);
    if (how.what == OSTEOFLOW_PARAM_TEXT) {
        self->how.assign(how.text.data, how.text.length);
    }
    *node = self;
    return OSTEOFLOW_OK;
}

static volatile int depth;

static int overflow(int n) {
    volatile char frame[4096];
    frame[0] = static_cast<char>(n);
    depth = n;
    return n < 0 ? 0 : overflow(n + 1) + frame[0];
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    const std::string &how = static_cast<dies *>(node)->how;
    if (how == "late" && firing->slots[0].items[0].number == 2) {
        std::this_thread::sleep_for(std::chrono::seconds(1));
    }
    if (firing->slots[0].items[0].number == 1) {
        if (how == "killed") {
            std::thread([] {
                std::this_thread::sleep_for(std::chrono::milliseconds(100));
                std::raise(SIGKILL);
            }).detach();
        } else if (how == "exit") {
            std::exit(0);
        } else if (how == "abort") {
            std::abort();
        } else if (how == "overflow") {
            return overflow(0);
        } else if (how == "throw") {
            throw std::runtime_error("the bone is upside down");
        } else if (how == "segv") {
            volatile std::uintptr_t nowhere = 8;
            *reinterpret_cast<volatile int *>(nowhere) = 1;
        } else if (how == "loop") {
            for (;;) {
                depth = depth + 1;
            }
        } else if (how == "write") {
            osteoflow_view view;
            firing->host->view(firing->slots[0].items[0].value, &view);
            std::memset(const_cast<void *>(view.columns[0].data), 0, 8);
        }
    }
    firing->host->emit_value(firing->run, 0, firing->slots[0].items[0].value);
    return OSTEOFLOW_OK;
}

static void destroy(void *node) {
    delete static_cast<dies *>(node);
}

static const osteoflow_input inputs[] = {
    { OSTEOFLOW_TEXT("value"), OSTEOFLOW_TEXT("Any."), OSTEOFLOW_NO_TEXT, 0, 0, OSTEOFLOW_JOIN_EACH, 0, 0,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_output outputs[] = {
    { OSTEOFLOW_TEXT("value"), OSTEOFLOW_TEXT("The same."), OSTEOFLOW_NO_TEXT, 0, 0, OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};
static const osteoflow_kind kinds[] = {
    { OSTEOFLOW_TEXT("dies.relay"), OSTEOFLOW_TEXT("Dies at the second item."),
      OSTEOFLOW_TEXT("{ \"type\": \"object\", \"properties\": { \"how\": { \"type\": \"string\", \"default\": \"not\", "
                     "\"description\": \"In what way.\" } } }"),
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, NULL, 0, inputs, 1, outputs, 1, OSTEOFLOW_ROLE_NODE, OSTEOFLOW_KEPT_NO, 0,
      0, NULL, create, fire, destroy, NULL, NULL },
};

OSTEOFLOW_PLUGIN("dies", "1", kinds)
