#include "geometry/mesh.h"

#include "arrays.h"
#include "attack/adversary.h"
#include "base/error.h"
#include "base/sizes.h"
#include "bind.h"
#include "exchange/mesh_files.h"

namespace mirage::python {
namespace {

using SharedMesh = std::shared_ptr<TexturedMesh>;

constexpr double kGrey = 0.5;

/// Texels of F faces, F × C × C × 3 or flat. InputError if C is no whole number.
TexelAtlas atlas_of(const py::handle& values, std::size_t faces) {
  TexelAtlas atlas;
  atlas.texels = rows_of_three(values, "texels");
  const std::size_t count = atlas.texels.size();
  atlas.resolution = 1;
  while (faces > 0 && faces * atlas.per_face() < count) ++atlas.resolution;
  if (faces == 0 || faces * atlas.per_face() != count)
    throw InputError("texels", "shape",
                     std::to_string(count) + " colours for " + std::to_string(faces) + " faces",
                     "give faces × C × C × 3 numbers, C the same for all faces");
  return atlas;
}

void give_grey(TexturedMesh& mesh, int resolution) {
  mesh.atlas.resolution = resolution;
  mesh.atlas.texels.assign(mesh.mesh.faces.size() * mesh.atlas.per_face(), Vec3d::Constant(kGrey));
}

SharedMesh make(const py::handle& vertices, const py::handle& faces, const py::object& texels) {
  auto mesh = std::make_shared<TexturedMesh>();
  mesh->mesh.vertices = rows_of_three(vertices, "vertices");
  mesh->mesh.faces = faces_of(faces);
  if (texels.is_none())
    give_grey(*mesh, TexelAtlas().resolution);
  else
    mesh->atlas = atlas_of(texels, mesh->mesh.faces.size());
  check_mesh(*mesh, "mesh");
  check_albedo(mesh->atlas.texels);
  return mesh;
}

py::array_t<double> texels(const SharedMesh& mesh) {
  const auto& texels = mesh->atlas.texels;
  const int c = mesh->atlas.resolution;
  return view(texels.empty() ? nullptr : texels.front().data(), {ssize(mesh->mesh.faces.size()), c, c, 3},
              mesh, true);
}

/// Writes into the memory that views of it share.
void assign(std::vector<Vec3d>& values, const py::handle& source, const char* name,
            void (*check)(std::span<const Vec3d>) = nullptr) {
  const std::vector<Vec3d> rows = rows_of_three(source, name);
  if (rows.size() != values.size())
    throw InputError(
        name, "shape",
        std::to_string(rows.size()) + " rows where the mesh has " + std::to_string(values.size()),
        "make another mesh: mirage.Mesh(vertices, faces, texels)");
  if (check) check(rows);
  std::copy(rows.begin(), rows.end(), values.begin());
}

SharedMesh start(int subdivisions, const py::object& half, int resolution) {
  if (subdivisions < 0 || subdivisions > 6)
    throw InputError("subdivisions", std::to_string(subdivisions), "out of range", "use 0 to 6");
  if (resolution < 1 || resolution > 64)
    throw InputError("resolution", std::to_string(resolution), "out of range", "use 1 to 64");
  Vec3d axes = 0.75 * AdversaryLimits().half;  // as the attack's own start
  if (!half.is_none()) {
    const std::vector<Vec3d> source = rows_of_three(half, "half");
    if (source.size() != 1) throw InputError("half", "shape", "is not three lengths", "give (x, y, z) in m");
    axes = source[0];
  }
  if (!(axes.minCoeff() > 0) || !axes.allFinite())
    throw InputError("half", "", "lengths must be positive", "give (x, y, z) in m");
  auto mesh = std::make_shared<TexturedMesh>();
  mesh->mesh = icosphere(subdivisions);
  for (Vec3d& v : mesh->mesh.vertices) v = v.cwiseProduct(axes);
  give_grey(*mesh, resolution);
  return mesh;
}

SharedMesh read(const std::filesystem::path& file) {
  const py::gil_scoped_release free;
  return std::make_shared<TexturedMesh>(read_textured_mesh(file));
}

void write(const TexturedMesh& mesh, const std::filesystem::path& file) {
  const py::gil_scoped_release free;
  check_mesh(mesh, "mesh");  // the arrays may have been written to
  check_albedo(mesh.atlas.texels);
  write_textured_mesh(file, mesh);
}

}  // namespace

void bind_meshes(py::module_& module) {
  py::class_<TexturedMesh, SharedMesh>(
      module, "Mesh",
      "Triangles with C×C texels each. Frame of the roof it stands on: x along the heading, y left, z up, "
      "m.\n"
      "vertices: V×3, faces: F×3 indices, counter-clockwise seen from outside, texels: F×C×C×3 scene-linear\n"
      "albedo in [0, 1] (None: 5×5 of mid-grey).")
      .def(py::init(&make), py::arg("vertices"), py::arg("faces"), py::arg("texels") = py::none())
      .def_property(
          "vertices", [](const SharedMesh& m) { return view_rows(m->mesh.vertices, m, true); },
          [](TexturedMesh& m, const py::object& v) { assign(m.mesh.vertices, v, "vertices"); },
          "V×3 float64, m. A view: writing to it changes the mesh.")
      .def_property_readonly(
          "faces", [](const SharedMesh& m) { return view_rows(m->mesh.faces, m, false); },
          "F×3 int32, indices of vertices. A view, read-only.")
      .def_property(
          "texels", &texels,
          [](TexturedMesh& m, const py::object& t) { assign(m.atlas.texels, t, "texels", &check_albedo); },
          "F×C×C×3 float64, scene-linear albedo in [0, 1]. A view: writing to it changes the mesh.")
      .def("write", &write, py::arg("file"),
           "Writes a .glb that keeps every bit of vertices and texels and that every viewer shows as it is,\n"
           "an .obj with texels of 8 bits, or the shape alone as .ply.")
      .def(
          "copy", [](const TexturedMesh& m) { return std::make_shared<TexturedMesh>(m); },
          "A copy of the mesh.")
      .def("__repr__", [](const TexturedMesh& m) {
        return "<mirage.Mesh: " + std::to_string(m.mesh.vertices.size()) + " vertices, " +
               std::to_string(m.mesh.faces.size()) + " faces, " + std::to_string(m.atlas.resolution) +
               "² texels a face>";
      });
  module.def(
      "icosphere", &start, py::arg("subdivisions") = 2, py::arg("half") = py::none(),
      py::arg("resolution") = TexelAtlas().resolution,
      "An icosphere of 10·4^n + 2 vertices and 20·4^n faces, stretched to the half axes `half` (x, y, z in\n"
      "m; None: those that an attack starts from), with resolution² texels of mid-grey a face.");
  module.def(
      "read_mesh", &read, py::arg("file"),
      "Reads a mesh from a glTF, OBJ or PLY file; the content tells which it is. glTF of Mesh.write and\n"
      "mirage attack keeps every bit; other glTF keeps its base colours; OBJ and PLY become grey.");
}

}  // namespace mirage::python
