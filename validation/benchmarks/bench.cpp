// Figures of the simulator on this machine: medians of repeated runs, printed and written as one flat JSON
// object (bench.json beside the program). Compare only within one run: shared machines are noisy.
#include "bench.h"

#include "base/files.h"
#include "base/parallel.h"
#include "sensors/raster_batch.h"

namespace mirage {
namespace {

/// Collects medians (milliseconds) by name, besides the console's table.
class Collector : public benchmark::ConsoleReporter {
 public:
  void ReportRuns(const std::vector<Run>& runs) override {
    ConsoleReporter::ReportRuns(runs);
    for (const Run& run : runs)
      if (run.run_type == Run::RT_Aggregate && run.aggregate_name == "median")
        figures()[run.run_name.function_name] = run.GetAdjustedRealTime();
  }
};

}  // namespace

nlohmann::json& figures() {
  static nlohmann::json figures = nlohmann::json::object();
  return figures;
}

}  // namespace mirage

int main(int argc, char** argv) {
  using namespace mirage;
  set_thread_count(1);
  benchmark::Initialize(&argc, argv);
  std::printf("instruction set: %s\n", raster_instruction_set());
  Collector collector;
  benchmark::RunSpecifiedBenchmarks(&collector);
  const auto file = executable_folder() / "bench.json";
  write_json(file, figures());
  std::printf("%s\n%s\n", figures().dump(1).c_str(), file.c_str());
  return 0;
}
