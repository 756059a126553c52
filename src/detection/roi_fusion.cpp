#include "detection/roi_fusion.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "detection/defenses.h"
#include "detection/detect.h"
#include "scene/data/kitti_rows.h"

namespace mirage {
namespace {

class RoiFusion : public DetectorWrapper {
 public:
  RoiFusion(std::unique_ptr<Detector> things, std::unique_ptr<Detector> picture)
      : DetectorWrapper(std::move(things)), picture_(std::move(picture)) {
    const auto types = inner_->capabilities().types;
    const auto car = std::find(types.begin(), types.end(), kCars);
    car_ = static_cast<int>(car - types.begin());
  }

  Capabilities capabilities() const override {
    Capabilities can = inner_->capabilities();
    const Capabilities seen = picture_->capabilities();
    can.reads_image = true;
    can.reads = seen.reads;
    if (!can.reads.empty() && !can.names(kFirstLidar)) can.reads.emplace_back(kFirstLidar);
    return can;
  }

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    std::vector<Detection> things = inner_->forward(view, reporting_threshold(score_threshold), keep_graph);
    if (view.image && !view.image->empty() && view.calibration) fuse(things, view);
    return scored_over(std::move(things), score_threshold);
  }

  std::unique_ptr<Detector> share() override {
    auto things = inner_->share(), picture = picture_->share();
    if (!things || !picture) return nullptr;
    return std::make_unique<RoiFusion>(std::move(things), std::move(picture));
  }

 private:
  void fuse(std::vector<Detection>& things, const SensorView& view) {
    const std::vector<Detection> boxes =
        suppress(picture_->forward(view, reporting_threshold(1), false), kInPicture);
    const auto is_car = [&](const Detection& thing) { return thing.type == car_; };
    std::vector<Detection> cars;  // that only the picture shows
    for (Detection& thing : things) {
      const auto place = projected(thing.box, *view.calibration);
      if (!place) continue;
      const std::optional<double> seen = logit_at(*place, boxes);
      if (is_car(thing)) {
        thing.logit += std::max(seen.value_or(kUnseenLogit), kUnseenLogit);
        continue;
      }
      if (!seen) continue;
      const bool called_car = std::any_of(things.begin(), things.end(), [&](const Detection& other) {
        return is_car(other) && contains(other.box, middle_of(thing.box), kMargin);
      });
      if (!called_car) {
        cars.push_back(thing);
        cars.back().type = car_;
        cars.back().logit = std::min(thing.logit, *seen);
      }
      const double still =
          std::clamp(thing.score() * (1 - Detection(BevBox(), *seen).score()), 1e-6, 1 - 1e-6);
      thing.logit = std::log(still / (1 - still));
    }
    things.insert(things.end(), cars.begin(), cars.end());
  }

  static Vec3d middle_of(const Box3& box) { return {box.bev.x, box.bev.y, box.bottom + box.height / 2}; }

  /// Logit of the first camera's box that overlaps the place most.
  static std::optional<double> logit_at(const PictureBox& place, const std::vector<Detection>& boxes) {
    double most = kSamePlace;
    std::optional<double> logit;
    for (const Detection& box : boxes)
      if (const double overlap = box.camera == 0 ? iou(place, box.picture) : 0; overlap > most)
        most = overlap, logit = box.logit;
    return logit;
  }

  static constexpr double kSamePlace = 0.4;  // IoU
  static constexpr double kMargin = 0.2;     // m
  std::unique_ptr<Detector> picture_;
  int car_ = 0;
};

}  // namespace

std::string picture_network(const std::filesystem::path& weights) {
  if (weights.extension() == ".onnx") return "onnx";
  return weights.extension() == ".weights" ? "camera" : "torchscript";
}

std::unique_ptr<Detector> with_picture(std::unique_ptr<Detector> things, std::unique_ptr<Detector> picture) {
  if (!picture->capabilities().finds_picture)
    throw FieldError("weights", picture->name(), "finds no boxes in the picture",
                     things->name() + " takes a network that does, as --detector camera");
  return std::make_unique<RoiFusion>(std::move(things), std::move(picture));
}

}  // namespace mirage
