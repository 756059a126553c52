// Figures of the simulator on this machine: medians of repeated runs, printed and written as one flat JSON
// object (bench.json beside the program). Compare only within one run: shared machines are noisy.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "attack/adversary.h"
#include "base/files.h"
#include "base/parallel.h"
#include "scene/generator.h"
#include "scene/insertion.h"

namespace mirage {
namespace {

/// The adversary's start on a car 10 m ahead of KITTI's rig, in an empty world.
struct Stage {
  PreparedFrame prepared;
  Label host;
  Rooftop rooftop;
  TexturedMesh adversary = random_adversary(1);

  Stage() {
    const Rig rig = read_rig(shipped_file("scenes/rigs/kitti64.toml"));
    Frame frame;
    frame.calibration = rig.calibration;
    frame.image = ImageF(rig.calibration.camera.width, rig.calibration.camera.height, 3, 0.3f);
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
    rooftop = BoxRooftopFinder().find(frame, host);
  }
};

const Stage& stage() {
  static const Stage one;
  return one;
}

void insertion(benchmark::State& state, double sigma) {
  SimulationSettings settings;
  settings.raster.sigma = sigma;
  const auto& s = stage();
  const ImageF d_image(s.prepared.frame.image.width, s.prepared.frame.image.height, 3, 1.f);
  for (auto _ : state) {
    const Simulated simulated = simulate(s.prepared, s.host, s.rooftop, s.adversary, settings);
    const std::vector<std::array<float, 4>> d_points(simulated.sweep.size(), {1, 1, 1, 1});
    benchmark::DoNotOptimize(simulate_vjp(simulated, d_image, d_points));
  }
}

/// Collects medians (milliseconds) by name, besides the console's table.
class Collector : public benchmark::ConsoleReporter {
 public:
  void ReportRuns(const std::vector<Run>& runs) override {
    ConsoleReporter::ReportRuns(runs);
    for (const Run& run : runs)
      if (run.run_type == Run::RT_Aggregate && run.aggregate_name == "median")
        figures[run.run_name.function_name] = run.GetAdjustedRealTime();
  }
  nlohmann::json figures = nlohmann::json::object();
};

}  // namespace
}  // namespace mirage

int main(int argc, char** argv) {
  using namespace mirage;
  set_thread_count(1);
  for (const auto& [name, sigma] :
       {std::pair{"insertion_ms", 5e-7}, std::pair{"insertion_ms_10m_sigma_1e-5", 1e-5},
        std::pair{"insertion_ms_10m_sigma_1e-4", 1e-4}})
    benchmark::RegisterBenchmark(name, [sigma = sigma](benchmark::State& state) { insertion(state, sigma); })
        ->Unit(benchmark::kMillisecond)
        ->Repetitions(9)
        ->ReportAggregatesOnly(true);
  benchmark::Initialize(&argc, argv);
  Collector collector;
  benchmark::RunSpecifiedBenchmarks(&collector);
  const auto file = executable_folder() / "bench.json";
  write_json(file, collector.figures);
  std::printf("%s\n", file.c_str());
  return 0;
}
