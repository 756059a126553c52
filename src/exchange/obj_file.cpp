#include "exchange/obj_file.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <map>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "exchange/texture_layout.h"
#include "geometry/atlas_triangles.h"

namespace mirage {

TexturedMesh standing_on_origin(TexturedMesh adversary) {
  const double lowest = bounds(adversary.mesh).min().z();
  for (Vec3d& v : adversary.mesh.vertices) v.z() -= lowest;
  return adversary;
}

void write_obj(const std::filesystem::path& file, const TexturedMesh& textured) {
  if (file.extension() != ".obj")
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
