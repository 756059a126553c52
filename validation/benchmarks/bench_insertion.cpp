// One insertion (both sensors, occlusion, VJP) 10 m ahead of KITTI's rig: as a whole, by stage, in a batch.
#include <benchmark/benchmark.h>

#include <map>
#include <string>
#include <vector>

#include "attack/adversary.h"
#include "base/files.h"
#include "base/random.h"
#include "bench.h"
#include "generator/generator.h"
#include "scene/depth_completion.h"
#include "scene/recorded_light.h"
#include "simulation/camera_pass.h"
#include "simulation/insertion.h"
#include "validation/thread_clock.h"

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
void stages(benchmark::State& state) {
  const auto& s = stage();
  const SimulationSettings settings;
  const TexturedMesh placed = place(s.adversary, s.placement);
  const ImageF& photograph = s.prepared.frame.image;
  const ImageF d_image(photograph.width, photograph.height, 3, 1.f);
  std::vector<double> copy_image, copy_sweep, camera, lidar, camera_vjp, lidar_vjp;
  for (auto _ : state)
    for (int round = 0; round < kInsertionRounds; ++round) {
      Simulated result;
      CameraTape camera_tape;
      LidarTape lidar_tape;
      copy_image.push_back(milliseconds([&] { benchmark::DoNotOptimize(result.image = photograph); }));
      copy_sweep.push_back(milliseconds([&] {
        Sweep copy = s.prepared.frame.sweep;
        benchmark::DoNotOptimize(copy.data());
      }));
      Simulated drawn;
      camera.push_back(milliseconds(
          [&] { camera_tape = draw_in_camera(s.prepared, s.placement, placed, settings, drawn); }));
      lidar.push_back(milliseconds([&] { lidar_tape = draw_in_lidar(s.prepared, placed, settings, drawn); }));
      std::vector<Vec3d> d_vertices(placed.mesh.vertices.size(), Vec3d::Zero()),
          d_texels(placed.atlas.texels.size(), Vec3d::Zero());
      const std::vector<std::array<float, 4>> d_points(drawn.sweep.size(), {1, 1, 1, 1});
      camera_vjp.push_back(milliseconds([&] {
        draw_in_camera_vjp(camera_tape, placed, s.prepared.frame.calibration, drawn, d_image, d_vertices,
                           d_texels);
      }));
      lidar_vjp.push_back(milliseconds(
          [&] { draw_in_lidar_vjp(lidar_tape, placed, settings, d_points, d_vertices, d_texels); }));
    }
  nlohmann::json& figures = extra_figures();
  figures["insertion_copy_image_ms"] = median(copy_image);
  figures["insertion_copy_sweep_ms"] = median(copy_sweep);
  figures["insertion_camera_ms"] = median(camera);
  figures["insertion_lidar_ms"] = median(lidar);
  figures["insertion_camera_vjp_ms"] = median(camera_vjp);
  figures["insertion_lidar_vjp_total_ms"] = median(lidar_vjp);
  std::printf(
      "  stages: copy image %.3f, copy sweep %.3f, camera %.3f (copy included), LiDAR %.3f (copy included), "
      "camera VJP %.3f, LiDAR VJP %.3f ms\n",
      median(copy_image), median(copy_sweep), median(camera), median(lidar), median(camera_vjp),
      median(lidar_vjp));
}

/// The adversary's start with every corner somewhere between its place and the middle: faces hide each other
/// and the sky, as those of a learned mesh do.
TexturedMesh crumpled(TexturedMesh mesh) {
  RandomStream random(1, "bench crumpled");
  const Vec3d centre = bounds(mesh.mesh).center();
  for (Vec3d& v : mesh.mesh.vertices) v = centre + random.uniform(0.4, 1) * (v - centre);
  return mesh;
}

/// Forward + VJP under the plain light and under the ones with visibility, in alternation, and what the
/// visible one does, by stage; CPU time of one thread. `suffix`: of the figures' names.
void compare_lights(const TexturedMesh& adversary, const std::string& suffix) {
  const auto& s = stage();
  const ImageF d_image(s.prepared.frame.image.width, s.prepared.frame.image.height, 3, 1.f);
  const TexturedMesh placed = place(adversary, s.placement);
  const std::vector<Vec3d> normals = face_normals(placed.mesh);
  const Lighting& lighting = s.prepared.frame.lighting;
  const Vec3d eye = s.prepared.frame.calibration.camera_from_velo.inverse().translation();
  std::map<LightModel, std::vector<double>> insertion;
  std::vector<double> rays, gather, vjp;
  std::size_t count = 0;
  for (int round = 0; round < kInsertionRounds; ++round) {
    for (LightModel model : {LightModel::plain, LightModel::visible, LightModel::fine}) {
      SimulationSettings settings;
      settings.light = model;
      insertion[model].push_back(cpu_ms([&] {
        const Simulated simulated = simulate(s.prepared, s.placement, adversary, settings);
        const std::vector<std::array<float, 4>> d_points(simulated.sweep.size(), {1, 1, 1, 1});
        benchmark::DoNotOptimize(simulate_vjp(simulated, d_image, d_points));
      }));
    }
    const LightSurroundings around = *surroundings_of(s.prepared.frame, s.placement);
    LightVisibility visibility;
    VisibleLight<double> lit;
    rays.push_back(cpu_ms([&] { visibility = find_visibility(placed, lighting, &around, &eye); }));
    gather.push_back(cpu_ms([&] {
      lit = visible_light(normals, placed.atlas.texels, lighting, visibility, VisibleLightSettings().bounces);
    }));
    std::vector<Vec3d> d_normals(normals.size(), Vec3d::Zero()),
        d_texels(placed.atlas.texels.size(), Vec3d::Zero());
    const std::vector<Vec3d> ones(lit.factor.size(), Vec3d::Ones());
    vjp.push_back(cpu_ms([&] {
      visible_light_vjp(normals, placed.atlas.texels, lighting, visibility, lit, ones, ones, d_normals,
                        d_texels);
    }));
    count = visibility.rays;
  }
  const double plain = median(insertion[LightModel::plain]), visible = median(insertion[LightModel::visible]),
               fine = median(insertion[LightModel::fine]);
  extra_figures()["light_plain_insertion_ms" + suffix] = plain;
  extra_figures()["light_visible_insertion_ms" + suffix] = visible;
  extra_figures()["light_fine_insertion_ms" + suffix] = fine;
  extra_figures()["light_visible_over_plain" + suffix] = visible / plain;
  extra_figures()["light_fine_over_plain" + suffix] = fine / plain;
  std::printf(
      "  plain %.3f ms, visible %.3f ms: %.2f times, fine %.3f ms: %.2f times; of visible: %zu rays %.3f, "
      "gathering %.3f, its VJP %.3f ms\n",
      plain, visible, visible / plain, fine, fine / plain, count, median(rays), median(gather), median(vjp));
}

void light_models(benchmark::State& state) {
  while (state.KeepRunning()) {
    compare_lights(stage().adversary, "");
    compare_lights(crumpled(stage().adversary), "_crumpled");
  }
}

void completion(benchmark::State& state) {
  const auto& frame = stage().prepared.frame;
  const ImageF sparse = sparse_depth(frame.sweep, frame.calibration);
  for (auto _ : state) benchmark::DoNotOptimize(complete_depth(sparse));
}

}  // namespace

void register_insertion_benchmarks() {
  const auto median_of_nine = [](auto* b) { b->Repetitions(9)->ReportAggregatesOnly(true); };
  for (const auto& [name, sigma, supersampling] :
       {std::tuple{"insertion_ms", 5e-7, 2}, std::tuple{"insertion_ms_10m_sigma_1e-5", 1e-5, 1},
        std::tuple{"insertion_ms_10m_sigma_1e-4", 1e-4, 1}})
    median_of_nine(benchmark::RegisterBenchmark(name, [sigma = sigma, supersampling = supersampling](
                                                          benchmark::State& state) {
                     insertion(state, sigma, supersampling);
                   })->Unit(benchmark::kMillisecond));
  median_of_nine(
      benchmark::RegisterBenchmark("depth_ip_basic_ms", completion)->Unit(benchmark::kMillisecond));
  benchmark::RegisterBenchmark("insertion_stages", stages)->Unit(benchmark::kMillisecond)->Iterations(1);
  benchmark::RegisterBenchmark("light_models", light_models)->Unit(benchmark::kMillisecond)->Iterations(1);
}

}  // namespace mirage
