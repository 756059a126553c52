#include "augment.h"

#include <algorithm>
#include <cmath>

#include "base/random.h"

namespace mirage::fusion {
namespace {

namespace fn = torch::nn::functional;
using torch::Tensor;

constexpr double kMinSize = 0.7, kMaxSize = 1.4;
constexpr double kMinVisibleShare = 0.5;  // of a box's area, for it to be taught
constexpr float kMinHeight = 12;          // pixels

/// The map of pixels from the original picture to the augmented one.
struct Pose {
  bool mirrored;
  double across, down;     ///< scales of columns and rows
  std::int64_t left, top;  ///< of the part that is cut out
  std::int64_t given_width;

  MiragePictureBox moved(const MiragePictureBox& box) const {
    const float last = static_cast<float>(given_width - 1);
    const float from = mirrored ? last - box.right : box.left, to = mirrored ? last - box.left : box.right;
    return {place(from, across, left), place(box.top, down, top), place(to, across, left),
            place(box.bottom, down, top)};
  }

 private:
  /// A pixel's centre is its integer coordinate: its corner scales, not its centre.
  static float place(double at, double scale, std::int64_t cut) {
    return static_cast<float>((at + 0.5) * scale - 0.5 - static_cast<double>(cut));
  }
};

double area(const MiragePictureBox& box) {
  return std::max(0.0, double{box.right - box.left}) * std::max(0.0, double{box.bottom - box.top});
}

MiragePictureBox cut(const MiragePictureBox& box, float width, float height) {
  return {std::clamp(box.left, 0.f, width - 1), std::clamp(box.top, 0.f, height - 1),
          std::clamp(box.right, 0.f, width - 1), std::clamp(box.bottom, 0.f, height - 1)};
}

constexpr double kMaxThinning = 0.4, kMaxShaking = 0.02;

torch::Tensor thin_and_shake(const torch::Tensor& points, RandomStream& random) {
  const double dropped = random.uniform(0, kMaxThinning), shaking = random.uniform(0, kMaxShaking);
  const bool thin = random.uniform() < 0.7;
  const std::int64_t count = points.size(0);
  torch::Tensor kept = torch::empty_like(points);
  const float* from = points.data_ptr<float>();
  float* to = kept.data_ptr<float>();
  std::int64_t n = 0;
  for (std::int64_t i = 0; i < count; ++i) {
    if (thin && random.uniform() < dropped) continue;
    for (int a = 0; a < 3; ++a)
      to[4 * n + a] = from[4 * i + a] + static_cast<float>(shaking * random.uniform(-1.7, 1.7));
    to[4 * n + 3] = from[4 * i + 3];
    ++n;
  }
  return kept.narrow(0, 0, n);
}

torch::Tensor change_picture(const torch::Tensor& picture, RandomStream& random) {
  const double exposure = std::exp(random.uniform(-0.5, 0.5));
  const double gamma = std::exp(random.uniform(-0.15, 0.15)), grey = random.uniform(0, 0.35);
  const double noise = random.uniform(0, 0.02);
  torch::Tensor gain = torch::empty({3});
  for (int c = 0; c < 3; ++c) gain[c] = exposure * std::exp(random.uniform(-0.15, 0.15));
  const std::uint64_t high = random.next_u32(), noise_seed = high << 32 | random.next_u32();

  torch::Tensor x = picture * gain;
  x = x + grey * (x.mean(2, true) - x);
  x = x.clamp(0, 1).pow(gamma);
  auto generator = at::make_generator<at::CPUGeneratorImpl>(noise_seed);
  x = x + noise * torch::sqrt(x + 1e-3) * torch::randn(x.sizes(), generator);
  return x.clamp(0, 1);
}

}  // namespace

LabelledPicture labelled_picture(const MirageSample& sample, const Tensor& image) {
  LabelledPicture taught;
  taught.image = image;
  taught.boxes.assign(sample.picture_boxes, sample.picture_boxes + sample.picture_box_count);
  taught.ignored.assign(sample.picture_ignore, sample.picture_ignore + sample.picture_ignore_count);
  if (sample.vehicle_mask && image.defined())
    taught.vehicle_mask.assign(sample.vehicle_mask, sample.vehicle_mask + image.size(0) * image.size(1));
  return taught;
}

LabelledPicture augmented_picture(const LabelledPicture& labelled, std::uint64_t seed, std::uint64_t index) {
  RandomStream random(seed, "picture pose", index);
  const std::int64_t height = labelled.image.size(0), width = labelled.image.size(1);
  Pose pose{};
  pose.mirrored = random.uniform() < 0.5;
  const double zoom = std::exp(random.uniform(std::log(kMinSize), std::log(kMaxSize)));
  const auto scaled = [&](std::int64_t size) {
    return std::max<std::int64_t>(1, std::llround(static_cast<double>(size) * zoom));
  };
  const std::int64_t rows = scaled(height), columns = scaled(width);
  pose.across = static_cast<double>(columns) / static_cast<double>(width);
  pose.down = static_cast<double>(rows) / static_cast<double>(height);
  pose.given_width = width;
  const std::int64_t kept_rows = std::min(rows, height), kept_columns = std::min(columns, width);
  pose.top = random.below(static_cast<int>(rows - kept_rows) + 1);
  pose.left = random.below(static_cast<int>(columns - kept_columns) + 1);

  const auto moved = [&](Tensor x) {  // 1 × C × H × W
    if (pose.mirrored) x = x.flip(3);
    return fn::interpolate(x, fn::InterpolateFuncOptions()
                                  .size(std::vector<std::int64_t>{rows, columns})
                                  .mode(torch::kBilinear)
                                  .align_corners(false)
                                  .antialias(zoom < 1))
        .narrow(2, pose.top, kept_rows)
        .narrow(3, pose.left, kept_columns);
  };
  LabelledPicture result;
  result.image = moved(labelled.image.permute({2, 0, 1}).unsqueeze(0))[0].permute({1, 2, 0}).contiguous();
  if (!labelled.vehicle_mask.empty()) {
    const Tensor mask = torch::from_blob(const_cast<std::uint8_t*>(labelled.vehicle_mask.data()),
                                         {1, 1, height, width}, torch::kByte);
    const Tensor there = (moved(mask.to(torch::kFloat)) > 0.5).to(torch::kByte).contiguous();
    result.vehicle_mask.assign(there.data_ptr<std::uint8_t>(),
                               there.data_ptr<std::uint8_t>() + there.numel());
  }
  const auto take = [&](const MiragePictureBox& box, bool taught) {
    const MiragePictureBox whole = pose.moved(box);
    const MiragePictureBox left = cut(whole, static_cast<float>(kept_columns), static_cast<float>(kept_rows));
    if (!(area(left) > 0)) return;
    taught = taught && area(left) >= kMinVisibleShare * area(whole) && left.bottom - left.top >= kMinHeight;
    (taught ? result.boxes : result.ignored).push_back(left);
  };
  for (const MiragePictureBox& box : labelled.boxes) take(box, true);
  for (const MiragePictureBox& box : labelled.ignored) take(box, false);
  return result;
}

SensorTensors augment(const SensorTensors& input, std::uint64_t seed, std::uint64_t index, bool picture) {
  RandomStream random(seed, "detector augmentation", index);
  SensorTensors changed = input;
  changed.points = thin_and_shake(input.points, random);
  if (picture && input.image.defined()) changed.image = change_picture(input.image, random);
  return changed;
}

}  // namespace mirage::fusion
