#include "validation/fidelity/arms.h"

#include <utility>
#include <vector>

#include "base/random.h"
#include "simulation/adversary_lidar.h"
#include "validation/fidelity/lidar_ladder.h"

namespace mirage {
namespace {

Sweep sweep_with(const HostScene& scene, const LidarEffects& effects) {
  SimulationSettings settings = scene.simulation;
  settings.lidar_effects = effects;
  Simulated simulated;
  draw_in_lidar(*scene.prepared, scene.placed, settings, simulated);
  return std::move(simulated.sweep);
}

ImageF picture_under(const HostScene& scene, const Simulated& attacked, LightModel light) {
  if (scene.simulation.light == light) return attacked.image;
  SimulationSettings settings = scene.simulation;
  settings.light = light;
  return simulate_host(scene, settings).image;
}

}  // namespace

ImageF noise_in_place(const Simulated& simulated, const ImageF& photograph, std::uint64_t seed) {
  ImageF image = photograph;
  RandomStream random(seed, "noise in the object's place");
  for (int v = simulated.rect.v0; v < simulated.rect.v1; ++v)
    for (int u = simulated.rect.u0; u < simulated.rect.u1; ++u) {
      const double covered = rgba_at(simulated, u, v, 3);
      for (int c = 0; c < image.channels; ++c)
        image.at(u, v, c) =
            static_cast<float>((1 - covered) * image.at(u, v, c) + covered * random.uniform());
    }
  return image;
}

ArmsResult look_at_arms(const HostScene& scene, const Simulated& attacked, const Simulated& learned,
                        const FullLight& full, const LookAt& look) {
  const Frame& frame = scene.prepared->frame;
  const Sweep ideal = sweep_with(scene, {}), realistic = sweep_with(scene, realistic_returns(scene));
  const ImageF raster = picture_under(scene, attacked, LightModel::plain),
               visible = picture_under(scene, attacked, LightModel::visible);
  ArmsResult result;
  result.arms.push_back({{ArmLight::learned, ArmReturns::learned}, look(learned.image, learned.sweep)});
  const std::pair<ArmLight, const ImageF*> pictures[] = {
      {ArmLight::raster, &raster}, {ArmLight::visible, &visible}, {ArmLight::cycles, &full.image}};
  for (const auto& [light, image] : pictures) {
    result.arms.push_back({{light, ArmReturns::ideal}, look(*image, ideal)});
    result.arms.push_back({{light, ArmReturns::realistic}, look(*image, realistic)});
  }
  const auto control = [&](Channel channel, const char* name, const ImageF& image, const Sweep& sweep) {
    result.controls.push_back({{channel, name}, look(image, sweep)});
  };
  control(Channel::image, "noise", noise_in_place(learned, frame.image, scene.seed), learned.sweep);
  control(Channel::image, "photograph", frame.image, learned.sweep);
  control(Channel::lidar, "no returns", learned.image, frame.sweep);
  return result;
}

}  // namespace mirage
