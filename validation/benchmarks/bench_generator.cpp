// The street generator: frames a second with two threads, files included, and the share of each stage with
// one.

#include <cmath>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "base/files.h"
#include "base/parallel.h"
#include "bench.h"
#include "generator/dataset.h"
#include "generator/generator.h"
#include "generator/street.h"
#include "scene/data/kitti.h"
#include "scene/shape/shape_fit.h"
#include "sensors/lidar_sweep.h"

namespace mirage {
namespace {

constexpr std::uint64_t kSeed = 2024;
constexpr int kStageFrames = 4, kGeneratedFrames = 8;

/// Seconds by stage over a few frames, as generate_frame and generate_dataset go through them.
std::map<std::string, double> stage_seconds(const Rig& rig, const std::filesystem::path& out) {
  std::map<std::string, double> seconds;
  for (std::uint64_t index = 0; index < kStageFrames; ++index) {
    const auto time = [&](const char* stage, const std::function<void()>& work) {
      seconds[stage] += 1e-3 * milliseconds(work);
    };
    generator::Street street;
    time("layout", [&] { street = generator::make_street(kSeed, index, rig.lidar.height, rig.look); });
    std::unique_ptr<RayScene> scene;
    time("embree_build", [&] { scene = std::make_unique<RayScene>(street.surfaces); });
    RayImage picture;
    const Calibration& calibration = rig.calibration;
    Frame frame;
    time("camera", [&] {
      picture = render(*scene, calibration.camera, calibration.camera_from_velo,
                       generator::make_light(kSeed, index));
    });
    time("exposure", [&] {
      frame.image = picture.color;
      generator::expose(frame.image, kSeed, index, index);
    });
    std::vector<int> returned;
    time("lidar",
         [&] { frame.sweep = simulate_sweep(*scene, rig.lidar, 1, generated_sweep_effects(), &returned); });
    time("labels", [&] {
      frame.labels = generator::label_street(street, calibration, picture.object, returned).labels;
    });
    frame.id = "00000" + std::to_string(index);
    frame.calibration = calibration;
    time("files", [&] { write_frame(out, frame); });
  }
  return seconds;
}

void generator_frames(benchmark::State& state, const std::string& name) {
  const Rig rig = read_rig(shipped_file("scenes/rigs/" + name + ".toml"));
  const std::filesystem::path out =
      std::filesystem::temp_directory_path() / ("mirage-bench-generator-" + name);
  auto& all_figures = figures();
  for (auto _ : state) {
    std::filesystem::remove_all(out);
    set_thread_count(1);
    const auto seconds = stage_seconds(rig, out / "stages");
    double all = 0;
    for (const auto& [stage, s] : seconds) all += s;
    for (const auto& [stage, s] : seconds) all_figures["generator_share_" + stage + "_" + name] = s / all;
    all_figures["generator_frames_per_s_1_thread_" + name] = kStageFrames / all;
    set_thread_count(2);
    const double ms = milliseconds(
        [&] { generate_dataset(rig, kSeed, 0, kGeneratedFrames, out / "set", [](std::size_t) {}); });
    set_thread_count(1);
    all_figures["generator_frames_per_s_" + name] = 1e3 * kGeneratedFrames / ms;
    std::filesystem::remove_all(out);
  }
}
ONCE(BENCHMARK_CAPTURE(generator_frames, kitti64, "kitti64"));
ONCE(BENCHMARK_CAPTURE(generator_frames, xenith, "xenith"));

// The vehicle fit, by stage, over the cars within 30 m of a few generated streets. One thread.

constexpr int kStreets = 6;
constexpr double kMaxDistance = 30;  // m

void fit(benchmark::State& state) {
  const LidarModel lidar = read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"));
  const ShapeModel model = read_shape_model(shipped_file("scenes/shapes/cars.shape"));
  Rounds rounds;
  for (auto _ : state)
    for (int index = 0; index < kStreets; ++index) {
      const auto street = generator::make_street(12, static_cast<std::uint64_t>(index), lidar.height);
      const SweepIndex sweep(simulate_sweep(RayScene(street.surfaces), lidar, 1), lidar);
      for (const auto& thing : street.placed) {
        if (thing.type != "Car" || horizontal_distance(thing.box.bev) > kMaxDistance) continue;
        VehicleEvidence evidence;
        const double gather = milliseconds([&] { evidence = gather_evidence(sweep, thing.box); });
        ShapeFit fit;
        const double solve = milliseconds([&] { fit = fit_shape(model, evidence, thing.box); });
        if (!fit.fitted) continue;
        Mesh mesh;
        rounds.time("fit_marching_cubes_ms", [&] { mesh = model.mesh(fit.shape); });
        rounds.time("fit_roof_ms", [&] { benchmark::DoNotOptimize(roof_point(mesh)); });
        rounds.add("fit_evidence_ms", gather);
        rounds.add("solve", solve);
        rounds.add("fit_ms", gather + solve);
      }
    }
  for (const char* name : {"fit_ms", "fit_evidence_ms", "fit_marching_cubes_ms", "fit_roof_ms"})
    figures()[name] = rounds[name];
  figures()["fit_vehicles"] = rounds.count("fit_ms");
  figures()["fit_ms_p95"] = rounds.at("fit_ms", 0.95);
  // The time of fit_shape without its mesh and rooftop.
  figures()["fit_solve_ms"] =
      std::max(0.0, rounds["solve"] - rounds["fit_marching_cubes_ms"] - rounds["fit_roof_ms"]);
}
ONCE(BENCHMARK(fit));

}  // namespace
}  // namespace mirage
