// A source in C++ as a starting point: my_plugin.xyz reads a file of points. Change it, run make, run the graph. Read from the
// end, where the kinds of the plugin are listed. An exception is an error of the node.
#include "osteoflow.hpp"
#include "osteoflow_geometry.h"

#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <sstream>

namespace {

class Xyz {
  public:
    // The program has checked the parameters against the schema below.
    explicit Xyz(const osteoflow::Building &building)
        : path_(building.text("path")), frame_(building.text("frame")), unit_mm_(building.number("unit_mm")) {}

    // The points of the file, three numbers each.
    std::vector<double> read() const {
        std::ifstream file(path_);
        if (!file) {
            throw std::runtime_error(path_ + ": cannot be read: " + std::strerror(errno));
        }
        std::vector<double> points;
        std::string line;
        for (size_t number = 1; std::getline(file, line); number++) {
            const std::string place = path_ + ":" + std::to_string(number) + ": ";
            if (file.eof()) {
                throw std::runtime_error(place + "the last line does not end; is the file whole?");
            }
            std::istringstream words(line.substr(0, line.find('#')));
            if ((words >> std::ws).eof()) {
                continue;
            }
            double point[3] = {};
            std::string more;
            if (!(words >> point[0] >> point[1] >> point[2]) || words >> more) {
                throw std::runtime_error(place + "three numbers are expected, found \"" + line + "\"");
            }
            for (double coordinate : point) {
                points.push_back(coordinate * unit_mm_);
            }
        }
        if (file.bad() || points.empty()) {
            throw std::runtime_error(path_ + (file.bad() ? ": cannot be read to its end" : ":1: the file has no points"));
        }
        return points;
    }

    void fire(osteoflow::Firing &firing) {
        if (done_) {
            firing.end();
            return;
        }
        done_ = true;
        osteoflow_cloud cloud = osteoflow_cloud();
        cloud.frame = osteoflow::text(frame_);
        osteoflow::Columns columns;
        columns.add("points", 3, read());
        firing.emit(0, cloud, columns);
    }

  private:
    std::string path_, frame_;
    double unit_mm_;
    bool done_ = false;
};

std::vector<osteoflow_output> make_outputs() {
    osteoflow_output cloud = osteoflow::output("cloud", "The points, once, in the order of the file.", OSTEOFLOW_CLOUD,
                                               OSTEOFLOW_CLOUD_VERSION);
    cloud.frame = osteoflow::text("$frame");
    return { cloud };
}

const char PARAMS[] = R"({ "type": "object", "additionalProperties": false, "required": ["path"], "properties": {
    "path": { "type": "string", "format": "input-path", "description": "The file." },
    "frame": { "type": "string", "default": "camera",
               "description": "The frame of its coordinates. camera: a scan is in the frame of the camera that made it." },
    "unit_mm": { "type": "number", "default": 1.0, "minimum": 1e-6, "maximum": 1e6,
                 "description": "Millimetres in the file's unit. 1: the file is in mm; 1000: in metres." } } })";

const char EXAMPLE[] = R"(kind  = "my_plugin.xyz"
path  = "points.xyz"
frame = "bone_marker"
)";

const char DOC[] = R"(The points of a text file: one per line, x y z, separated by spaces; `#` begins a comment.

The last line must end, since a file that was cut within its last number would otherwise give a wrong point.)";

osteoflow_kind xyz() {
    osteoflow_kind kind = osteoflow::kind<Xyz>("my_plugin.xyz", DOC, PARAMS, EXAMPLE, {}, make_outputs());
    kind.role = OSTEOFLOW_ROLE_SOURCE;
    // One item, which other nodes may join once.
    kind.flags = OSTEOFLOW_KIND_CONSTANT;
    return kind;
}

const osteoflow_kind kinds[] = { xyz() };

} // namespace

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
