// A made-up data set in which picture and sweep both show where the one car stands, and detectors that read
// one of them.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "base/error.h"
#include "detection/detector.h"
#include "scene/data/kitti.h"

namespace mirage::test {

inline constexpr int kPlaces = 12;

inline double place(int k) {
  return 10 + 3 * k;
}

/// A frame with one car ahead. Its brightness encodes the car's place, and its returns show it.
inline Frame planted_frame(int k, int width = 48) {
  Frame frame;
  frame.id = "00000" + std::string(1, static_cast<char>('a' + k));
  frame.image = ImageF(width, 32, 3);
  for (float& value : frame.image.data) value = static_cast<float>((k + 0.5) / kPlaces);
  frame.calibration.camera = {40, 40, width / 2.0, 16, width, 32};
  frame.calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  for (const float along : {-1.0f, 0.0f, 1.0f, 1.5f})
    frame.sweep.push_back({static_cast<float>(place(k)) + along, 0.2f, -1, 0.3f});
  Label car;
  car.type = "Car";
  car.left = 20, car.top = 2, car.right = 28, car.bottom = 30;
  car.box = {{place(k), 0, 4, 2, 0}, -1.7, 1.5};
  frame.labels.push_back(car);
  return frame;
}

inline void write_planted(const std::filesystem::path& data) {
  for (int k = 0; k < kPlaces; ++k) write_frame(data, planted_frame(k));
}

enum class Eyes { sees, needs_a_picture, ignores, glances };

/// Finds the car by the picture's brightness or by its returns.
class Planted : public Detector {
 public:
  explicit Planted(Eyes eyes, std::string name = "planted") : eyes_(eyes), name_(std::move(name)) {}
  std::string name() const override { return name_; }
  Capabilities capabilities() const override {
    Capabilities can;
    can.reads_image = name_ != "lidar";
    return can;
  }
  std::array<double, 4> region() const override { return {0, 60, -25, 25}; }
  std::vector<Detection> forward(const SensorView& input, double, bool) override {
    ++passes;
    const bool picture = input.image != nullptr && !input.image->empty();
    const double bright = picture ? input.image->data[0] : 0;
    if (eyes_ == Eyes::sees || eyes_ == Eyes::needs_a_picture) {
      if (!picture && eyes_ == Eyes::needs_a_picture) throw Failure("planted", "no picture", "give one");
      if (!picture) return {};
      return {{{place(static_cast<int>(bright * kPlaces)), 0, 4, 2, 0}, 3}};
    }
    double x = 0;
    for (const LidarPoint& point : input.points) x += point.x / static_cast<double>(input.points.size());
    return {{{x, 0, 4, 2, 0}, eyes_ == Eyes::glances ? 3 + 0.3 * bright : 3}};
  }
  SensorGradient backward(std::span<const double>) override { return {}; }
  TrainingLoss train_step(std::span<const TrainingSample>, double) override { return {}; }
  void save(const std::filesystem::path&, bool) override {}

  int passes = 0;  ///< of forward

 private:
  Eyes eyes_;
  std::string name_;
};

}  // namespace mirage::test
