// The placement of an object and the victim of its attack, as --place names it:
//
//   NAME               a shipped placement, scenes/placements/NAME.toml: roof (the default), rear-rack, …
//   FILE.toml          a user's placement
//   X,Y,Z,YAW          in the host vehicle's frame: metres forward, left and up from the ground under its
//                      box's centre, and degrees counter-clockwise from its heading
//   world:X,Y,Z,YAW    the same numbers in `velo`, for any host
//
// The object's lowest vertex is set at Z; its own x axis points along YAW. scenes/placements/roof.toml
// explains the keys of a file.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "base/fields.h"
#include "base/types.h"
#include "geometry/mesh.h"

namespace mirage {

/// The host's true box with the object: the label's, or one that also holds the object (a rack makes a
/// vehicle longer).
enum class TrueBox { labelled, grown };
constexpr auto words_of(TrueBox) {
  return std::to_array<const char*>({"as labelled", "grown"});
}

/// The victim of the deception. carrier: the host goes undetected. neighbour: the labelled vehicle nearest to
/// the object goes undetected. phantom: vehicles are detected where there is none. object: the object itself
/// goes undetected, under any class.
enum class Victim { carrier, neighbour, phantom, object };
constexpr auto words_of(Victim) {
  return std::to_array<const char*>({"carrier", "neighbour", "phantom", "object"});
}

/// A parsed --place. Each place has one canonical text: text_of() returns the shortest that set_from_text()
/// accepts; for a file, its absolute path.
struct PlaceChoice {
  /// Origin of `at`, with axes along the host's heading, left and up: the roof point, the ground under its
  /// box's centre, or under the middle of a side of the box; world: `velo`.
  enum class In { roof, vehicle, world, front, rear, left, right };
  In in = In::roof;
  Vec3d at = Vec3d::Zero();     ///< m
  double yaw = 0;               ///< degrees, (−180, 180]
  Vec3d volume = 2 * kRoofBox;  ///< m, largest extents of the object along its own axes
  TrueBox box = TrueBox::labelled;
  Victim victim = Victim::carrier;
  double within = 0;      ///< m; largest distance of the neighbour's box centre to the object
  std::string what = {};  ///< a sentence
  std::string name = {};  ///< NAME or FILE.toml; empty: given by numbers

  /// Whether it comes from a file: then the object needs room (placement_of).
  bool of_file() const { return !name.empty(); }
};
constexpr auto words_of(PlaceChoice::In) {
  return std::to_array<const char*>({"roof", "centre", "world", "front", "rear", "left", "right"});
}

/// Parses --place. FieldError for any other text, a missing file, a coordinate beyond kMaxPlaceDistance, and
/// an angle that is not finite. InputError naming file and key for an invalid value in a file.
void set_from_text(const std::string& text, PlaceChoice& place);
/// NAME or FILE.toml, "roof", or "X,Y,Z,YAW" (m, degrees), with "world:" before it in `velo`.
std::string text_of(const PlaceChoice& place);

/// Reads a placement's file; `name` becomes its text. InputError as ConfigTable's, for a volume that reaches
/// into the host or under the ground, and for `within` without a neighbour.
PlaceChoice read_place(const std::filesystem::path& file, const std::string& name);
/// The same from to_json()'s output, an object under `key` in `file` (for errors).
PlaceChoice read_place(const nlohmann::json& stored, const std::filesystem::path& file,
                       const std::string& key, const std::string& name);
/// The inverse of read_place; for a place without a file the anchor may also be "world".
nlohmann::json to_json(const PlaceChoice& place);
/// The part of the place that determines a result: the file's content unless it is the plain roof, otherwise
/// the text. The file's name does not count.
nlohmann::json content_of(const PlaceChoice& place);

/// m along each axis.
inline constexpr double kMaxPlaceDistance = 1000;

}  // namespace mirage
