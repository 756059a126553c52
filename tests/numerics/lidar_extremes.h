// An insertion with its VJP, and the properties that must hold for any input.
#pragma once

#include <gtest/gtest.h>

#include "support/lidar_world.h"

namespace mirage::test {

inline constexpr double kGrazing = 0.05;

/// Runs an insertion and its VJP, and checks the properties that hold for any input.
struct Outcome {
  Simulated simulated;
  LidarTape tape;
  double steepest = 0;  ///< largest gradient of a vertex per return
};
inline Outcome insert(const PreparedFrame& prepared, const TexturedMesh& object,
                      const LidarEffects& effects = {}) {
  SimulationSettings settings;
  settings.lidar_effects = effects;
  Outcome outcome;
  outcome.tape = draw_in_lidar(prepared, object, settings, outcome.simulated);
  const Sweep& sweep = outcome.simulated.sweep;
  for (std::size_t i = outcome.tape.first; i < sweep.size(); ++i) {
    EXPECT_TRUE(sweep[i].position().allFinite());
    EXPECT_TRUE(sweep[i].reflectance >= 0 && sweep[i].reflectance <= 1);
  }
  const std::vector<std::array<float, 4>> d_points(sweep.size(), {1, 1, 1, 1});
  std::vector<Vec3d> d_vertices(object.mesh.vertices.size(), Vec3d::Zero()),
      d_texels(object.atlas.texels.size(), Vec3d::Zero());
  draw_in_lidar_vjp(outcome.tape, object, settings, d_points, d_vertices, d_texels);
  for (const Vec3d& d : d_vertices) {
    EXPECT_TRUE(d.allFinite());
    outcome.steepest = std::max(outcome.steepest,
                                d.norm() / std::max(1.0, static_cast<double>(outcome.tape.returns.size())));
  }
  for (const Vec3d& d : d_texels) EXPECT_TRUE(d.allFinite());
  return outcome;
}
inline constexpr double kSteepest = 2 / kGrazing + 2 / kThinFace;  // √3 upstream, rounded up

}  // namespace mirage::test
