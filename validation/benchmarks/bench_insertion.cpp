// One insertion (both sensors, occlusion, VJP) 10 m ahead of KITTI's rig: as a whole, by stage, in a batch.

#include <string>
#include <vector>

#include "attack/adversary.h"
#include "base/files.h"
#include "base/random.h"
#include "bench.h"
#include "generator/generator.h"
#include "scene/depth_completion.h"
#include "simulation/camera_pass.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

constexpr int kInsertionRounds = 31;

/// The adversary's start on a car 10 m ahead of KITTI's rig, in an empty world.
struct Stage {
  PreparedFrame prepared;
  Placement placement;
  TexturedMesh adversary = random_adversary(1);

  Stage() {
    const Rig rig = read_rig(shipped_file("scenes/rigs/kitti64.toml"));
    Frame frame;
    frame.calibration = rig.calibration;
    frame.image = ImageF(rig.calibration.camera.width, rig.calibration.camera.height, 3, 0.3f);
    Label host;
    host.type = "Car";
    host.box = {{10, 0, 4, 1.7, 0}, -1.73, 1.5};
    frame.labels = {host};
    for (std::size_t beam = 0; beam < rig.lidar.beams.size(); ++beam)  // a wall 25 m ahead behind everything
      for (int column = 0; column < rig.lidar.azimuth_count(); ++column) {
        const LidarRay ray = rig.lidar.ray(static_cast<int>(beam), column);
        const Vec3d p = ray.origin + (25 - ray.origin.x()) / ray.direction.x() * ray.direction;
        frame.sweep.push_back({float(p.x()), float(p.y()), float(p.z()), 0.3f});
      }
    prepared = prepare(frame, rig.lidar);
    placement = on_roof(BoxRoofFinder().find(frame, host));
  }
};

const Stage& stage() {
  static const Stage stage;
  return stage;
}

void insertion(benchmark::State& state, double sigma, int supersampling) {
  SimulationSettings settings;
  settings.raster.sigma = sigma;
  settings.supersampling = supersampling;
  const auto& s = stage();
  const ImageF d_image(s.prepared.frame.image.width, s.prepared.frame.image.height, 3, 1.f);
  std::vector<std::array<float, 4>> d_points(s.prepared.frame.sweep.size() + 4096, {1, 1, 1, 1});
  for (auto _ : state) {
    const Simulated simulated = simulate(s.prepared, s.placement, s.adversary, settings);
    d_points.resize(simulated.sweep.size(), {1, 1, 1, 1});
    benchmark::DoNotOptimize(simulate_vjp(simulated, d_image, d_points));
  }
}

/// Medians of the stages, taken in alternation: what is copied, each sensor forward, each sensor's VJP.
void insertion_stages(benchmark::State& state) {
  const auto& s = stage();
  const SimulationSettings settings;
  const TexturedMesh placed = place(s.adversary, s.placement);
  const ImageF& photograph = s.prepared.frame.image;
  const ImageF d_image(photograph.width, photograph.height, 3, 1.f);
  Rounds rounds;
  for (auto _ : state)
    for (int round = 0; round < kInsertionRounds; ++round) {
      Simulated result;
      CameraTape camera_tape;
      LidarTape lidar_tape;
      rounds.time("insertion_copy_image_ms", [&] { benchmark::DoNotOptimize(result.image = photograph); });
      rounds.time("insertion_copy_sweep_ms", [&] {
        Sweep copy = s.prepared.frame.sweep;
        benchmark::DoNotOptimize(copy.data());
      });
      Simulated drawn;
      rounds.time("insertion_camera_ms",
                  [&] { camera_tape = draw_in_camera(s.prepared, s.placement, placed, settings, drawn); });
      rounds.time("insertion_lidar_ms",
                  [&] { lidar_tape = draw_in_lidar(s.prepared, placed, settings, drawn); });
      std::vector<Vec3d> d_vertices(placed.mesh.vertices.size(), Vec3d::Zero()),
          d_texels(placed.atlas.texels.size(), Vec3d::Zero());
      const std::vector<std::array<float, 4>> d_points(drawn.sweep.size(), {1, 1, 1, 1});
      rounds.time("insertion_camera_vjp_ms", [&] {
        draw_in_camera_vjp(camera_tape, placed, s.prepared.frame.calibration, drawn, d_image.data, d_vertices,
                           d_texels);
      });
      rounds.time("insertion_lidar_vjp_total_ms",
                  [&] { draw_in_lidar_vjp(lidar_tape, placed, settings, d_points, d_vertices, d_texels); });
    }
  rounds.record();
}
ONCE(BENCHMARK(insertion_stages));

/// The adversary's start with every corner somewhere between its place and the middle: faces hide each other
/// and the sky, as those of a learned mesh do.
TexturedMesh crumpled(TexturedMesh mesh) {
  RandomStream random(1, "bench crumpled");
  const Vec3d centre = bounds(mesh.mesh).center();
  for (Vec3d& v : mesh.mesh.vertices) v = centre + random.uniform(0.4, 1) * (v - centre);
  return mesh;
}

/// Forward + VJP under the plain light and under the ones with visibility, in alternation; CPU time of one
/// thread. `suffix`: of the figures' names.
void compare_lights(const TexturedMesh& adversary, const std::string& suffix) {
  const auto& s = stage();
  const ImageF d_image(s.prepared.frame.image.width, s.prepared.frame.image.height, 3, 1.f);
  Rounds rounds;
  for (int round = 0; round < kInsertionRounds; ++round)
    for (const LightModel model : {LightModel::plain, LightModel::visible, LightModel::fine}) {
      SimulationSettings settings;
      settings.light = model;
      rounds.cpu(std::string("light_") + to_word(model) + "_insertion_ms", [&] {
        const Simulated simulated = simulate(s.prepared, s.placement, adversary, settings);
        const std::vector<std::array<float, 4>> d_points(simulated.sweep.size(), {1, 1, 1, 1});
        benchmark::DoNotOptimize(simulate_vjp(simulated, d_image, d_points));
      });
    }
  rounds.record(suffix);
  for (const std::string model : {"visible", "fine"})
    figures()["light_" + model + "_over_plain" + suffix] =
        rounds["light_" + model + "_insertion_ms"] / rounds["light_plain_insertion_ms"];
}

void light_models(benchmark::State& state) {
  while (state.KeepRunning()) {
    compare_lights(stage().adversary, "");
    compare_lights(crumpled(stage().adversary), "_crumpled");
  }
}

ONCE(BENCHMARK(light_models));

// Medians of plain loops, under their own names.
void depth_ip_basic_ms(benchmark::State& state) {
  const auto& frame = stage().prepared.frame;
  const ImageF sparse = sparse_depth(frame.sweep, frame.calibration);
  for (auto _ : state) benchmark::DoNotOptimize(complete_depth(sparse));
}
void median_of_nine(benchmark::internal::Benchmark* plain) {
  plain->Repetitions(9)->ReportAggregatesOnly(true)->Unit(benchmark::kMillisecond);
}
BENCHMARK_CAPTURE(insertion, standard, 5e-7, 2)->Name("insertion_ms")->Apply(median_of_nine);
BENCHMARK_CAPTURE(insertion, at_1e_5, 1e-5, 1)->Name("insertion_ms_10m_sigma_1e-5")->Apply(median_of_nine);
BENCHMARK_CAPTURE(insertion, at_1e_4, 1e-4, 1)->Name("insertion_ms_10m_sigma_1e-4")->Apply(median_of_nine);
BENCHMARK(depth_ip_basic_ms)->Apply(median_of_nine);

}  // namespace
}  // namespace mirage
