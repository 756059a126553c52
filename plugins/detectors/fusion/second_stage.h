// The choice of proposals for the second stage.
#pragma once

#include <torch/torch.h>

#include <array>
#include <cstdint>
#include <vector>

#include "sensor_tensors.h"

namespace mirage::fusion {

/// The places of the highest of `logits` above `least`, `most` at most, in the order of places (of equal ones
/// the first count). A discrete choice, made in float.
std::vector<std::int64_t> highest(const torch::Tensor& logits, float least, std::size_t most);

// The returns in and around boxes of the bird's-eye view, with the picture's evidence.

/// Cells of the raster over a box: ±0.7 lengths along, ±1 width across.
inline constexpr int kOccupiedAlong = 20, kOccupiedAcross = 14, kOccupiedLayers = 3;
inline constexpr int kOccupancy = kOccupiedAlong * kOccupiedAcross * kOccupiedLayers;

/// The returns of regions. Their choice is discrete, and made in float for tensors of any type.
class RegionReturns {
 public:
  /// boxes: n × 5 (x, y, length, width, yaw). A return belongs to a box if it lies up to 0.8 lengths along
  /// and 1.2 widths across from its centre and 0.3 m below to 2.7 m above its ground; of more than 128 every
  /// second, third, … is used. Watched places count as returns, and all of them are used.
  RegionReturns(const torch::Tensor& boxes, const SensorTensors& input, int width, int height);

  std::vector<float> ground;   ///< n: height of the ground around a box (LowestReturns)
  std::vector<float> visible;  ///< n: 1 if a car there is in the picture (car_in_picture), or 0
  /// One entry per pair of a box and a return in it: the box's index, the return's row in points_of().
  std::vector<std::int64_t> region, which;

  torch::Tensor points_of(const SensorTensors& input) const;  ///< rows × 3, differentiable
  torch::Tensor masses_of(const SensorTensors& input) const;  ///< rows: 1, or the mass of a watched one
  /// rows: probability that its pixel shows a vehicle, 0 where the camera does not see it. Differentiable in
  /// returns and mask.
  torch::Tensor evidence_of(const SensorTensors& input, const torch::Tensor& mask) const;
  /// n × kOccupancy: mass by cells of the box's frame, of the lower and of the upper returns (each return in
  /// shares, from the ground to the roof) and of those that show a vehicle; bounded by m / (1 + m) as voxels
  /// are. Differentiable in boxes (n × 5), returns, masses and mask; `ground_heights`: n, the grounds as a
  /// tensor.
  torch::Tensor occupancy(const torch::Tensor& boxes, const torch::Tensor& ground_heights,
                          const SensorTensors& input, const torch::Tensor& mask) const;

 private:
  std::vector<std::int64_t> rows_;  ///< by row the return's number; watched places follow the returns
  std::vector<std::int64_t> seen_;  ///< rows that the camera sees
};

// The second stage: each of the first stage's best proposals is looked at again in its own region, and gets
// another logit and another box (Liang et al., "Multi-Task Multi-Sensor Fusion", CVPR 2019, section 3.4).
//
// A region is read three times: a rotated raster over the bird's-eye view's features, a raster over the
// rectangle that its box covers in the picture (camera features and mask, so that pixels speak whether a
// return lies near or not), and the returns in and around the box in the box's own frame (as in PointRCNN,
// Shi et al., CVPR 2019), with the mask's evidence, as a soft raster that is finer than the bird's-eye
// view's.

/// The first stage's result for an input, on the CPU.
struct FirstStage {
  torch::Tensor output;   ///< kOutputs × 140 × 160
  torch::Tensor bev;      ///< 1 × kBevFeatures × 140 × 160: its head's input
  torch::Tensor picture;  ///< 1 × (kCameraFeatures + 1) × H/8 × W/8: features and mask; undefined: none
  torch::Tensor mask;     ///< 1 × 1 × H/4 × W/4, logits; undefined: none
};
inline constexpr int kBevFeatures = 32;

/// A box's parts and the second stage's change of each: along and across the box (m), the logarithms of
/// length and width, the yaw (rad). A row of Regions::change counts in these units.
inline constexpr int kBoxParts = 5;
inline constexpr std::array<double, kBoxParts> kChangeUnits = {0.3, 0.3, 0.1, 0.1, 0.1};

/// The n proposals of the second stage.
struct Regions {
  std::vector<std::int64_t> cells;
  torch::Tensor boxes;            ///< n × 5 of the first stage: x, y, length, width (m), yaw (rad)
  torch::Tensor logits;           ///< n, new
  torch::Tensor change;           ///< n × kBoxParts
  torch::Tensor refined() const;  ///< n × 5: the boxes with their change
};

struct SecondStageImpl : torch::nn::Module {
  SecondStageImpl();
  /// The cells for the second stage: a logit above −4, at most the 256 highest. A discrete choice.
  static std::vector<std::int64_t> chosen(const FirstStage& first);
  /// The regions of those cells, each by itself. `first` has a picture. Differentiable in all four maps
  /// (through the boxes' places, too), in returns and in the masses of watched ones; which returns are in a
  /// region (of many, every second, third, …), the ground's height and visibility in the picture carry no
  /// gradient.
  Regions find_regions(const FirstStage& first, const SensorTensors& input, std::vector<std::int64_t> cells);
  /// The first stage's output with the chosen regions' logits and boxes in their cells.
  torch::Tensor forward(const FirstStage& first, const SensorTensors& input);
  /// The same with these cells alone.
  torch::Tensor refine(const FirstStage& first, const SensorTensors& input,
                       const std::vector<std::int64_t>& cells);

  torch::nn::Linear bev_place{nullptr}, bev_region{nullptr};
  torch::nn::Linear picture_place{nullptr}, picture_region{nullptr};
  torch::nn::Linear returns_region{nullptr};
  torch::nn::Linear together{nullptr}, hidden{nullptr}, last{nullptr};
};
TORCH_MODULE(SecondStage);

}  // namespace mirage::fusion
