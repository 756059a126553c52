#include "attack/attack.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>

#include "attack/checkpoint.h"
#include "attack/rank_steps.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/progress.h"
#include "base/random.h"
#include "base/ranks.h"
#include "exchange/gltf.h"
#include "geometry/laplacian.h"
#include "scene/kitti.h"

namespace mirage {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// What a checkpoint must agree with. Iterations are not in it: a finished run can be prolonged.
nlohmann::json identity(const AttackSettings& settings) {
  const auto& weights = settings.detector.weights;
  nlohmann::json id = {
      {"data", std::filesystem::absolute(settings.data).lexically_normal().string()},
      {"detector", settings.detector.detector},
      {"weights", weights.empty() ? "" : std::filesystem::absolute(weights).lexically_normal().string()},
      {"weights_hash", settings.weights_hash},
      {"target", settings.target},
      {"seed", settings.seed},
      {"batch", settings.batch},
      {"vertex_rate", settings.vertex_rate},
      {"texel_rate", settings.texel_rate},
      {"min_view", settings.min_view},
      {"limits", {settings.limits.half.x(), settings.limits.half.y(), settings.limits.half.z()}},
      {"lambda_fp", settings.objective.lambda_fp},
      {"lambda_laplacian", settings.objective.lambda_laplacian},
      {"relevant_score", settings.objective.relevant_score},
      {"simulation", to_json(settings.simulation)}};
  // Only where it differs, so that runs of before the choice go on: those stood on boxes.
  if (settings.depth != AttackSettings().depth) id["depth"] = settings.depth;
  if (settings.rooftop != "box") {
    id["rooftop"] = settings.rooftop;
    id["rooftop_model_hash"] = rooftop_model_hash(settings.rooftop);
  }
  if (settings.sun != kDefaultSun) id["sun"] = settings.sun;
  if (settings.parts != "both") id["parts"] = settings.parts;
  if (const Expectation& e = settings.expectation; e.any())
    id["expectation"] = {e.roof_shift, e.roof_yaw, e.sun, e.light, e.exposure, e.image_noise, e.range_noise};
  if (const BuildableSettings& b = settings.buildable; b.on)
    id["buildable"] = {b.min_thickness, b.base, b.black, b.white};
  return id;
}

/// The hosts of one iteration: an endless sequence of shuffled passes over all hosts, by seed alone.
std::vector<std::size_t> batch_of(std::size_t hosts, int batch, long iteration, std::uint64_t seed) {
  std::vector<std::size_t> chosen;
  std::vector<std::size_t> order(hosts);
  long shuffled = -1;
  for (int k = 0; k < batch; ++k) {
    const long position = iteration * batch + k, pass = position / static_cast<long>(hosts);
    if (pass != shuffled) {
      for (std::size_t i = 0; i < hosts; ++i) order[i] = i;
      RandomStream random(seed, "host order", static_cast<std::uint64_t>(pass));
      for (std::size_t i = hosts; i > 1; --i)
        std::swap(order[i - 1], order[static_cast<std::size_t>(random.below(static_cast<int>(i)))]);
      shuffled = pass;
    }
    chosen.push_back(order[static_cast<std::size_t>(position % static_cast<long>(hosts))]);
  }
  return chosen;
}

std::vector<HostId> ids(const std::vector<Host>& hosts) {
  std::vector<HostId> list;
  for (const Host& host : hosts) list.push_back(host.id);
  return list;
}

void write_losses(const std::filesystem::path& file, const std::vector<LossRow>& rows) {
  std::string text = "iteration,loss,hide,false_positive,laplacian\n";
  for (std::size_t i = 0; i < rows.size(); ++i)
    text += fmt::format("{},{:.9g},{:.9g},{:.9g},{:.9g}\n", i, rows[i].loss(), rows[i].hide,
                        rows[i].false_positive, rows[i].laplacian);
  write_file(file, text);
}

/// InputError for numbers that no run can use.
void check_settings(const AttackSettings& settings) {
  const auto demand = [](bool good, const char* option, double value, const char* fix) {
    if (!good) throw InputError(option, fmt::format("{}", value), "out of range", fix);
  };
  const auto& raster = settings.simulation.raster;
  const auto positive = [](double value) { return std::isfinite(value) && value > 0; };
  demand(settings.batch >= 1, "--batch", settings.batch, "use 1 or more");
  demand(settings.iterations >= 0, "--iterations", settings.iterations, "use 0 or more");
  demand(positive(raster.sigma), "--sigma", raster.sigma, "use a positive number");
  demand(positive(raster.gamma), "--gamma", raster.gamma, "use a positive number");
  demand(positive(settings.vertex_rate), "--vertex-rate", settings.vertex_rate, "use a positive number");
  demand(positive(settings.texel_rate), "--texel-rate", settings.texel_rate, "use a positive number");
  demand(settings.min_view >= 0 && settings.min_view <= 1, "--min-view", settings.min_view,
         "use a share in [0, 1]");
  if (settings.buildable.on) check_buildable(settings.buildable, settings.limits);
  demand(std::isfinite(settings.objective.lambda_fp), "--lambda-fp", settings.objective.lambda_fp,
         "use a number");
  demand(std::isfinite(settings.objective.lambda_laplacian), "--lambda-lap",
         settings.objective.lambda_laplacian, "use a number");
}

/// A gradient that is not finite would poison the optimiser's state and, with it, the checkpoint.
void check_finite(const HostStep& step, const HostId& host, long iteration) {
  bool finite = std::isfinite(step.hide) && std::isfinite(step.false_positive);
  for (const Vec3d& d : step.gradient.vertices) finite = finite && d.allFinite();
  for (const Vec3d& d : step.gradient.texels) finite = finite && d.allFinite();
  if (!finite)
    throw Failure("attack",
                  fmt::format("gradient of host {}/{} is not finite in iteration {}", host.frame, host.label,
                              iteration),
                  "check the detector; the last checkpoint is good");
}

/// The random mesh that the learned one is compared with, under the same rules.
TexturedMesh baseline(const AttackSettings& settings) {
  TexturedMesh random = random_adversary(settings.seed, settings.limits);
  if (settings.buildable.on)
    keep_buildable(random, fresh_state(settings).adversary, settings.buildable, settings.limits);
  return random;
}

}  // namespace

AttackTarget parse_target(const std::string& word) {
  if (word == "both") return AttackTarget::both;
  if (word == "image") return AttackTarget::image;
  if (word == "lidar") return AttackTarget::lidar;
  if (word == "random") return AttackTarget::random;
  throw InputError("--target", word, "unknown target", "use both, image, lidar or random");
}

AttackParts parse_parts(const std::string& word) {
  if (word == "both") return AttackParts::both;
  if (word == "shape") return AttackParts::shape;
  if (word == "texture") return AttackParts::texture;
  throw InputError("--parts", word, "unknown", "use both, shape or texture");
}

HostStep attack_host(Detector& detector, const PreparedFrame& known, const Host& host,
                     const TexturedMesh& adversary, AttackTarget target, const AttackSettings& settings,
                     const WorldDraw* draw) {
  HostStep step;
  auto start = Clock::now();
  std::optional<PreparedFrame> drawn;
  if (draw != nullptr && settings.expectation.any_in_frame()) drawn = draw->frame(known);
  const PreparedFrame& prepared = drawn ? *drawn : known;
  const Label& label = prepared.frame.labels[static_cast<std::size_t>(host.id.label)];
  Simulated simulated = draw == nullptr
                            ? simulate(prepared, label, host.rooftop, adversary, settings.simulation)
                            : simulate(prepared, label, draw->rooftop(host.rooftop), adversary,
                                       draw->simulation(settings.simulation));
  if (draw != nullptr) draw->add_noise(simulated.image);
  step.simulation_seconds = seconds_since(start);

  start = Clock::now();
  const SensorView view{&simulated.image, simulated.sweep, &prepared.frame.calibration};
  const auto proposals = detector.forward(view, settings.objective.relevant_score, true);
  const auto boxes = ground_truth_boxes(prepared.frame);
  const ObjectiveValue value = objective(proposals, label.box.bev, boxes, settings.objective);
  step.hide = value.hide;
  step.false_positive = value.false_positive;
  step.gradient.vertices.assign(adversary.mesh.vertices.size(), Vec3d::Zero());
  step.gradient.texels.assign(adversary.atlas.texels.size(), Vec3d::Zero());
  const bool any = std::any_of(value.d_logits.begin(), value.d_logits.end(), [](double d) { return d != 0; });
  if (!any) {
    step.detector_seconds = seconds_since(start);
    return step;
  }
  SensorGradient gradient = detector.backward(value.d_logits);
  step.detector_seconds = seconds_since(start);

  start = Clock::now();
  if (target == AttackTarget::lidar) gradient.image = ImageF();
  if (target == AttackTarget::image) gradient.points.clear();
  step.gradient = simulate_vjp(simulated, gradient.image, gradient.points);
  step.simulation_seconds += seconds_since(start);
  return step;
}

AttackResult run_attack(const AttackSettings& settings) {
  parse_target(settings.target);  // before the detector is loaded
  parse_parts(settings.parts);
  check_settings(settings);
  AttackSettings known = settings;
  if (!settings.detector.fresh) known.weights_hash = content_hash(read_file(weights_file(settings.detector)));
  return run_attack(known, load_detector_pool(settings.detector, settings.batch));
}

AttackResult run_attack(const AttackSettings& settings, const DetectorPool& detectors) {
  const AttackTarget target = parse_target(settings.target);
  const AttackParts parts = parse_parts(settings.parts);
  check_settings(settings);
  make_output_folder(settings.out);
  const auto checkpoint_file = settings.out / "checkpoint.json";

  FrameStore store(settings.data, settings.depth, settings.rooftop, settings.sun);
  std::vector<std::string> train_frames, test_frames;
  split_frames(list_frames(settings.data), settings.seed, train_frames, test_frames);
  const auto train = find_all_hosts(store, train_frames, detectors.front()->region(), settings.simulation,
                                    settings.min_view);
  const auto test =
      find_all_hosts(store, test_frames, detectors.front()->region(), settings.simulation, settings.min_view);
  if (train.empty())
    throw InputError(settings.data.string(), "label_2",
                     fmt::format("no car in the training frames has {:.0f} % of the adversary in view",
                                 100 * settings.min_view),
                     "give more frames or lower --min-view");
  spdlog::info("{} host vehicles to train on, {} held back", train.size(), test.size());

  // The hosts belong to a run's identity: with other frames or labels the split would be another one, and a
  // resumed run would be tested on what it was trained on.
  nlohmann::json id = identity(settings);
  id["train"] = to_json(ids(train));
  id["test"] = to_json(ids(test));
  AttackState state = fresh_state(settings);
  if (std::filesystem::exists(checkpoint_file)) {
    state = read_checkpoint(checkpoint_file, id);
    spdlog::info("resuming at iteration {}", state.iteration);
  }
  if (any_rank(state.iteration != first_rank_value(state.iteration)))
    throw Failure(checkpoint_file.string(), "processes see different checkpoints",
                  "give --out a folder that all machines share");
  const TexturedMesh random = baseline(settings);
  if (rank() == 0) {
    write_json(settings.out / "run.json", id);
    write_adversary(settings.out / "random.glb", random);
  }

  const Laplacian laplacian(state.adversary.mesh);
  const auto save = [&] {
    if (rank() > 0) return;
    write_checkpoint(checkpoint_file, state, id);
    write_losses(settings.out / "loss.csv", state.losses);
  };
  const long iterations = target == AttackTarget::random ? 0 : settings.iterations;
  if (rank() == 0 &&
      state.iteration < iterations)  // what an earlier, shorter run left is no longer this run's result
    for (const char* name : {"adversary.glb", "result.json"}) std::filesystem::remove(settings.out / name);
  Progress progress("attack", static_cast<std::size_t>(iterations), settings.quiet);
  const auto start = Clock::now();
  const long first = state.iteration;
  while (state.iteration < iterations &&
         !(settings.seconds > 0 && any_rank(seconds_since(start) >= settings.seconds))) {
    if (any_rank(interrupted())) {
      save();
      throw Interrupted(fmt::format("interrupted after {} iterations; run the same command to go on from {}",
                                    state.iteration, checkpoint_file.string()));
    }
    std::vector<Vec3d> d_vertices(state.adversary.mesh.vertices.size(), Vec3d::Zero());
    std::vector<Vec3d> d_texels(state.adversary.atlas.texels.size(), Vec3d::Zero());
    LossRow row;
    const auto chosen = batch_of(train.size(), settings.batch, state.iteration, settings.seed);
    std::vector<HostStep> steps(chosen.size());
    const std::vector<std::size_t> mine = own_hosts(chosen.size());
    for_each_with_detector(detectors, mine.size(), [&](Detector& detector, std::size_t i) {
      const std::size_t k = mine[i];
      const Host& host = train[chosen[k]];
      const WorldDraw draw(settings.expectation, settings.seed,
                           static_cast<std::uint64_t>(state.iteration * settings.batch) + k);
      steps[k] = attack_host(detector, store.get(host.id.frame), host, state.adversary, target, settings,
                             settings.expectation.any() ? &draw : nullptr);
    });
    for (const std::size_t k : mine) check_finite(steps[k], train[chosen[k]].id, state.iteration);
    share_steps(steps, state.adversary);
    for (const HostStep& step : steps) {
      row.hide += step.hide / settings.batch;
      row.false_positive += step.false_positive / settings.batch;
      for (std::size_t i = 0; i < d_vertices.size(); ++i)
        d_vertices[i] += step.gradient.vertices[i] / settings.batch;
      for (std::size_t i = 0; i < d_texels.size(); ++i)
        d_texels[i] += step.gradient.texels[i] / settings.batch;
    }
    const double weight = settings.objective.lambda_laplacian;
    row.laplacian = weight * laplacian.energy(state.adversary.mesh.vertices, weight, d_vertices);
    const TexturedMesh before = state.adversary;
    if (parts != AttackParts::texture) state.vertices.step(state.adversary.mesh.vertices, d_vertices);
    if (parts != AttackParts::shape) state.texels.step(state.adversary.atlas.texels, d_texels);
    project(state.adversary, settings.limits);
    if (settings.buildable.on) keep_buildable(state.adversary, before, settings.buildable, settings.limits);
    state.losses.push_back(row);
    ++state.iteration;
    progress.update(static_cast<std::size_t>(state.iteration),
                    fmt::format("loss {:.3f} (hide {:.3f}, false positives {:.3f})", row.loss(), row.hide,
                                row.false_positive));
    if (state.iteration % settings.checkpoint_every == 0) save();
  }
  const double seconds = seconds_since(start);
  save();
  if (target == AttackTarget::random) state.adversary = random;
  if (rank() == 0) write_adversary(settings.out / "adversary.glb", state.adversary);

  AttackResult result;
  result.vehicles_train = static_cast<int>(train.size());
  result.vehicles_test = static_cast<int>(test.size());
  for (const auto* hosts : {&train, &test})
    for (const Host& host : *hosts) result.rooftops.add(host.rooftop);
  result.buildable = buildable_report(state.adversary, settings.buildable);
  result.iterations = static_cast<int>(state.iteration);
  const std::size_t tail = std::max<std::size_t>(1, state.losses.size() / 10);
  for (std::size_t i = state.losses.size() - std::min(tail, state.losses.size()); i < state.losses.size();
       ++i)
    result.loss += state.losses[i].loss() / static_cast<double>(tail);
  if (state.iteration > first)
    result.seconds_per_iteration = seconds / static_cast<double>(state.iteration - first);
  return result;
}

}  // namespace mirage
