#include "sensor_tensors.h"

#include <algorithm>

namespace mirage::fusion {

SensorTensors view_input(const MirageSensorInput& input, bool with_image) {
  SensorTensors tensors;
  if (with_image && input.image && input.width > 0 && input.height > 0)
    tensors.image = torch::from_blob(const_cast<float*>(input.image), {input.height, input.width, 3});
  if (input.points && input.point_count > 0)
    tensors.points = torch::from_blob(const_cast<float*>(input.points), {input.point_count, 4});
  else
    tensors.points = torch::empty({0, 4});
  std::copy(std::begin(input.pixel_from_velo), std::end(input.pixel_from_velo), tensors.projection.begin());
  return tensors;
}

SensorTensors copy_input(const MirageSensorInput& input, bool with_image) {
  SensorTensors tensors = view_input(input, with_image);
  if (tensors.image.defined()) tensors.image = tensors.image.clone();
  tensors.points = tensors.points.clone();
  return tensors;
}

}  // namespace mirage::fusion
