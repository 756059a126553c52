#include "defense/adversarial_training.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "attack/attack_step.h"
#include "attack/baseline.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/random.h"
#include "base/sizes.h"
#include "base/training_loop.h"
#include "detection/detect.h"
#include "detection/detector_settings.h"
#include "exchange/gltf.h"
#include "frames/frame_cache.h"
#include "frames/frame_provenance.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// The adversary's part of the training as attack settings.
AttackSettings attack_settings(const DefenseSettings& settings) {
  AttackSettings attack;
  attack.buildable.on = false;  // a mesh that need not be buildable is the stronger opponent
  static_cast<FrameSource&>(attack) = settings;
  attack.detector = settings.detector;
  attack.batch = settings.adversary_batch;
  attack.seed = settings.seed;
  attack.vertex_rate = settings.vertex_rate;
  attack.texel_rate = settings.texel_rate;
  attack.quiet = settings.quiet;
  fit_limits(attack);
  return attack;
}

/// The identity that a resumed run must match.
RunIdentity identity(const DefenseSettings& settings, const AttackSettings& attack, std::size_t hosts) {
  nlohmann::json json = fields_json(settings);
  json["start"] = file_hash(weights_file(settings.detector));
  json["network_parts"] = settings.detector.parts;
  if (is_plugin_path(settings.detector.detector))
    json["plugin_hash"] = file_hash(plugin_file(settings.detector));
  json["lidar_gradient"] = to_word(attack.simulation.lidar_gradient);
  json["objective"] = fields_json(attack.objective);
  json["limits"] = {attack.limits.half.x(), attack.limits.half.y(), attack.limits.half.z()};
  json["hosts"] = hosts;
  json["frames_hash"] =
      frames_hash(settings.data, list_frames(settings.data, settings.frames), settings.cameras);
  json["lidar"] = lidar_identity(lidar_of(settings.data, settings.rig));
  if (content_of(settings.placement).is_object()) json["placed"] = to_json(settings.placement);
  nlohmann::json lacking = lacking_json<DefenseSettings>();
  ObjectiveSettings earlier;
  earlier.fp_top_k = 0;
  lacking["objective"] = fields_json(earlier);
  for (const char* key : {"frames_hash", "lidar", "plugin_hash"})
    if (json.contains(key)) lacking[key] = json[key];  // missing in earlier runs
  return {json, lacking};
}

/// The trained detector, and instances that share its weights and compute the adversary's gradients.
DetectorPool shared_pool(const DetectorOptions& options, int most) {
  DetectorPool pool;
  pool.push_back(load_detector(options));
  add_shared(pool, most);  // if it cannot share, one thread works: a copy would not learn
  return pool;
}

fs::path adversary_file(const fs::path& out, std::int64_t step) {
  return out / fmt::format("adversary-{}.json", step);
}

/// Samples of a batch that carry a mesh.
std::size_t attacked_samples(const DefenseSettings& settings) {
  const bool attacks = settings.carried == Carried::random || settings.adversary_updates > 0;
  return attacks ? as_size(std::lround(settings.attacked * settings.batch)) : 0;
}

/// FieldError if the attacked share rounds to none or all of the batch.
void check_attacked(const DefenseSettings& settings) {
  if (settings.carried == Carried::adversary && settings.adversary_updates == 0) return;
  const std::size_t count = attacked_samples(settings);
  const bool none = settings.attacked > 0 && count == 0,
             all = settings.attacked < 1 && count == as_size(settings.batch);
  if (none || all)
    throw FieldError("attacked", fmt::format("{:g}", settings.attacked),
                     fmt::format("rounds to {} of a batch of {}", none ? "none" : "all", settings.batch),
                     fmt::format("use a larger --batch, or --attacked {}", none ? 0 : 1));
}

/// FieldError for a detector that finds boxes in the picture alone, and for methods that need the picture
/// with a detector that does not read it.
void check_parts(const DefenseSettings& settings, const Detector& detector) {
  if (!detector.capabilities().finds_bev)
    throw FieldError("detector", detector.name(),
                     "finds boxes in the picture alone, and cannot learn a defence", "use fusion or lidar");
  const auto& parts = settings.detector.parts;
  if ((!parts.empty() || settings.left_out > 0) && !detector.capabilities().reads_image)
    throw FieldError("method", parts.empty() ? "left out picture" : parts.front(),
                     "needs a detector that sees the picture, and " + detector.name() + " does not",
                     "use adversarial, or --detector fusion");
}

/// Training on one set of hosts.
class DefenseTraining {
 public:
  DefenseTraining(const DefenseSettings& settings, const std::array<double, 4>& region)
      : settings_(settings), attack_(attack_settings(settings)), region_(region), store_(attack_) {
    const std::vector<std::string> frames = list_frames(settings.data, settings.frames);
    check_labels(settings.data, frames, "adversarial training");
    SkippedHosts left_out;
    hosts_ = find_all_hosts(store_, frames, region, attack_.simulation, attack_.min_view, true, &left_out);
    warn_of_left_out(store_.place(), left_out);
    if (hosts_.empty())
      throw InputError(settings.data.string(), "labels", "no car has enough of its roof in view",
                       "give more frames");
    order_.emplace(hosts_, settings.batch, settings.seed + 1);
    spdlog::info("{} host vehicles for training", hosts_.size());
  }

  const std::vector<Host>& hosts() const { return hosts_; }
  const AttackSettings& attack() const { return attack_; }
  FrameStore& store() { return store_; }

  /// The samples of a step, attacked ones first. They depend on (seed, step) and the mesh alone.
  std::vector<PreparedSample> samples(std::int64_t step, const TexturedMesh& adversary) {
    const auto batch = order_->batch(step);
    const bool random = settings_.carried == Carried::random;
    const std::size_t attacked = attacked_samples(settings_);
    std::vector<PreparedSample> result(batch.size());
    parallel_for(batch.size(), [&](std::size_t i) {
      const Host& host = hosts_[batch[i]];
      const auto prepared = store_.get(host.id.frame);
      const auto index = static_cast<std::uint64_t>(step) * batch.size() + i;
      Frame frame = prepared->frame;
      if (i < attacked) {
        const Simulated simulated = simulate(
            *prepared, store_.placement(host.id),
            random ? random_load(settings_.seed, index, attack_.limits) : adversary, attack_.simulation);
        frame.image = simulated.image;
        frame.sweep = simulated.sweep;
      }
      result[i] = prepared_sample(compact(frame, region_), random_pose(settings_.seed, index), region_);
      if (RandomStream(settings_.seed, "picture left out", index).uniform() < settings_.left_out)
        result[i].image = {};
    });
    return result;
  }

 private:
  const DefenseSettings& settings_;
  AttackSettings attack_;
  std::array<double, 4> region_;
  FrameStore store_;
  std::vector<Host> hosts_;
  std::optional<HostOrder> order_;  ///< set once the hosts are known
};

struct Method {
  const char* word;
  std::vector<std::string> parts;  ///< added to the network
  void (*set)(DefenseSettings&);
};

const std::vector<Method>& methods() {
  static const auto adversarial = [](DefenseSettings&) {};
  static const auto clean = [](DefenseSettings& settings) { settings.adversary_updates = 0; };
  static const std::vector<Method> all = {
      {"adversarial", {}, adversarial},
      {"denoising", {"denoising"}, adversarial},
      {"depth-gate", {"depth-gate"}, clean},
      {"roof-objects", {}, [](DefenseSettings& settings) { settings.carried = Carried::random; }},
      {kCeiling,
       {},
       [](DefenseSettings& settings) {
         settings.carried = Carried::random;
         settings.detector.defense = kTrainedCeiling;
       }},
      {"picture-dropout", {}, [](DefenseSettings& settings) {
         settings.adversary_updates = 0;
         settings.left_out = 0.5;
       }}};
  return all;
}

}  // namespace

const std::vector<std::string>& defense_methods() {
  static const std::vector<std::string> words = [] {
    std::vector<std::string> all;
    for (const Method& method : methods()) all.emplace_back(method.word);
    return all;
  }();
  return words;
}

void set_method(const std::string& word, DefenseSettings& settings) {
  const auto match = std::ranges::find(methods(), word, &Method::word);
  if (match == methods().end())
    throw FieldError(
        "method", word, "unknown",
        use_one_of(word, defense_methods()) +
            " (jpeg:QUALITY, ceiling:HEIGHT, consistency and shadows need no training: --defense)");
  settings.detector.parts = match->parts;
  match->set(settings);
}

std::vector<std::string> unused_fields(const std::string& method) {
  DefenseSettings settings;
  set_method(method, settings);
  const bool random = settings.carried == Carried::random;
  std::vector<std::string> unused;
  if (!random && settings.adversary_updates > 0) return unused;
  unused = {"adversary_updates", "adversary_batch", "vertex_rate", "texel_rate"};
  if (!random) unused.emplace_back("attacked");
  return unused;
}

TexturedMesh random_load(std::uint64_t seed, std::uint64_t index, const AdversaryLimits& limits) {
  RandomStream random(seed, "things on roofs", index);
  TexturedMesh mesh = random_adversary(random.next_u32(), limits);
  Vec3d half;
  for (int axis = 0; axis < 3; ++axis) half[axis] = random.uniform(0.5, 1) * limits.half[axis];
  fit_bounds(mesh.mesh, Eigen::AlignedBox3d(-half, half));
  const std::uint32_t paint = random.next_u32();
  paint_patches(mesh, 1 + random.below(40), paint);
  return mesh;
}

DefenseResult train_defended(const DefenseSettings& settings) {
  check_fields(settings);
  check_attacked(settings);
  if (needs_no_weights(settings.detector.detector))
    throw FieldError("detector", settings.detector.detector, "learned nothing, and cannot learn a defence",
                     "use one that has weights, such as fusion");
  DetectorOptions load = settings.detector;
  load.start = true;
  load.threads = settings.threads;
  load.weights = weights_file(settings.detector);
  auto pool = shared_pool(load, settings.adversary_batch);
  check_parts(settings, *pool.front());
  make_output_folder(settings.out);
  DefenseTraining training(settings, pool.front()->region());
  const RunIdentity run_identity = identity(settings, training.attack(), training.hosts().size());
  TrainingLoop loop(settings, run_identity);
  AttackState adversary = fresh_state(training.attack());
  DefenseResult result;
  const auto score = [&](const char* when) {
    Detector* const judge = pool.front().get();
    const DetectionRun run = detect_data_set({&judge, 1}, settings.validation, settings.validation_frames);
    spdlog::info("{}: clean AP 0.5 {:.1f} %, AP 0.7 {:.1f} %", when, 100 * run.at50.average_precision,
                 100 * run.at70.average_precision);
    return run;
  };
  if (!settings.validation.empty()) {
    const DetectionRun before = score("before");
    result.at50_before = before.at50;
    result.at70_before = before.at70;
  }
  if (loop.goes_on()) {
    load.start = false;
    load.weights = loop.state().weights;
    load.parts.clear();
    pool = shared_pool(load, settings.adversary_batch);
    adversary =
        read_checkpoint(adversary_file(settings.out, loop.state().step), run_identity, training.attack());
  }

  const AttackStepper stepper(training.attack(), pool, training.store(), training.hosts(),
                              adversary.adversary.mesh);
  const auto& losses = loop.state().losses;  // total, score, box
  LossRow row;
  TrainingWork work;
  work.name = "defend";
  work.follow = 0.05;
  work.report_every = 10;
  work.learn = [&](std::int64_t step, double rate) {
    if (settings.carried == Carried::adversary)
      for (int k = 0; k < settings.adversary_updates; ++k) row = stepper.step(adversary);
    const auto samples = training.samples(step, adversary.adversary);
    const TrainingLoss loss = pool.front()->train_step(views_of(samples), rate);
    return std::array{loss.total, loss.score, loss.box};
  };
  work.save = [&](const fs::path& file) {
    write_checkpoint(adversary_file(settings.out, loop.state().step), adversary, run_identity.json);
    pool.front()->save(file, true);
  };
  work.drop = [&](std::int64_t step) {
    std::error_code ignored;
    fs::remove(adversary_file(settings.out, step), ignored);
  };
  work.note = [&] {
    return fmt::format("model {:.3f}, adversary {:.3f} (hide {:.3f}, false positives {:.3f})", losses[0],
                       row.loss(), row.hide, row.false_positive);
  };
  work.report = [&](double rate) {
    loop.log({{"rate", rate},
              {"loss", losses[0]},
              {"score_loss", losses[1]},
              {"box_loss", losses[2]},
              {"hide", row.hide},
              {"false_positive", row.false_positive}});
  };

  result.seconds_per_step = loop.run(work);
  result.steps = loop.state().step;
  result.hosts = static_cast<int>(training.hosts().size());
  result.loss = {losses[0], losses[1], losses[2]};
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
