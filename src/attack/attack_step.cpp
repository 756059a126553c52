#include "attack/attack_step.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "attack/evaluation.h"
#include "base/error.h"
#include "base/ranks.h"
#include "base/sizes.h"

namespace mirage {

namespace {

/// This rank's hosts among 0 … n − 1 of a batch: every rank_count()-th, starting at its rank.
std::vector<std::size_t> own_hosts(std::size_t n) {
  std::vector<std::size_t> own;
  for (auto k = as_size(rank()); k < n; k += as_size(rank_count())) own.push_back(k);
  return own;
}

/// The coordinates of all points as one contiguous span.
std::span<double> coordinates(std::vector<Vec3d>& points) {
  static_assert(sizeof(Vec3d) == 3 * sizeof(double));
  return {points.empty() ? nullptr : points.front().data(), 3 * points.size()};
}

/// Exchanges the steps between ranks; each then sums all of them in the batch's order, to the same bits as a
/// single process. `adversary` gives the gradients' sizes. A collective call.
void share_steps(std::vector<HostStep>& steps, const TexturedMesh& adversary) {
  if (rank_count() == 1) return;
  std::vector<std::vector<double>> blocks;  // hide, false positive, hidden, found, vertices, texels
  for (HostStep& step : steps) {
    AdversaryGradient& gradient = step.gradient;
    gradient.vertices.resize(adversary.mesh.vertices.size(), Vec3d::Zero());
    gradient.texels.resize(adversary.atlas.texels.size(), Vec3d::Zero());
    auto& block = blocks.emplace_back(std::vector<double>{
        step.hide, step.false_positive, static_cast<double>(step.hidden), static_cast<double>(step.found)});
    for (const std::span<double> part : {coordinates(gradient.vertices), coordinates(gradient.texels)})
      block.insert(block.end(), part.begin(), part.end());
  }
  share_blocks(blocks);
  for (std::size_t k = 0; k < steps.size(); ++k) {
    HostStep& step = steps[k];
    auto from = blocks[k].begin();
    step.hide = *from++, step.false_positive = *from++;
    step.hidden = *from++ != 0, step.found = *from++ != 0;
    for (const std::span<double> part :
         {coordinates(step.gradient.vertices), coordinates(step.gradient.texels)})
      for (double& value : part) value = *from++;
  }
}

/// Frames of this rank's hosts in a batch.
std::vector<std::string> own_frames(const std::vector<HostId>& batch) {
  std::vector<std::string> frames;
  for (const std::size_t k : own_hosts(batch.size())) frames.push_back(batch[k].frame);
  return frames;
}

bool are_finite(const std::vector<Vec3d>& points) {
  return std::ranges::all_of(points, [](const Vec3d& p) { return p.allFinite(); });
}

void check_finite(const HostStep& step, const HostId& host, long iteration) {
  if (!std::isfinite(step.hide) || !std::isfinite(step.false_positive) ||
      !are_finite(step.gradient.vertices) || !are_finite(step.gradient.texels))
    throw Failure("attack",
                  fmt::format("gradient of host {}/{} is not finite in iteration {}", host.frame, host.label,
                              iteration),
                  "check the detector; the last checkpoint is good");
}

/// Failure unless `finite`: loss, gradient or mesh can overflow by weights and rates although each host's
/// gradient is finite.
void check_weights(bool finite, long iteration) {
  if (!finite)
    throw Failure("attack", fmt::format("the step of iteration {} is not finite", iteration),
                  "use smaller weights (--lambda-lap, --lambda-fp) and rates; the last checkpoint is good");
}

/// Ground truths of the objective: the host's targets, or the placed object itself.
std::vector<HostTruth> truths_of(const Observation& seen, const TexturedMesh& adversary, Matching matching) {
  const Placement& placement = seen.host().placement;
  const Frame& frame = seen.host().prepared.frame;
  std::vector<HostTruth> truths;
  if (placement.victim == Victim::object) {
    const Label own = own_label(placement, place(adversary, placement).mesh, frame.calibration);
    truths.push_back(HostTruth::of_object(frame, own, matching));
    return truths;
  }
  std::optional<PictureBox> object;
  if (matching.in_picture())
    object =
        labelled_boxes(placement, {}, frame.calibration, carried_box(seen.simulated(), placement)).object;
  for (const Label& target : placement.targets) truths.emplace_back(frame, target, matching, object);
  return truths;
}

/// The objective over these truths: the hiding terms of each, and the false positives once. An object is
/// found by any box on it, since vehicle detectors do not fit other objects. It is absent as recorded, and
/// counts as found there.
ObjectiveValue loss_of(const Observation& seen, const TexturedMesh& adversary,
                       std::span<const Detection> proposals, Matching matching, ObjectiveSettings settings,
                       HostStep& step) {
  const StepHost& host = seen.host();
  const bool itself = host.placement.victim == Victim::object;
  settings.hides = host.placement.victim != Victim::phantom;
  ObjectiveValue sum;
  bool found_attacked = false;
  step.found = itself;
  for (const Label& target : host.placement.targets)
    step.found |= finds(host.clean, HostTruth(host.prepared.frame, target, matching));
  for (const HostTruth& truth : truths_of(seen, adversary, matching)) {
    const ObjectiveValue value = objective(proposals, truth, settings, host.clean);
    sum.hide += value.hide;
    sum.false_positive += value.false_positive;
    sum.d_logits.resize(proposals.size(), 0.0);
    for (std::size_t i = 0; i < proposals.size(); ++i) sum.d_logits[i] += value.d_logits[i];
    found_attacked |= itself ? reports(proposals, truth) : finds(proposals, truth);
    settings.lambda_fp = 0;
  }
  step.hide = sum.hide;
  step.false_positive = sum.false_positive;
  step.hidden = step.found && !found_attacked;
  return sum;
}

}  // namespace

HostStep attack_host(Detector& detector, const StepHost& host, const TexturedMesh& adversary,
                     const AttackSettings& settings, bool back) {
  Observation seen(host, adversary, settings.simulation);
  HostStep step;
  const Capabilities can = detector.capabilities();
  // Another exposure or noise changes every pixel: to a detector that reads them nothing is as recorded.
  SensorView view = seen.view(can, can.why_whole.empty() && !(seen.changes_picture() && can.reads_image));
  if (back && can.knows_presence && settings.target != AttackTarget::image &&
      settings.parts != AttackParts::texture)
    seen.watch(view);
  step.seconds = seen.seconds();
  Stopwatch clock;
  const auto proposals = detector.forward(view, settings.objective.least_score(), back);
  step.seconds.detector_forward = clock.lap();
  const ObjectiveValue value = loss_of(seen, adversary, proposals, can.matching(), settings.objective, step);
  if (!back) return step;
  step.gradient.vertices.assign(adversary.mesh.vertices.size(), Vec3d::Zero());
  step.gradient.texels.assign(adversary.atlas.texels.size(), Vec3d::Zero());
  const bool any = std::ranges::any_of(value.d_logits, [](double d) { return d != 0; });
  step.seconds.rest += clock.lap();
  if (!any) return step;
  SensorGradient gradient = detector.backward(value.d_logits);
  step.seconds.detector_backward = clock.lap();
  if (host.draw) host.draw->noise_vjp(seen.simulated().image, gradient.image);
  step.gradient = seen.vjp(gradient, settings.target);
  step.seconds.simulation_vjp = clock.lap();
  return step;
}

HostStep step_host(Detector& detector, StepHost host, const TexturedMesh& adversary,
                   const AttackSettings& settings, std::uint64_t number, bool back) {
  const EotSettings& expectation = settings.expectation;
  HostTimings selection;
  if (expectation.any() && expectation.draws() > 1) {
    HostStep worst;
    int chosen = 0;
    for (int k = 0; k < expectation.draws(); ++k) {
      const SampledEnvironment draw(expectation, settings.seed, candidate_draw(number, k));
      host.draw = &draw;
      HostStep step = attack_host(detector, host, adversary, settings, false);
      selection += step.seconds;
      const double loss = step.hide + step.false_positive, most = worst.hide + worst.false_positive;
      if (k == 0 || !(loss <= most)) worst = std::move(step), chosen = k;  // NaN is kept, to be reported
      if (!std::isfinite(loss)) break;
    }
    if (!back) {
      worst.seconds = selection;
      return worst;
    }
    number = candidate_draw(number, chosen);
  }
  const SampledEnvironment draw(expectation, settings.seed, number);
  host.draw = expectation.any() ? &draw : nullptr;
  HostStep step = attack_host(detector, host, adversary, settings, back);
  step.seconds += selection;
  return step;
}

AttackStepper::AttackStepper(const AttackSettings& settings, const DetectorPool& detectors, FrameStore& store,
                             const std::vector<Host>& hosts, const Mesh& mesh,
                             std::shared_ptr<CleanDetectionCache> clean_cache)
    : settings_(settings),
      detectors_(detectors),
      store_(store),
      hosts_(hosts),
      order_(hosts, settings.batch, settings.seed),
      laplacian_(mesh),
      unit_(initial_adversary({Vec3d::Ones()}, 1).mesh.vertices),
      clean_cache_(std::move(clean_cache)) {
  if (settings.renderer) pictures_ = std::make_unique<RenderedPictures>(*settings.renderer, settings.seed);
}

std::vector<HostId> AttackStepper::batch(long iteration) const {
  std::vector<HostId> hosts;
  for (const std::size_t k : order_.batch(iteration)) hosts.push_back(hosts_[k].id);
  return hosts;
}

std::vector<HostStep> AttackStepper::steps_of(const std::vector<HostId>& hosts, const TexturedMesh& adversary,
                                              const RenderedMesh& rendered, std::uint64_t first_world,
                                              bool back, StepTimings& stages,
                                              const std::function<void()>& meanwhile) const {
  Stopwatch clock;
  std::vector<HostStep> steps(hosts.size());
  const std::vector<std::size_t> mine = own_hosts(hosts.size());
  for_each_with_detector(detectors_, mine.size(), [&](Detector& detector, std::size_t i) {
    const std::size_t k = mine[i];
    const auto prepared = store_.get(hosts[k].frame);
    const auto clean = clean_cache_->of(*prepared, detector);
    const StepHost host{*prepared,       hosts[k], store_.placement(hosts[k]), clean, nullptr,
                        pictures_.get(), &rendered};
    isolated([&] {  // otherwise an inner loop would run (and time) another host's work
      steps[k] = step_host(detector, host, adversary, settings_, first_world + k, back);
    });
  });
  for (const std::size_t k : mine) stages.threads += steps[k].seconds;
  stages.hosts = clock.lap();
  meanwhile();
  const TexturedMesh none;  // no gradients to share
  share_steps(steps, back ? adversary : none);
  stages.exchange = clock.lap();
  return steps;
}

LossRow AttackStepper::row_of(const std::vector<HostStep>& steps, const std::vector<Vec3d>& vertices,
                              std::vector<Vec3d>& d_vertices) const {
  LossRow row;
  for (const HostStep& step : steps) {
    row.hide += step.hide / static_cast<double>(steps.size());
    row.false_positive += step.false_positive / static_cast<double>(steps.size());
    row.found += step.found;
    row.hidden += step.hidden;
  }
  const double weight = settings_.objective.lambda_laplacian;
  row.laplacian = weight * laplacian_.energy(vertices, weight, d_vertices);
  return row;
}

LossRow AttackStepper::judge(const TexturedMesh& adversary, const std::vector<Host>& hosts,
                             std::uint64_t first_world, StepTimings* spent) const {
  StepTimings stages;
  const RenderedMesh rendered{-1, pictures_ ? adversary : TexturedMesh()};
  const std::vector<HostStep> steps =
      steps_of(host_ids(hosts), adversary, rendered, first_world, false, stages, [] {});
  std::vector<Vec3d> unused(adversary.mesh.vertices.size(), Vec3d::Zero());
  if (spent) *spent += stages;
  return row_of(steps, adversary.mesh.vertices, unused);
}

double AttackStepper::held_out(const TexturedMesh& adversary, const std::vector<Host>& hosts) const {
  constexpr std::uint64_t kWorlds = std::uint64_t{1} << 62;
  return judge(adversary, hosts, kWorlds).loss();
}

void AttackStepper::open_ahead(std::span<const std::string> next, std::span<const std::string> seen) const {
  Detector& detector = *detectors_.front();
  Arrival arrival;
  // In a drawn environment the frame differs each time.
  if (!detector.capabilities().why_whole.empty() || settings_.expectation.any()) return;
  for (const std::string& name : next) {
    if (std::ranges::find(seen, name) != seen.end()) continue;
    if (arrival.all_here()) return;
    const auto prepared = store_.get(name);
    const UnchangedInput clean = unchanged_input(*prepared, {});
    SensorView view = view_of(prepared->frame);
    view.clean = &clean;
    detector.forward(view, settings_.objective.least_score(), false);
  }
}

LossRow AttackStepper::step(AttackState& state, StepTimings* spent) const {
  const AttackSettings& settings = settings_;
  if (pictures_ &&
      (state.rendered.iteration < 0 || has_moved(state.rendered.mesh, state.adversary, settings.redraw)))
    state.rendered = {state.iteration, state.adversary};
  StepTimings stages;
  Stopwatch clock;
  const std::vector<HostId> hosts = batch(state.iteration);
  const std::vector<std::string> names = own_frames(hosts), next = own_frames(batch(state.iteration + 1));
  std::vector<std::shared_ptr<const PreparedFrame>> frames(names.size());  // held until the step is done
  parallel_for(names.size(), [&](std::size_t i) { frames[i] = store_.get(names[i]); });
  store_.prefetch(next);
  stages.input = clock.lap();

  const std::vector<HostStep> steps = steps_of(hosts, state.adversary, state.rendered,
                                               static_cast<std::uint64_t>(state.iteration * settings.batch),
                                               true, stages, [&] { open_ahead(next, names); });
  clock.lap();
  std::vector<Vec3d> d_vertices(state.adversary.mesh.vertices.size(), Vec3d::Zero());
  std::vector<Vec3d> d_texels(state.adversary.atlas.texels.size(), Vec3d::Zero());
  for (std::size_t k = 0; k < steps.size(); ++k) {
    const HostStep& step = steps[k];
    check_finite(step, hosts[k], state.iteration);
    for (std::size_t i = 0; i < d_vertices.size(); ++i)
      d_vertices[i] += step.gradient.vertices[i] / settings.batch;
    for (std::size_t i = 0; i < d_texels.size(); ++i) d_texels[i] += step.gradient.texels[i] / settings.batch;
  }
  const LossRow row = row_of(steps, state.adversary.mesh.vertices, d_vertices);
  check_weights(std::isfinite(row.loss()) && are_finite(d_vertices) && are_finite(d_texels), state.iteration);
  const TexturedMesh before = state.adversary;
  const Adam vertices_before = state.vertices, texels_before = state.texels;
  auto& vertices = state.adversary.mesh.vertices;
  if (settings.parts == AttackParts::size) {
    std::vector<Vec3d> half = {half_lengths(state.adversary.mesh)};
    state.vertices.step(half, {half_length_gradient(unit_, d_vertices)});
    half[0] = half[0].cwiseMax(kMinAdversarySize).cwiseMin(settings.limits.half);
    for (std::size_t i = 0; i < vertices.size(); ++i) vertices[i] = unit_[i].cwiseProduct(half[0]);
  } else if (settings.parts != AttackParts::texture) {
    if (settings.buildable.on)
      step_buildable(state.vertices, vertices, d_vertices, settings.limits);
    else
      state.vertices.step(vertices, d_vertices);
  }
  if (settings.parts == AttackParts::both || settings.parts == AttackParts::texture)
    state.texels.step(state.adversary.atlas.texels, d_texels);
  project(state.adversary, settings.limits);
  const bool finite = are_finite(vertices) && are_finite(state.adversary.atlas.texels);
  if (!finite) state.adversary = before, state.vertices = vertices_before, state.texels = texels_before;
  check_weights(finite, state.iteration);
  if (settings.buildable.on) keep_buildable(state.adversary, before, settings.buildable, settings.limits);
  state.losses.push_back(row);
  ++state.iteration;
  stages.optimiser = clock.lap();
  if (spent) *spent += stages;
  return row;
}

}  // namespace mirage
