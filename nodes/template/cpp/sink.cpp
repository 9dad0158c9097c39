// A sink in C++ as a starting point: my_plugin.xyz writes a file of points. Change it, run make, run the graph. Read from the
// end, where the kinds of the plugin are listed. An exception is an error of the node.
#include "osteoflow.hpp"
#include "osteoflow_geometry.h"

#include <cerrno>
#include <cstring>
#include <fstream>

namespace {

class Xyz {
  public:
    // The program has checked the parameter against the schema below.
    explicit Xyz(const osteoflow::Building &building) : unit_mm_(building.number("unit_mm")) {}

    void fire(osteoflow::Firing &firing) const {
        const osteoflow_firing *raw = firing.raw();
        const osteoflow_text dir = raw->host->out_dir(raw->run);
        if (dir.data == nullptr) {
            throw std::runtime_error("the run has no folder to write into; name one with --out");
        }
        const osteoflow::Input cloud = firing.input(0);
        const osteoflow::Rows<double> points = cloud.rows<double>("points", 3);
        const std::string name =
            osteoflow::to_string(raw->host->node(raw->run)) + "-" + std::to_string(firing.item()) + ".xyz";
        const std::string path = osteoflow::to_string(dir) + "/" + name;
        std::ofstream file(path);
        // 17 digits read back to the same bits.
        file.precision(17);
        file << "# frame " << osteoflow::to_string(cloud.head<osteoflow_cloud>().frame) << ", unit " << unit_mm_ << " mm\n";
        for (size_t i = 0; i < points.size(); i++) {
            file << points[i][0] / unit_mm_ << ' ' << points[i][1] / unit_mm_ << ' ' << points[i][2] / unit_mm_ << '\n';
        }
        file.close();
        if (!file) {
            throw std::runtime_error(path + " cannot be written: " + std::strerror(errno));
        }
        const osteoflow_words words = { osteoflow::text(name) };
        firing.emit(0, words);
    }

  private:
    double unit_mm_;
};

const char PARAMS[] = R"({ "type": "object", "additionalProperties": false, "properties": {
    "unit_mm": { "type": "number", "default": 1.0, "minimum": 1e-6, "maximum": 1e6,
                 "description": "Millimetres in the file's unit. 1: the file is in mm; 1000: in metres." } } })";

const char EXAMPLE[] = R"(kind = "my_plugin.xyz"
in   = { cloud = "to_bone.cloud" }
unit_mm = 1.0
)";

const char DOC[] = R"(Writes clouds as text files of points into the run's folder, named after the node: one point per line, x y z.

The numbers read back to the same bits. The first line is a comment with frame and unit.)";

const osteoflow_kind kinds[] = { osteoflow::kind<Xyz>(
    "my_plugin.xyz", DOC, PARAMS, EXAMPLE,
    { osteoflow::input("cloud", "A cloud; one file for each.", OSTEOFLOW_CLOUD, OSTEOFLOW_CLOUD_VERSION) },
    { osteoflow::output("file", "The name of the file.", OSTEOFLOW_WORDS, OSTEOFLOW_WORDS_VERSION) }) };

} // namespace

OSTEOFLOW_PLUGIN("my_plugin", "0.1.0", kinds)
