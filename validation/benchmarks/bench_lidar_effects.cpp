// What each optional LiDAR effect changes, alone, against the same sweep and the same insertion without it:
// on generated streets, as flat figures lidar_effect_NAME_….
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "attack/adversary.h"
#include "base/files.h"
#include "base/random.h"
#include "bench.h"
#include "generator/street.h"
#include "sensors/lidar_sweep.h"
#include "simulation/adversary_lidar.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

constexpr int kNoisyStreets = 4;
constexpr double kFarthestHost = 40;  // m

struct Case {
  const char* name;
  LidarEffects effects;
};

std::vector<Case> cases() {
  std::vector<Case> all;
  const LidarEffects generated = generated_sweep_effects();
  LidarEffects e;
  e.range_sigma = generated.range_sigma;
  all.push_back({"range_noise", e});
  e = {};
  e.drop_out = generated.drop_out;
  e.signal_floor = generated.signal_floor;
  all.push_back({"drop_out", e});
  e = {};
  e.divergence = Vec2d(2e-3, 2e-3);
  all.push_back({"divergence", e});
  e = {};
  e.albedo = true;
  all.push_back({"albedo", e});
  e = {};
  e.velocity = Vec3d(13.9, 0, 0);  // 50 km/h in a gentle bend
  e.yaw_rate = 0.1;
  all.push_back({"motion", e});
  return all;
}

/// Sums over what two simulations both returned, and counts of what only one did.
struct Difference {
  double before = 0, lost = 0, gained = 0, both = 0, range = 0, reflectance = 0, position = 0;

  void add(bool had, bool has, double d_range, double d_reflectance, double d_position) {
    before += had;
    lost += had && !has;
    gained += has && !had;
    if (!had || !has) return;
    ++both;
    range += std::abs(d_range);
    reflectance += std::abs(d_reflectance);
    position += d_position;
  }
  void write(const std::string& prefix) const {
    auto& figures = extra_figures();
    figures[prefix + "_points"] = before;
    figures[prefix + "_lost_share"] = lost / before;
    figures[prefix + "_gained_share"] = gained / before;
    figures[prefix + "_mean_range_change_m"] = range / both;
    figures[prefix + "_mean_position_change_m"] = position / both;
    figures[prefix + "_mean_reflectance_change"] = reflectance / both;
  }
};

double cosine(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  double ab = 0, aa = 0, bb = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    ab += a[i].dot(b[i]);
    aa += a[i].squaredNorm();
    bb += b[i].squaredNorm();
  }
  return aa > 0 && bb > 0 ? ab / std::sqrt(aa * bb) : 0;
}

struct Inserted {
  LidarTape tape;
  Simulated simulated;
  std::vector<Vec3d> d_vertices;
};

/// The insertion and its gradient for an upstream gradient that belongs to the ray, whatever came of it.
Inserted insert(const PreparedFrame& prepared, const TexturedMesh& placed, const LidarEffects& effects) {
  SimulationSettings settings;
  settings.lidar_effects = effects;
  Inserted result;
  result.tape = draw_in_lidar(prepared, placed, settings, result.simulated);
  std::vector<std::array<float, 4>> d_points(result.simulated.sweep.size(), {0, 0, 0, 0});
  for (std::size_t i = 0; i < result.tape.returns.size(); ++i) {
    const auto& back = result.tape.returns[i];
    RandomStream random(
        0, "upstream",
        static_cast<std::uint64_t>(back.beam) * 100000 + static_cast<std::uint64_t>(back.firing + 1));
    for (float& value : d_points[result.tape.first + i]) value = static_cast<float>(random.normal());
  }
  result.d_vertices.assign(placed.mesh.vertices.size(), Vec3d::Zero());
  std::vector<Vec3d> d_texels(placed.atlas.texels.size(), Vec3d::Zero());
  draw_in_lidar_vjp(result.tape, placed, settings, d_points, result.d_vertices, d_texels);
  return result;
}

void compare(const Inserted& before, const Inserted& after, Difference& difference) {
  std::map<std::pair<int, int>, std::pair<const LidarTape::Return*, const LidarTape::Return*>> by_ray;
  for (const auto& back : before.tape.returns)
    if (back.firing >= 0) by_ray[{back.beam, back.firing}].first = &back;
  for (const auto& back : after.tape.returns)
    if (back.firing >= 0) by_ray[{back.beam, back.firing}].second = &back;
  for (const auto& [ray, pair] : by_ray) {
    const auto [had, has] = pair;
    if (had && has) {
      const Vec3d p = had->ray.origin + had->range * had->ray.direction,
                  q = has->ray.origin + has->range * has->ray.direction;
      difference.add(true, true, has->range - had->range, has->hit.reflectance - had->hit.reflectance,
                     (p - q).norm());
    } else {
      difference.add(had, has, 0, 0, 0);
    }
  }
}

void lidar_effects(benchmark::State& state) {
  const LidarModel lidar = read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"));
  const auto all = cases();
  std::vector<Difference> sweeps(all.size()), insertions(all.size());
  std::vector<double> gradients(all.size(), 0);
  int hosts = 0;
  for (auto _ : state)
    for (int street_index = 0; street_index < kNoisyStreets; ++street_index) {
      const auto street = generator::make_street(11, static_cast<std::uint64_t>(street_index), lidar.height);
      const RayScene scene(street.surfaces);
      const Firings ideal = simulate_firings(scene, lidar, 1, {});
      for (std::size_t c = 0; c < all.size(); ++c) {
        const Firings with = simulate_firings(scene, lidar, 1, all[c].effects);
        for (std::size_t i = 0; i < ideal.ranges.size(); ++i) {
          const LidarPoint &p = ideal.points[i], &q = with.points[i];
          sweeps[c].add(ideal.ranges[i] > 0, with.ranges[i] > 0, with.ranges[i] - ideal.ranges[i],
                        q.reflectance - p.reflectance, (q.position() - p.position()).norm());
        }
      }
      PreparedFrame prepared;
      prepared.lidar = lidar;
      prepared.frame.id = fmt::format("{:06}", street_index);
      prepared.frame.sweep = simulate_sweep(scene, lidar, 1);
      prepared.index = SweepIndex(prepared.frame.sweep, lidar);
      for (const auto& thing : street.placed) {
        const BevBox& box = thing.box.bev;
        if (thing.type != "Car" || box.x < 5 || std::hypot(box.x, box.y) > kFarthestHost ||
            std::abs(box.y) > 0.8 * box.x)
          continue;
        Label label;
        label.type = thing.type;
        label.box = thing.box;
        TexturedMesh placed =
            place(random_adversary(1), on_roof(BoxRoofFinder().find(prepared.frame, label)));
        RandomStream paint(3, "texels");
        for (Vec3d& t : placed.atlas.texels) t = Vec3d(paint.uniform(), paint.uniform(), paint.uniform());
        const Inserted before = insert(prepared, placed, {});
        if (before.tape.returns.size() < 20) continue;
        ++hosts;
        for (std::size_t c = 0; c < all.size(); ++c) {
          const Inserted after = insert(prepared, placed, all[c].effects);
          compare(before, after, insertions[c]);
          gradients[c] += cosine(before.d_vertices, after.d_vertices);
        }
      }
    }
  for (std::size_t c = 0; c < all.size(); ++c) {
    const std::string prefix = fmt::format("lidar_effect_{}", all[c].name);
    sweeps[c].write(fmt::format("{}_sweep", prefix));
    insertions[c].write(fmt::format("{}_insertion", prefix));
    extra_figures()[fmt::format("{}_insertion_gradient_cosine", prefix)] = gradients[c] / hosts;
  }
  extra_figures()["lidar_effect_hosts"] = hosts;
}

}  // namespace

void register_lidar_effect_benchmarks() {
  benchmark::RegisterBenchmark("lidar_effects", lidar_effects)->Iterations(1)->Unit(benchmark::kMillisecond);
}

}  // namespace mirage
