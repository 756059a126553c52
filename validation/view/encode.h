// Bytes as a page carries them.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "sensors/lidar_model.h"

namespace mirage {

/// RFC 4648, with padding.
std::string base64(std::string_view bytes);
/// RFC 1952; a browser's DecompressionStream("gzip") undoes it.
std::string gzip(std::string_view bytes);

/// Points as columns that gzip makes small, n points each:
///   x, y, z: whole centimetres, the difference to the point before in zigzag form (0, −1, 1, −2, … as 0, 1,
///   2, 3, …),
///            low bytes of all, then high bytes of all; 6n bytes
///   reflectance: 255ths; n bytes
///   instance: as given; n bytes
/// All points lie within ±kReach; `instance` has as many values.
std::string packed_points(const Sweep& points, const std::vector<unsigned char>& instance);
inline constexpr double kReach = 327;  ///< m

}  // namespace mirage
