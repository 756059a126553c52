#include "attack/zoo.h"

#include <algorithm>
#include <cmath>

#include "attack/evaluation.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/names.h"
#include "base/sizes.h"
#include "exchange/mesh_files.h"

namespace mirage {
namespace {

constexpr const char *kFolder = "scenes/objects", *kExtension = ".glb";

/// Adds a part of one colour (linear albedo).
void add_part(TexturedMesh& load, const Mesh& part, const Vec3d& colour,
              const Transform& place = Transform::Identity()) {
  append(load.mesh, part, place);
  load.atlas.texels.resize(load.mesh.faces.size(), colour);
}

void add_bar(TexturedMesh& load, const Vec3d& low, const Vec3d& high, const Vec3d& colour) {
  add_part(load, box_mesh(high - low), colour, Transform(Eigen::Translation3d(0.5 * (low + high))));
}

/// A box with rounded edges that stands on z = 0: a superellipsoid, flatter for smaller `power`.
Mesh rounded(const Vec3d& size, double power) {
  Mesh mesh = icosphere(2);
  for (Vec3d& v : mesh.vertices)
    for (int c = 0; c < 3; ++c)
      v[c] = 0.5 * size[c] * (std::copysign(std::pow(std::abs(v[c]), power), v[c]) + (c == 2 ? 1 : 0));
  return mesh;
}

void add_roof_box(TexturedMesh& load) {
  Mesh shell = rounded({1.9, 0.8, 0.38}, 0.45);
  for (Vec3d& v : shell.vertices) {
    v.y() *= 1 - 0.3 * v.z();                          // narrower above
    if (v.x() > 0) v.z() *= 1 - 0.35 * v.x() * v.x();  // and lower ahead
  }
  add_part(load, shell, Vec3d::Constant(0.03));
}

void add_ladder(TexturedMesh& load) {
  const Vec3d aluminium = Vec3d::Constant(0.4);
  for (const double side : {-0.2, 0.2})
    add_bar(load, {-1.4, side - 0.02, 0}, {1.4, side + 0.02, 0.08}, aluminium);
  for (int rung = 0; rung < 10; ++rung) {
    const double x = -1.26 + 0.28 * rung;
    add_bar(load, {x - 0.015, -0.2, 0.025}, {x + 0.015, 0.2, 0.055}, aluminium);
  }
}

void add_mattress(TexturedMesh& load) {
  Mesh mattress = rounded({2, 1.4, 0.2}, 0.25);
  for (Vec3d& v : mattress.vertices) v.z() += 0.05 * (1 - v.x() * v.x());  // bends over the roof
  add_part(load, mattress, Vec3d(0.75, 0.73, 0.68));
}

void add_kayak(TexturedMesh& load) {
  Mesh hull = icosphere(2);
  for (Vec3d& v : hull.vertices) {
    const double thin = 1 - std::pow(std::abs(v.x()), 1.5);  // for the pointed ends
    v = Vec3d(1.45 * v.x(), 0.32 * v.y() * (0.45 + 0.55 * thin), 0.17 * v.z() + 0.12 * v.x() * v.x());
  }
  const double lowest = bounds(hull).min().z();
  for (Vec3d& v : hull.vertices) v.z() -= lowest;
  add_part(load, hull, Vec3d(0.6, 0.1, 0.02));
}

void add_boxes_under_net(TexturedMesh& load) {
  const Vec3d carton(0.36, 0.24, 0.13), net(0.01, 0.01, 0.012);
  const Vec3d boxes[][2] = {
      {{-0.75, -0.55, 0}, {-0.15, -0.05, 0.4}}, {{-0.7, 0, 0}, {-0.2, 0.5, 0.32}},
      {{-0.1, -0.5, 0}, {0.45, 0.05, 0.3}},     {{-0.1, 0.1, 0}, {0.6, 0.55, 0.42}},
      {{0.5, -0.45, 0}, {0.8, 0, 0.24}},        {{-0.55, -0.4, 0.4}, {-0.2, -0.1, 0.58}}};
  double shade = 0.85;
  for (const auto& [low, high] : boxes) {
    add_bar(load, low, high, carton * shade);
    shade += 0.06;
  }
  // Ropes over the boxes' tops and down their sides.
  for (const double x : {-0.65, -0.35, 0.0, 0.3, 0.7}) {
    add_bar(load, {x - 0.012, -0.58, 0.43}, {x + 0.012, 0.58, 0.45}, net);
    for (const double side : {-0.58, 0.56})
      add_bar(load, {x - 0.012, side, 0}, {x + 0.012, side + 0.02, 0.45}, net);
  }
  for (const double y : {-0.4, -0.1, 0.2, 0.45})
    add_bar(load, {-0.78, y - 0.012, 0.43}, {0.82, y + 0.012, 0.45}, net);
}

}  // namespace

std::vector<NamedObject> read_objects(const std::vector<std::filesystem::path>& words) {
  std::vector<NamedObject> objects;
  const auto add = [&](const std::string& name, const std::filesystem::path& file) {
    if (std::ranges::any_of(objects, [&](const NamedObject& other) {
          return std::filesystem::weakly_canonical(other.file) == std::filesystem::weakly_canonical(file);
        }))
      throw FieldError("mesh", name, "is named twice", "name each object once");
    objects.push_back({name, file, read_object(file)});
  };
  for (const std::filesystem::path& word : words) {
    if (word != kZoo) {
      add(word.string(), word);
      continue;
    }
    const std::vector<std::string> names = shipped_names(kFolder, kExtension);
    if (names.empty())
      throw FieldError("mesh", kZoo, std::string("names no object: ") + kFolder + " is missing or empty",
                       "install Mirage whole, or name a file");
    for (const std::string& name : names)
      add(name, shipped_file(std::string(kFolder) + "/" + name + kExtension));
  }
  return objects;
}

void add_objects(Provenance& provenance, const std::vector<NamedObject>& objects) {
  nlohmann::json names = nlohmann::json::array();
  std::string hashes;
  for (const NamedObject& object : objects) {
    names.push_back(escape_name(object.file.stem().string()));
    hashes += hash_of(object.mesh);  // not of the file: a glTF's geometry may be in another one
  }
  provenance.set("mesh", names);
  provenance.input("mesh", content_hash(hashes));
}

TexturedMesh resampled(const TexturedMesh& mesh, int resolution) {
  const TexelAtlas& atlas = mesh.atlas;
  const std::size_t faces = mesh.mesh.faces.size();
  constexpr int kSamples = 8;  // samples a side
  TexelAtlas result{resolution, {}};
  result.texels.assign(faces * result.per_face(), Vec3d::Zero());
  const auto within = atlas_triangles(kSamples);
  for (const AtlasTriangle& target : atlas_triangles(resolution))
    for (const AtlasTriangle& sample : within) {
      const Vec2d b = (sample.corners[0] + sample.corners[1] + sample.corners[2]) / 3;
      const Vec2d at =
          b.x() * target.corners[0] + b.y() * target.corners[1] + (1 - b.x() - b.y()) * target.corners[2];
      const auto from = as_size(texel_index(at.x(), at.y(), atlas.resolution));
      for (std::size_t f = 0; f < faces; ++f)
        result.texels[f * result.per_face() + as_size(target.texel)] +=
            atlas.texels[f * atlas.per_face() + from] / static_cast<double>(within.size());
    }
  return {mesh.mesh, std::move(result)};
}

const std::vector<CarriedLoad>& carried_loads() {
  static const std::vector<CarriedLoad> loads = {
      {"roof-box", "a roof box of 1.9 m", add_roof_box},
      {"ladder", "a ladder of 2.8 m with ten rungs", add_ladder},
      {"mattress", "a mattress of 2 × 1.4 m", add_mattress},
      {"kayak", "a kayak of 2.9 m", add_kayak},
      {"boxes-under-net", "six boxes under a net of ropes", add_boxes_under_net}};
  return loads;
}

TexturedMesh carried_load(const std::string& name) {
  const auto match = std::ranges::find(carried_loads(), name, &CarriedLoad::name);
  if (match == carried_loads().end())
    throw InputError("load", name, "is not known", "use a name of carried_loads()");
  TexturedMesh load;
  load.atlas.resolution = 1;
  match->add_to(load);
  return load;
}

Run run_of_objects(const std::vector<NamedObject>& objects) {
  Run run;
  run.settings.buildable.on = false;  // so random meshes of their size need not be buildable
  if (objects.empty()) return run;
  run.adversary = objects.front().mesh;
  Vec3d& half = run.settings.limits.half;
  for (const NamedObject& object : objects) half = half.cwiseMax(half_lengths(object.mesh.mesh));
  return run;
}

}  // namespace mirage
