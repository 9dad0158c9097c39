// A node in C++ as a starting point: my_plugin.sphere keeps the points within a distance of a centre. Change it, run make, run
// the graph. Read from the end, where the kinds of the plugin are listed. An exception is an error of the node.
// Unchanged, it gives the same points to the last bit as the built-in crop.sphere with the same centre and radius.
#include "osteoflow.hpp"
#include "osteoflow_geometry.h"

#include <cmath>

namespace {

// The rows of a column that are kept.
template <class T> std::vector<T> kept(const osteoflow_column &column, const std::vector<size_t> &chosen) {
    std::vector<T> out;
    out.reserve(chosen.size() * column.width);
    const T *rows = static_cast<const T *>(column.data);
    for (size_t row : chosen) {
        out.insert(out.end(), rows + row * column.width, rows + (row + 1) * column.width);
    }
    return out;
}

class Sphere {
  public:
    // The program has checked the parameters against the schema below.
    explicit Sphere(const osteoflow::Building &building)
        : centre_(building.numbers("centre_mm")), radius_(building.number("radius_mm")) {}

    // The indices of the points to keep. Change this.
    std::vector<size_t> choose(const osteoflow::Rows<double> &points) const {
        std::vector<size_t> chosen;
        for (size_t i = 0; i < points.size(); i++) {
            const double x = points[i][0] - centre_[0], y = points[i][1] - centre_[1], z = points[i][2] - centre_[2];
            if (std::sqrt(x * x + y * y + z * z) <= radius_) {
                chosen.push_back(i);
            }
        }
        return chosen;
    }

    void fire(osteoflow::Firing &firing) const {
        const osteoflow::Input cloud = firing.input(0);
        const osteoflow::Rows<double> points = cloud.rows<double>("points", 3);
        const std::vector<size_t> chosen = choose(points);
        if (chosen.empty()) {
            // An empty cloud is an error: give the reason and a next step.
            throw std::runtime_error("none of " + std::to_string(points.size()) + " points is within " +
                                     std::to_string(radius_) + " mm of the centre; is it given in mm?");
        }
        // Points, normals and all others; every column of a cloud holds doubles.
        osteoflow::Columns columns;
        for (uint64_t i = 0; i < cloud.view().n_columns; i++) {
            const osteoflow_column &column = cloud.view().columns[i];
            columns.add(osteoflow::to_string(column.name), column.width, kept<double>(column, chosen));
        }
        // Frame, stamp and viewpoint are unchanged.
        firing.emit(0, cloud.head<osteoflow_cloud>(), columns);
    }

  private:
    std::vector<double> centre_;
    double radius_;
};

// The ports of every crop, so that graphs can switch to this one by its kind.
std::vector<osteoflow_input> make_inputs() {
    osteoflow_input region = osteoflow::input("region", "Ignored.", OSTEOFLOW_REGION, OSTEOFLOW_REGION_VERSION);
    region.flags = OSTEOFLOW_INPUT_UNUSED;
    region.join = OSTEOFLOW_JOIN_ONCE;
    return { osteoflow::input("cloud", "The cloud to crop.", OSTEOFLOW_CLOUD, OSTEOFLOW_CLOUD_VERSION), region };
}

std::vector<osteoflow_output> make_outputs() {
    osteoflow_output cloud =
        osteoflow::output("cloud", "The points in the sphere.", OSTEOFLOW_CLOUD, OSTEOFLOW_CLOUD_VERSION);
    cloud.frame = osteoflow::text("cloud");
    return { cloud };
}

const char PARAMS[] =
    R"({ "type": "object", "additionalProperties": false, "required": ["centre_mm", "radius_mm"], "properties": {
    "centre_mm": { "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3,
                   "description": "The centre in the cloud's frame." },
    "radius_mm": { "type": "number", "minimum": 0.001, "maximum": 1e6, "description": "The radius." } } })";

const char EXAMPLE[] = R"(kind = "my_plugin.sphere"
in   = { cloud = "recording.scan" }
centre_mm = [0.0, 0.0, 200.0]
radius_mm = 80.0
)";

const char DOC[] = "Points within a distance of a centre.";

const osteoflow_kind kinds[] = { osteoflow::kind<Sphere>("my_plugin.sphere", DOC, PARAMS, EXAMPLE, make_inputs(),
                                                        make_outputs()) };

} // namespace

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
