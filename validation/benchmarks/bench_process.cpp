// A detector in a process of its own: what the way there and back costs for a frame of KITTI's size, with a
// toy at the other end that takes no time. Linear and 8-bit pictures, with and without gradients.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "bench.h"
#include "detection/process_detector.h"

namespace mirage {
namespace {

constexpr int kTrips = 101, kPointsInView = 20000;

void process(benchmark::State& state, const std::string& pictures) {
  ImageF image(1242, 375, 3);
  RandomStream random(7, "benchmark of processes");
  for (float& value : image.data) value = static_cast<float>(random.uniform());
  Sweep points(kPointsInView, LidarPoint{10, 1, -1, 0.3f});
  Calibration calibration;
  calibration.camera.width = image.width, calibration.camera.height = image.height;
  calibration.camera.fx = calibration.camera.fy = 720;
  DetectorOptions options;
  options.threads = 1;
  options.detector = fmt::format("exec:/usr/bin/python3 -B '{}' {}",
                                 shipped_file("validation/benchmarks/process_toy.py").string(), pictures);
  const SensorView view{&image, points, &calibration};
  std::vector<double> forward, both;
  try {
    const auto detector = start_program(options);
    const auto pass = [&](bool back) {
      return milliseconds([&] {
        const auto found = detector->forward(view, 0.1, back);
        if (back) detector->backward(std::vector<double>(found.size(), 1));
      });
    };
    for (auto _ : state)
      for (int round = 0; round < kTrips; ++round) {
        forward.push_back(pass(false));
        both.push_back(pass(true));
      }
  } catch (const InputError& error) {
    state.SkipWithError(error.what());
    return;
  }
  extra_figures()[fmt::format("process_{}_ms", pictures)] = median(forward);
  extra_figures()[fmt::format("process_{}_gradient_ms", pictures)] = median(both);
  state.counters["forward_ms"] = median(forward);
  state.counters["both_ms"] = median(both);
}

}  // namespace

void register_process_benchmarks() {
  for (const char* pictures : {"linear", "srgb8"})
    benchmark::RegisterBenchmark(fmt::format("process/{}", pictures).c_str(), process, pictures)
        ->Iterations(1)
        ->Unit(benchmark::kMillisecond);
}

}  // namespace mirage
