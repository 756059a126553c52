// A made-up scene to run a user's network on as soon as it is loaded.
#pragma once

#include <array>
#include <vector>

#include "base/sizes.h"

namespace mirage {

/// A grey picture and returns of a road and a wall ahead, all in its view.
struct ProbeScene {
  int width, height;
  std::vector<float> image;   ///< height x width x 3
  std::vector<float> points;  ///< N x 4
  std::array<double, 12> pixel_from_ego = {609.6, -721.5, 0, 0, 172.9, 0, -721.5, 0, 1, 0, 0, 0};

  /// KITTI's size unless the network has one of its own.
  explicit ProbeScene(int its_width = 1242, int its_height = 375)
      : width(its_width), height(its_height), image(as_size(width) * as_size(height) * 3, 0.2f) {
    for (std::size_t i = 0; i < image.size(); i += 7) image[i] = 0.1f + static_cast<float>(i % 11) / 20;
    for (int i = 0; i < 40; ++i)
      for (int k = -20; k <= 20; ++k) {
        const float x = 8 + static_cast<float>(i), y = 0.015f * x * static_cast<float>(k);
        points.insert(points.end(), {x, y, -1.7f, 0.3f, 30.f, 0.5f * static_cast<float>(k),
                                     -1 + 0.05f * static_cast<float>(i), 0.2f});
      }
  }
};

}  // namespace mirage
