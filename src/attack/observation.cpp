#include "attack/observation.h"

#include <array>
#include <cmath>
#include <cstring>

#include "base/error.h"
#include "base/memory.h"
#include "base/random.h"
#include "base/ranks.h"
#include "detection/car_in_picture.h"
#include "simulation/render_scene.h"
#include "simulation/sensor_pass.h"

namespace mirage {
namespace {

constexpr std::size_t kMaxKeptValues = std::size_t{1} << 28;  // values: 1 GiB

double mean_square(const std::vector<Vec3d>& from, const std::vector<Vec3d>& to) {
  double sum = 0;
  for (std::size_t i = 0; i < from.size(); ++i) sum += (to[i] - from[i]).squaredNorm();
  return from.empty() ? 0 : sum / static_cast<double>(from.size());
}

bool same_mesh(const TexturedMesh& a, const TexturedMesh& b) {
  return a.mesh.vertices == b.mesh.vertices && a.atlas.texels == b.atlas.texels;
}

/// Eight independent sums of products of 8 bytes each, as fast as memory. Distinguishes contents; not
/// cryptographic.
class Hash {
 public:
  void add(const void* bytes, std::size_t size) {
    const auto* from = static_cast<const std::byte*>(bytes);
    for (; size >= kBlock; size -= kBlock, from += kBlock) {
      std::array<std::uint64_t, kLanes> words;
      std::memcpy(words.data(), from, kBlock);
      for (std::size_t k = 0; k < kLanes; ++k)
        lanes_[k] = std::rotl(lanes_[k] ^ words[k], 29) * 0x9e3779b97f4a7c15ull;
    }
    std::array<std::uint64_t, kLanes> rest{};
    copy_bytes(rest.data(), from, size);
    for (std::size_t k = 0; k < kLanes; ++k)
      lanes_[k] = std::rotl(lanes_[k] ^ rest[k] ^ size, 31) * 0xbf58476d1ce4e5b9ull;
  }
  std::uint64_t value() const {
    std::uint64_t all = 0;
    for (const std::uint64_t lane : lanes_) all = (all ^ lane ^ (all >> 31)) * 0x94d049bb133111ebull;
    return all ^ (all >> 29);
  }

 private:
  static constexpr std::size_t kLanes = 8, kBlock = kLanes * sizeof(std::uint64_t);
  std::array<std::uint64_t, kLanes> lanes_ = {1, 2, 3, 4, 5, 6, 7, 8};
};

/// The stages by their keys in result.json.
constexpr std::pair<const char*, double HostTimings::*> kHostTimings[] = {
    {"simulation_forward", &HostTimings::simulation_forward},
    {"simulation_vjp", &HostTimings::simulation_vjp},
    {"detector_forward", &HostTimings::detector_forward},
    {"detector_backward", &HostTimings::detector_backward},
    {"worlds", &HostTimings::worlds},
    {"rendering", &HostTimings::rendering},
    {"rest", &HostTimings::rest}};
constexpr std::pair<const char*, double StepTimings::*> kStepTimings[] = {
    {"input", &StepTimings::input},
    {"hosts", &StepTimings::hosts},
    {"exchange", &StepTimings::exchange},
    {"optimiser", &StepTimings::optimiser},
    {"files", &StepTimings::files}};

/// InputError if the view has sensors besides the first camera and the LiDAR: drawn environments
/// (attack/eot.h) and renderers do not support them.
void require_no_others(const SensorView& view) {
  if (view.others.empty()) return;
  throw InputError("expect, renderer", view.others[0].name,
                   "is not drawn by them: they know of a frame's first camera and LiDAR alone",
                   "leave them off with a detector that reads further sensors");
}

/// For Upstream::others: the detector's gradient to each of Simulated::others and Simulated::measurements,
/// null if it gave none, or the object changed nothing. It points into `gradient`.
std::vector<const float*> others_of(const SensorGradient& gradient, const Frame& frame,
                                    const Simulated& simulated) {
  std::vector<const float*> others;
  const auto add = [&](const std::string& name, std::size_t values) {
    const auto gradient_of_sensor = gradient.others.find(name);
    const bool there = gradient_of_sensor != gradient.others.end() && values > 0 &&
                       gradient_of_sensor->second.size() == values;
    others.push_back(there ? gradient_of_sensor->second.data() : nullptr);
  };
  for (std::size_t k = 0; k < simulated.others.size(); ++k)
    add(frame.others[k].name, simulated.others[k].rect.empty() ? 0 : simulated.others[k].image.data.size());
  for (const Measurement& measured : simulated.measurements) add(measured.name, measured.data.size());
  return others;
}

}  // namespace

bool has_moved(const TexturedMesh& from, const TexturedMesh& to, const RedrawThresholds& redraw) {
  return std::sqrt(mean_square(from.mesh.vertices, to.mesh.vertices)) > redraw.metres ||
         std::sqrt(mean_square(from.atlas.texels, to.atlas.texels) / 3) > redraw.texels;
}

std::shared_ptr<const RenderedPictures::Correction> RenderedPictures::make(const HostInWorld& host,
                                                                           const TexturedMesh& adversary,
                                                                           const RenderedMesh& rendered,
                                                                           const Simulated& simulated) const {
  const Frame& frame = host.prepared.frame;
  Simulated then;
  // The renderer's picture is ideal; lens and sensor effects come afterwards.
  SimulationSettings ideal = host.simulation;
  ideal.camera_effects = {};
  const bool now = same_mesh(adversary, rendered.mesh) && !host.simulation.camera_effects.any();
  if (!now) then = simulate(host.prepared, host.placement, rendered.mesh, ideal);
  const Simulated& at = now ? simulated : then;
  auto correction = std::make_shared<Correction>();
  correction->world = host.world;
  if (at.rect.empty()) return correction;
  RandomStream random(seed_, "rendered " + host_name(host.host),
                      static_cast<std::uint64_t>(rendered.iteration));
  ObjectRenderer::Window window = renderer_.draw(host, rendered.mesh, at, random.next_u32());
  const ImageF raster = radiance_of(at, frame.image, window.rect);
  correction->rect = window.rect;
  correction->difference = std::move(window.picture);
  for (std::size_t i = 0; i < raster.data.size(); ++i) correction->difference.data[i] -= raster.data[i];
  if (const double blur = host.simulation.camera_effects.blur_sigma; blur > 0)
    soften(correction->difference, blur);
  return correction;
}

PixelRect RenderedPictures::correct(const HostInWorld& host, const TexturedMesh& adversary,
                                    const RenderedMesh& rendered, Simulated& simulated) {
  const std::string name = host_name(host.host);
  std::shared_ptr<const Correction> correction;
  const bool keep = rendered.iteration >= 0;
  if (keep) {
    const std::scoped_lock lock(mutex_);
    if (iteration_ != rendered.iteration) corrections_.clear(), kept_ = 0;
    iteration_ = rendered.iteration;
    if (const auto cached = corrections_.find(name);
        cached != corrections_.end() && cached->second->world == host.world)
      correction = cached->second;
  }
  if (!correction) {
    correction = make(host, adversary, rendered, simulated);
    const std::scoped_lock lock(mutex_);
    if (keep && iteration_ == rendered.iteration) {
      if (kept_ > kMaxKeptValues) corrections_.clear(), kept_ = 0;  // they are recomputed to the same bits
      kept_ += correction->difference.data.size();
      corrections_[name] = correction;
    }
  }
  add_to_picture(correction->difference, correction->rect, simulated);
  return correction->rect;
}

SensorView view_of(const PreparedFrame& prepared, const Simulated& simulated, const Capabilities& can) {
  const Frame& frame = prepared.frame;
  SensorView view = view_of(frame, simulated.image, simulated.sweep);
  for (std::size_t k = 0; k < frame.others.size(); ++k)
    if (const ImageF& image = simulated.others[k].image; !image.empty() && can.names(frame.others[k].name))
      view.others.push_back(sensor_beside(frame, k, &image));
  for (std::size_t k = 0; k < simulated.measurements.size(); ++k)
    if (const Measurement& measured = simulated.measurements[k]; can.names(measured.name)) {
      view.others.push_back(sensor_beside(frame, frame.others.size() + k));
      view.others.back().values = measured.data;
    }
  return view;
}

UnchangedInput unchanged_input(const PreparedFrame& prepared, const PixelRect& changed) {
  const Frame& frame = prepared.frame;
  Hash hash;
  hash.add(frame.image.data.data(), frame.image.data.size() * sizeof(float));
  hash.add(frame.sweep.data(), frame.sweep.size() * sizeof(LidarPoint));
  const std::array<double, 12> projection = pixel_from_velo(frame.calibration);
  hash.add(projection.data(), sizeof(projection));
  return {&frame.image, frame.sweep, hash.value(), changed};
}

HostTimings& HostTimings::operator+=(const HostTimings& other) {
  for (const auto& [name, stage] : kHostTimings) this->*stage += other.*stage;
  return *this;
}

StepTimings& StepTimings::operator+=(const StepTimings& other) {
  for (const auto& [name, stage] : kStepTimings) this->*stage += other.*stage;
  threads += other.threads;
  return *this;
}

nlohmann::json to_json(const StepTimings& stages, double seconds, long iterations, std::size_t workers) {
  const double n = iterations > 0 ? static_cast<double>(iterations) : 1;
  double accounted = 0;
  nlohmann::json wall, threads;
  for (const auto& [name, stage] : kStepTimings) accounted += stages.*stage, wall[name] = stages.*stage / n;
  for (const auto& [name, stage] : kHostTimings) threads[name] = stages.threads.*stage / n;
  wall["rest"] = (seconds - accounted) / n, wall["total"] = seconds / n;
  return {{"iterations", iterations},
          {"threads", workers},
          {"ranks", rank_count()},
          {"wall_seconds", wall},
          {"thread_seconds", threads}};
}

Observation::Observation(const StepHost& host, const TexturedMesh& adversary,
                         const SimulationSettings& simulation)
    : host_(host), world_(host.draw, host.prepared, host.placement, adversary, simulation) {
  seconds_.worlds = clock_.lap();
  simulated_ = simulate(world_.prepared(), world_.placement(), world_.object(), world_.simulation());
  seconds_.simulation_forward = clock_.lap();
  changed_ = simulated_.rect;
  if (host.pictures) {
    const HostInWorld in_world{world_.prepared(), host.id, world_.placement(), world_.simulation(),
                               host.draw ? host.draw->number() : 0};
    changed_ =
        united(changed_, host.pictures->correct(in_world, world_.object(), *host.rendered, simulated_));
  }
  seconds_.rendering = clock_.lap();
  if (host.draw) host.draw->add_noise(simulated_.image);
  seconds_.worlds += clock_.lap();
}

SensorView Observation::view(const Capabilities& can, bool local) {
  Stopwatch clock;
  SensorView view = view_of(world_.prepared(), simulated_, can);
  if (host_.pictures || (host_.draw && host_.draw->expectation().any_in_frame())) require_no_others(view);
  if (local) {
    clean_ = unchanged_input(world_.prepared(), changed_);
    view.clean = &clean_;
  }
  seconds_.simulation_forward += clock.lap();
  return view;
}

void Observation::watch(SensorView& view) {
  if (world_.simulation().lidar_gradient != LidarGradient::silhouette) return;
  Stopwatch clock;
  silhouette_ = lidar_silhouette(world_.prepared(), placed_adversary(simulated_));
  view.watched = silhouette_.places;
  seconds_.simulation_forward += clock.lap();
}

AdversaryGradient Observation::vjp(const SensorGradient& gradient, AttackTarget target) const {
  Upstream upstream;
  if (target != AttackTarget::lidar && !gradient.image.empty())
    upstream = {gradient.image.data.data(), gradient.image.width, gradient.image.height};
  std::vector<const float*> others = others_of(gradient, world_.prepared().frame, simulated_);
  for (std::size_t k = 0; k < others.size(); ++k) {
    const bool camera = k < simulated_.others.size();
    if (target != AttackTarget::both && !(camera && target == AttackTarget::image)) others[k] = nullptr;
  }
  upstream.others.assign(others.begin(), others.end());
  if (target != AttackTarget::image) upstream.points = gradient.points;
  upstream.silhouette = &silhouette_;
  upstream.presence = gradient.presence;
  AdversaryGradient designed = simulate_vjp(simulated_, upstream);
  world_.vjp(designed);
  return designed;
}

}  // namespace mirage
