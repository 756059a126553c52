// Where an object is put and whom it is to deceive, as --place names it:
//
//   NAME               a shipped placement, scenes/placements/NAME.toml: roof (the default), rear-rack, …
//   FILE.toml          one of the user's
//   X,Y,Z,YAW          in the host vehicle's frame: metres forward, left and up from the ground under its
//                      box's centre, and degrees counter-clockwise from its heading
//   world:X,Y,Z,YAW    the same numbers in the frame's `velo`, whichever vehicle is the host
//
// The object's lowest vertex is set at Z; its own x axis points along YAW. scenes/placements/roof.toml says
// what the keys of a file mean.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "base/fields.h"
#include "base/types.h"
#include "geometry/mesh.h"

namespace mirage {

/// What the host's true box is with the object: that of the label, or one that holds the object, too (a rack
/// makes a vehicle longer).
enum class TrueBox { labelled, grown };
constexpr auto words_of(TrueBox) {
  return std::to_array<const char*>({"as labelled", "grown"});
}

/// Whom the object is to deceive about. carrier: its host goes unseen. neighbour: the labelled vehicle
/// nearest to the object does. phantom: vehicles are seen where none is. object: the object itself goes
/// unseen, whatever the detector calls it.
enum class Victim { carrier, neighbour, phantom, object };
constexpr auto words_of(Victim) {
  return std::to_array<const char*>({"carrier", "neighbour", "phantom", "object"});
}

/// A parsed --place. Each place has one canonical text: text_of() gives the shortest that set_from_text()
/// accepts, of a file its absolute path.
struct PlaceChoice {
  /// What `at` starts from, with axes along the host's heading, left and up: the roof point, the ground under
  /// its box's centre, or that under the middle of a side of the box; world: `velo`.
  enum class In { roof, vehicle, world, front, rear, left, right };
  In in = In::roof;
  Vec3d at = Vec3d::Zero();     ///< m
  double yaw = 0;               ///< degrees, (−180, 180]
  Vec3d volume = 2 * kRoofBox;  ///< m, the largest extents of an object there, along its own axes
  TrueBox box = TrueBox::labelled;
  Victim victim = Victim::carrier;
  double within = 0;      ///< m; of a neighbour: the farthest from the object to its box's centre
  std::string what = {};  ///< a sentence
  std::string name = {};  ///< NAME or FILE.toml; empty: none, the numbers say it all

  /// Whether a file says it: then the object needs room there (placement_of).
  bool of_file() const { return !name.empty(); }
};
constexpr auto words_of(PlaceChoice::In) {
  return std::to_array<const char*>({"roof", "centre", "world", "front", "rear", "left", "right"});
}

/// FieldError for any other text, a file that is not there, a coordinate beyond kMaxPlaceDistance, and an
/// angle that is not finite. InputError naming file and key for what a file can't say.
void set_from_text(const std::string& text, PlaceChoice& place);
/// NAME or FILE.toml, "roof", or "X,Y,Z,YAW" (m, degrees), with "world:" before it in `velo`.
std::string text_of(const PlaceChoice& place);

/// A placement's file; `name` becomes its text. InputError as ConfigTable, for a volume that reaches into the
/// host or under the ground, and for `within` without a neighbour.
PlaceChoice read_place(const std::filesystem::path& file, const std::string& name);
/// The same of what to_json says, which stands in a `file` (for errors) as its `key`, an object.
PlaceChoice read_place(const nlohmann::json& stored, const std::filesystem::path& file,
                       const std::string& key, const std::string& name);
/// What read_place takes; of a place without a file "world" may be the anchor, too.
nlohmann::json to_json(const PlaceChoice& place);
/// The part of the place that decides a result: the file's content where it says more than the plain roof,
/// else the text. The file's name does not count.
nlohmann::json content_of(const PlaceChoice& place);

/// m along each axis.
inline constexpr double kMaxPlaceDistance = 1000;

}  // namespace mirage
