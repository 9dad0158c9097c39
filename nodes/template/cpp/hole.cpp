// A node in C++ as a starting point: my_plugin.difference is a hole detector. Change it, run make, run the graph. Read from the
// end, where the kinds of the plugin are listed. An exception is an error of the node.
#include "osteoflow.hpp"
#include "osteoflow_geometry.h"

#include <cmath>
#include <limits>

namespace {

// Missing points at most this many times `radius_mm` apart are of one hole: more than the spacing of a scan.
const double LINK = 1.5;

double square_distance(const double *p, const double *q) {
    const double x = q[0] - p[0], y = q[1] - p[1], z = q[2] - p[2];
    return x * x + y * y + z * z;
}

class Difference {
  public:
    // The program has checked the parameters against the schema below.
    explicit Difference(const osteoflow::Building &building)
        : radius_mm_(building.number("radius_mm")), min_points_(static_cast<size_t>(building.number("min_points"))) {}

    // The points of `reference` without a point of `cloud` nearer than `radius_mm`.
    std::vector<const double *> missing(const osteoflow::Rows<double> &reference, const osteoflow::Rows<double> &cloud) const {
        std::vector<const double *> missing;
        size_t at = 0;
        for (size_t i = 0; i < reference.size(); i++) {
            // Neighbours follow each other, so the search begins where the last one ended.
            size_t seen = 0;
            while (seen < cloud.size() && square_distance(reference[i], cloud[at]) > radius_mm_ * radius_mm_) {
                at = (at + 1) % cloud.size();
                seen++;
            }
            if (seen == cloud.size()) {
                missing.push_back(reference[i]);
            }
        }
        return missing;
    }

    // The largest set of points that are connected by short steps.
    std::vector<const double *> largest_patch(std::vector<const double *> points) const {
        const double link = LINK * LINK * radius_mm_ * radius_mm_;
        std::vector<const double *> largest;
        while (!points.empty()) {
            std::vector<const double *> patch(1, points.back());
            points.pop_back();
            for (size_t next = 0; next < patch.size(); next++) {
                for (size_t i = points.size(); i-- > 0;) {
                    if (square_distance(patch[next], points[i]) <= link) {
                        patch.push_back(points[i]);
                        points[i] = points.back();
                        points.pop_back();
                    }
                }
            }
            if (patch.size() > largest.size()) {
                largest.swap(patch);
            }
        }
        return largest;
    }

    void fire(osteoflow::Firing &firing) const {
        const osteoflow::Input reference = firing.input(0), cloud = firing.input(1);
        const osteoflow_cloud &head = cloud.head<osteoflow_cloud>();
        const std::string frame = osteoflow::to_string(reference.head<osteoflow_cloud>().frame);
        if (osteoflow::to_string(head.frame) != frame) {
            throw std::runtime_error("the scan with the laser is in " + osteoflow::to_string(head.frame) +
                                     ", but the full scan in " + frame);
        }
        const std::vector<const double *> gone = missing(reference.rows<double>("points", 3), cloud.rows<double>("points", 3));
        const std::vector<const double *> hole = largest_patch(gone);
        if (hole.size() < min_points_) {
            throw std::runtime_error(std::to_string(gone.size()) + " points are missing, " + std::to_string(hole.size()) +
                                     " of them in one place, " + std::to_string(min_points_) +
                                     " are needed; is the laser on the bone?");
        }
        const double n = static_cast<double>(hole.size());
        std::vector<double> centre(3);
        for (const double *p : hole) {
            for (size_t k = 0; k < 3; k++) {
                centre[k] += p[k] / n;
            }
        }
        double squares = 0.0;
        for (const double *p : hole) {
            squares += square_distance(p, centre.data());
        }
        osteoflow_points point = osteoflow_points();
        point.frame = head.frame;
        point.stamp_ns = head.stamp_ns;
        point.names = head.label.data == nullptr ? osteoflow::text("hole") : head.label;
        osteoflow::Columns columns;
        columns.add("positions", 3, centre);
        columns.add("stamps_ns", 1, std::vector<int64_t>(1, head.stamp_ns));
        columns.add("confidences", 1, std::vector<double>(1, std::numeric_limits<double>::quiet_NaN()));
        firing.emit(0, point, columns);
        // A disc of radius r has a mean squared distance of r²/2 from its centre; points at its rim are not missing.
        const osteoflow_metrics report = { osteoflow::text("n_missing\nn_hole\nhole_radius"), osteoflow::text("\n\nmm") };
        osteoflow::Columns values;
        values.add("values", 1, std::vector<double>{ static_cast<double>(gone.size()), n, std::sqrt(2.0 * squares / n) + radius_mm_ });
        firing.emit(1, report, values);
    }

  private:
    double radius_mm_;
    size_t min_points_;
};

// The ports of every hole detector, so that graphs can switch to this one by its kind.
std::vector<osteoflow_input> make_inputs() {
    osteoflow_input reference = osteoflow::input("reference", "The full scan.", OSTEOFLOW_CLOUD, OSTEOFLOW_CLOUD_VERSION);
    reference.join = OSTEOFLOW_JOIN_ONCE;
    reference.frame = osteoflow::text("cloud");
    osteoflow_input cloud = osteoflow::input("cloud", "A scan with the laser spot, labelled with the landmark's name.",
                                             OSTEOFLOW_CLOUD, OSTEOFLOW_CLOUD_VERSION);
    cloud.frame = osteoflow::text("reference");
    return { reference, cloud };
}

std::vector<osteoflow_output> make_outputs() {
    osteoflow_output point =
        osteoflow::output("point", "The landmark under the spot, with its name.", OSTEOFLOW_POINTS, OSTEOFLOW_POINTS_VERSION);
    point.frame = osteoflow::text("cloud");
    return { point, osteoflow::output("report", "Missing points, those of the hole, and its radius.", OSTEOFLOW_METRICS,
                                      OSTEOFLOW_METRICS_VERSION) };
}

const char PARAMS[] = R"({ "type": "object", "additionalProperties": false, "properties": {
    "radius_mm": { "type": "number", "default": 1.0, "minimum": 0.01, "maximum": 20.0,
                   "description": "A point of the full scan is missing if the scan with the laser has none nearer. 1: twice the spacing of a scan." },
    "min_points": { "type": "integer", "default": 15, "minimum": 3, "maximum": 100000,
                    "description": "Minimum number of points of a hole. 15: a spot of 2 mm radius leaves thirty." } } })";

const char EXAMPLE[] = R"(kind = "my_plugin.difference"
in   = { reference = "to_bone.cloud", cloud = "to_bone_laser.cloud" }
radius_mm = 1.0
)";

const char DOC[] = "The landmark under a laser spot: the centre of the largest patch of the full scan that the scan with the laser lacks.";

const osteoflow_kind kinds[] = { osteoflow::kind<Difference>("my_plugin.difference", DOC, PARAMS, EXAMPLE, make_inputs(),
                                                        make_outputs()) };

} // namespace

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
