#include "exchange/mesh_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <span>
#include <string_view>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/sizes.h"
#include "exchange/gltf.h"
#include "exchange/gltf_document.h"
#include "exchange/gltf_model.h"
#include "simulation/check_inputs.h"

namespace mirage {
namespace {

constexpr const char* kBlank = " \t\r";

class ObjReader {
 public:
  ObjReader(FileCharacters& from, Polygons& into) : from_(from), into_(into) {}

  void read() {
    while (!from_.at_end()) {
      const std::size_t first = line_;
      read_line();
      const auto words = split(text_, kBlank);
      const std::string_view kind = words.empty() ? "" : words.front();
      number_ = first;
      if (kind == "usemtl") into_.leave_out("materials (usemtl)");
      if (kind != "v" && kind != "f") continue;
      if (text_.size() == kMaxLineBytes) fail("is too long");
      const auto values = std::span(words).subspan(1);
      kind == "v" ? read_vertex(values) : read_face(values);
    }
  }

 private:
  static constexpr std::size_t kMaxLineBytes = 1 << 20;

  [[noreturn]] void fail(const std::string& problem) const {
    into_.fail(fmt::format("line {}", number_), problem);
  }
  /// Reads the next line into text_, cut at kMaxLineBytes. A backslash at its end continues it.
  void read_line() {
    text_.clear();
    const auto add = [&](char c) {
      if (text_.size() < kMaxLineBytes) text_.push_back(c);
    };
    for (bool on = true; on && !from_.at_end(); from_.next()) {
      const char c = from_.current();
      if (c == '\n') ++line_;
      if (c != '\n') {
        add(c);
      } else if (text_.ends_with('\\') || text_.ends_with("\\\r")) {
        text_.resize(text_.rfind('\\'));
        text_.push_back(' ');
      } else {
        on = false;
      }
    }
  }
  void read_vertex(std::span<const std::string_view> words) {
    Vec3d place;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto value = k < words.size() ? try_parse_number<double>(words[k], true) : std::nullopt;
      if (!value || !std::isfinite(*value)) fail("is a vertex without three finite numbers");
      place[static_cast<Eigen::Index>(k)] = *value;
    }
    into_.add_vertex(place);
    // The fourth number is a weight w or red.
    if (words.size() > 5 && try_parse_number<double>(words[4], true) &&
        try_parse_number<double>(words[5], true))
      into_.leave_out("vertex colours");
  }
  void read_face(std::span<const std::string_view> words) {
    const auto comment = std::ranges::find(words, '#', [](std::string_view word) { return word.front(); });
    words = words.first(as_size(comment - words.begin()));
    into_.check_corners(static_cast<double>(words.size()));
    face_.clear();
    for (const std::string_view word : words) {
      const auto named = try_parse_number<int>(word.substr(0, word.find('/')), true);
      if (!named || *named == 0) fail("is a face with a corner that is not a vertex's number");
      const double before = static_cast<double>(into_.vertex_count());
      face_.push_back(into_.corner(*named > 0 ? *named - 1.0 : *named + before));
    }
    into_.add_face(face_);
  }

  FileCharacters& from_;
  Polygons& into_;
  std::string text_;
  std::vector<int> face_;
  std::size_t line_ = 1, number_ = 1;  // of the line to read next; of text_'s first line
};

namespace fs = std::filesystem;

enum class MeshFormat { gltf, ply, obj };

/// Whether this beginning of a text has a row of an OBJ. It has no magic bytes.
bool looks_like_obj(std::string_view head) {
  if (head.find('\0') != std::string_view::npos) return false;
  for (const std::string_view line : split(head, "\n"))
    if (const auto words = split(line, kBlank); !words.empty())
      for (const char* row : {"v", "vn", "vt", "vp", "f", "l", "p", "o", "g", "s", "mtllib", "usemtl"})
        if (words.front() == row) return true;
  return false;
}

MeshFormat format_of(const fs::path& file) {
  constexpr std::size_t kHead = 1 << 16;  // longer than the comments before the first row
  const std::string head = read_head(ConfinedFiles(file).file(), kHead);
  if (head.starts_with("glTF") || looks_like_json(head)) return MeshFormat::gltf;
  if (head.starts_with("ply")) return MeshFormat::ply;
  if (looks_like_obj(head)) return MeshFormat::obj;
  throw InputError(file.string(), "content", "is not a glTF, OBJ or PLY mesh",
                   "give a .glb, .gltf, .obj or .ply file");
}

Vec3d axis(const std::string& text, const std::string& what) {
  if (text.size() == 2 && (text[0] == '+' || text[0] == '-') && text[1] >= 'x' && text[1] <= 'z')
    return (text[0] == '+' ? 1.0 : -1.0) * Vec3d::Unit(text[1] - 'x');
  throw InputError(what, text, "is not an axis", "give +x, -x, +y, -y, +z or -z");
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

/// The polygons of an OBJ or PLY, in its own axes.
Polygons polygons_of(const fs::path& file, MeshFormat format) {
  return read_polygons(ConfinedFiles(file).file(), file.string(),
                       format == MeshFormat::ply ? read_ply : read_obj);
}

Mesh with_faces(Mesh mesh, const fs::path& file) {
  if (mesh.faces.empty()) throw InputError(file.string(), "faces", "there are none", "export the mesh again");
  return mesh;
}

}  // namespace

void read_obj(FileCharacters& from, Polygons& into) {
  ObjReader(from, into).read();
}

TexturedMesh standing_on_origin(TexturedMesh adversary) {
  const double lowest = bounds(adversary.mesh).min().z();
  for (Vec3d& v : adversary.mesh.vertices) v.z() -= lowest;
  return adversary;
}

void write_obj(const std::filesystem::path& file, const TexturedMesh& textured) {
  if (lower_extension(file) != ".obj")
    throw InputError(file.string(), "extension", "is not .obj", "name the file FILE.obj");
  check_mesh(textured, file.string());
  const auto& [mesh, atlas] = textured;
  const bool colored = !atlas.texels.empty();
  const TextureLayout layout(atlas.texels.size());
  const std::string name = file.stem().string();
  const auto beside = [&](const char* extension) {
    return std::filesystem::path(file).replace_extension(extension);
  };
  std::string vertices, uvs, faces;
  std::map<std::array<std::string, 3>, std::size_t> vertex_numbers;  // by what is written: faces share them
  const auto vertex = [&](const Vec3d& p) {
    const std::array<std::string, 3> words{fmt::format("{:.9g}", p.x()), fmt::format("{:.9g}", p.y()),
                                           fmt::format("{:.9g}", p.z())};
    const auto [at, fresh] = vertex_numbers.try_emplace(words, vertex_numbers.size() + 1);
    if (fresh) vertices += fmt::format("v {} {} {}\n", words[0], words[1], words[2]);
    return at->second;
  };
  for (std::size_t t = 0; t < atlas.texels.size(); ++t) {
    const Vec2d uv = layout.centre(t);
    uvs += fmt::format("vt {:.9g} {:.9g}\n", uv.x(), 1 - uv.y());  // OBJ counts from the bottom
  }
  const auto triangles = atlas_triangles(colored ? atlas.resolution : 1);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const auto face = mesh.corners(mesh.faces[f]);
    for (const AtlasTriangle& triangle : triangles) {
      faces += "f";
      for (const Vec3d& corner : triangle.on(face)) {
        faces += fmt::format(" {}", vertex(corner));
        if (colored) faces += fmt::format("/{}", f * atlas.per_face() + as_size(triangle.texel) + 1);
      }
      faces += "\n";
    }
  }
  if (colored) write_file(beside(".png"), encode_srgb_png(texel_picture(atlas)));
  write_file(beside(".mtl"),
             fmt::format("newmtl {}\nKd {}\nKs 0 0 0\nillum 1\n{}", name, colored ? "1 1 1" : "0.5 0.5 0.5",
                         colored ? fmt::format("map_Kd {}.png\n", name) : ""));
  write_file(
      file, fmt::format("# metres; x forward, y left, z up; the origin is the pivot\nmtllib {0}.mtl\no {0}\n",
                        name) +
                vertices + uvs + fmt::format("usemtl {}\ns off\n", name) + faces);
}

Mesh read_mesh(const fs::path& file, const std::optional<MeshAxes>& axes) {
  const MeshFormat format = format_of(file);
  const bool gltf = format == MeshFormat::gltf;
  Eigen::Matrix3d turn = vehicle_from_file(axes.value_or(gltf ? MeshAxes{"+z", "+y"} : MeshAxes{"+x", "+z"}));
  if (gltf) turn *= gltf_from_velo();
  Mesh mesh = with_faces(
      welded(gltf ? GltfModel(file).triangles().mesh : triangulated(polygons_of(file, format))), file);
  for (Vec3d& vertex : mesh.vertices) vertex = turn * vertex;
  check_mesh({mesh, {}}, file.string());
  return mesh;
}

TexturedMesh read_textured_mesh(const fs::path& file) {
  const MeshFormat format = format_of(file);
  if (format == MeshFormat::gltf) return GltfModel(file).object();
  const Polygons polygons = polygons_of(file, format);
  TexturedMesh textured;
  textured.mesh = with_faces(welded(triangulated(polygons)), file);
  textured.atlas.texels.assign(textured.mesh.faces.size() * textured.atlas.per_face(), Vec3d::Constant(0.5));
  check_mesh(textured, file.string());
  if (!polygons.left_out().empty())
    spdlog::warn("{}: left out: {}; the mesh is grey", file.string(), fmt::join(polygons.left_out(), ", "));
  return textured;
}

TexturedMesh read_object(const fs::path& file) {
  if (format_of(file) == MeshFormat::gltf && GltfModel(file).scene_extras())
    throw InputError(file.string(), "scenes[0]", "is a whole scene with host and ground, placed in the world",
                     "give the object alone: adversary.glb of the same export or run");
  TexturedMesh object = read_textured_mesh(file);
  check_object(object, file.string());
  warn_of_large_object(bounds(object.mesh).sizes(), file.string());
  return object;
}

void write_textured_mesh(const fs::path& file, const TexturedMesh& mesh) {
  const std::string extension = lower_extension(file);
  if (extension == ".glb")
    write_adversary(file, mesh);
  else if (extension == ".obj")
    write_obj(file, mesh);
  else if (extension == ".ply")
    write_mesh(file, mesh.mesh);
  else
    throw InputError(file.string(), "extension", "is not one that is written", "give .glb, .obj or .ply");
}

std::vector<ShapeSample> read_vehicle_meshes(const fs::path& folder, const std::optional<MeshAxes>& axes) {
  if (!fs::is_directory(folder))
    throw InputError(folder.string(), "", "is not a folder",
                     "give a folder with .glb, .gltf, .obj or .ply files");
  std::vector<fs::path> files;
  const std::set<std::string> kinds = {".glb", ".gltf", ".obj",
                                       ".ply"};  // beside them lie pictures and materials
  for (const auto& entry : fs::directory_iterator(folder))
    if (entry.is_regular_file() && kinds.contains(lower_extension(entry.path())))
      files.push_back(entry.path());
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
          fmt::format("{:.2f} m long, {:.2f} m wide, {:.2f} m high is not a vehicle", s.x(), s.y(), s.z()),
          "export it in metres and name its axes (--mesh-forward, --mesh-up)");
    samples.push_back({std::move(mesh), "user"});
  }
  return samples;
}

void write_mesh(const fs::path& file, const Mesh& mesh) {
  const std::string extension = lower_extension(file);
  std::vector<float> positions;
  const Eigen::Matrix3d turn =
      extension == ".glb" ? gltf_from_velo() : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
  for (const Vec3d& v : mesh.vertices) {
    const Vec3d p = turn * v;
    for (int k = 0; k < 3; ++k) positions.push_back(static_cast<float>(p[k]));
  }
  if (extension == ".glb") {
    GltfBuilder gltf;
    const int position = gltf.add_floats(positions, 3), index = gltf.add_corners(mesh.faces);
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
    for (const Face& f : mesh.faces) {
      out.push_back(3);
      out.append(reinterpret_cast<const char*>(f.data()), sizeof f);
    }
    write_file(file, out);
  } else {
    throw InputError(file.string(), "extension", "is not one that is written", "give .glb or .ply");
  }
}

}  // namespace mirage
