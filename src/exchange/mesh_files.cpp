#include "exchange/mesh_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstdint>

#include "base/error.h"
#include "base/files.h"
#include "exchange/folder_files.h"
#include "exchange/gltf_builder.h"
#include "exchange/gltf_document.h"
#include "exchange/gltf_model.h"
#include "exchange/obj_file.h"
#include "exchange/ply_file.h"
#include "exchange/polygons.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

std::string extension_of(const fs::path& file) {
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

bool is_gltf(const std::string& extension) {
  return extension == ".glb" || extension == ".gltf";
}

bool readable(const std::string& extension) {
  return is_gltf(extension) || extension == ".obj" || extension == ".ply";
}

Vec3d axis(const std::string& text, const std::string& what) {
  if (text.size() == 2 && (text[0] == '+' || text[0] == '-') && text[1] >= 'x' && text[1] <= 'z')
    return (text[0] == '+' ? 1.0 : -1.0) * Vec3d::Unit(text[1] - 'x');
  throw InputError(what, text, "is no axis", "give +x, -x, +y, -y, +z or -z");
}

/// Rows are the vehicle's x, y, z in the file's axes.
Eigen::Matrix3d vehicle_from_file(const MeshAxes& axes) {
  const Vec3d forward = axis(axes.forward, "forward axis"), up = axis(axes.up, "up axis");
  if (std::abs(forward.dot(up)) > 0.5)
    throw InputError("mesh axes", axes.forward + " and " + axes.up, "are parallel",
                     "give two different axes");
  Eigen::Matrix3d m;
  m.row(0) = forward;
  m.row(1) = up.cross(forward);
  m.row(2) = up;
  return m;
}

/// What the file holds, in its own axes.
Mesh read_in_own_axes(const fs::path& file, const std::string& extension) {
  if (!is_gltf(extension))
    return triangulated(
        read_polygons(FolderFiles(file).file(), file.string(), extension == ".ply" ? read_ply : read_obj));
  Mesh mesh = GltfModel(file).triangles().mesh;
  for (Vec3d& v : mesh.vertices) v = gltf_from_velo() * v;
  return mesh;
}

}  // namespace

Mesh read_mesh(const fs::path& file, const std::optional<MeshAxes>& axes) {
  const std::string extension = extension_of(file);
  if (!readable(extension))
    throw InputError(file.string(), "extension", "is not one that is read", "give .glb, .gltf, .obj or .ply");
  const Eigen::Matrix3d turn =
      vehicle_from_file(axes.value_or(is_gltf(extension) ? MeshAxes{"+z", "+y"} : MeshAxes{"+x", "+z"}));
  Mesh mesh = joined(read_in_own_axes(file, extension));
  if (mesh.faces.empty()) throw InputError(file.string(), "faces", "there are none", "export the mesh again");
  for (Vec3d& vertex : mesh.vertices) vertex = turn * vertex;
  check_mesh({mesh, {}}, file.string());
  return mesh;
}

std::vector<ShapeSample> read_vehicle_meshes(const fs::path& folder, const std::optional<MeshAxes>& axes) {
  if (!fs::is_directory(folder))
    throw InputError(folder.string(), "", "is not a folder",
                     "give a folder with .glb, .gltf, .obj or .ply files");
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder))
    if (entry.is_regular_file() && readable(extension_of(entry.path()))) files.push_back(entry.path());
  if (files.empty())
    throw InputError(folder.string(), "", "holds no meshes", "put .glb, .gltf, .obj or .ply files there");
  std::sort(files.begin(), files.end());
  std::vector<ShapeSample> samples;
  for (const fs::path& file : files) {
    Mesh mesh = read_mesh(file, axes);
    const Vec3d s = bounds(mesh).sizes();
    if (!(s.x() >= 2 && s.x() <= 12 && s.y() >= 1 && s.y() <= 3.5 && s.z() >= 0.8 && s.z() <= 4.5 &&
          s.x() > s.y()))
      throw InputError(
          file.string(), "size",
          fmt::format("{:.2f} m long, {:.2f} m wide, {:.2f} m high is no vehicle", s.x(), s.y(), s.z()),
          "export it in metres and name its axes (--mesh-forward, --mesh-up)");
    samples.push_back({std::move(mesh), "user"});
  }
  return samples;
}

void write_mesh(const fs::path& file, const Mesh& mesh) {
  const std::string extension = extension_of(file);
  std::vector<float> positions;
  std::vector<std::uint32_t> indices;
  const Eigen::Matrix3d turn =
      extension == ".glb" ? gltf_from_velo() : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
  for (const Vec3d& v : mesh.vertices) {
    const Vec3d p = turn * v;
    for (int k = 0; k < 3; ++k) positions.push_back(static_cast<float>(p[k]));
  }
  for (const Face& f : mesh.faces) indices.insert(indices.end(), f.begin(), f.end());
  if (extension == ".glb") {
    constexpr int kUnsigned = 5125, kElements = 34963;  // GL's names for indices
    GltfBuilder gltf;
    const int position = gltf.add_floats(positions, 3, true);
    const int index = gltf.add("accessors", {{"bufferView", gltf.add_view(indices, kElements)},
                                             {"componentType", kUnsigned},
                                             {"count", indices.size()},
                                             {"type", "SCALAR"}});
    const nlohmann::json primitive = {{"attributes", {{"POSITION", position}}}, {"indices", index}};
    const std::string name = file.stem().string();
    const int number =
        gltf.add("meshes", {{"name", name}, {"primitives", nlohmann::json::array({primitive})}});
    gltf.add_node({{"name", name}, {"mesh", number}});
    write_file(file, gltf.glb());
  } else if (extension == ".ply") {
    std::string out = fmt::format(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
        "property float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.vertices.size(), mesh.faces.size());
    out.append(reinterpret_cast<const char*>(positions.data()), positions.size() * sizeof(float));
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
      out.push_back(3);
      out.append(reinterpret_cast<const char*>(&indices[3 * f]), 3 * sizeof(std::uint32_t));
    }
    write_file(file, out);
  } else {
    throw InputError(file.string(), "extension", "is not one that is written", "give .glb or .ply");
  }
}

}  // namespace mirage
