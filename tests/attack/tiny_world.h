// A data set of a few tiny frames and a differentiable stand-in for a network, so that the attack loop can be
// tested without a network.
#pragma once

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "attack/detector_pool.h"
#include "attack/run.h"
#include "base/files.h"
#include "base/sizes.h"
#include "detection/detector.h"
#include "generator/car_body.h"
#include "scene/data/kitti.h"
#include "sensors/ray_caster.h"

namespace mirage::test {

/// KITTI's LiDAR returns from flat ground ahead, every eighth firing, and from a car of the family that fills
/// `box`, if given. They are ordered laser by laser, like KITTI's sweeps.
inline Sweep tiny_sweep(const Box3* box) {
  constexpr double kGround = -1.73;
  constexpr int kEvery = 8;
  const LidarModel lidar = read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"));
  RandomStream random(1, "tiny world");
  Mesh car = car_mesh(draw_body(BodyStyle::hatchback, random));
  const Vec3d size = bounds(car).sizes();
  if (box)
    for (Vec3d& v : car.vertices)
      v = velo_from_box(*box) *
          v.cwiseProduct(Vec3d(box->bev.length, box->bev.width, box->height).cwiseQuotient(size));
  const RayCaster caster({&car, 1});
  const auto hit_by = [&](const LidarRay& ray) {
    const Hit hit = caster.intersect({ray.origin.cast<float>(), ray.direction.cast<float>()});
    return box && hit.hit() ? hit.t : 0.f;
  };
  const int beams = static_cast<int>(lidar.beams.size());
  std::vector<bool> fires(as_size(lidar.azimuth_count()));
  for (int column = 0; column < lidar.azimuth_count(); ++column)
    for (int beam = 0; beam < beams; ++beam)
      if (column % kEvery == 0 || hit_by(lidar.ray(beam, column)) > 0) fires[as_size(column)] = true;
  Sweep sweep;
  for (int beam = 0; beam < beams; ++beam)
    for (int column = 0; column < lidar.azimuth_count(); ++column) {
      if (!fires[as_size(column)]) continue;
      const LidarRay ray = lidar.ray(beam, column);
      const float on_car = hit_by(ray);
      const double to_ground = (kGround - ray.origin.z()) / ray.direction.z();
      const Vec3f p = (ray.origin + (on_car > 0 ? on_car : to_ground) * ray.direction).cast<float>();
      if (on_car > 0)
        sweep.push_back({p.x(), p.y(), p.z(), 0.3f});
      else if (to_ground > 0 && p.x() > 6 && p.x() < 40 && std::abs(p.y()) <= 0.35f * p.x())
        sweep.push_back({p.x(), p.y(), p.z(), 0.2f});
    }
  return sweep;
}

/// Few hosts per step, with the paper's slow rates and free mesh.
inline AttackSettings tiny_attack() {
  AttackSettings settings;
  settings.buildable.on = false;
  settings.batch = 2;
  settings.vertex_rate = 1e-3;
  settings.texel_rate = 4e-3;
  return settings;
}

/// The car of write_tiny_data in a frame, where StandInDetector finds it.
inline BevBox tiny_car(int frame) {
  return {11.4 + 0.04 * frame, 0.02 * frame, 3.9, 1.6, 0.01 * frame};
}

/// Flat ground and one car per frame, with or without LiDAR returns on it; a fifth of KITTI's image size.
inline void write_tiny_data(const std::filesystem::path& data, int frames, bool returns = false) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);  // the parent of scenes/rigs
  setenv("MIRAGE_CACHE", "off", 0);         // unless a test sets it
  for (int i = 0; i < frames; ++i) {
    Frame frame;
    frame.id = "00000" + std::to_string(i);
    frame.calibration.camera = {144, 144, 122, 35, 248, 75};
    Eigen::Matrix3d axes;
    axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    frame.calibration.camera_from_velo.linear() = axes;
    frame.calibration.camera_from_velo.translation() = Vec3d(0, -0.08, -0.27);
    frame.image = ImageF(248, 75, 3, 0.3f);
    Label car;
    car.type = "Car";
    car.box = {tiny_car(i), -1.73, 1.5};
    car.left = 90, car.right = 150, car.top = 20, car.bottom = 60;
    frame.labels = {car};
    frame.sweep = tiny_sweep(returns ? &car.box : nullptr);
    frame.sweep.front().reflectance += 1e-3f * static_cast<float>(i);  // no two sweeps are equal
    write_frame(data, frame);
  }
}

/// Writes the run.json that `mirage attack` would write with these settings.
inline void write_run_json(const std::filesystem::path& run, const AttackSettings& settings,
                           const std::vector<HostId>& train, const std::vector<HostId>& test) {
  nlohmann::json json = identity(settings).json;
  json["train"] = to_json(train);
  json["test"] = to_json(test);
  write_json(run / "run.json", json);
}

/// One proposal on every frame's car. Its logit rises with the image's brightness inside a fixed window and
/// falls with the number of points near the car's roof, smoothly.
class StandInDetector : public Detector {
 public:
  std::string name() const override { return "stand-in"; }
  std::array<double, 4> region() const override { return {0, 50, -25, 25}; }
  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool) override {
    image_ = *input.image;
    points_.assign(input.points.begin(), input.points.end());
    double logit = 1;
    for (float value : image_.data) logit += kImage * (value - 0.3);
    for (const LidarPoint& p : points_) logit += kPoints * weight(p);
    const Detection proposal{{11.5, 0, 4, 1.7, 0}, logit};
    if (proposal.score() <= score_threshold) return {};
    return {proposal};
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient gradient{ImageF(image_.width, image_.height, 3), {}};
    for (float& d : gradient.image.data) d = static_cast<float>(kImage * d_logits[0]);
    for (const LidarPoint& p : points_) {
      const double w = -2 * kPoints * weight(p) * d_logits[0];
      gradient.points.push_back({float(w * (p.x - 11)), float(w * p.y), float(w * p.z), 0});
    }
    return gradient;
  }
  TrainingLoss train_step(std::span<const TrainingSample>, double) override { return {}; }
  void save(const std::filesystem::path&, bool) override {}

 protected:
  static constexpr double kImage = 1e-2, kPoints = -2e-2;
  static double weight(const LidarPoint& p) {
    return std::exp(-(p.x - 11) * (p.x - 11) - p.y * p.y - p.z * p.z);
  }

 private:
  ImageF image_;
  std::vector<LidarPoint> points_;
};

/// The same for the picture alone: its proposal is the box in the picture of every label of the tiny data.
class PictureStandIn : public StandInDetector {
 public:
  Capabilities capabilities() const override { return {true, false, false, true}; }
  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    auto found = StandInDetector::forward({input.image, {}, input.calibration}, score_threshold, keep_graph);
    for (Detection& proposal : found) {
      proposal.box = {};
      proposal.picture = {90, 20, 150, 60};
    }
    return found;
  }
};

/// Finds the car in every frame of the tiny data; its logit rises with the picture's brightness.
class Everywhere : public test::StandInDetector {
 public:
  std::vector<Detection> forward(const SensorView& input, double threshold, bool keep) override {
    returns_ = input.points.size();
    const auto one = StandInDetector::forward({input.image, {}, input.calibration}, 0, keep);
    const double sure = one.empty() ? 0 : logit(input, one[0].logit);
    std::vector<Detection> found;
    for (int i = 0; i < 6; ++i) found.push_back({test::tiny_car(i), sure});
    return found[0].score() > threshold ? found : std::vector<Detection>();
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    double sum = 0;
    for (const double d : d_logits) sum += d;
    SensorGradient gradient = StandInDetector::backward({{sum}});
    gradient.points.resize(returns_);
    return gradient;
  }

 protected:
  virtual double logit(const SensorView&, double stand_in) const { return stand_in; }

 private:
  std::size_t returns_ = 0;
};

/// A pool of one.
template <class Kind>
DetectorPool one_of() {
  DetectorPool pool;
  pool.push_back(std::make_unique<Kind>());
  return pool;
}

}  // namespace mirage::test
