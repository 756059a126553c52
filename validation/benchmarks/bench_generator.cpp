// The street generator: frames a second with two threads, files included, and the share of each stage with
// one.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "base/files.h"
#include "base/parallel.h"
#include "bench.h"
#include "generator/appearance.h"
#include "generator/dataset.h"
#include "generator/labels.h"
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
  auto& figures = extra_figures();
  for (auto _ : state) {
    std::filesystem::remove_all(out);
    set_thread_count(1);
    const auto seconds = stage_seconds(rig, out / "stages");
    double all = 0;
    for (const auto& [stage, s] : seconds) all += s;
    for (const auto& [stage, s] : seconds) figures["generator_share_" + stage + "_" + name] = s / all;
    figures["generator_frames_per_s_1_thread_" + name] = kStageFrames / all;
    set_thread_count(2);
    const double ms = milliseconds(
        [&] { generate_dataset(rig, kSeed, 0, kGeneratedFrames, out / "set", [](std::size_t) {}); });
    set_thread_count(1);
    figures["generator_frames_per_s_" + name] = 1e3 * kGeneratedFrames / ms;
    std::filesystem::remove_all(out);
  }
}

}  // namespace

void register_generator_benchmarks() {
  for (const std::string name : {"kitti64", "xenith"})
    benchmark::RegisterBenchmark(("generator_" + name).c_str(), generator_frames, name)
        ->Iterations(1)
        ->Unit(benchmark::kMillisecond);
}

// The vehicle fit, by stage, over the cars within 30 m of a few generated streets. One thread.

namespace {

constexpr int kStreets = 6;
constexpr double kFarthest = 30;  // m

double quantile(std::vector<double> values, double p) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0 : values[static_cast<std::size_t>(p * static_cast<double>(values.size() - 1))];
}

void fit(benchmark::State& state) {
  const LidarModel lidar = read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"));
  const ShapeModel model = read_shape_model(shipped_file("scenes/shapes/cars.shape"));
  std::vector<double> evidence_ms, fit_ms, mesh_ms, roof_ms, whole_ms;
  for (auto _ : state)
    for (int index = 0; index < kStreets; ++index) {
      const auto street = generator::make_street(12, static_cast<std::uint64_t>(index), lidar.height);
      const SweepIndex sweep(simulate_sweep(RayScene(street.surfaces), lidar, 1), lidar);
      for (const auto& thing : street.placed) {
        if (thing.type != "Car" || std::hypot(thing.box.bev.x, thing.box.bev.y) > kFarthest) continue;
        VehicleEvidence evidence;
        const double gather = milliseconds([&] { evidence = gather_evidence(sweep, thing.box); });
        ShapeFit fit;
        const double solve = milliseconds([&] { fit = fit_shape(model, evidence, thing.box); });
        if (!fit.fitted) continue;
        Mesh mesh;
        mesh_ms.push_back(milliseconds([&] { mesh = model.mesh(fit.shape); }));
        roof_ms.push_back(milliseconds([&] { benchmark::DoNotOptimize(roof_point(mesh)); }));
        evidence_ms.push_back(gather);
        fit_ms.push_back(solve);
        whole_ms.push_back(gather + solve);
      }
    }
  auto& figures = extra_figures();
  figures["fit_vehicles"] = whole_ms.size();
  figures["fit_ms"] = quantile(whole_ms, 0.5);
  figures["fit_ms_p95"] = quantile(whole_ms, 0.95);
  figures["fit_evidence_ms"] = quantile(evidence_ms, 0.5);
  figures["fit_marching_cubes_ms"] = quantile(mesh_ms, 0.5);
  figures["fit_roof_ms"] = quantile(roof_ms, 0.5);
  // What fit_shape takes besides its mesh and rooftop.
  figures["fit_solve_ms"] =
      std::max(0.0, quantile(fit_ms, 0.5) - quantile(mesh_ms, 0.5) - quantile(roof_ms, 0.5));
}

}  // namespace

void register_fit_benchmarks() {
  benchmark::RegisterBenchmark("fit", fit)->Iterations(1)->Unit(benchmark::kMillisecond);
}

}  // namespace mirage
