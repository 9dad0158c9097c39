// Loads and writes clouds and surfaces by the loaders of PCL itself: pcl_read read|binary|compressed|ascii|ply IN OUT.
#include <cstdio>
#include <pcl/PolygonMesh.h>
#include <pcl/conversions.h>
#include <pcl/io/pcd_io.h>
#include <pcl/io/ply_io.h>
#include <pcl/point_types.h>
#include <string>

static bool ends(const std::string& name, const char* ending) {
    return name.size() > 3 && name.substr(name.size() - 3) == ending;
}

int main(int argc, char** argv) {
    if (argc != 4) return 2;
    std::string what = argv[1], in = argv[2], out = argv[3];
    if (what.substr(0, 4) == "blob") {
        // As PCL's own programs do, which know no type of point.
        pcl::PCLPointCloud2 blob;
        if ((ends(in, "ply") ? pcl::io::loadPLYFile(in, blob) : pcl::io::loadPCDFile(in, blob)) != 0) return 3;
        pcl::PCDWriter writer;
        auto origin = Eigen::Vector4f::Zero();
        auto turn = Eigen::Quaternionf::Identity();
        if (what == "blob_compressed") return writer.writeBinaryCompressed(out, blob, origin, turn) < 0;
        return writer.writeBinary(out, blob, origin, turn) < 0;
    }
    pcl::PointCloud<pcl::PointXYZ> points;
    bool surface = in.find("bone") != std::string::npos;
    if (surface) {
        // Three corners for each face, in its order.
        pcl::PointCloud<pcl::PointXYZ> corners;
        if (ends(in, "ply")) {
            pcl::PolygonMesh mesh;
            if (pcl::io::loadPLYFile(in, mesh) != 0) return 3;
            pcl::fromPCLPointCloud2(mesh.cloud, corners);
            for (const auto& face : mesh.polygons)
                for (auto corner : face.vertices) points.push_back(corners[corner]);
        } else {
            // PCL reads an STL by VTK, with merged corners; its bytes are read here.
            FILE* file = std::fopen(in.c_str(), "rb");
            unsigned char head[84], row[50];
            if (!file || std::fread(head, 1, 84, file) != 84) return 3;
            while (std::fread(row, 1, 50, file) == 50)
                for (int k = 1; k < 4; k++) {
                    float p[3];
                    std::memcpy(p, row + 12 * k, 12);
                    points.push_back(pcl::PointXYZ(p[0], p[1], p[2]));
                }
            std::fclose(file);
        }
    } else if ((ends(in, "ply") ? pcl::io::loadPLYFile(in, points) : pcl::io::loadPCDFile(in, points)) != 0) {
        return 3;
    }
    if (what == "binary") return pcl::io::savePCDFileBinary(out, points);
    if (what == "compressed") return pcl::io::savePCDFileBinaryCompressed(out, points);
    if (what == "ascii") return pcl::io::savePCDFileASCII(out, points);
    if (what == "ply") return pcl::io::savePLYFileBinary(out, points);
    FILE* file = std::fopen(out.c_str(), "wb");
    for (const auto& p : points) std::fwrite(p.data, sizeof(float), 3, file);
    return std::fclose(file);
}
