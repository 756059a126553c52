#include "generator/generator.h"

#include <fmt/format.h>

#include <map>

#include "base/random.h"
#include "generator/appearance.h"
#include "generator/labels.h"
#include "generator/street.h"
#include "sensors/lidar_sweep.h"
#include "sensors/ray_camera.h"

namespace mirage {
namespace {

FrameTruth make_truth(const generator::Street& street, const std::vector<int>& line, const RayImage& picture,
                      const std::vector<int>& objects) {
  FrameTruth truth{picture.depth, {picture.object.width, picture.object.height, 1}, {}};
  for (std::size_t i = 0; i < picture.object.data.size(); ++i)
    if (const int object = picture.object.data[i]; object >= 0)
      truth.instance.data[i] = static_cast<std::uint16_t>(line[static_cast<std::size_t>(object)] + 1);
  for (int object : objects) {
    std::uint32_t word = 0;
    if (object >= 0) {
      const auto k = static_cast<std::size_t>(object);
      word = static_cast<std::uint32_t>(line[k] + 1) << 16 | semantic_class(street.placed[k].type);
    }
    truth.returns.push_back(word);
  }
  return truth;
}

}  // namespace

std::uint16_t semantic_class(const std::string& type) {
  static const std::map<std::string, std::uint16_t> classes = {
      {"Car", 10}, {"Van", 10}, {"Truck", 18}, {"Misc", 20}, {"Pedestrian", 30}, {"Cyclist", 31}};
  const auto entry = classes.find(type);
  return entry == classes.end() ? 0 : entry->second;
}

Frame generate_frame(const Rig& rig, std::uint64_t seed, std::uint64_t index, FrameTruth* truth) {
  const generator::Street street = generator::make_street(seed, index, rig.lidar.height, rig.look);
  const SceneLight light = generator::make_light(seed, index);
  const RayScene scene(street.surfaces);
  RayCameraSettings settings;
  settings.sparse = true;
  settings.seed = RandomStream(seed, "camera", index).next_u32();
  const RayImage picture =
      render(scene, rig.calibration.camera, rig.calibration.camera_from_velo, light, settings);

  Frame frame;
  frame.id = fmt::format("{:06}", index);
  frame.image = picture.color;
  generator::expose(frame.image, seed, index);
  std::vector<int> objects;
  frame.sweep = simulate_sweep(scene, rig.lidar, RandomStream(seed, "lidar", index).next_u32(),
                               generated_sweep_effects(), &objects);
  frame.calibration = rig.calibration;
  generator::StreetLabels labelled =
      generator::label_street(street, rig.calibration, picture.object, objects);
  frame.labels = std::move(labelled.labels);
  frame.lighting = light.lighting;
  if (truth) *truth = make_truth(street, labelled.line, picture, objects);
  return frame;
}

}  // namespace mirage
