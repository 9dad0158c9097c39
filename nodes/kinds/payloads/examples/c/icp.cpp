/*
 * icp_cpp.point_to_point: point-to-point ICP in its plainest form, written in C++.
 *
 *   c++ -std=c++11 -O2 -shared -fPIC -I engine/node/include -I nodes/kinds/payloads/include \
 *       nodes/kinds/payloads/examples/c/icp.cpp -o libicp.so
 *
 * Every source point pairs with the nearest target point, the motion that fits the pairs best is taken, and so on until
 * no pair changes any more. The built-in icp.published does the same with reading = "iterations", and both
 * converge to the same pose to 1e-9 mm. Ports are those of the built-in kinds, so that one word in a graph swaps them.
 *
 * Errors are exceptions inside, and caught in the three functions at the end: none may leave them.
 */
#include "osteoflow_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace {

// ---- Linear algebra ---------------------------------------------------------------------------------------------------

typedef std::array<double, 3> Vec;

Vec operator+(const Vec &a, const Vec &b) { return Vec{ { a[0] + b[0], a[1] + b[1], a[2] + b[2] } }; }
Vec operator-(const Vec &a, const Vec &b) { return Vec{ { a[0] - b[0], a[1] - b[1], a[2] - b[2] } }; }
Vec operator*(const Vec &a, double s) { return Vec{ { a[0] * s, a[1] * s, a[2] * s } }; }
double dot(const Vec &a, const Vec &b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec cross(const Vec &a, const Vec &b) {
    return Vec{ { a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0] } };
}

// The mean, summed about the first point: in CT coordinates, far from the origin, sums would lose digits.
Vec centroid(const std::vector<Vec> &points) {
    Vec sum = Vec();
    for (const Vec &p : points) {
        sum = sum + (p - points[0]);
    }
    return points[0] + sum * (1.0 / static_cast<double>(points.size()));
}

template <size_t N> using Matrix = std::array<std::array<double, N>, N>;

template <size_t N> struct Eigen {
    std::array<double, N> values; // the largest first
    Matrix<N> vectors;            // one in each row
};

// Eigenvalues and -vectors of a symmetric matrix, by Jacobi's rotations.
template <size_t N> Eigen<N> eigen(Matrix<N> a) {
    Matrix<N> v = Matrix<N>();
    for (size_t i = 0; i < N; i++) {
        v[i][i] = 1.0;
    }
    for (int sweep = 0; sweep < 64; sweep++) {
        double off = 0.0, on = 0.0;
        for (size_t p = 0; p < N; p++) {
            on += a[p][p] * a[p][p];
            for (size_t q = p + 1; q < N; q++) {
                off += a[p][q] * a[p][q];
            }
        }
        if (off <= 1e-36 * on) {
            break;
        }
        for (size_t p = 0; p < N; p++) {
            for (size_t q = p + 1; q < N; q++) {
                if (a[p][q] == 0.0) {
                    continue;
                }
                const double theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                const double t = (theta < 0.0 ? -1.0 : 1.0) / (std::fabs(theta) + std::sqrt(theta * theta + 1.0));
                const double c = 1.0 / std::sqrt(t * t + 1.0), s = t * c;
                for (size_t k = 0; k < N; k++) {
                    const double kp = a[k][p], kq = a[k][q];
                    a[k][p] = c * kp - s * kq;
                    a[k][q] = s * kp + c * kq;
                }
                for (size_t k = 0; k < N; k++) {
                    const double pk = a[p][k], qk = a[q][k];
                    a[p][k] = c * pk - s * qk;
                    a[q][k] = s * pk + c * qk;
                    const double vp = v[p][k], vq = v[q][k];
                    v[p][k] = c * vp - s * vq;
                    v[q][k] = s * vp + c * vq;
                }
            }
        }
    }
    std::array<size_t, N> order;
    for (size_t i = 0; i < N; i++) {
        order[i] = i;
    }
    std::sort(order.begin(), order.end(), [&](size_t i, size_t j) { return a[i][i] > a[j][j]; });
    Eigen<N> result;
    for (size_t i = 0; i < N; i++) {
        result.values[i] = a[order[i]][order[i]];
        result.vectors[i] = v[order[i]];
    }
    return result;
}

// A unit quaternion x y z w.
typedef std::array<double, 4> Quaternion;

Quaternion normalised(Quaternion q) {
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (double &part : q) {
        part /= norm;
    }
    return q;
}

Quaternion operator*(const Quaternion &a, const Quaternion &b) {
    const Vec u = { { a[0], a[1], a[2] } }, v = { { b[0], b[1], b[2] } };
    const Vec vector = v * a[3] + u * b[3] + cross(u, v);
    return normalised(Quaternion{ { vector[0], vector[1], vector[2], a[3] * b[3] - dot(u, v) } });
}

Vec turned(const Quaternion &q, const Vec &p) {
    const Vec u = { { q[0], q[1], q[2] } };
    const Vec t = cross(u, p) * 2.0;
    return p + t * q[3] + cross(u, t);
}

double angle(const Quaternion &q) {
    return 2.0 * std::atan2(std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]), std::fabs(q[3]));
}

// ---- Nearest points ---------------------------------------------------------------------------------------------------

// A k-d tree stored in the order of its points; each range is split at its median.
class Tree {
  public:
    explicit Tree(std::vector<Vec> points, std::vector<Vec> normals) {
        std::vector<uint32_t> order(points.size());
        for (size_t i = 0; i < order.size(); i++) {
            order[i] = static_cast<uint32_t>(i);
        }
        axes_.resize(points.size());
        build(points, order, 0, points.size());
        for (uint32_t i : order) {
            points_.push_back(points[i]);
            normals_.push_back(normals.empty() ? Vec() : normals[i]);
        }
    }

    const Vec &point(int64_t i) const { return points_[static_cast<size_t>(i)]; }
    const Vec &normal(int64_t i) const { return normals_[static_cast<size_t>(i)]; }

    // The nearest point closer than a squared distance, -1 if there is none; looks at `guess` first.
    int64_t nearest(const Vec &query, double limit_square, int64_t guess) const {
        int64_t best = -1;
        if (guess >= 0) {
            consider(query, static_cast<size_t>(guess), best, limit_square);
        }
        search(query, 0, points_.size(), best, limit_square);
        return best;
    }

  private:
    static const size_t LEAF = 8;

    void build(const std::vector<Vec> &points, std::vector<uint32_t> &order, size_t from, size_t to) {
        if (to - from <= LEAF) {
            return;
        }
        Vec low = points[order[from]], high = low;
        for (size_t i = from; i < to; i++) {
            for (size_t k = 0; k < 3; k++) {
                low[k] = std::min(low[k], points[order[i]][k]);
                high[k] = std::max(high[k], points[order[i]][k]);
            }
        }
        const Vec size = high - low;
        const size_t axis = static_cast<size_t>(std::max_element(size.begin(), size.end()) - size.begin());
        const size_t middle = from + (to - from) / 2;
        std::nth_element(order.begin() + static_cast<std::ptrdiff_t>(from),
                         order.begin() + static_cast<std::ptrdiff_t>(middle),
                         order.begin() + static_cast<std::ptrdiff_t>(to),
                         [&](uint32_t a, uint32_t b) { return points[a][axis] < points[b][axis]; });
        axes_[middle] = static_cast<uint8_t>(axis);
        build(points, order, from, middle);
        build(points, order, middle + 1, to);
    }

    void consider(const Vec &query, size_t i, int64_t &best, double &square) const {
        const Vec gap = points_[i] - query;
        const double found = dot(gap, gap);
        if (found < square) {
            square = found;
            best = static_cast<int64_t>(i);
        }
    }

    void search(const Vec &query, size_t from, size_t to, int64_t &best, double &square) const {
        if (to - from <= LEAF) {
            for (size_t i = from; i < to; i++) {
                consider(query, i, best, square);
            }
            return;
        }
        const size_t middle = from + (to - from) / 2;
        const double beyond = query[axes_[middle]] - points_[middle][axes_[middle]];
        if (beyond < 0.0) {
            search(query, from, middle, best, square);
        } else {
            search(query, middle + 1, to, best, square);
        }
        if (beyond * beyond < square) {
            consider(query, middle, best, square);
            if (beyond < 0.0) {
                search(query, middle + 1, to, best, square);
            } else {
                search(query, from, middle, best, square);
            }
        }
    }

    std::vector<Vec> points_, normals_;
    std::vector<uint8_t> axes_;
};

// ---- Inputs -----------------------------------------------------------------------------------------------------------

// An output that was refused, or a call of the program that failed; the program has reported the reason.
struct ReportedError : std::exception {};

osteoflow_view view_of(const osteoflow_firing *firing, uint64_t port) {
    osteoflow_view view;
    if (osteoflow_input_view(firing, port, &view) != OSTEOFLOW_OK) {
        throw std::runtime_error("an input cannot be read");
    }
    return view;
}

// The rows of a column of three doubles; none if the view lacks it.
std::vector<Vec> rows(const osteoflow_view &view, const char *name) {
    const osteoflow_column *column = osteoflow_find_column(&view, name, OSTEOFLOW_F64, 3);
    std::vector<Vec> out;
    if (column != NULL && column->n_rows > 0) {
        const Vec *first = static_cast<const Vec *>(column->data);
        out.assign(first, first + column->n_rows);
    }
    return out;
}

bool same(osteoflow_text a, osteoflow_text b) {
    return a.length == b.length && std::equal(a.data, a.data + a.length, b.data);
}

std::string text(osteoflow_text given) { return std::string(given.data, given.length); }

// Keeps the points that a camera at `eye` may see, up to 20 degrees past the silhouette, as the built-in kinds do: a scan
// would else be drawn to the far side of a thin bone. Keeps all where the side of the normals cannot be told.
void keep_facing(const Vec &eye, std::vector<Vec> &points, std::vector<Vec> &normals) {
    const Vec middle = centroid(points);
    double along = 0.0, length = 0.0;
    for (size_t i = 0; i < points.size(); i++) {
        const Vec arm = points[i] - middle;
        along += dot(arm, normals[i]);
        length += std::sqrt(dot(arm, arm) * dot(normals[i], normals[i]));
    }
    if (!(std::fabs(along / length) > 0.02)) {
        return;
    }
    const double side = along < 0.0 ? -1.0 : 1.0;
    size_t kept = 0;
    for (size_t i = 0; i < points.size(); i++) {
        const Vec sight = eye - points[i];
        if (side * dot(normals[i], sight) > -0.34 * std::sqrt(dot(sight, sight))) {
            points[kept] = points[i];
            normals[kept++] = normals[i];
        }
    }
    points.resize(kept);
    normals.resize(kept);
}

// ---- The registration -------------------------------------------------------------------------------------------------

struct Params {
    double max_pair_distance_mm;
    uint64_t max_iterations;
    uint64_t min_pairs;
};

// The pose of the source: its rotation, and its centroid in the target's frame.
struct State {
    Quaternion rotation;
    Vec centre;
};

struct Step {
    uint64_t n_pairs;
    double rms_mm, step_mm, step_rad;
    State after;
};

class Icp {
  public:
    Icp(const Tree &target, const std::vector<Vec> &source, const Params &params)
        : target_(target), params_(params), source_centre(centroid(source)), partners_(source.size(), -1) {
        double squares = 0.0;
        for (const Vec &p : source) {
            arms_.push_back(p - source_centre);
            squares += dot(arms_.back(), arms_.back());
        }
        lever_arm_mm = std::max(std::sqrt(squares / static_cast<double>(source.size())), 1e-9);
    }

    // Steps until no pair changes any more or the steps are used up; true if the pairs stay.
    bool run(State start, const osteoflow_firing *firing) {
        state = start;
        pair();
        while (steps.size() < params_.max_iterations && !firing->host->cancelled(firing->run)) {
            const State next = best_fit();
            Step step = { n_pairs, rms_mm(), 0.0, 0.0, next };
            const Quaternion back = { { -state.rotation[0], -state.rotation[1], -state.rotation[2],
                                        state.rotation[3] } };
            const Vec shift = next.centre - state.centre;
            step.step_rad = angle(next.rotation * back);
            step.step_mm = std::sqrt(dot(shift, shift) + std::pow(step.step_rad * lever_arm_mm, 2));
            steps.push_back(step);
            state = next;
            if (!pair()) {
                return true;
            }
        }
        return false;
    }

    double rms_mm() const { return std::sqrt(squares_ / static_cast<double>(n_pairs)); }

    // The normal matrix of the pairs along the target's normals: translation in mm, rotation about the centroid times `lever`.
    Matrix<6> normal_matrix(double lever) const {
        Matrix<6> sum = Matrix<6>();
        for (size_t i = 0; i < arms_.size(); i++) {
            if (partners_[i] < 0) {
                continue;
            }
            const Vec &n = target_.normal(partners_[i]);
            const Vec turn = cross(turned(state.rotation, arms_[i]), n) * (1.0 / lever);
            const double row[6] = { n[0], n[1], n[2], turn[0], turn[1], turn[2] };
            for (size_t a = 0; a < 6; a++) {
                for (size_t b = 0; b < 6; b++) {
                    sum[a][b] += row[a] * row[b];
                }
            }
        }
        return sum;
    }

  private:
    const Tree &target_;
    const Params params_;

  public:
    const Vec source_centre;
    double lever_arm_mm;
    State state;
    uint64_t n_pairs;
    std::vector<Step> steps;

  private:
    // Pairs every point again; true if a pair has changed.
    bool pair() {
        bool changed = false;
        n_pairs = 0;
        squares_ = 0.0;
        const double limit = params_.max_pair_distance_mm * params_.max_pair_distance_mm;
        for (size_t i = 0; i < arms_.size(); i++) {
            const Vec moved = state.centre + turned(state.rotation, arms_[i]);
            const int64_t found = target_.nearest(moved, limit, partners_[i]);
            changed = changed || found != partners_[i];
            partners_[i] = found;
            if (found >= 0) {
                const Vec gap = target_.point(found) - moved;
                squares_ += dot(gap, gap);
                n_pairs++;
            }
        }
        if (n_pairs < params_.min_pairs) {
            throw std::runtime_error(std::to_string(n_pairs) + " of " + std::to_string(arms_.size()) +
                                     " source points lie within " + std::to_string(params_.max_pair_distance_mm) +
                                     " mm of the target, " + std::to_string(params_.min_pairs) +
                                     " are needed; is init right, and are both in mm?");
        }
        return changed;
    }

    // The motion that best carries the source points of the pairs onto their target points. Source: Horn 1987, the quaternion as the
    // eigenvector of the largest eigenvalue. Sums are taken about the source's centroid to keep all digits.
    State best_fit() const {
        Vec mean_arm = Vec(), mean_partner = Vec();
        for (size_t i = 0; i < arms_.size(); i++) {
            if (partners_[i] >= 0) {
                mean_arm = mean_arm + turned(state.rotation, arms_[i]);
                mean_partner = mean_partner + (target_.point(partners_[i]) - state.centre);
            }
        }
        mean_arm = mean_arm * (1.0 / static_cast<double>(n_pairs));
        mean_partner = mean_partner * (1.0 / static_cast<double>(n_pairs));
        Matrix<3> m = Matrix<3>();
        for (size_t i = 0; i < arms_.size(); i++) {
            if (partners_[i] >= 0) {
                const Vec from = turned(state.rotation, arms_[i]) - mean_arm;
                const Vec to = target_.point(partners_[i]) - state.centre - mean_partner;
                for (size_t a = 0; a < 3; a++) {
                    for (size_t b = 0; b < 3; b++) {
                        m[a][b] += from[a] * to[b];
                    }
                }
            }
        }
        const double trace = m[0][0] + m[1][1] + m[2][2];
        const Vec skew = { { m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0] } };
        Matrix<4> horn = Matrix<4>();
        for (size_t a = 0; a < 3; a++) {
            for (size_t b = 0; b < 3; b++) {
                horn[a][b] = m[a][b] + m[b][a] - (a == b ? trace : 0.0);
            }
            horn[a][3] = horn[3][a] = skew[a];
        }
        horn[3][3] = trace;
        const Quaternion turn = normalised(eigen(horn).vectors[0]);
        State next;
        next.rotation = turn * state.rotation;
        next.centre = state.centre + mean_partner - turned(turn, mean_arm);
        return next;
    }

    std::vector<Vec> arms_;
    std::vector<int64_t> partners_;
    double squares_;
};

// ---- The report -------------------------------------------------------------------------------------------------------

std::string number(double value) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.17g", value);
    return std::isfinite(value) ? digits : "null";
}

template <class List> std::string list(const List &values) {
    std::string out = "[";
    for (double value : values) {
        out += (out.size() > 1 ? "," : "") + number(value);
    }
    return out + "]";
}

std::string field(const char *name, const std::string &json) { return std::string("\"") + name + "\":" + json; }

std::string json_of(const State &state, const Vec &source_centre) {
    const Vec translation = state.centre - turned(state.rotation, source_centre);
    return "{" + field("rotation", list(state.rotation)) + "," + field("translation", list(translation)) + "}";
}

// A motion and its eigenvalue; an eigenvector has no sign, so its largest component is made positive.
std::string direction(double value, std::array<double, 6> v) {
    const auto largest = std::max_element(v.begin(), v.end(), [](double a, double b) { return fabs(a) < fabs(b); });
    if (*largest < 0.0) {
        for (double &part : v) {
            part = -part;
        }
    }
    return "{" + field("residual_per_mm", number(std::sqrt(std::max(value, 0.0)))) + "," +
           field("translation", list(Vec{ { v[0], v[1], v[2] } })) + "," +
           field("rotation", list(Vec{ { v[3], v[4], v[5] } })) + "}";
}

// As the built-in kinds report. What this one does not know (the way still to go, the resolution) is null.
std::string report(const Icp &icp, bool stays, const Params &params, size_t n_source) {
    const double n = static_cast<double>(icp.n_pairs);
    std::string matrix;
    for (const std::array<double, 6> &row : icp.normal_matrix(1.0)) {
        matrix += (matrix.empty() ? "" : ",") + list(row);
    }
    Matrix<6> hold = icp.normal_matrix(icp.lever_arm_mm);
    for (std::array<double, 6> &row : hold) {
        for (double &part : row) {
            part /= n;
        }
    }
    const Eigen<6> held = eigen(hold);
    std::array<double, 6> values = held.values;
    std::string undetermined;
    for (size_t k = 6; k-- > 0;) {
        values[k] = std::max(values[k], 0.0);
        // Ten millimetres of slide would hide in a residual of 0.05 mm.
        if (std::sqrt(values[k]) < 0.005) {
            undetermined += (undetermined.empty() ? "" : ",") + direction(values[k], held.vectors[k]);
        }
    }
    const bool used_up = icp.steps.size() >= params.max_iterations;
    const std::string rule = "{" + field("parameter", "\"max_iterations\"") + "," +
                             field("limit", number(static_cast<double>(params.max_iterations))) + "," +
                             field("last", number(static_cast<double>(icp.steps.size()))) + "," +
                             field("met", used_up ? "true" : "false") + "}";
    const std::string observability =
        "{" + field("eigenvalues", list(values)) + "," + field("condition", number(values[0] / values[5])) + "," +
        field("lever_arm_mm", number(icp.lever_arm_mm)) + "," +
        field("weakest", direction(values[5], held.vectors[5])) + "," +
        field("undetermined", "[" + undetermined + "]") + "}";
    return "{" + field("converged", stays ? "true" : "false") + "," +
           field("stop_reason", stays ? "\"step\"" : used_up ? "\"iterations\"" : "\"cancelled\"") + "," +
           field("rules", "[" + rule + "]") + "," + field("iterations", std::to_string(icp.steps.size())) + "," +
           field("n_source", std::to_string(n_source)) + "," + field("n_pairs", std::to_string(icp.n_pairs)) + "," +
           field("pair_share", number(n / static_cast<double>(n_source))) + "," +
           field("rms_mm", number(icp.rms_mm())) + "," + field("point_rms_mm", number(icp.rms_mm())) + "," +
           field("step_mm", number(icp.steps.empty() ? 0.0 : icp.steps.back().step_mm)) + "," +
           field("step_rad", number(icp.steps.empty() ? 0.0 : icp.steps.back().step_rad)) + "," +
           field("remaining_mm", "null") + "," + field("resolution_mm", "null") + "," + field("left_mm", "null") +
           "," + field("normal_matrix", "[" + matrix + "]") + "," + field("centroid_mm", list(icp.state.centre)) + "," +
           field("observability", observability) + "}";
}

std::string trace(const Icp &icp) {
    std::string steps;
    for (size_t k = 0; k < icp.steps.size(); k++) {
        const Step &step = icp.steps[k];
        steps += (k > 0 ? ",{" : "{") + field("iteration", std::to_string(k + 1)) + "," + field("every", "1") + "," +
                 field("n_pairs", std::to_string(step.n_pairs)) + "," + field("rms_mm", number(step.rms_mm)) + "," +
                 field("step_mm", number(step.step_mm)) + "," + field("step_rad", number(step.step_rad)) + "," +
                 field("remaining_mm", "null") + "," + field("accelerated", "false") + "," +
                 field("t_target_source", json_of(step.after, icp.source_centre)) + "}";
    }
    return "{" + field("steps", "[" + steps + "]") + "}";
}

void emit(const osteoflow_firing *firing, uint64_t port, const void *head, uint64_t head_size) {
    const osteoflow_view view = { head, head_size, NULL, 0 };
    if (firing->host->emit(firing->run, port, &view) != OSTEOFLOW_OK) {
        throw ReportedError();
    }
}

void emit_json(const osteoflow_firing *firing, uint64_t port, const std::string &json) {
    osteoflow_json head;
    head.json.data = json.data();
    head.json.length = json.size();
    emit(firing, port, &head, sizeof head);
}

// ---- The node ---------------------------------------------------------------------------------------------------------

class PointToPoint {
  public:
    explicit PointToPoint(const osteoflow_firing *firing) {
        params_.max_pair_distance_mm = osteoflow_param_number(firing, "max_pair_distance_mm", 5.0);
        params_.max_iterations = static_cast<uint64_t>(osteoflow_param_number(firing, "max_iterations", 500));
        params_.min_pairs = static_cast<uint64_t>(osteoflow_param_number(firing, "min_pairs", 10));
    }

    void process(const osteoflow_firing *firing) const {
        const osteoflow_view source_view = view_of(firing, 0), target_view = view_of(firing, 1);
        const osteoflow_view init_view = view_of(firing, 2);
        const osteoflow_cloud *cloud = static_cast<const osteoflow_cloud *>(source_view.head);
        const osteoflow_target *target = static_cast<const osteoflow_target *>(target_view.head);
        const osteoflow_pose *init = static_cast<const osteoflow_pose *>(init_view.head);
        if (!same(init->to, target->frame) || !same(init->from, cloud->frame)) {
            throw std::runtime_error("init maps " + text(init->from) + " -> " + text(init->to) + ", but source is in " +
                                     text(cloud->frame) + " and target in " + text(target->frame));
        }
        const std::vector<Vec> source = rows(source_view, "points");
        std::vector<Vec> points = rows(target_view, "points"), normals = rows(target_view, "normals");
        if (source.size() < params_.min_pairs || points.empty()) {
            throw std::runtime_error(std::to_string(source.size()) + " source points and " +
                                     std::to_string(points.size()) + " target points, at least " +
                                     std::to_string(params_.min_pairs) + " are needed; is the crop empty?");
        }
        if (cloud->viewpoint.data != NULL && !normals.empty()) {
            Vec eye;
            osteoflow_move(init->isometry, cloud->viewpoint.data, eye.data());
            keep_facing(eye, points, normals);
        }
        const Tree tree(std::move(points), std::move(normals));
        Icp icp(tree, source, params_);
        State start;
        std::copy(init->isometry + 3, init->isometry + 7, start.rotation.begin());
        osteoflow_move(init->isometry, icp.source_centre.data(), start.centre.data());
        const bool stays = icp.run(start, firing);

        osteoflow_pose pose;
        pose.to = target->frame;
        pose.from = cloud->frame;
        pose.stamp_ns = firing->host->stamp_ns(firing->run);
        const Vec translation = icp.state.centre - turned(icp.state.rotation, icp.source_centre);
        std::copy(translation.begin(), translation.end(), pose.isometry);
        std::copy(icp.state.rotation.begin(), icp.state.rotation.end(), pose.isometry + 3);
        emit(firing, 0, &pose, sizeof pose);
        emit_json(firing, 1, report(icp, stays, params_, source.size()));
        emit_json(firing, 2, trace(icp));
    }

  private:
    Params params_;
};

// ---- The boundary: no exception leaves these functions ----------------------------------------------------------------

template <class Work> int32_t guarded(const osteoflow_firing *firing, Work work) {
    try {
        work();
        return OSTEOFLOW_OK;
    } catch (const ReportedError &) {
        return OSTEOFLOW_FAILED;
    } catch (const std::exception &error) {
        return osteoflow_fail(firing, error.what());
    } catch (...) {
        return osteoflow_fail(firing, "an exception was thrown that is no std::exception");
    }
}

extern "C" {

static int32_t create(const osteoflow_kind *, const osteoflow_firing *firing, osteoflow_text, void **node) {
    return guarded(firing, [&] { *node = new PointToPoint(firing); });
}

static int32_t fire(void *node, const osteoflow_firing *firing) {
    return guarded(firing, [&] { static_cast<const PointToPoint *>(node)->process(firing); });
}

static void destroy(void *node) { delete static_cast<PointToPoint *>(node); }

} // extern "C"

// ---- The description --------------------------------------------------------------------------------------------------

const osteoflow_input inputs[] = {
    { OSTEOFLOW_TEXT("source"), OSTEOFLOW_TEXT("Moves: the scanned surface, cropped."), OSTEOFLOW_TEXT(OSTEOFLOW_CLOUD),
      OSTEOFLOW_CLOUD_VERSION, 0, OSTEOFLOW_JOIN_EACH, 0, 0, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
    { OSTEOFLOW_TEXT("target"), OSTEOFLOW_TEXT("Stays: the CT surface, prepared once."),
      OSTEOFLOW_TEXT(OSTEOFLOW_TARGET), OSTEOFLOW_TARGET_VERSION, 0, OSTEOFLOW_JOIN_ONCE, 0, 0,
      OSTEOFLOW_TEXT("init.to"), OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
    { OSTEOFLOW_TEXT("init"), OSTEOFLOW_TEXT("Where to start: from the coarse fit."), OSTEOFLOW_TEXT(OSTEOFLOW_POSE),
      OSTEOFLOW_POSE_VERSION, 0, OSTEOFLOW_JOIN_EACH, 0, 0, OSTEOFLOW_NO_TEXT, OSTEOFLOW_TEXT("target"),
      OSTEOFLOW_TEXT("source") },
};

const osteoflow_output outputs[] = {
    { OSTEOFLOW_TEXT("t_target_source"), OSTEOFLOW_TEXT("The registration."), OSTEOFLOW_TEXT(OSTEOFLOW_POSE),
      OSTEOFLOW_POSE_VERSION, 0, OSTEOFLOW_NO_TEXT, OSTEOFLOW_TEXT("target"), OSTEOFLOW_TEXT("source") },
    { OSTEOFLOW_TEXT("report"), OSTEOFLOW_TEXT("How it ended."), OSTEOFLOW_TEXT("report/Icp"), 1, 0, OSTEOFLOW_NO_TEXT,
      OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
    { OSTEOFLOW_TEXT("trace"), OSTEOFLOW_TEXT("How it got there, step by step."), OSTEOFLOW_TEXT("report/IcpTrace"), 1,
      0, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT },
};

const osteoflow_text literature[] = { OSTEOFLOW_TEXT("Besl & McKay 1992"), OSTEOFLOW_TEXT("Horn 1987") };

const osteoflow_kind kinds[] = {
    { OSTEOFLOW_TEXT("icp_cpp.point_to_point"),
      OSTEOFLOW_TEXT("Fine registration of a bone surface onto the CT surface by plain point-to-point ICP.\n\n"
                     "Runs until no pair changes any more."),
      OSTEOFLOW_TEXT("{ \"type\": \"object\", \"additionalProperties\": false, \"properties\": { "
                     "\"max_pair_distance_mm\": { \"description\": \"Pairs farther apart are not used, mm. 5: as of the "
                     "built-in kinds.\", \"type\": \"number\", \"default\": 5.0, \"minimum\": 1e-6, \"maximum\": 1e6 }, "
                     "\"max_iterations\": { \"description\": \"Stop after so many steps. 500: as of the built-in kinds.\", "
                     "\"type\": \"integer\", \"default\": 500, \"minimum\": 1, \"maximum\": 100000 }, "
                     "\"min_pairs\": { \"description\": \"Fewer pairs than this are an error. 10: as of the built-in "
                     "kinds.\", \"type\": \"integer\", \"default\": 10, \"minimum\": 3, \"maximum\": 1000000 } } }"),
      OSTEOFLOW_TEXT("kind = \"icp_cpp.point_to_point\"\n"
                     "in   = { source = \"to_bone.cloud\", target = \"ct_surface.target\", "
                     "init = \"coarse.t_target_source\" }\n"
                     "max_pair_distance_mm = 5.0\n"),
      OSTEOFLOW_NO_TEXT, literature, 2, inputs, 3, outputs, 3, OSTEOFLOW_ROLE_NODE, OSTEOFLOW_KEPT_NO, 0, 0, NULL,
      create, fire, destroy, NULL, NULL },
};

} // namespace

OSTEOFLOW_PLUGIN("icp", "1.0.0", kinds)
