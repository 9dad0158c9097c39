// A node in C++ as a starting point: my_plugin.tre is a metric. Change it, run make, run the graph. Read from the end, where the
// kinds of the plugin are listed. An exception is an error of the node.
#include "osteoflow.hpp"
#include "osteoflow_geometry.h"

#include <algorithm>
#include <cmath>

namespace {

std::string frames(const osteoflow_pose &pose) {
    return osteoflow::to_string(pose.from) + " -> " + osteoflow::to_string(pose.to);
}

class Tre {
  public:
    // The program has checked the parameter against the schema below.
    explicit Tre(const osteoflow::Building &building) : limit_mm_(building.number("limit_mm")) {}

    void fire(osteoflow::Firing &firing) const {
        const osteoflow::Input planned = firing.input(0), found = firing.input(1), known = firing.input(2);
        const osteoflow_pose &pose = found.head<osteoflow_pose>(), &truth = known.head<osteoflow_pose>();
        const std::string frame = osteoflow::to_string(planned.head<osteoflow_points>().frame);
        if (frames(pose) != frames(truth) || osteoflow::to_string(pose.to) != frame) {
            throw std::runtime_error("the poses map " + frames(pose) + " and " + frames(truth) +
                                     ", which does not fit points in " + frame);
        }
        const osteoflow::Rows<double> points = planned.rows<double>("positions", 3);
        if (points.size() == 0) {
            throw std::runtime_error("there are no points to evaluate the error at; does the plan have some?");
        }
        const double *t = truth.isometry;
        const double back[7] = { 0.0, 0.0, 0.0, -t[3], -t[4], -t[5], t[6] };
        double sum = 0.0, max = 0.0, n_good = 0.0;
        for (size_t i = 0; i < points.size(); i++) {
            // Where the point is by the true registration, and where this one takes that place.
            const double *p = points[i];
            double q[3] = { p[0] - t[0], p[1] - t[1], p[2] - t[2] };
            osteoflow_move(back, q, q);
            osteoflow_move(pose.isometry, q, q);
            const double x = q[0] - p[0], y = q[1] - p[1], z = q[2] - p[2], off_mm = std::sqrt(x * x + y * y + z * z);
            sum += off_mm;
            max = std::max(max, off_mm);
            n_good += off_mm <= limit_mm_ ? 1.0 : 0.0;
        }
        const double n = static_cast<double>(points.size());
        // Numbers of results.json: names and units, one a line.
        const osteoflow_metrics report = { osteoflow::text("mean\nmax\nshare_good"), osteoflow::text("mm\nmm\n") };
        osteoflow::Columns values;
        values.add("values", 1, std::vector<double>{ sum / n, max, n_good / n });
        firing.emit(0, report, values);
    }

  private:
    double limit_mm_;
};

std::vector<osteoflow_input> make_inputs() {
    osteoflow_input planned = osteoflow::input("planned", "Points on the bone at which the error is evaluated.",
                                               OSTEOFLOW_POINTS, OSTEOFLOW_POINTS_VERSION);
    planned.join = OSTEOFLOW_JOIN_ONCE;
    osteoflow_input pose = osteoflow::input("t_ct_world", "The registration.", OSTEOFLOW_POSE, OSTEOFLOW_POSE_VERSION);
    pose.to = osteoflow::text("planned");
    pose.from = osteoflow::text("t_ct_world_true.from");
    osteoflow_input truth =
        osteoflow::input("t_ct_world_true", "The true registration.", OSTEOFLOW_POSE, OSTEOFLOW_POSE_VERSION);
    truth.join = OSTEOFLOW_JOIN_ONCE;
    truth.to = osteoflow::text("planned");
    truth.from = osteoflow::text("t_ct_world.from");
    return { planned, pose, truth };
}

std::vector<osteoflow_output> make_outputs() {
    return { osteoflow::output("report", "Mean and largest error, and the share of good points.", OSTEOFLOW_METRICS,
                               OSTEOFLOW_METRICS_VERSION) };
}

const char PARAMS[] = R"({ "type": "object", "additionalProperties": false, "properties": {
    "limit_mm": { "type": "number", "default": 1.5, "minimum": 0.0, "maximum": 1000.0,
                  "description": "Points off by at most this much are good. 1.5: half of what a cut may be off." } } })";

const char EXAMPLE[] = R"(kind = "my_plugin.tre"
in   = { planned = "plan.assessment", t_ct_world = "planes_at_scan.t_ct_world", t_ct_world_true = "recording.t_ct_world_true" }
limit_mm = 1.5
)";

const char DOC[] =
    "Target registration error: the distances by which a registration misplaces points, where the true one is known.";

const osteoflow_kind kinds[] = { osteoflow::kind<Tre>("my_plugin.tre", DOC, PARAMS, EXAMPLE, make_inputs(), make_outputs()) };

} // namespace

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
