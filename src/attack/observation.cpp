#include "attack/observation.h"

#include <algorithm>

#include "attack/clean_view.h"
#include "base/ranks.h"
#include "simulation/object_window.h"
#include "simulation/upstream.h"

namespace mirage {

HostSeconds& HostSeconds::operator+=(const HostSeconds& other) {
  simulation_forward += other.simulation_forward;
  simulation_vjp += other.simulation_vjp;
  detector_forward += other.detector_forward;
  detector_backward += other.detector_backward;
  worlds += other.worlds;
  rendering += other.rendering;
  rest += other.rest;
  return *this;
}

StageSeconds& StageSeconds::operator+=(const StageSeconds& other) {
  input += other.input;
  hosts += other.hosts;
  exchange += other.exchange;
  optimiser += other.optimiser;
  files += other.files;
  threads += other.threads;
  return *this;
}

nlohmann::json to_json(const StageSeconds& stages, double seconds, long iterations, std::size_t workers) {
  const double n = iterations > 0 ? static_cast<double>(iterations) : 1;
  const double known = stages.input + stages.hosts + stages.exchange + stages.optimiser + stages.files;
  const HostSeconds& t = stages.threads;
  return {{"iterations", iterations},
          {"threads", workers},
          {"ranks", rank_count()},
          {"wall_seconds",
           {{"input", stages.input / n},
            {"hosts", stages.hosts / n},
            {"exchange", stages.exchange / n},
            {"optimiser", stages.optimiser / n},
            {"files", stages.files / n},
            {"rest", (seconds - known) / n},
            {"total", seconds / n}}},
          {"thread_seconds",
           {{"simulation_forward", t.simulation_forward / n},
            {"simulation_vjp", t.simulation_vjp / n},
            {"detector_forward", t.detector_forward / n},
            {"detector_backward", t.detector_backward / n},
            {"worlds", t.worlds / n},
            {"rendering", t.rendering / n},
            {"rest", t.rest / n}}}};
}

Observation::Observation(const StepHost& host, const TexturedMesh& adversary, const AttackSettings& settings)
    : host_(host),
      settings_(settings),
      world_(host.draw, host.prepared, host.placement, adversary, settings.simulation) {
  seconds_.worlds = clock_.lap();
  simulated_ = simulate(world_.prepared(), world_.placement(), world_.object(), world_.simulation());
  seconds_.simulation_forward = clock_.lap();
  changed_ = simulated_.rect;
  if (host.seen.pictures) {
    const HostInWorld in_world{world_.prepared(), host.id, world_.placement(), world_.simulation(),
                               world_.number()};
    changed_ =
        united(changed_, host.seen.pictures->correct(in_world, world_.object(), *host.seen.of, simulated_));
  }
  seconds_.rendering = clock_.lap();
  world_.add_noise(simulated_.image);
  seconds_.worlds += clock_.lap();
}

SensorView Observation::view(const Capabilities& can, bool back) {
  Stopwatch clock;
  SensorView view = view_of(world_.prepared(), simulated_, can);
  if (host_.seen.pictures || (host_.draw && settings_.expectation.any_in_frame())) require_no_others(view);
  // Another exposure or noise changes every pixel: to a detector that reads them nothing is as recorded.
  if (can.why_whole.empty() && !(world_.changes_picture() && can.reads_image)) {
    clean_ = clean_view(world_.prepared(), changed_);
    view.clean = &clean_;
  }
  if (back && can.knows_presence && world_.simulation().lidar_gradient == LidarGradient::silhouette &&
      settings_.target != AttackTarget::image && settings_.parts != AttackParts::texture)
    silhouette_ = lidar_silhouette(world_.prepared(), placed_adversary(simulated_));
  view.watched = silhouette_.places;
  seconds_.simulation_forward += clock.lap();
  return view;
}

AdversaryGradient Observation::vjp(const SensorGradient& gradient) const {
  Upstream<float> upstream;
  if (settings_.target != AttackTarget::lidar && !gradient.image.empty())
    upstream = {gradient.image.data.data(), gradient.image.width, gradient.image.height};
  std::vector<const float*> others = others_of(gradient, world_.prepared().frame, simulated_);
  for (std::size_t k = 0; k < others.size(); ++k) {
    const bool camera = k < simulated_.others.size();
    if (settings_.target != AttackTarget::both && !(camera && settings_.target == AttackTarget::image))
      others[k] = nullptr;
  }
  upstream.others = others;
  if (settings_.target != AttackTarget::image) upstream.points = gradient.points;
  upstream.silhouette = &silhouette_;
  upstream.presence = gradient.presence;
  AdversaryGradient designed = simulate_vjp(simulated_, upstream);
  world_.vjp(designed);
  return designed;
}

}  // namespace mirage
