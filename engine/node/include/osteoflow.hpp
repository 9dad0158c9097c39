/*
 * Plugins in C++: osteoflow.h with classes, from C++11 on.
 *
 * A node is a class with a constructor that reads its parameters and a function that handles one firing:
 *
 *   struct Sphere {
 *       explicit Sphere(const osteoflow::Building &building) : radius(building.number("radius_mm")) {}
 *       void fire(osteoflow::Firing &firing);
 *       double radius;
 *   };
 *
 * osteoflow::set_functions<Sphere>(kind) makes it a kind. Exceptions of both, also those that are no std::exception, become
 * errors of the node: none leaves a function that the program calls. What is not emitted is freed.
 */
#ifndef OSTEOFLOW_HPP
#define OSTEOFLOW_HPP

#include "osteoflow.h"

#include <exception>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace osteoflow {

/* A function of the program refused its arguments, and has reported the reason. */
struct Refused : std::exception {
    const char *what() const noexcept override { return "the program refused this and has reported the reason"; }
};

/* A text from a literal or a string that outlives its use. */
inline osteoflow_text text(const char *literal) { return osteoflow_text_of(literal); }

inline osteoflow_text text(const std::string &text) {
    osteoflow_text out;
    out.data = text.data();
    out.length = text.size();
    return out;
}

inline std::string to_string(osteoflow_text text) {
    return text.data == nullptr ? std::string() : std::string(text.data, static_cast<size_t>(text.length));
}

/* The number in the interface of a type of values. */
template <class T> struct TypeOf;
template <> struct TypeOf<double> { enum { VALUE = OSTEOFLOW_F64 }; };
template <> struct TypeOf<float> { enum { VALUE = OSTEOFLOW_F32 }; };
template <> struct TypeOf<int64_t> { enum { VALUE = OSTEOFLOW_I64 }; };
template <> struct TypeOf<uint32_t> { enum { VALUE = OSTEOFLOW_U32 }; };

/* Rows of WIDTH values of an input column; memory of the program, valid until the firing ends. */
template <class T> class Rows {
  public:
    Rows(const T *data, size_t n_rows, size_t width) : data_(data), n_rows_(n_rows), width_(width) {}

    size_t size() const { return n_rows_; }
    const T *operator[](size_t row) const { return data_ + row * width_; }

  private:
    const T *data_;
    size_t n_rows_, width_;
};

/* The value of an input. */
class Input {
  public:
    explicit Input(const osteoflow_view &view) : view_(view) {}

    const osteoflow_view &view() const { return view_; }

    /* The head, as the struct of its payload: `input.head<osteoflow_cloud>()`. */
    template <class Head> const Head &head() const {
        if (view_.head_size < sizeof(Head)) {
            throw std::runtime_error("the head of an input is smaller than the struct that it is read by");
        }
        return *static_cast<const Head *>(view_.head);
    }

    bool has(const char *name) const {
        for (uint64_t i = 0; i < view_.n_columns; i++) {
            if (osteoflow_text_is(view_.columns[i].name, name)) {
                return true;
            }
        }
        return false;
    }

    /* The rows of a column; an error if there is none of this name, type and width. */
    template <class T> Rows<T> rows(const char *name, uint32_t width) const {
        const osteoflow_column *column = osteoflow_find_column(&view_, name, TypeOf<T>::VALUE, width);
        if (column == nullptr) {
            throw std::runtime_error("an input has no column \"" + std::string(name) + "\" of this type and width");
        }
        return Rows<T>(static_cast<const T *>(column->data), static_cast<size_t>(column->n_rows), width);
    }

  private:
    osteoflow_view view_;
};

/* The columns of an answer. Those that are not emitted are freed. */
class Columns {
  public:
    Columns() {}
    Columns(const Columns &) = delete;
    Columns &operator=(const Columns &) = delete;
    ~Columns() {
        for (const osteoflow_column &column : columns_) {
            if (column.owner.release != nullptr) {
                column.owner.release(column.owner.self);
            }
        }
    }

    /* Adds a column with `width` values in a row. The values are moved, not copied. */
    template <class T> void add(const std::string &name, uint32_t width, std::vector<T> values) {
        if (width == 0 || values.size() % width != 0) {
            throw std::logic_error("the values of column \"" + name + "\" are no whole number of rows");
        }
        std::unique_ptr<Owned<T>> owned(new Owned<T>(name, std::move(values)));
        osteoflow_column column = osteoflow_column();
        column.name = text(owned->name);
        column.data = owned->values.data();
        column.n_rows = owned->values.size() / width;
        column.stride = width * sizeof(T);
        column.type = TypeOf<T>::VALUE;
        column.width = width;
        column.owner.release = release<T>;
        column.owner.self = owned.get();
        columns_.push_back(column);
        owned.release();
    }

  private:
    friend class Firing;

    template <class T> struct Owned {
        Owned(const std::string &name, std::vector<T> values) : name(name), values(std::move(values)) {}
        std::string name;
        std::vector<T> values;
    };

    template <class T> static void release(void *owned) { delete static_cast<Owned<T> *>(owned); }

    std::vector<osteoflow_column> columns_;
};

/* A node while it is built: its parameters, checked against the schema and with defaults. */
class Building {
  public:
    explicit Building(const osteoflow_firing *firing) : firing_(firing) {}

    osteoflow_param param(const std::string &name) const {
        osteoflow_param found;
        firing_->host->param(firing_->run, osteoflow::text(name), &found);
        return found;
    }

    double number(const std::string &name) const { return of(name, OSTEOFLOW_PARAM_NUMBER, "number").number; }
    bool boolean(const std::string &name) const { return of(name, OSTEOFLOW_PARAM_BOOL, "boolean").boolean != 0; }
    std::string text(const std::string &name) const { return to_string(of(name, OSTEOFLOW_PARAM_TEXT, "text").text); }
    std::vector<double> numbers(const std::string &name) const {
        const osteoflow_param found = of(name, OSTEOFLOW_PARAM_NUMBERS, "list of numbers");
        return std::vector<double>(found.numbers.data, found.numbers.data + found.numbers.length);
    }

    /* Refuses the value of a parameter: `throw building.refuse("radius_mm", "it is larger than ..");` */
    Refused refuse(const std::string &parameter, const std::string &message) const {
        firing_->host->fail(firing_->run, osteoflow::text(parameter), osteoflow::text(message));
        return Refused();
    }

    const osteoflow_firing *raw() const { return firing_; }

  private:
    osteoflow_param of(const std::string &name, uint32_t what, const char *called) const {
        const osteoflow_param found = param(name);
        if (found.what != what) {
            throw refuse(name, "the plugin reads a " + std::string(called) + ", which neither graph nor schema gives");
        }
        return found;
    }

    const osteoflow_firing *firing_;
};

/* One firing of a node. */
class Firing {
  public:
    explicit Firing(const osteoflow_firing *firing) : firing_(firing) {}

    /* Whether an input has a value; inputs that are not optional have one. */
    bool has(uint64_t port) const {
        return firing_->slots[port].n_items == 1 && firing_->slots[port].items[0].value != nullptr;
    }

    Input input(uint64_t port) const {
        osteoflow_view view;
        if (osteoflow_input_view(firing_, port, &view) != OSTEOFLOW_OK) {
            throw std::runtime_error("input " + std::to_string(port) + " cannot be read");
        }
        return Input(view);
    }

    /* Answers on an output. The program owns the columns from here on, also if it refuses them. */
    template <class Head> void emit(uint64_t port, const Head &head, Columns &columns) {
        const std::vector<osteoflow_column> given = std::move(columns.columns_);
        columns.columns_.clear();
        osteoflow_view view = osteoflow_view();
        view.head = &head;
        view.head_size = sizeof head;
        view.columns = given.data();
        view.n_columns = given.size();
        done(firing_->host->emit(firing_->run, port, &view));
    }

    template <class Head> void emit(uint64_t port, const Head &head) {
        Columns none;
        emit(port, head, none);
    }

    void emit_empty(uint64_t port, const std::string &reason) {
        done(firing_->host->emit_empty(firing_->run, port, text(reason)));
    }

    uint64_t item() const { return firing_->host->item(firing_->run); }
    int64_t stamp_ns() const { return firing_->host->stamp_ns(firing_->run); }
    void set_stamp_ns(int64_t stamp_ns) { firing_->host->set_stamp_ns(firing_->run, stamp_ns); }
    uint64_t random(uint64_t index) const { return firing_->host->random(firing_->run, index); }
    bool cancelled() const { return firing_->host->cancelled(firing_->run) != 0; }
    void warn(const std::string &message) { firing_->host->warn(firing_->run, text(message)); }

    /* The end of a source: it is not called again. */
    void end() { status_ = OSTEOFLOW_END; }
    int32_t status() const { return status_; }

    /* The firing of osteoflow.h, for what is missing here. */
    const osteoflow_firing *raw() const { return firing_; }

  private:
    static void done(int32_t status) {
        if (status != OSTEOFLOW_OK) {
            throw Refused();
        }
    }

    const osteoflow_firing *firing_;
    int32_t status_ = OSTEOFLOW_OK;
};

/* Calls `work`; an exception becomes an error of the node. */
template <class Work> int32_t guarded(const osteoflow_firing *firing, Work work) noexcept {
    try {
        return work();
    } catch (const Refused &) {
        return OSTEOFLOW_FAILED;
    } catch (const std::exception &error) {
        return osteoflow_fail(firing, error.what());
    } catch (...) {
        return osteoflow_fail(firing, "an exception was thrown that is no std::exception");
    }
}

template <class Node> struct Functions {
    static int32_t create(const osteoflow_kind *, const osteoflow_firing *firing, osteoflow_text, void **node) {
        return guarded(firing, [&] {
            *node = new Node(Building(firing));
            return static_cast<int32_t>(OSTEOFLOW_OK);
        });
    }

    static int32_t fire(void *node, const osteoflow_firing *firing) {
        return guarded(firing, [&] {
            Firing call(firing);
            static_cast<Node *>(node)->fire(call);
            return call.status();
        });
    }

    static void destroy(void *node) { delete static_cast<Node *>(node); }
};

/* Makes a class the node of a kind. */
template <class Node> void set_functions(osteoflow_kind &kind) {
    kind.create = Functions<Node>::create;
    kind.fire = Functions<Node>::fire;
    kind.destroy = Functions<Node>::destroy;
}

/* A port that takes one item at each firing; change its fields for another join. */
inline osteoflow_input input(const char *name, const char *doc, const char *payload, uint32_t version) {
    osteoflow_input port = osteoflow_input();
    port.name = text(name);
    port.doc = text(doc);
    port.payload = text(payload);
    port.version = version;
    port.join = OSTEOFLOW_JOIN_EACH;
    return port;
}

inline osteoflow_output output(const char *name, const char *doc, const char *payload, uint32_t version) {
    osteoflow_output port = osteoflow_output();
    port.name = text(name);
    port.doc = text(doc);
    port.payload = text(payload);
    port.version = version;
    return port;
}

/* A kind of nodes of one class. The texts are literals; `params` is the JSON Schema of the parameters. */
template <class Node>
osteoflow_kind kind(const char *name, const char *doc, const char *params, const char *example,
                    std::vector<osteoflow_input> inputs, std::vector<osteoflow_output> outputs) {
    static const std::vector<osteoflow_input> its_inputs = std::move(inputs);
    static const std::vector<osteoflow_output> its_outputs = std::move(outputs);
    osteoflow_kind kind = osteoflow_kind();
    kind.kind = text(name);
    kind.doc = text(doc);
    kind.params_schema = text(params);
    kind.example = text(example);
    kind.inputs = its_inputs.data();
    kind.n_inputs = its_inputs.size();
    kind.outputs = its_outputs.data();
    kind.n_outputs = its_outputs.size();
    kind.role = OSTEOFLOW_ROLE_NODE;
    set_functions<Node>(kind);
    return kind;
}

} // namespace osteoflow

#endif
