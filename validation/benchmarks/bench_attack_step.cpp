// One host's attack step (simulation, detector, objective, and back) over whole frames and over what the
// object changes, in bfloat16 and truncated, in alternation, and how far their gradients lie apart. Shipped
// weights, KITTI's rig, CPU time of one thread.
#include <algorithm>
#include <cmath>
#include <utility>

#include "attack/attack_step.h"
#include "attack/evaluation.h"
#include "attack/observation.h"
#include "base/error.h"
#include "base/files.h"
#include "base/sizes.h"
#include "bench.h"
#include "detection/car_in_picture.h"
#include "detection/detector_settings.h"
#include "generator/generator.h"

namespace mirage {
namespace {

constexpr int kStepFrames = 2, kHosts = 3, kStepRounds = 3;  // hosts of each frame
constexpr std::size_t kInDouble = 4;                         // hosts whose gradients are compared in double
constexpr double kLocalities[] = {1, 2, 4, 8};               // m
constexpr const char* kAttacked[] = {"lidar", "camera", "painted", "fusion", "late", "refined"};

struct Street {
  std::vector<std::unique_ptr<PreparedFrame>> frames;
  std::vector<StepHost> stands;

  Street() {
    const Rig rig = read_rig(shipped_file("scenes/rigs/kitti64.toml"));
    for (std::uint64_t seed = 0; frames.size() < kStepFrames; ++seed) {
      Frame frame = generate_frame(rig, 23, seed);
      frame.id = std::to_string(seed);
      frame.sweep = points_in_view(frame.sweep, frame.calibration);
      std::vector<int> cars;
      for (std::size_t i = 0; i < frame.labels.size(); ++i) {
        const Label& label = frame.labels[i];
        if (label.type == "Car" && label.occluded == 0 && label.truncated == 0 && label.box.bev.x > 5 &&
            label.box.bev.x < 50)
          cars.push_back(static_cast<int>(i));
      }
      if (cars.size() < kHosts) continue;
      frames.push_back(std::make_unique<PreparedFrame>(prepare(std::move(frame), rig.lidar)));
      for (std::size_t k = 0; k < kHosts; ++k) {
        const Label& label = frames.back()->frame.labels[as_size(cars[k])];
        stands.push_back({*frames.back(),
                          {frames.back()->frame.id, cars[k]},
                          on_roof(BoxRoofFinder().find(frames.back()->frame, label))});
      }
    }
  }
};

/// Vertices, then texels.
Eigen::VectorXd flat(const AdversaryGradient& gradient) {
  Eigen::VectorXd all(3 * static_cast<Eigen::Index>(gradient.vertices.size() + gradient.texels.size()));
  Eigen::Index at = 0;
  for (const auto* list : {&gradient.vertices, &gradient.texels})
    for (const Vec3d& v : *list) all.segment<3>(std::exchange(at, at + 3)) = v;
  return all;
}

/// Norm of a − b over the norm of b.
double difference(const AdversaryGradient& a, const AdversaryGradient& b) {
  const Eigen::VectorXd reference = flat(b);
  const double apart = (flat(a) - reference).norm(), norm = reference.norm();
  return norm > 0 ? apart / norm : apart;
}

double cosine(const AdversaryGradient& a, const AdversaryGradient& b) {
  const Eigen::VectorXd x = flat(a), y = flat(b);
  return x.dot(y) / std::sqrt(std::max(x.squaredNorm() * y.squaredNorm(), 1e-300));
}

std::unique_ptr<Detector> variant_of(const std::string& name, int clean_memory_mb, const char* precision,
                                     double locality = 0) {
  DetectorOptions options;
  options.detector = name;
  options.threads = 1;
  options.clean_memory_mb = clean_memory_mb;
  options.precision = precision;
  options.locality = locality;
  return load_detector(options);
}

/// Another way to the same gradient, or nearly the same.
struct Variant {
  std::string word;  // of its figures
  std::unique_ptr<Detector> detector;
};

void attack_steps(benchmark::State& state, const std::string& name) {
  static const Street street;
  std::unique_ptr<Detector> whole, local;
  try {
    local = variant_of(name, 2048, "float");
    whole = variant_of(name, 0, "float");
  } catch (const InputError& error) {
    state.SkipWithError(error.what());
    return;
  }
  std::vector<Variant> variants;
  if (multiplies_bfloat16()) {
    variants.push_back({"full_bfloat16", variant_of(name, 0, "bfloat16")});
    variants.push_back({"bfloat16", variant_of(name, 2048, "bfloat16")});
  }
  for (const double metres : kLocalities)
    variants.push_back(
        {"locality_" + std::to_string(static_cast<int>(metres)), variant_of(name, 2048, "float", metres)});
  const TexturedMesh adversary = random_adversary(1);
  AttackSettings settings;
  Rounds rounds;
  double error = 0, float_error = 0, simulation = 0, all = 0;
  const auto step = [&](Detector& detector, const StepHost& stand) {
    return attack_host(detector, stand, adversary, settings);
  };
  for (auto _ : state) {
    step(*whole, street.stands[0]);  // warms up
    for (const Variant& variant : variants)
      for (const StepHost& stand : street.stands)
        step(*variant.detector, stand);  // and keeps the clean frames
    for (int round = 0; round < kStepRounds; ++round)
      for (std::size_t k = 0; k < street.stands.size(); ++k) {
        const StepHost& stand = street.stands[k];
        HostStep full, changed;
        rounds.cpu("full", [&] { full = step(*whole, stand); });
        rounds.cpu(round == 0 && k % kHosts == 0 ? "new frame" : "local",
                   [&] { changed = step(*local, stand); });
        float_error = std::max(float_error, difference(changed.gradient, full.gradient));
        for (const Variant& variant : variants) {
          HostStep other;
          rounds.cpu(variant.word, [&] { other = step(*variant.detector, stand); });
          rounds.add("cosine " + variant.word, cosine(other.gradient, changed.gradient));
          rounds.add("error " + variant.word, difference(other.gradient, changed.gradient));
        }
        const HostTimings& s = changed.seconds;
        if (round > 0) {
          simulation += s.simulation_forward + s.simulation_vjp;
          all += s.simulation_forward + s.simulation_vjp + s.detector_forward + s.detector_backward + s.rest;
        }
        // As in an evaluation: forward alone.
        const Simulated simulated = simulate(stand.prepared, stand.placement, adversary, settings.simulation);
        SensorView view = view_of(stand.prepared, simulated, whole->capabilities());
        rounds.cpu("full evaluation", [&] { detections(*whole, view, {}); });
        rounds.cpu("local evaluation", [&] {
          const UnchangedInput clean = unchanged_input(stand.prepared, simulated.rect);
          view.clean = &clean;
          detections(*local, view, {});
        });
      }
    {
      const auto whole64 = variant_of(name, 0, "double"), local64 = variant_of(name, 2048, "double");
      for (std::size_t k = 0; k < std::min(kInDouble, street.stands.size()); ++k)
        error = std::max(error, difference(step(*local64, street.stands[k]).gradient,
                                           step(*whole64, street.stands[k]).gradient));
    }
  }
  auto& all_figures = figures();
  all_figures["attack_step_ms_" + name + "_full"] = rounds["full"];
  all_figures["attack_step_ms_" + name] = rounds["local"];
  all_figures["attack_step_ms_" + name + "_new_frame"] = rounds["new frame"];
  all_figures["attack_step_speedup_" + name] = rounds["full"] / rounds["local"];
  all_figures["attack_step_gradient_error_" + name] = error;
  all_figures["attack_step_gradient_error_" + name + "_float"] = float_error;
  for (const Variant& variant : variants) {
    const std::string of = name + "_" + variant.word;
    all_figures["attack_step_ms_" + of] = rounds[variant.word];
    all_figures["attack_step_gradient_cosine_" + of] = rounds["cosine " + variant.word];
    all_figures["attack_step_gradient_cosine_least_" + of] = rounds.least("cosine " + variant.word);
    all_figures["attack_step_gradient_error_" + of] = rounds["error " + variant.word];
    if (variant.word == "bfloat16")
      all_figures["attack_step_bfloat16_speedup_" + name] = rounds["local"] / rounds[variant.word];
  }
  all_figures["attack_step_share_simulation_" + name] = simulation / all;
  all_figures["evaluation_forward_ms_" + name + "_full"] = rounds["full evaluation"];
  all_figures["evaluation_forward_ms_" + name] = rounds["local evaluation"];
  if (name == "fusion") all_figures["attack_step_share_simulation"] = simulation / all;
}

const auto* const kAttackSteps = [] {
  benchmark::internal::Benchmark* last = nullptr;
  for (const char* name : kAttacked)
    last = ONCE(benchmark::RegisterBenchmark((std::string("attack_step_") + name).c_str(), attack_steps,
                                             std::string(name)));
  return last;
}();

}  // namespace
}  // namespace mirage
