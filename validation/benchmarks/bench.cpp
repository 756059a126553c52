// Figures of the simulator on this machine: medians of repeated runs, printed and written as one flat JSON
// object (bench.json beside the program). Compare only within one run: shared machines are noisy.
#include "bench.h"

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "base/files.h"
#include "base/parallel.h"

namespace mirage {
namespace {

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

double milliseconds(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

nlohmann::json& extra_figures() {
  static nlohmann::json figures = nlohmann::json::object();
  return figures;
}

}  // namespace mirage

int main(int argc, char** argv) {
  using namespace mirage;
  set_thread_count(1);
  register_raster_benchmarks();
  register_insertion_benchmarks();
  register_lidar_benchmarks();
  register_fit_benchmarks();
  register_generator_benchmarks();
  register_detector_benchmarks();
  register_attack_step_benchmarks();
  register_process_benchmarks();
  benchmark::Initialize(&argc, argv);
  Collector collector;
  benchmark::RunSpecifiedBenchmarks(&collector);
  collector.figures.update(extra_figures());
  const auto file = executable_folder() / "bench.json";
  write_json(file, collector.figures);
  std::printf("%s\n", file.c_str());
  return 0;
}
