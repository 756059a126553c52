// Detectors: a pass forward, forward and backward, and a training step, split by what the interface lets us
// vary: with and without the picture's branch (fusion against lidar), with and without points, one sample
// against two. Fresh weights, frames made here, one thread.
#include <fmt/format.h>

#include <array>
#include <filesystem>
#include <map>
#include <memory>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "base/sizes.h"
#include "bench.h"
#include "detection/car_in_picture.h"
#include "detection/process_detector.h"
#include "detection/training.h"
#include "generator/dataset.h"
#include "generator/generator.h"

namespace mirage {
namespace {

constexpr int kPassFrames = 2, kPassRounds = 7;
constexpr const char* kPassing[] = {"lidar", "fusion"};

struct Input {
  Frame frame;
  std::vector<LidarPoint> points;
  SensorView view() const { return view_of(frame, frame.image, points); }
};

std::vector<Input> inputs_of(const Rig& rig) {
  std::vector<Input> inputs(kPassFrames);
  for (std::size_t i = 0; i < kPassFrames; ++i) {
    inputs[i].frame = generate_frame(rig, 21, static_cast<std::uint64_t>(i));
    inputs[i].points = points_in_view(inputs[i].frame.sweep, inputs[i].frame.calibration);
  }
  return inputs;
}

std::unique_ptr<Detector> fresh(const std::string& name) {
  DetectorOptions options;
  options.detector = name;
  options.fresh = true;
  options.threads = 1;
  return load_detector(options);
}

void detector_passes(benchmark::State& state, const std::string& rig_name) {
  const std::string suffix = rig_name == "kitti64" ? "" : "_" + rig_name;
  std::map<std::string, std::unique_ptr<Detector>> detectors;
  std::vector<Input> inputs;
  try {
    for (const char* name : kPassing) detectors[name] = fresh(name);
    inputs = inputs_of(read_rig(shipped_file("scenes/rigs/" + rig_name + ".toml")));
  } catch (const InputError& error) {
    state.SkipWithError(error.what());
    return;
  }
  Rounds rounds;
  const auto pass = [&](Detector& detector, const SensorView& view, bool back) {
    // Threshold −1: every proposal, so that the same gradient arrives everywhere.
    const auto proposals = detector.forward(view, -1, back);
    if (back) benchmark::DoNotOptimize(detector.backward(std::vector<double>(proposals.size(), 1)));
  };
  for (auto _ : state)
    for (int round = -1; round < kPassRounds; ++round) {  // the first warms up
      Rounds warm;
      Rounds& into = round < 0 ? warm : rounds;
      const Input& input = inputs[as_size(round + 1) % inputs.size()];
      SensorView blind = input.view();
      blind.points = {};
      for (const char* name : kPassing) {
        Detector& detector = *detectors[name];
        into.time(std::string("forward ") + name, [&] { pass(detector, input.view(), false); });
        into.time(std::string("both ") + name, [&] { pass(detector, input.view(), true); });
        into.time(std::string("no points ") + name, [&] { pass(detector, blind, false); });
      }
    }
  auto& all = figures();
  for (const std::string name : kPassing) {
    all["detector_forward_ms_" + name + suffix] = rounds["forward " + name];
    all["detector_forward_backward_ms_" + name + suffix] = rounds["both " + name];
    all["detector_backward_ms_" + name + suffix] = rounds.difference("both " + name, "forward " + name);
  }
  // The lidar network without points is the bird's-eye network and its head alone.
  all["detector_forward_bev_head_ms" + suffix] = rounds["no points lidar"];
  all["detector_forward_points_ms" + suffix] = rounds.difference("forward lidar", "no points lidar");
  all["detector_forward_image_and_fusion_ms" + suffix] = rounds.difference("forward fusion", "forward lidar");
  all["detector_forward_fusion_of_points_ms" + suffix] =
      rounds.difference("forward fusion", "no points fusion") -
      rounds.difference("forward lidar", "no points lidar");
}

ONCE(BENCHMARK_CAPTURE(detector_passes, kitti64, "kitti64"));
ONCE(BENCHMARK_CAPTURE(detector_passes, xenith, "xenith"));

void detector_training(benchmark::State& state) {
  const auto folder = std::filesystem::temp_directory_path() / "mirage-bench-detector";
  std::map<std::string, std::unique_ptr<Detector>> detectors;
  try {
    for (const char* name : kPassing) detectors[name] = fresh(name);
  } catch (const InputError& error) {
    state.SkipWithError(error.what());
    return;
  }
  generate_dataset(
      read_rig(shipped_file("scenes/rigs/kitti64.toml")), 22, 0, kPassFrames, folder, [](std::size_t) {},
      Truth::all);
  const auto region = detectors["fusion"]->region();
  TrainingData plain(folder, 0, region, 1), pasting(folder, 0, region, 1, 2);
  Rounds rounds;
  for (auto _ : state)
    for (int round = -1; round < kPassRounds; ++round) {
      Rounds warm;  // the first round reads the files
      Rounds& into = round < 0 ? warm : rounds;
      std::vector<PreparedSample> samples;
      into.time("data", [&] { samples = plain.prepare(round + 1, 2); });
      into.time("data pasting", [&] { benchmark::DoNotOptimize(pasting.prepare(round + 1, 2)); });
      const std::array<TrainingSample, 2> views = {samples[0].view(), samples[1].view()};
      for (const char* name : kPassing) {
        Detector& detector = *detectors[name];
        into.time(std::string("two ") + name, [&] { detector.train_step(views, 1e-3); });
        into.time(std::string("one ") + name, [&] { detector.train_step({views.data(), 1}, 1e-3); });
        into.time(std::string("other ") + name, [&] { detector.train_step({views.data() + 1, 1}, 1e-3); });
      }
    }
  std::filesystem::remove_all(folder);
  auto& all = figures();
  for (const std::string name : kPassing) {
    all["training_step_ms_" + name] = rounds["two " + name];
    // Two steps of one sample hold one optimiser step more than one step of both.
    const double optimiser = rounds["one " + name] + rounds["other " + name] - rounds["two " + name];
    all["training_optimiser_ms_" + name] = optimiser;
    all["training_sample_ms_" + name] = (rounds["two " + name] - optimiser) / 2;
  }
  all["training_steps_per_s"] = 1000 / rounds["two fusion"];
  all["training_image_and_fusion_ms"] = rounds.difference("two fusion", "two lidar");
  all["training_data_ms"] = rounds["data"];  // read ahead on another thread
  all["training_ground_truth_sampling_ms"] = rounds.difference("data pasting", "data");
}
ONCE(BENCHMARK(detector_training));

// A detector in its own process: the cost of the round trip for a frame of KITTI's size, with a toy at the
// other end that takes no time. Linear and 8-bit pictures, with and without gradients.

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
  Rounds rounds;
  try {
    const auto detector = start_program(options);
    const auto pass = [&](bool back) {
      const auto found = detector->forward(view, 0.1, back);
      if (back) detector->backward(std::vector<double>(found.size(), 1));
    };
    for (auto _ : state)
      for (int round = 0; round < kTrips; ++round) {
        rounds.time("process_" + pictures + "_ms", [&] { pass(false); });
        rounds.time("process_" + pictures + "_gradient_ms", [&] { pass(true); });
      }
  } catch (const InputError& error) {
    state.SkipWithError(error.what());
    return;
  }
  rounds.record();
}
ONCE(BENCHMARK_CAPTURE(process, linear, "linear"));
ONCE(BENCHMARK_CAPTURE(process, srgb8, "srgb8"));

}  // namespace
}  // namespace mirage
