// A detector with scripted answers and their gradient.
#pragma once

#include <gtest/gtest.h>

#include <utility>

#include "detection/detector.h"

namespace mirage::test {

/// Proposals at fixed places, whose logits are `rest` + weights · (pixel 0, x of point 0).
struct Script {
  struct Line {
    Detection proposal;  ///< its logit is `rest`
    double of_pixel = 0, of_point = 0;
  };
  std::vector<Line> lines;
};

class Scripted : public Detector {
 public:
  Scripted(const char* name, Capabilities can, Script& script)
      : name_(name), can_(std::move(can)), script_(script) {}
  std::string name() const override { return name_; }
  Capabilities capabilities() const override { return can_; }
  std::array<double, 4> region() const override { return {0, 70, -40, 40}; }
  std::vector<Detection> forward(const SensorView& view, double threshold, bool) override {
    std::vector<Detection> found;
    rows_.clear();
    if (view.image) image_ = ImageF(view.image->width, view.image->height, 3);
    points_ = view.points.size();
    for (const Script::Line& line : script_.lines) {
      Detection proposal = line.proposal;
      if (view.image && can_.reads_image) proposal.logit += line.of_pixel * view.image->data[0];
      if (!view.points.empty() && can_.reads_points) proposal.logit += line.of_point * view.points[0].x;
      if (!(proposal.score() > threshold)) continue;
      found.push_back(proposal);
      rows_.push_back(line);
    }
    return found;
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    EXPECT_EQ(d_logits.size(), rows_.size());
    SensorGradient gradient{image_, {}};
    gradient.points.resize(points_);
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      if (can_.reads_image) gradient.image.data[0] += static_cast<float>(d_logits[i] * rows_[i].of_pixel);
      if (can_.reads_points) gradient.points[0][0] += static_cast<float>(d_logits[i] * rows_[i].of_point);
    }
    return gradient;
  }
  TrainingLoss train_step(std::span<const TrainingSample>, double) override { return {1, 2, 3}; }
  void save(const std::filesystem::path&, bool) override {}
  std::unique_ptr<Detector> share() override { return std::make_unique<Scripted>(name_, can_, script_); }

 private:
  const char* name_;
  Capabilities can_;
  Script& script_;
  std::vector<Script::Line> rows_;
  ImageF image_;
  std::size_t points_ = 0;
};

}  // namespace mirage::test
