#include "attack/baseline.h"

#include <algorithm>
#include <map>

#include "attack/checkpoint.h"
#include "base/fields.h"
#include "base/random.h"
#include "base/sizes.h"
#include "geometry/solid.h"

namespace mirage {
namespace {

constexpr int kPatches = 12;     // on 320 faces: about 0.4 m across on a mesh that fills the box
constexpr int kCuboidCells = 5;  // 300 faces, about as many as a learned mesh has

/// Faces that share an edge with each face.
std::vector<std::vector<std::size_t>> neighbours(const Mesh& mesh) {
  std::vector<std::vector<std::size_t>> beside(mesh.faces.size());
  for (const MeshEdge& edge : edges_of(mesh))
    for (const int a : edge.faces)
      for (const int b : edge.faces)
        if (a != b) beside[as_size(a)].push_back(as_size(b));
  return beside;
}

/// Watertight cuboid with half lengths `half` (m) and n × n × 2 faces a side; n ≥ 1.
Mesh divided_cuboid(const Vec3d& half, int n) {
  Mesh mesh;
  std::map<std::array<int, 3>, int> numbers;
  const auto vertex = [&](const std::array<int, 3>& at) {
    const auto [place, added] = numbers.try_emplace(at, static_cast<int>(mesh.vertices.size()));
    if (added)
      mesh.vertices.push_back(
          half.cwiseProduct(Vec3d(2. * at[0] / n - 1, 2. * at[1] / n - 1, 2. * at[2] / n - 1)));
    return place->second;
  };
  for (int axis = 0; axis < 3; ++axis)
    for (const int side : {0, n})
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
          // (axis, u, v) is right-handed, so that u × v points along +axis.
          const auto corner = [&](int u, int v) {
            std::array<int, 3> at{};
            at[as_size(axis)] = side;
            at[as_size((axis + 1) % 3)] = i + u;
            at[as_size((axis + 2) % 3)] = j + v;
            return vertex(at);
          };
          const int a = corner(0, 0), b = corner(1, 0), c = corner(1, 1), d = corner(0, 1);
          if (side == n)
            mesh.faces.insert(mesh.faces.end(), {{a, b, c}, {a, c, d}});
          else
            mesh.faces.insert(mesh.faces.end(), {{a, c, b}, {a, d, c}});
        }
  return mesh;
}

void keep_rules(TexturedMesh& mesh, const TexturedMesh& start, const Run& run) {
  project(mesh, run.settings.limits);
  if (run.settings.buildable.on) keep_buildable(mesh, start, run.settings.buildable, run.settings.limits);
}

TexturedMesh size_matched_mesh(const Run& run, std::uint64_t seed) {
  const Eigen::AlignedBox3d target = bounds(run.adversary.mesh);
  TexturedMesh start = fresh_state(run.settings).adversary;  // its base is flat in a buildable run
  fit_bounds(start.mesh, target);
  TexturedMesh baseline = start;
  const TexturedMesh random = random_adversary(seed, run.settings.limits);
  // Displacements of the baseline `start`, in metres, applied to the stretched start.
  const TexturedMesh plain = initial_adversary(run.settings.limits);
  for (std::size_t i = 0; i < baseline.mesh.vertices.size(); ++i)
    baseline.mesh.vertices[i] += random.mesh.vertices[i] - plain.mesh.vertices[i];
  fit_bounds(baseline.mesh, target);
  paint_patches(baseline, kPatches, seed);
  keep_rules(baseline, start, run);
  return baseline;
}

TexturedMesh filling_mesh(const Run& run, Baseline kind, std::uint64_t seed) {
  const TexturedMesh start = filling_shape(kind, run.settings.limits, run.settings.buildable);
  TexturedMesh baseline = start;
  paint_patches(baseline, kPatches, seed);
  keep_rules(baseline, start, run);
  return baseline;
}

}  // namespace

std::string describe(Baseline kind) {
  const char* words[] = {"random mesh", "random mesh of its size", "ellipsoid filling the box",
                         "cuboid filling the box"};
  return words[as_size(kind)];
}

std::vector<Baseline> parse_baselines(const std::string& words) {
  constexpr auto kinds = words_of(Baseline());
  std::vector<Baseline> found;
  const std::vector<std::string> listed = listed_words(words);
  for (const char* alone : {"none", "all"})
    if (listed.size() > 1 && std::ranges::find(listed, alone) != listed.end())
      throw FieldError("baseline", words, std::string("names ") + alone + " and others",
                       "leave it out, or the others");
  for (const std::string& word : listed) {
    bool recognised = word == "none" || word == "all";
    for (std::size_t i = 0; i < kinds.size(); ++i) {
      if (word != kinds[i] && word != "all") continue;
      recognised = true;
      const auto kind = static_cast<Baseline>(i);
      if (std::ranges::find(found, kind) == found.end()) found.push_back(kind);
    }
    if (!recognised)
      throw unknown_word("baseline", word, {"start", "sized", "ellipsoid", "cuboid", "all", "none"});
  }
  return found;
}

std::vector<TexturedMesh> baseline_meshes(const Run& run, Baseline kind, int count) {
  std::vector<TexturedMesh> meshes;
  for (int i = 0; i < count; ++i) {
    const std::uint64_t seed = run.settings.seed + static_cast<std::uint64_t>(i);
    if (kind == Baseline::start)
      meshes.push_back(i == 0 ? run.random
                              : random_baseline(seed, run.settings.limits, run.settings.buildable));
    else
      meshes.push_back(kind == Baseline::sized ? size_matched_mesh(run, seed)
                                               : filling_mesh(run, kind, seed));
  }
  return meshes;
}

TexturedMesh filling_shape(Baseline kind, const AdversaryLimits& limits, const BuildableSettings& buildable) {
  TexturedMesh shape = initial_adversary(limits, 1);
  if (kind == Baseline::cuboid) {
    shape.mesh = divided_cuboid(limits.half, kCuboidCells);
    shape.atlas.texels.assign(shape.mesh.faces.size() * shape.atlas.per_face(), Vec3d::Constant(0.5));
  }
  if (buildable.on) {
    make_buildable(shape, buildable, limits);
    fit_bounds(shape.mesh, Eigen::AlignedBox3d(-limits.half, limits.half));
  }
  return shape;
}

void fit_bounds(Mesh& mesh, const Eigen::AlignedBox3d& target) {
  const Eigen::AlignedBox3d now = bounds(mesh);
  for (Vec3d& v : mesh.vertices)
    for (int c = 0; c < 3; ++c) {
      const double low = now.min()[c], extent = now.sizes()[c];
      if (v[c] == now.max()[c] && extent > 0)  // exact at both ends
        v[c] = target.max()[c];
      else
        v[c] = target.min()[c] + (extent > 0 ? (v[c] - low) / extent * target.sizes()[c] : 0);
    }
}

void paint_patches(TexturedMesh& mesh, int patches, std::uint64_t seed) {
  const std::size_t faces = mesh.mesh.faces.size();
  if (faces == 0) return;
  RandomStream random(seed, "patches");
  const auto beside = neighbours(mesh.mesh);
  std::vector<std::size_t> front;
  std::vector<int> patch(faces, -1);
  std::vector<Vec3d> colours;
  const int count = std::clamp(patches, 1, static_cast<int>(faces));
  const auto begin_patch = [&](std::size_t face) {
    patch[face] = static_cast<int>(colours.size());
    front.push_back(face);
    const double r = random.uniform(), g = random.uniform(), b = random.uniform();
    colours.push_back({r, g, b});
  };
  while (static_cast<int>(colours.size()) < count) {
    const auto face = as_size(random.below(static_cast<int>(faces)));
    if (patch[face] < 0) begin_patch(face);
  }
  for (std::size_t left = faces - colours.size(); left > 0;) {  // a face joins a random neighbour's patch
    if (front.empty()) {  // the patches have not reached every part of the mesh
      begin_patch(as_size(std::find(patch.begin(), patch.end(), -1) - patch.begin()));
      --left;
      continue;
    }
    const auto at = as_size(random.below(static_cast<int>(front.size())));
    std::vector<std::size_t> open;
    for (const std::size_t other : beside[front[at]])
      if (patch[other] < 0) open.push_back(other);
    if (open.empty()) {
      front[at] = front.back();
      front.pop_back();
      continue;
    }
    const std::size_t next = open[as_size(random.below(static_cast<int>(open.size())))];
    patch[next] = patch[front[at]];
    front.push_back(next);
    --left;
  }
  const std::size_t per_face = mesh.atlas.per_face();
  mesh.atlas.texels.resize(faces * per_face);
  for (std::size_t f = 0; f < faces; ++f)
    for (std::size_t t = 0; t < per_face; ++t)
      mesh.atlas.texels[f * per_face + t] = colours[as_size(patch[f])];
}

}  // namespace mirage
