#include "exchange/texture_layout.h"

#include <algorithm>
#include <cmath>

namespace mirage {

TextureLayout::TextureLayout(std::size_t texels) {
  const std::size_t count = std::max<std::size_t>(1, texels);
  width = static_cast<int>(std::ceil(std::sqrt(static_cast<double>(count))));
  height = static_cast<int>((count + width - 1) / width);
}

Vec2d TextureLayout::centre(std::size_t texel) const {
  return {(static_cast<double>(texel % width) + 0.5) / width,
          (static_cast<double>(texel / width) + 0.5) / height};
}

}  // namespace mirage
