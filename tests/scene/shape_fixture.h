// A small shape model, learned once for all tests of an executable.
#pragma once

#include "generator/car_body.h"

namespace mirage::test {

inline const ShapeModel& small_shape_model() {
  static const ShapeModel model = [] {
    ShapeModelSettings settings;
    settings.dimension = 8;
    settings.spacing = 0.14;
    return build_shape_model(family_samples(5, 1), settings);
  }();
  return model;
}

}  // namespace mirage::test
