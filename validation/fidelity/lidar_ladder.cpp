#include "validation/fidelity/lidar_ladder.h"

#include <chrono>
#include <cmath>
#include <map>
#include <tuple>

#include "simulation/adversary_lidar.h"

namespace mirage {
namespace {

constexpr double kMoved = 1e-3;       // m
constexpr double kRangeSigma = 0.02;  // m, HDL-64E's data sheet
constexpr double kDropOut = 0.1;      // share

/// What tells a ray: its beam and firing, and where it points for a return that shares both with another.
using RayKey = std::tuple<int, int, long, long>;

std::map<RayKey, Vec3d> by_ray(const LidarTape& tape, const Sweep& sweep) {
  std::map<RayKey, Vec3d> points;
  for (std::size_t i = 0; i < tape.returns.size(); ++i) {
    const LidarTape::Return& back = tape.returns[i];
    RayKey key{back.beam, back.firing, 0, 0};
    if (back.firing < 0)
      key = {back.beam, back.firing,
             std::lround(1e6 * std::atan2(back.ray.direction.y(), back.ray.direction.x())),
             std::lround(1e6 * back.ray.direction.z())};
    points[key] = sweep[tape.first + i].position().cast<double>();
  }
  return points;
}

}  // namespace

LidarEffects realistic_returns(const HostScene& scene) {
  LidarEffects all = parse_lidar_effects("divergence,motion", scene.prepared->lidar.divergence);
  all.range_sigma = kRangeSigma;
  all.drop_out = kDropOut;
  all.seed = scene.seed;
  return all;
}

std::vector<LidarRung> lidar_ladder(const HostScene& scene) {
  const LidarEffects ideal, all = realistic_returns(scene);
  LidarEffects noise, drop_out, divergence, motion;
  noise.range_sigma = all.range_sigma;
  drop_out.drop_out = all.drop_out;
  divergence.divergence = all.divergence;
  motion.velocity = all.velocity;
  motion.yaw_rate = all.yaw_rate;
  std::map<RayKey, Vec3d> reference;
  std::vector<LidarRung> ladder;
  for (auto& [name, effects] : std::vector<std::pair<std::string, LidarEffects>>{{"ideal", ideal},
                                                                                 {"noise", noise},
                                                                                 {"drop-out", drop_out},
                                                                                 {"divergence", divergence},
                                                                                 {"motion", motion},
                                                                                 {"all", all}}) {
    SimulationSettings settings = scene.simulation;
    settings.lidar_effects = effects;
    settings.lidar_effects.seed = scene.seed;
    LidarRung rung;
    rung.effect = name;
    Simulated simulated;
    const auto start = std::chrono::steady_clock::now();
    const LidarTape tape = draw_in_lidar(*scene.prepared, scene.placed, settings, simulated);
    rung.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const auto points = by_ray(tape, simulated.sweep);
    if (ladder.empty()) reference = points;
    std::size_t changed = 0;
    for (const auto& [ray, point] : points) {
      const auto same = reference.find(ray);
      changed += same == reference.end() || (same->second - point).norm() > kMoved;
    }
    for (const auto& [ray, point] : reference) changed += !points.contains(ray);
    const double count = std::max<double>(1, static_cast<double>(reference.size()));
    rung.returns = static_cast<int>(points.size());
    rung.changed = static_cast<double>(changed) / count;
    rung.returns_change =
        (static_cast<double>(points.size()) - static_cast<double>(reference.size())) / count;
    rung.sweep = std::move(simulated.sweep);
    ladder.push_back(std::move(rung));
  }
  return ladder;
}

}  // namespace mirage
