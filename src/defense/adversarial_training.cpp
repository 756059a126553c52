#include "defense/adversarial_training.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "attack/attack_step.h"
#include "base/checkpoint_timer.h"
#include "base/clock.h"
#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/progress.h"
#include "base/schedule.h"
#include "base/training_state.h"
#include "detection/training_data.h"
#include "exchange/gltf.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kLogEvery = 10;  // steps

void check_settings(const DefenseSettings& settings) {
  const auto demand = [](bool good, const char* option, double value, const char* fix) {
    if (!good) throw InputError(option, fmt::format("{}", value), "out of range", fix);
  };
  const auto positive = [](double value) { return std::isfinite(value) && value > 0; };
  if (settings.detector.detector == "lidar" && !settings.detector.parts.empty())
    throw InputError("--method", settings.detector.parts.front(),
                     "is of the image branch, and lidar has none", "use adversarial, or --detector fusion");
  check_fields(static_cast<const FrameSource&>(settings));
  demand(settings.steps >= 1, "--steps", static_cast<double>(settings.steps), "use 1 or more");
  demand(settings.batch >= 1, "--batch", settings.batch, "use 1 or more");
  demand(settings.adversary_updates >= 0, "--adversary-updates", settings.adversary_updates, "use 0 or more");
  demand(settings.adversary_batch >= 1, "--adversary-batch", settings.adversary_batch, "use 1 or more");
  demand(settings.attacked >= 0 && settings.attacked <= 1, "--attacked", settings.attacked,
         "use a share in [0, 1]");
  demand(positive(settings.learning_rate), "--learning-rate", settings.learning_rate,
         "use a positive number");
  demand(positive(settings.vertex_rate), "--vertex-rate", settings.vertex_rate, "use a positive number");
  demand(positive(settings.texel_rate), "--texel-rate", settings.texel_rate, "use a positive number");
}

/// The adversary's side of the training as an attack's settings.
AttackSettings attack_settings(const DefenseSettings& settings) {
  AttackSettings attack;
  static_cast<FrameSource&>(attack) = settings;
  attack.detector = settings.detector;
  attack.batch = settings.adversary_batch;
  attack.seed = settings.seed;
  attack.vertex_rate = settings.vertex_rate;
  attack.texel_rate = settings.texel_rate;
  attack.quiet = settings.quiet;
  return attack;
}

/// What must agree for a run to go on. "limits", "vertex_rate" and "texel_rate" are read by read_checkpoint.
nlohmann::json identity(const DefenseSettings& settings, const AttackSettings& attack, std::size_t hosts) {
  return {{"data", escape_name(fs::absolute(settings.data).lexically_normal().string())},
          {"detector", settings.detector.detector},
          {"start", content_hash(read_file(weights_file(settings.detector)))},
          {"network_parts", settings.detector.parts},
          {"depth", settings.depth},
          {"rooftop", settings.rooftop},
          {"sun", settings.sun},
          {"lidar_gradient", to_word(attack.simulation.lidar_gradient)},
          {"steps", settings.steps},
          {"batch", settings.batch},
          {"attacked", settings.attacked},
          {"adversary_updates", settings.adversary_updates},
          {"adversary_batch", settings.adversary_batch},
          {"learning_rate", settings.learning_rate},
          {"vertex_rate", attack.vertex_rate},
          {"texel_rate", attack.texel_rate},
          {"limits", {attack.limits.half.x(), attack.limits.half.y(), attack.limits.half.z()}},
          {"hosts", hosts},
          {"seed", settings.seed}};
}

/// The trained detector and instances on the same weights that compute the adversary's gradients beside it.
DetectorPool shared_pool(const DetectorOptions& options, int most) {
  DetectorPool pool;
  pool.push_back(load_detector(options));
  add_shared(pool, most);  // where it cannot, one thread does: a copy would not learn
  return pool;
}

fs::path adversary_file(const fs::path& out, std::int64_t step) {
  return out / fmt::format("adversary-{}.json", step);
}

/// Training on one set of hosts.
class DefenseTraining {
 public:
  DefenseTraining(const DefenseSettings& settings, const std::array<double, 4>& region)
      : settings_(settings), attack_(attack_settings(settings)), region_(region), store_(attack_) {
    std::vector<std::string> frames = list_frames(settings.data);
    if (settings.frames > 0 && frames.size() > settings.frames) frames.resize(settings.frames);
    hosts_ = find_all_hosts(store_, frames, region, attack_.simulation, attack_.min_view);
    if (hosts_.empty())
      throw InputError(settings.data.string(), "label_2", "no car has enough of its roof in view",
                       "give more frames");
    order_.emplace(hosts_, settings.batch, settings.seed + 1);
    spdlog::info("{} host vehicles to train on", hosts_.size());
  }

  std::size_t hosts() const { return hosts_.size(); }
  const AttackSettings& attack() const { return attack_; }
  FrameStore& store() { return store_; }
  const std::vector<Host>& host_list() const { return hosts_; }

  /// The samples of a step: those that carry the adversary first. They depend on (seed, step) and the mesh.
  std::vector<PreparedSample> samples(std::int64_t step, const TexturedMesh& adversary) {
    const auto batch = order_->batch(step);
    const auto attacked = settings_.adversary_updates > 0
                              ? static_cast<std::size_t>(std::lround(settings_.attacked * settings_.batch))
                              : 0;
    std::vector<PreparedSample> result(batch.size());
    parallel_for(batch.size(), [&](std::size_t i) {
      const Host& host = hosts_[batch[i]];
      const auto prepared = store_.get(host.id.frame);
      Frame frame = prepared->frame;
      if (i < attacked) {
        const Simulated simulated = simulate(*prepared, label_of(prepared->frame, host.id), host.rooftop,
                                             adversary, attack_.simulation);
        frame.image = simulated.image;
        frame.sweep = simulated.sweep;
      }
      const auto index = static_cast<std::uint64_t>(step) * batch.size() + i;
      result[i] = prepared_sample(compact(frame, region_), random_pose(settings_.seed, index), region_);
    });
    return result;
  }

 private:
  const DefenseSettings& settings_;
  AttackSettings attack_;
  std::array<double, 4> region_;
  FrameStore store_;
  std::vector<Host> hosts_;
  std::optional<HostOrder> order_;  ///< known once the hosts are
};

}  // namespace

DefenseResult train_defended(const DefenseSettings& settings) {
  check_settings(settings);
  make_output_folder(settings.out);
  DetectorOptions load = settings.detector;
  load.start = true;
  load.threads = settings.threads;
  load.weights = weights_file(settings.detector);
  auto pool = shared_pool(load, settings.adversary_batch);
  DefenseTraining training(settings, pool.front()->region());
  const nlohmann::json wanted = identity(settings, training.attack(), training.hosts());
  TrainingState state = read_training_state(settings.out, wanted);
  AttackState adversary = fresh_state(training.attack());
  DefenseResult result;
  const auto score = [&](const char* when) {
    const DetectionRun run = detect_data_set(*pool.front(), settings.validation, settings.validation_frames);
    spdlog::info("{}: clean AP50 {:.3f} AP70 {:.3f}", when, run.at50.average_precision,
                 run.at70.average_precision);
    return run;
  };
  if (!settings.validation.empty()) {
    const DetectionRun before = score("before");
    result.at50_before = before.at50;
    result.at70_before = before.at70;
  }
  if (!state.weights.empty()) {
    load.start = false;
    load.weights = state.weights;
    load.parts.clear();
    pool = shared_pool(load, settings.adversary_batch);
    adversary = read_checkpoint(adversary_file(settings.out, state.step), wanted);
    spdlog::info("going on from step {} of {}", state.step, settings.steps);
  }

  const auto checkpoint = [&] {
    const std::int64_t earlier = state.weights.empty() ? -1 : read_training_state(settings.out, wanted).step;
    write_checkpoint(adversary_file(settings.out, state.step), adversary, wanted);
    write_training_state(settings.out, wanted, state,
                         [&](const fs::path& file) { pool.front()->save(file, true); });
    std::error_code ignored;
    if (earlier >= 0 && earlier != state.step) fs::remove(adversary_file(settings.out, earlier), ignored);
  };
  const AttackStepper stepper(training.attack(), pool, training.store(), training.host_list(),
                              adversary.adversary.mesh);
  TrainingLog log(settings.out, state.step);
  const double seconds_before = state.seconds;
  const std::int64_t first = state.step;
  const auto start = Clock::now();
  CheckpointTimer timer({settings.checkpoint_every, settings.checkpoint_seconds});
  LossRow row;
  {
    Progress progress("defend", static_cast<std::size_t>(settings.steps), settings.quiet);
    while (state.step < settings.steps) {
      for (int k = 0; k < settings.adversary_updates; ++k) row = stepper.step(adversary);
      const auto samples = training.samples(state.step, adversary.adversary);
      std::vector<TrainingSample> views;
      for (const PreparedSample& sample : samples) views.push_back(sample.view());
      const double rate = one_cycle(settings.learning_rate,
                                    static_cast<double>(state.step) / static_cast<double>(settings.steps));
      const TrainingLoss loss = pool.front()->train_step(views, rate);
      follow_losses(state, {loss.total, loss.score, loss.box}, 0.05);
      ++state.step;
      state.seconds = seconds_before + seconds_since(start);
      progress.update(static_cast<std::size_t>(state.step),
                      fmt::format("model {:.3f}, adversary {:.3f} (hide {:.3f}, false positives {:.3f})",
                                  state.losses[0], row.loss(), row.hide, row.false_positive));
      if (state.step % kLogEvery == 0)
        log.add({{"step", state.step},
                 {"seconds", state.seconds},
                 {"rate", rate},
                 {"loss", state.losses[0]},
                 {"score_loss", state.losses[1]},
                 {"box_loss", state.losses[2]},
                 {"hide", row.hide},
                 {"false_positive", row.false_positive}});
      const bool stop = settings.stop();
      if (const bool due = timer.due(state.step); stop || due) checkpoint();
      if (stop) throw Interrupted("interrupted; the checkpoint is kept, the same command goes on from it");
    }
  }
  checkpoint();
  result.steps = state.step;
  result.hosts = static_cast<int>(training.hosts());
  result.seconds_per_step =
      state.step > first ? seconds_since(start) / static_cast<double>(state.step - first) : 0;
  result.loss = {state.losses[0], state.losses[1], state.losses[2]};
  if (!adversary.losses.empty()) result.adversary_loss = adversary.losses.back().loss();
  result.weights = settings.out / (settings.detector.detector + ".weights");
  pool.front()->save(result.weights, false);
  write_adversary(settings.out / "adversary.glb", adversary.adversary);
  if (!settings.validation.empty()) {
    const DetectionRun after = score("after");
    result.validated = true;
    result.at50 = after.at50;
    result.at70 = after.at70;
  }
  return result;
}

}  // namespace mirage
