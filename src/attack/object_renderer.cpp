#include "attack/object_renderer.h"

#include <cmath>

#include "base/random.h"
#include "simulation/object_window.h"

namespace mirage {
namespace {

constexpr std::size_t kMostKept = std::size_t{1} << 28;  // values: 1 GiB

double mean_square(const std::vector<Vec3d>& from, const std::vector<Vec3d>& to) {
  double sum = 0;
  for (std::size_t i = 0; i < from.size(); ++i) sum += (to[i] - from[i]).squaredNorm();
  return from.empty() ? 0 : sum / static_cast<double>(from.size());
}

bool same_mesh(const TexturedMesh& a, const TexturedMesh& b) {
  return a.mesh.vertices == b.mesh.vertices && a.atlas.texels == b.atlas.texels;
}

}  // namespace

bool has_moved(const TexturedMesh& from, const TexturedMesh& to, const Renewal& renewal) {
  return std::sqrt(mean_square(from.mesh.vertices, to.mesh.vertices)) > renewal.metres ||
         std::sqrt(mean_square(from.atlas.texels, to.atlas.texels) / 3) > renewal.texels;
}

std::shared_ptr<const RenderedPictures::Correction> RenderedPictures::make(const HostInWorld& host,
                                                                           const TexturedMesh& adversary,
                                                                           const RenderedMesh& rendered,
                                                                           const Simulated& simulated) const {
  const Frame& frame = host.prepared.frame;
  Simulated then;
  // What the renderer draws is ideal; lens and sensor come after the light.
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
    if (const auto known = corrections_.find(name);
        known != corrections_.end() && known->second->world == host.world)
      correction = known->second;
  }
  if (!correction) {
    correction = make(host, adversary, rendered, simulated);
    const std::scoped_lock lock(mutex_);
    if (keep && iteration_ == rendered.iteration) {
      if (kept_ > kMostKept) corrections_.clear(), kept_ = 0;  // they are made again, to the same bits
      kept_ += correction->difference.data.size();
      corrections_[name] = correction;
    }
  }
  add_to_picture(correction->difference, correction->rect, simulated);
  return correction->rect;
}

}  // namespace mirage
