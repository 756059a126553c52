#include "detection/ceiling_detector.h"

#include <optional>
#include <utility>
#include <vector>

#include "detection/around.h"
#include "detection/body_evidence.h"

namespace mirage {
namespace {

/// Zeroes the pixels of `image` that see nothing below z = `plane` (m, `velo`) up to `reach` m ahead: on a
/// line of sight o + t d the height at that distance is above the plane where (o_z − plane) d_x + (reach −
/// o_x) d_z is positive.
void hide_above(ImageF& image, const Calibration& calibration, double plane, double reach) {
  const Transform velo_from_camera = calibration.camera_from_velo.inverse();
  const Vec3d o = velo_from_camera.translation(),
              above = velo_from_camera.linear().transpose() * Vec3d(o.z() - plane, 0, reach - o.x());
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u) {
      if (above.dot(calibration.camera.unproject(u, v, 1)) <= 0) continue;
      for (int c = 0; c < image.channels; ++c) image.at(u, v, c) = 0;
    }
}

/// What is left of a frame, and which of its places.
struct Below {
  ImageF image;
  std::vector<LidarPoint> points, watched;
  std::vector<std::size_t> kept, kept_watched;  ///< their indices in the frame
};

class CeilingDetector : public DetectorAround {
 public:
  CeilingDetector(std::unique_ptr<Detector> inner, double height, double unit_height)
      : DetectorAround(std::move(inner)), height_(height), unit_height_(unit_height) {}

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    below_ = {}, clean_below_ = {};
    SensorView seen = lowered(view, below_);
    if (view.clean) {
      const SensorView lower =
          lowered({view.clean->image, view.clean->points, view.calibration}, clean_below_);
      clean_ = {lower.image, lower.points, view.clean->key, view.clean->changed};
      seen.clean = &clean_;
    }
    count_ = view.points.size(), watched_count_ = view.watched.size();
    calibration_.reset();
    if (seen.image && view.calibration) calibration_ = *view.calibration;
    return inner_->forward(seen, score_threshold, keep_graph);
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient below = inner_->backward(d_logits), all;
    if (calibration_) hide_above(below.image, *calibration_, plane(), reach());
    all.image = std::move(below.image);
    all.points.resize(count_);
    for (std::size_t i = 0; i < below.points.size(); ++i) all.points[below_.kept.at(i)] = below.points[i];
    if (!below.presence.empty()) all.presence.resize(watched_count_);
    for (std::size_t i = 0; i < below.presence.size(); ++i)
      all.presence[below_.kept_watched.at(i)] = below.presence[i];
    return all;
  }

  TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) override {
    std::vector<Below> below(samples.size());
    std::vector<TrainingSample> seen(samples.begin(), samples.end());
    for (std::size_t i = 0; i < seen.size(); ++i) seen[i].input = lowered(samples[i].input, below[i]);
    return inner_->train_step(seen, learning_rate);
  }
  std::unique_ptr<Detector> share() override {
    auto other = inner_->share();
    return other ? under_ceiling(std::move(other), height_, unit_height_) : nullptr;
  }
  ImageFeatures image_features(const SensorView& input) override {
    Below below;
    return inner_->image_features(lowered(input, below));
  }

 private:
  double plane() const { return height_ - unit_height_; }
  double reach() const { return inner_->region()[1]; }

  /// The view of what lies below the ceiling, which lives in `below`; without a clean one.
  SensorView lowered(SensorView view, Below& below) const {
    const RoadSurface road(view.points);
    const auto keep = [&](std::span<const LidarPoint> points, auto& kept, auto& indices) {
      for (std::size_t i = 0; i < points.size(); ++i) {
        if (points[i].z > road.height(points[i].x, points[i].y) + height_) continue;
        kept.push_back(points[i]);
        indices.push_back(i);
      }
    };
    keep(view.points, below.points, below.kept);
    keep(view.watched, below.watched, below.kept_watched);
    view.points = below.points, view.watched = below.watched, view.clean = nullptr;
    if (view.image && !view.image->empty() && view.calibration) {
      below.image = *view.image;
      hide_above(below.image, *view.calibration, plane(), reach());
      view.image = &below.image;
    }
    return view;
  }

  double height_, unit_height_;
  // Of the last forward: what the inner detector looks at until its backward pass is done.
  Below below_, clean_below_;
  CleanView clean_;
  std::size_t count_ = 0, watched_count_ = 0;
  std::optional<Calibration> calibration_;  ///< if it had a picture
};

}  // namespace

std::unique_ptr<Detector> under_ceiling(std::unique_ptr<Detector> inner, double height, double unit_height) {
  return std::make_unique<CeilingDetector>(std::move(inner), height, unit_height);
}

}  // namespace mirage
