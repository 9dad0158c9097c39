// A node in C++ as a starting point: my_plugin.point_to_plane is an ICP. Change it, run make, run the graph. Read from the end,
// where the kinds of the plugin are listed. An exception is an error of the node.
#include "osteoflow.hpp"
#include "osteoflow_geometry.h"

#include <algorithm>
#include <cmath>

namespace {

// Fewer pairs determine six unknowns, but leave no redundancy.
const size_t MIN_PAIRS = 10;

// A point of the target, and its row.
struct Place {
    double p[3];
    size_t row;
};

// The points of the target, sorted by x.
std::vector<Place> sorted(const osteoflow::Rows<double> &points) {
    std::vector<Place> places;
    for (size_t i = 0; i < points.size(); i++) {
        places.push_back(Place{ { points[i][0], points[i][1], points[i][2] }, i });
    }
    std::sort(places.begin(), places.end(), [](const Place &a, const Place &b) { return a.p[0] < b.p[0]; });
    return places;
}

// The row of the place nearest to p; their number if none has a squared distance below `limit`. Only those on either side whose
// x alone is not too far off are looked at.
size_t nearest(const std::vector<Place> &places, const double *p, double limit) {
    size_t found = places.size();
    const auto is_near = [&](const Place &q) {
        const double x = q.p[0] - p[0], y = q.p[1] - p[1], z = q.p[2] - p[2], square = x * x + y * y + z * z;
        if (x * x < limit && square < limit) {
            limit = square;
            found = q.row;
        }
        return x * x < limit;
    };
    const auto middle =
        std::lower_bound(places.begin(), places.end(), p[0], [](const Place &q, double x) { return q.p[0] < x; });
    for (auto q = middle; q != places.end() && is_near(*q); ++q) {
    }
    for (auto q = middle; q != places.begin() && is_near(*(q - 1)); --q) {
    }
    return found;
}

// The sums of the pairs of a step: six equations, and their right-hand side in the last column.
struct Sums {
    double rows[6][7] = {};
    double squares = 0.0, reach = 0.0;
    size_t n = 0;

    // A moved point, its pair on the target and the normal there. Turns are about `centre`.
    void add(const double *p, const double *q, const double *normal, const double *centre) {
        const double a[3] = { p[0] - centre[0], p[1] - centre[1], p[2] - centre[2] };
        const double residual = (q[0] - p[0]) * normal[0] + (q[1] - p[1]) * normal[1] + (q[2] - p[2]) * normal[2];
        const double row[7] = { a[1] * normal[2] - a[2] * normal[1],
                                a[2] * normal[0] - a[0] * normal[2],
                                a[0] * normal[1] - a[1] * normal[0],
                                normal[0],
                                normal[1],
                                normal[2],
                                residual };
        for (int i = 0; i < 6; i++) {
            for (int j = 0; j < 7; j++) {
                rows[i][j] += row[i] * row[j];
            }
        }
        squares += residual * residual;
        reach = std::max(reach, std::sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]));
        n++;
    }

    // The turn (rad) and the shift (mm) that minimise the distances along the normals, by Gauss-Jordan elimination.
    std::vector<double> solve() {
        for (int k = 0; k < 6; k++) {
            int pivot = k;
            for (int i = k + 1; i < 6; i++) {
                pivot = std::fabs(rows[i][k]) > std::fabs(rows[pivot][k]) ? i : pivot;
            }
            std::swap(rows[k], rows[pivot]);
            if (!(std::fabs(rows[k][k]) > 1e-9)) {
                throw std::runtime_error("the pairs leave a motion free, as on a plane; scan more of the bone");
            }
            for (int i = 0; i < 6; i++) {
                const double factor = i == k ? 0.0 : rows[i][k] / rows[k][k];
                for (int j = k; j < 7; j++) {
                    rows[i][j] -= factor * rows[k][j];
                }
            }
        }
        std::vector<double> x(6);
        for (int k = 0; k < 6; k++) {
            x[k] = rows[k][6] / rows[k][k];
        }
        return x;
    }
};

// Turns a pose about a centre, by a vector of the length of the angle, then shifts it.
void move(double *t, const double *turn, const double *shift, const double *centre) {
    const double angle = std::sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]);
    const double s = angle > 0.0 ? std::sin(angle / 2.0) / angle : 0.5;
    const double a[4] = { turn[0] * s, turn[1] * s, turn[2] * s, std::cos(angle / 2.0) }, b[4] = { t[3], t[4], t[5], t[6] };
    const double rotation[7] = { 0.0, 0.0, 0.0, a[0], a[1], a[2], a[3] };
    const double arm[3] = { t[0] - centre[0], t[1] - centre[1], t[2] - centre[2] };
    osteoflow_move(rotation, arm, t);
    double q[4] = { a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
                    a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
                    a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
                    a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2] };
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int k = 0; k < 4; k++) {
        t[k] += k < 3 ? centre[k] + shift[k] : 0.0;
        q[k] /= norm;
    }
    std::copy(q, q + 4, t + 3);
}

class PointToPlane {
  public:
    // The program has checked the parameters against the schema below.
    explicit PointToPlane(const osteoflow::Building &building)
        : max_pair_distance_mm_(building.number("max_pair_distance_mm")), stop_step_mm_(building.number("stop_step_mm")),
          max_iterations_(static_cast<int>(building.number("max_iterations"))),
          n_points_(static_cast<size_t>(building.number("n_points"))) {}

    void fire(osteoflow::Firing &firing) const {
        const osteoflow::Input source = firing.input(0), target = firing.input(1), init = firing.input(2);
        osteoflow_pose pose = init.head<osteoflow_pose>();
        const std::string from = osteoflow::to_string(source.head<osteoflow_cloud>().frame);
        const std::string to = osteoflow::to_string(target.head<osteoflow_target>().frame);
        if (osteoflow::to_string(pose.from) != from || osteoflow::to_string(pose.to) != to) {
            throw std::runtime_error("init maps " + osteoflow::to_string(pose.from) + " -> " +
                                     osteoflow::to_string(pose.to) + ", but source is in " + from + " and target in " + to);
        }
        const osteoflow::Rows<double> all = source.rows<double>("points", 3);
        const osteoflow::Rows<double> points = target.rows<double>("points", 3), normals = target.rows<double>("normals", 3);
        if (all.size() < MIN_PAIRS) {
            throw std::runtime_error("source has " + std::to_string(all.size()) + " points, " + std::to_string(MIN_PAIRS) +
                                     " are needed; is the crop empty?");
        }
        const std::vector<Place> places = sorted(points);
        const size_t stride = std::max<size_t>(1, all.size() / n_points_);
        const double limit = max_pair_distance_mm_ * max_pair_distance_mm_;
        bool converged = false;
        int iterations = 0;
        Sums sums;
        while (!converged && iterations < max_iterations_) {
            if (firing.cancelled()) {
                throw std::runtime_error("interrupted");
            }
            double centre[3];
            osteoflow_move(pose.isometry, all[all.size() / 2], centre);
            sums = Sums();
            for (size_t i = 0; i < all.size(); i += stride) {
                double p[3];
                osteoflow_move(pose.isometry, all[i], p);
                const size_t found = nearest(places, p, limit);
                if (found < points.size()) {
                    sums.add(p, points[found], normals[found], centre);
                }
            }
            if (sums.n < MIN_PAIRS) {
                throw std::runtime_error(std::to_string(sums.n) + " source points lie near the target, " +
                                         std::to_string(MIN_PAIRS) + " are needed; is init right?");
            }
            const std::vector<double> step = sums.solve();
            move(pose.isometry, &step[0], &step[3], centre);
            const double turn = std::sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2]);
            const double shift = std::sqrt(step[3] * step[3] + step[4] * step[4] + step[5] * step[5]);
            // No point moves by more.
            converged = shift + turn * sums.reach < stop_step_mm_;
            iterations++;
        }
        pose.stamp_ns = firing.stamp_ns();
        firing.emit(0, pose);
        // The verdict of a run reads `converged` and `stop_reason`.
        const std::string json = std::string("{\"converged\":") + (converged ? "true" : "false") + ",\"stop_reason\":\"" +
                                 (converged ? "step" : "max_iterations") + "\",\"iterations\":" + std::to_string(iterations) +
                                 ",\"n_pairs\":" + std::to_string(sums.n) + ",\"rms_mm\":" +
                                 std::to_string(std::sqrt(sums.squares / static_cast<double>(sums.n))) + "}";
        const osteoflow_json report = { osteoflow::text(json) };
        firing.emit(1, report);
    }

  private:
    double max_pair_distance_mm_, stop_step_mm_;
    int max_iterations_;
    size_t n_points_;
};

// The ports of every ICP, so that graphs can switch to this one by its kind.
std::vector<osteoflow_input> make_inputs() {
    osteoflow_input source = osteoflow::input("source", "The scan, cropped.", OSTEOFLOW_CLOUD, OSTEOFLOW_CLOUD_VERSION);
    osteoflow_input target = osteoflow::input("target", "The CT surface.", OSTEOFLOW_TARGET, OSTEOFLOW_TARGET_VERSION);
    target.join = OSTEOFLOW_JOIN_ONCE;
    target.frame = osteoflow::text("init.to");
    osteoflow_input init = osteoflow::input("init", "The start.", OSTEOFLOW_POSE, OSTEOFLOW_POSE_VERSION);
    init.to = osteoflow::text("target");
    init.from = osteoflow::text("source");
    return { source, target, init };
}

std::vector<osteoflow_output> make_outputs() {
    osteoflow_output pose =
        osteoflow::output("t_target_source", "The registration.", OSTEOFLOW_POSE, OSTEOFLOW_POSE_VERSION);
    pose.to = osteoflow::text("target");
    pose.from = osteoflow::text("source");
    return { pose, osteoflow::output("report", "Convergence of the fit.", OSTEOFLOW_JSON, OSTEOFLOW_JSON_VERSION) };
}

const char PARAMS[] = R"({ "type": "object", "additionalProperties": false, "properties": {
    "max_pair_distance_mm": { "type": "number", "default": 5.0, "minimum": 0.001, "maximum": 1000.0,
                              "description": "Pairs farther apart are left out. 5: less than half the bone." },
    "stop_step_mm": { "type": "number", "default": 1e-3, "minimum": 1e-9, "maximum": 10.0,
                      "description": "Converged if a step moves no point by more. 1e-3: far below the noise of a camera." },
    "max_iterations": { "type": "integer", "default": 500, "minimum": 1, "maximum": 100000,
                        "description": "Largest number of steps. 500: more than real bones need." },
    "n_points": { "type": "integer", "default": 2000, "minimum": 10, "maximum": 1000000,
                  "description": "Number of points of the scan that are used, about. 2000: a tenth of a scan averages its noise out." } } })";

const char EXAMPLE[] = R"(kind = "my_plugin.point_to_plane"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
max_pair_distance_mm = 5.0
)";

const char DOC[] = "Registers a scan onto the CT surface by point-to-plane ICP.\n\nEach step pairs points of the scan with the nearest points of the surface, and minimises the distances along its normals.";

const osteoflow_kind kinds[] = { osteoflow::kind<PointToPlane>("my_plugin.point_to_plane", DOC, PARAMS, EXAMPLE, make_inputs(),
                                                        make_outputs()) };

} // namespace

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
