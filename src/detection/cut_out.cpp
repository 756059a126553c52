#include "detection/cut_out.h"

#include <algorithm>
#include <cmath>

#include "base/color.h"
#include "scene/data/read_frames.h"
#include "scene/data/truth_files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

void cut_pixels(CutOut& car, const ImageF& image, const Image<std::uint16_t>& instances, int instance) {
  PixelRect rect{image.width, image.height, 0, 0};
  const auto is_car = [&](int u, int v) { return instances.at(u, v) == instance; };
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u)
      if (is_car(u, v))
        rect = {std::min(rect.u0, u), std::min(rect.v0, v), std::max(rect.u1, u + 1),
                std::max(rect.v1, v + 1)};
  if (rect.empty()) return;
  car.rect = rect;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u) {
      car.mask.push_back(is_car(u, v));
      for (int c = 0; c < 3; ++c)
        car.srgb.push_back(static_cast<std::uint8_t>(std::lround(255 * srgb_from_linear(image.at(u, v, c)))));
    }
}

}  // namespace

bool may_be_cut_out(const Label& label, const std::array<double, 4>& region) {
  return label.occluded == 0 && counts_by_label(label, region);
}

std::vector<CutOut> cut_out_cars(const fs::path& data, const std::string& id,
                                 const std::array<double, 4>& region, bool with_picture) {
  const Frame frame = read_frame(data, id);
  const fs::path label_file = point_label_file(data, id);
  std::vector<std::uint32_t> owner;
  if (fs::exists(label_file)) owner = read_point_labels(label_file, frame.sweep.size());
  Image<std::uint16_t> instances;
  if (with_picture) instances = read_instances(data, id, frame.image.width, frame.image.height);
  std::vector<CutOut> cars;
  for (std::size_t k = 0; k < frame.labels.size(); ++k) {
    const Label& label = frame.labels[k];
    if (!may_be_cut_out(label, region)) continue;
    CutOut car;
    car.box = label.box;
    car.difficulty = easiest_level(label);
    car.picture = picture_box(label);
    car.camera = frame.calibration.camera;
    car.camera_from_velo = frame.calibration.camera_from_velo;
    Box3 body = label.box;
    body.bottom += 0.2;  // with the margin: all but the lowest 0.1 m
    body.height -= 0.2;
    for (std::size_t i = 0; i < frame.sweep.size(); ++i)
      if (owner.empty() ? contains(body, frame.sweep[i].position().cast<double>(), 0.1)
                        : owner[i] >> 16 == k + 1)
        car.points.push_back(frame.sweep[i]);
    if (with_picture) cut_pixels(car, frame.image, instances, static_cast<int>(k) + 1);
    if (car.points.size() >= kLeastPoints && !(with_picture && car.rect.empty()))
      cars.push_back(std::move(car));
  }
  return cars;
}

}  // namespace mirage
