#include "exchange/obj_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "exchange/folder_files.h"
#include "exchange/texture_layout.h"
#include "geometry/atlas_triangles.h"

namespace mirage {
namespace {

/// The first word of `line`, which is left without it; empty at the line's end.
std::string_view take_word(std::string_view& line) {
  constexpr std::string_view kBlank = " \t\r";
  line.remove_prefix(std::min(line.find_first_not_of(kBlank), line.size()));
  const std::string_view word = line.substr(0, std::min(line.find_first_of(kBlank), line.size()));
  line.remove_prefix(word.size());
  return word;
}

template <class T>
std::optional<T> number(std::string_view word) {
  if (word.starts_with('+')) word.remove_prefix(1);
  T value{};
  const auto [stop, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || stop != word.data() + word.size()) return std::nullopt;
  return value;
}

class ObjReader {
 public:
  ObjReader(FileCharacters& from, Polygons& into) : from_(from), into_(into) {}

  void read() {
    for (const char c : {'\xEF', '\xBB', '\xBF'})  // a byte order mark would spoil the first row
      if (!from_.at_end() && from_.current() == c) from_.next();
    while (!from_.at_end()) {
      const std::size_t first = line_;
      read_line();
      std::string_view line = text_;
      const std::string_view kind = take_word(line);
      number_ = first;
      if (kind == "usemtl") into_.leave_out("materials (usemtl)");
      if (kind != "v" && kind != "f") continue;
      if (text_.size() == kLongestLine) fail("is too long");
      kind == "v" ? read_vertex(line) : read_face(line);
    }
  }

 private:
  static constexpr std::size_t kLongestLine = 1 << 20;

  [[noreturn]] void fail(const std::string& problem) const {
    into_.fail(fmt::format("line {}", number_), problem);
  }
  /// The next line into text_, cut at kLongestLine, with those that a backslash at its end makes parts of it.
  void read_line() {
    text_.clear();
    const auto add = [&](char c) {
      if (text_.size() < kLongestLine) text_.push_back(c);
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
  void read_vertex(std::string_view line) {
    Vec3d place;
    for (int k = 0; k < 3; ++k) {
      const auto value = number<double>(take_word(line));
      if (!value || !std::isfinite(*value)) fail("is a vertex without three finite numbers");
      place[k] = *value;
    }
    into_.add_vertex(place);
    take_word(line);  // a weight w, or red
    if (number<double>(take_word(line)) && number<double>(take_word(line))) into_.leave_out("vertex colours");
  }
  void read_face(std::string_view line) {
    face_.clear();
    for (std::string_view word = take_word(line); !word.empty() && word[0] != '#'; word = take_word(line)) {
      const auto named = number<int>(word.substr(0, word.find('/')));
      if (!named || *named == 0) fail("is a face with a corner that is no vertex's number");
      const double before = static_cast<double>(into_.vertex_count());
      face_.push_back(into_.corner(*named > 0 ? *named - 1.0 : *named + before));
      if (face_.size() > kMostFaceCorners) break;  // is refused in a moment
    }
    // How many there are altogether, of those that are too many.
    std::size_t corners = face_.size();
    while (corners > kMostFaceCorners && !take_word(line).empty()) ++corners;
    into_.check_corners(static_cast<double>(corners));
    into_.add_face(face_);
  }

  FileCharacters& from_;
  Polygons& into_;
  std::string text_;
  std::vector<int> face_;
  std::size_t line_ = 1, number_ = 1;  // that is read next; that text_ begins with
};

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
  std::map<std::array<std::string, 3>, std::size_t> known;  // vertices that faces share, by what is written
  const auto vertex = [&](const Vec3d& p) {
    const std::array<std::string, 3> words{fmt::format("{:.9g}", p.x()), fmt::format("{:.9g}", p.y()),
                                           fmt::format("{:.9g}", p.z())};
    const auto [at, fresh] = known.try_emplace(words, known.size() + 1);
    if (fresh) vertices += fmt::format("v {} {} {}\n", words[0], words[1], words[2]);
    return at->second;
  };
  for (std::size_t t = 0; t < atlas.texels.size(); ++t) {
    const Vec2d uv = layout.centre(t);
    uvs += fmt::format("vt {:.9g} {:.9g}\n", uv.x(), 1 - uv.y());  // OBJ counts from the bottom
  }
  const auto triangles = atlas_triangles(colored ? atlas.resolution : 1);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const Vec3d &v0 = mesh.vertices[mesh.faces[f][0]], &v1 = mesh.vertices[mesh.faces[f][1]],
                &v2 = mesh.vertices[mesh.faces[f][2]];
    for (const AtlasTriangle& triangle : triangles) {
      faces += "f";
      for (const Vec2d& b : triangle.corners) {
        faces += fmt::format(" {}", vertex(b.x() * v0 + b.y() * v1 + (1 - b.x() - b.y()) * v2));
        if (colored) faces += fmt::format("/{}", f * atlas.per_face() + triangle.texel + 1);
      }
      faces += "\n";
    }
  }
  if (colored) {
    ImageF picture(layout.width, layout.height, 3, 1.0f);
    for (std::size_t t = 0; t < atlas.texels.size(); ++t)
      for (int c = 0; c < 3; ++c) picture.data[3 * t + c] = static_cast<float>(atlas.texels[t][c]);
    write_file(beside(".png"), encode_srgb_png(picture));
  }
  write_file(beside(".mtl"),
             fmt::format("newmtl {}\nKd {}\nKs 0 0 0\nillum 1\n{}", name, colored ? "1 1 1" : "0.5 0.5 0.5",
                         colored ? fmt::format("map_Kd {}.png\n", name) : ""));
  write_file(
      file, fmt::format("# metres; x forward, y left, z up; the origin is the pivot\nmtllib {0}.mtl\no {0}\n",
                        name) +
                vertices + uvs + fmt::format("usemtl {}\ns off\n", name) + faces);
}

}  // namespace mirage
