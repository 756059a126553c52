// Where an object is put, as --place names it:
//
//   roof               on the host vehicle's roof (scene/carrier.h)
//   X,Y,Z,YAW          in the host vehicle's frame: metres forward, left and up from the ground under its
//                      box's centre, and degrees counter-clockwise from its heading
//   world:X,Y,Z,YAW    the same numbers in the frame's `velo`, whichever vehicle is the host
//
// The object's lowest vertex is set at Z; its own x axis points along YAW.
#pragma once

#include <string>

#include "base/fields.h"
#include "base/types.h"

namespace mirage {

/// The word, understood. One place has one text: text_of is the shortest of all that set_from_text takes for
/// it.
struct PlaceChoice {
  enum class In { roof, vehicle, world };
  In in = In::roof;
  Vec3d at = Vec3d::Zero();  ///< m; not of In::roof
  double yaw = 0;            ///< degrees, (−180, 180]; not of In::roof
};

/// FieldError for any other text, a coordinate beyond kFarthestPlace, and an angle that is not finite.
void set_from_text(const std::string& text, PlaceChoice& place);
std::string text_of(const PlaceChoice& place);

/// m along each axis.
inline constexpr double kFarthestPlace = 1000;

}  // namespace mirage
