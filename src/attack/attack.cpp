#include "attack/attack.h"

#include <fmt/format.h>

#include <algorithm>

#include "attack/attack_hosts.h"
#include "attack/attack_step.h"
#include "attack/black_box.h"
#include "attack/checkpoint.h"
#include "attack/portfolio.h"
#include "attack/run.h"
#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/ranks.h"
#include "base/schedule.h"
#include "base/sizes.h"
#include "detection/detector_settings.h"
#include "detection/process_detector.h"
#include "exchange/gltf.h"
#include "frames/frame_provenance.h"
#include "scene/data/read_frames.h"
#include "simulation/check_inputs.h"

namespace mirage {
namespace {

/// FieldError if the detector does not read the one sensor that the target names, or if only colours are
/// learned and it does not see them.
void check_target(const AttackSettings& settings, const Detector& detector) {
  const AttackTarget target = settings.target;
  const Capabilities can = detector.capabilities();
  if (target == AttackTarget::lidar && !can.reads_points)
    throw FieldError("target", "lidar", detector.name() + " does not read the LiDAR's returns",
                     "use image or both");
  if (target == AttackTarget::image && !can.reads_image)
    throw FieldError("target", "image", detector.name() + " does not read the picture", "use lidar or both");
  if (settings.parts == AttackParts::texture && target != AttackTarget::random &&
      !sees_colours(settings, can))
    throw FieldError("parts", "texture",
                     can.reads_image ? "is not seen by the target, which is the LiDAR alone"
                                     : "is not seen by " + detector.name() + ", which reads no picture",
                     "use shape, or --lidar-effects albedo, by which returns show colours");
}

/// FieldError for an invalid redraw, or a detector that does not read the picture.
void check_renderer(const AttackSettings& settings, const Detector& detector) {
  check_number({.name = "cycles_renew", .range = kNotNegative}, settings.redraw.metres);
  check_number({.name = "cycles_renew_texels", .range = kNotNegative}, settings.redraw.texels);
  if (settings.renderer && !detector.capabilities().reads_image)
    throw FieldError("renderer", "cycles", detector.name() + " does not read the picture", "leave it out");
}

/// FieldError for a detector without gradients if the attack needs them.
void check_gradient(const AttackSettings& settings, const Detector& detector) {
  if (settings.attack == AttackSearch::black_box || settings.target == AttackTarget::random) return;
  if (!detector.capabilities().has_gradients)
    throw FieldError("detector", detector.name(), "gives no gradient",
                     "use --attack black-box, which learns from scores alone");
}

/// Loss terms of the last iteration, and, for the hosts attacked last, how many of those found as recorded
/// are hidden.
std::string progress_note(const LossRow& row, const std::vector<LossRow>& rows, int batch) {
  constexpr int kHosts = 50;
  int hosts = 0, found = 0, hidden = 0;
  for (auto past = rows.rbegin(); past != rows.rend() && hosts < kHosts; ++past) {
    hosts += batch;
    found += past->found;
    hidden += past->hidden;
  }
  return fmt::format(
      "loss {:.3f} (hide {:.3f}, false positives {:.3f}, smoothness {:.3f})  hidden {} of {} found",
      row.loss(), row.hide, row.false_positive, row.laplacian, hidden, found);
}

/// The report except kept_iteration.
PlateauReport plateau_report(const HeldOutRecord& record, const std::vector<Host>& hosts,
                             const AttackSettings& settings) {
  PlateauReport report;
  report.stopped = record.plateau(settings.until_plateau);
  report.iterations = record.iterations, report.values = record.values;
  report.best_iteration = record.best_iteration, report.best = record.best;
  report.vehicles = hosts.size(), report.frames = host_frames(host_ids(hosts)).size();
  report.steps = settings.until_plateau, report.every = settings.validation_every;
  return report;
}

/// FieldError for settings that no run can use.
void check_settings(const AttackSettings& settings) {
  check_fields(settings);
  if (settings.buildable.on && settings.parts == AttackParts::size)
    throw FieldError("parts", "size", "is an ellipsoid, which has no flat base", "give --free");
  if (settings.buildable.on) check_buildable(settings.buildable, settings.limits);
  check_search(settings);
  if (settings.expectation.worst > 0 && !settings.expectation.any())
    throw FieldError("expectation", "worst", "chooses among draws in which nothing varies",
                     "name what varies, too, as in shape:0.02,worst:4");
  if (settings.expectation.worst > 0 && settings.attack == AttackSearch::black_box)
    throw FieldError("expectation", "worst", "has no gradient to choose for",
                     "leave it out, or --attack plain");
  if (settings.placement.victim == Victim::phantom && !(settings.objective.lambda_fp > 0))
    throw FieldError("lambda_fp", fmt::format("{:g}", settings.objective.lambda_fp),
                     "rewards no false positive, and they are what the placement " +
                         text_of(settings.placement) + " is for (victim = \"phantom\")",
                     "give a weight above 0, or another --place");
}

/// Writes the learned mesh, and fills the fields of the result that all kinds of attack share. `steps`: those
/// of this process, which took `seconds` on `workers` detectors.
void finish(const AttackSettings& settings, const AttackState& state, const std::vector<Host>& train,
            const std::vector<Host>& test, long steps, double seconds, const StepTimings& stages,
            std::size_t workers, AttackResult& result) {
  if (rank() == 0) write_adversary(settings.out / "adversary.glb", state.adversary);
  await_ranks();  // the caller may read the run's files
  result.vehicles_train = static_cast<int>(train.size());
  result.vehicles_test = static_cast<int>(test.size());
  Clusters clusters;
  for (const Host& host : test) clusters.add(host.id.frame, track_of(settings, host.id));
  result.clusters = clusters.count();
  for (const auto* hosts : {&train, &test})
    for (const Host& host : *hosts) result.rooftops.add(host.from_box);
  result.buildable = buildable_report(state.adversary, settings.buildable);
  const std::size_t tail = std::max<std::size_t>(1, state.losses.size() / 10);
  for (std::size_t i = state.losses.size() - std::min(tail, state.losses.size()); i < state.losses.size();
       ++i)
    result.loss += state.losses[i].loss() / static_cast<double>(tail);
  result.steps = steps;
  if (steps > 0) result.seconds_per_iteration = seconds / static_cast<double>(steps);
  result.stages = to_json(stages, seconds, steps, workers);
}

}  // namespace

void fit_limits(AttackSettings& settings) {
  if (!settings.limits.is_explicit && settings.limits.half == kRoofBox)
    settings.limits.half = settings.placement.volume / 2;
}

AttackResult run_attack(const AttackSettings& settings) {
  AttackSettings resolved = settings;
  fit_limits(resolved);
  check_settings(resolved);  // before the detector is loaded
  resolved.detector.precision = usable_precision(settings.detector.precision);
  if (is_outside(settings.detector))
    resolved.weights_hash = outside_content(settings.detector);
  else if (!settings.detector.fresh)
    resolved.weights_hash = weights_hash(settings.detector);
  return run_attack(resolved, load_detector_pool(resolved.detector, settings.batch));
}

AttackResult run_attack(const AttackSettings& requested, const DetectorPool& detectors) {
  AttackSettings settings = requested;
  fit_limits(settings);
  const AttackTarget target = settings.target;
  check_settings(settings);
  check_target(settings, *detectors.front());
  const std::string box_of_size = "the box of the object (size)";
  if (rank() == 0) {
    warn_of_large_object(2 * settings.limits.half, box_of_size);
    warn_of_volume(settings.placement, 2 * settings.limits.half, box_of_size);
  }
  check_renderer(settings, *detectors.front());
  check_gradient(settings, *detectors.front());
  make_output_folder(settings.out);
  const auto checkpoint_file = settings.out / "checkpoint.json";

  if (settings.hosts_from == HostSource::detections) settings.data = label_by_detections(settings, detectors);
  FrameStore store(settings);
  std::vector<std::string> train_frames, test_frames;
  const std::vector<std::string> frames = list_frames(settings.data);
  check_labels(settings.data, frames, "an attack", settings.classes, settings.cameras);
  split_frames(frames, settings.seed, train_frames, test_frames);
  SkippedHosts left_out;
  const auto hosts_in = [&](const std::vector<std::string>& of) {
    return find_all_hosts(store, of, detectors.front()->region(), settings.simulation, settings.min_view,
                          settings.quiet, &left_out);
  };
  const auto train = hosts_in(train_frames), test = hosts_in(test_frames);
  if (train.empty()) refuse_left_out(settings.placement, left_out);
  if (train.empty())
    throw InputError(settings.data.string(), "labels",
                     fmt::format("no car in the training frames has {:.0f} % of the adversary in view",
                                 100 * settings.min_view),
                     "give more frames or lower --min-view");
  if (rank() == 0) warn_of_left_out(settings.placement, left_out);
  spdlog::info("{} host vehicles for training, {} for testing", train.size(), test.size());
  if (const std::string why = detectors.front()->capabilities().why_whole;
      !why.empty() && target != AttackTarget::random)
    spdlog::info("each detector pass covers the whole frame, which is slower: {}", why);

  // The options identify the weights only if the detector was loaded from them.
  const auto clean_cache = std::make_shared<CleanDetectionCache>(
      store, settings.weights_hash.empty()
                 ? std::string()
                 : detector_identity(settings.detector, detectors.front()->capabilities().version));
  AttackResult result;
  result.attack = settings.attack;
  result.placement = settings.placement;
  result.left_out = left_out;
  result.found_clean =
      measure_clean_performance(detectors, store, train, settings.simulation, *clean_cache, settings.quiet);
  spdlog::info("{} {}", detectors.front()->name(), describe(result.found_clean));
  require_detections(result.found_clean, *detectors.front());

  // The hosts are part of a run's identity: other frames or labels would change the split, and a resumed run
  // would be tested on its training hosts.
  RunIdentity id = identity(settings);
  id.json["train"] = to_json(host_ids(train));
  id.json["test"] = to_json(host_ids(test));
  for (const auto& [key, of] : {std::pair(kTrainFrames, &train), std::pair(kTestFrames, &test)})
    id.json[key] = id.lacking[key] =  // missing in runs of earlier versions
        frames_hash(settings.data, host_frames(host_ids(*of)), settings.cameras);
  id.json["renderer"] = settings.renderer ? settings.renderer->identity() : nlohmann::json(kRasterRenderer);
  if (settings.renderer)
    id.json["renewal"] = {{"metres", settings.redraw.metres}, {"texels", settings.redraw.texels}};
  const TexturedMesh random = random_baseline(settings.seed, settings.limits, settings.buildable);
  const auto began = Clock::now();
  if (settings.attack != AttackSearch::plain) {
    const SearchRun run{settings, detectors, store, train, clean_cache, id};
    const SearchOutcome outcome =
        settings.attack == AttackSearch::black_box ? run_black_box(run) : run_portfolio(run);
    if (rank() == 0) write_adversary(settings.out / "random.glb", random);
    result.black_box = outcome.black_box;
    result.automatic = outcome.automatic;
    result.iterations = static_cast<int>(outcome.steps);
    finish(settings, outcome.state, train, test, outcome.steps - outcome.first, seconds_since(began),
           outcome.stages, detectors.size(), result);
    return result;
  }
  ValidationPart part{train, {}};
  if (settings.until_plateau > 0 && target != AttackTarget::random) {
    part = split_validation(train, settings.seed);
    id.json["validation"] = to_json(host_ids(part.held_out));
    spdlog::info("{} of them are held out to tell when the attack is at its plateau", part.held_out.size());
  }
  AttackState state = fresh_state(settings);
  if (std::filesystem::exists(checkpoint_file)) {
    state = read_checkpoint(checkpoint_file, id, settings);
    if (state.iteration < settings.iterations) spdlog::info("resuming at iteration {}", state.iteration);
  }
  require_one_file(checkpoint_file, state.iteration, "checkpoints");
  if (rank() == 0) {
    write_json(settings.out / "run.json", id.json);
    write_adversary(settings.out / "random.glb", random);
  }

  const AttackStepper stepper(settings, detectors, store, part.learn, state.adversary.mesh, clean_cache);
  const auto save = [&] {
    if (rank() > 0) return;
    write_checkpoint(checkpoint_file, state, id.json);
    write_losses(settings.out / "loss.csv", state.losses);
  };
  // Files of an earlier, shorter run stay until this run replaces them, one by one.
  const long iterations = target == AttackTarget::random ? 0 : settings.iterations;
  Progress progress("attack", as_size(iterations), settings.quiet);
  StepTimings stages;
  const auto start = Clock::now();
  CheckpointTimer timer(settings.checkpoint);
  const long first = state.iteration;
  const auto step = [&] {
    try {
      return stepper.step(state, &stages);
    } catch (const std::exception&) {
      if (settings.renderer) save();  // the renderer can fail at any step, and steps are expensive
      throw;
    }
  };
  // The checks happen at the same steps however often the run was stopped.
  const auto at_plateau = [&] {
    if (part.held_out.empty()) return false;
    HeldOutRecord& record = state.held_out;
    if (state.iteration % settings.validation_every == 0 &&
        (record.iterations.empty() || record.iterations.back() < state.iteration))
      record.add(state.iteration, stepper.held_out(state.adversary, part.held_out), state.adversary);
    return record.plateau(settings.until_plateau);
  };
  while (!at_plateau() && state.iteration < iterations &&
         !(settings.seconds > 0 && any_rank(seconds_since(start) >= settings.seconds))) {
    if (any_rank(interrupted())) {
      save();
      throw Interrupted(fmt::format("interrupted after {} iterations; run the same command to go on from {}",
                                    state.iteration, checkpoint_file.string()));
    }
    const LossRow row = step();
    progress.update(as_size(state.iteration), progress_note(row, state.losses, settings.batch));
    Stopwatch clock;
    if (timer.due(state.iteration)) save();
    stages.files += clock.lap();
  }
  const double seconds = seconds_since(start);
  save();
  if (target == AttackTarget::random) state.adversary = random;
  if (!part.held_out.empty()) {
    result.plateau = plateau_report(state.held_out, part.held_out, settings);
    // If the run ended between two checks, the last mesh is judged as well, but not stored in the checkpoint.
    HeldOutRecord best = state.held_out;
    if (best.iterations.back() < state.iteration)
      best.add(state.iteration, stepper.held_out(state.adversary, part.held_out), state.adversary);
    result.plateau->kept_iteration = best.best_iteration;
    state.adversary = best.mesh;
  }
  result.iterations = static_cast<int>(state.iteration);
  finish(settings, state, train, test, state.iteration - first, seconds, stages, detectors.size(), result);
  return result;
}

}  // namespace mirage
