// Which returns lie in and around boxes of the bird's-eye view, and what the picture says of them.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_tensors.h"
#include "torch_headers.h"

namespace mirage::fusion {

/// Cells of the raster over a box: ±0.7 lengths along, ±1 width across.
inline constexpr int kOccupiedAlong = 20, kOccupiedAcross = 14, kOccupiedLayers = 3;
inline constexpr int kOccupancy = kOccupiedAlong * kOccupiedAcross * kOccupiedLayers;

/// The returns of regions. Which they are is discrete, and decided in float whatever the type of the tensors.
class RegionReturns {
 public:
  /// boxes: n × 5 (x, y, length, width, yaw). A return is a box's if it lies up to 0.8 lengths along and 1.2
  /// widths across from its centre and 0.3 m below to 2.7 m above its ground; of more than 128 every second,
  /// third, … counts. What is watched counts like a return, and all of it.
  RegionReturns(const torch::Tensor& boxes, const SensorTensors& input, int width, int height);

  std::vector<float> ground;   ///< n: height of the ground around a box (LowestReturns)
  std::vector<float> visible;  ///< n: 1 if a car there is in the picture (car_in_picture), else 0
  /// One entry a pair of a return and a box that it belongs to: which box, which row of points_of.
  std::vector<std::int64_t> region, which;

  torch::Tensor points_of(const SensorTensors& input) const;  ///< rows × 3, differentiable
  torch::Tensor masses_of(const SensorTensors& input) const;  ///< rows: 1, or the mass of a watched one
  /// rows: probability that its pixel shows a vehicle, 0 where the camera does not see it. Differentiable in
  /// returns and mask.
  torch::Tensor evidence_of(const SensorTensors& input, const torch::Tensor& mask) const;
  /// n × kOccupancy: mass by cells of the box's frame, of the lower and of the upper returns (each return in
  /// shares, from the ground to the roof) and of those that show a vehicle; bounded by m / (1 + m) as voxels
  /// are. Differentiable in boxes (n × 5), returns, masses and mask; `above`: n, the grounds as a tensor.
  torch::Tensor occupancy(const torch::Tensor& boxes, const torch::Tensor& above, const SensorTensors& input,
                          const torch::Tensor& mask) const;

 private:
  std::vector<std::int64_t> rows_;  ///< by row the return's number; what is watched follows the returns
  std::vector<std::int64_t> seen_;  ///< rows that the camera sees
};

}  // namespace mirage::fusion
