#include "simulation/object_window.h"

#include <algorithm>

#include "simulation/render_scene.h"

namespace mirage {

double rgba_at(const CameraSight& seen, int u, int v, int c) {
  const PixelRect& r = seen.rect;
  if (u < r.u0 || u >= r.u1 || v < r.v0 || v >= r.v1) return 0;
  return seen.rgba.at(u - r.u0, v - r.v0, c);
}

ImageF radiance_of(const Simulated& simulated, const ImageF& photograph, const PixelRect& rect) {
  ImageF window = crop(photograph, rect);
  const PixelRect& drawn = simulated.rect;
  for (int v = std::max(rect.v0, drawn.v0); v < std::min(rect.v1, drawn.v1); ++v)
    for (int u = std::max(rect.u0, drawn.u0); u < std::min(rect.u1, drawn.u1); ++u)
      for (int c = 0; c < 3; ++c)
        window.at(u - rect.u0, v - rect.v0, c) = static_cast<float>(rgba_at(simulated, u, v, c));
  return window;
}

void add_to_picture(const ImageF& difference, const PixelRect& rect, Simulated& simulated) {
  const PixelRect& drawn = simulated.rect;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u) {
      const bool inside = u >= drawn.u0 && u < drawn.u1 && v >= drawn.v0 && v < drawn.v1;
      for (int c = 0; c < 3; ++c) {
        float& shown = simulated.image.at(u, v, c);
        double value = difference.at(u - rect.u0, v - rect.v0, c);
        if (inside)
          value = simulated.rgba.at(u - drawn.u0, v - drawn.v0, c) += value;
        else
          value += shown;
        shown = static_cast<float>(std::clamp(value, 0.0, 1.0));
      }
    }
}

PixelRect united(const PixelRect& a, const PixelRect& b) {
  if (a.empty()) return b;
  if (b.empty()) return a;
  return {std::min(a.u0, b.u0), std::min(a.v0, b.v0), std::max(a.u1, b.u1), std::max(a.v1, b.v1)};
}

}  // namespace mirage
