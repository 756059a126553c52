#include "scene/place.h"

#include <fmt/format.h>

#include <cmath>

namespace mirage {
namespace {

constexpr const char *kField = "placement", *kRoof = "roof", *kWorld = "world:";
constexpr const char* kUse = "use roof, X,Y,Z,YAW or world:X,Y,Z,YAW (m, degrees)";

/// To billionths, so that an angle has one number, with or without a turn more; 0 has no sign.
double rounded(double value) {
  return std::round(value * 1e9) / 1e9 + 0.0;
}

}  // namespace

void set_from_text(const std::string& text, PlaceChoice& place) {
  place = {};
  if (text == kRoof) return;
  const bool world = text.starts_with(kWorld);
  place.in = world ? PlaceChoice::In::world : PlaceChoice::In::vehicle;
  const std::vector<std::string> words = listed_words(world ? text.substr(std::string(kWorld).size()) : text);
  if (words.size() != 4) throw FieldError(kField, text, "is no place", kUse);
  for (int i = 0; i < 3; ++i) {
    place.at[i] = rounded(parse_number(words[static_cast<std::size_t>(i)], kField));
    if (!(std::abs(place.at[i]) <= kFarthestPlace))
      throw FieldError(kField, text, fmt::format("lies beyond {:g} m", kFarthestPlace), kUse);
  }
  const double yaw = parse_number(words[3], kField);
  if (!std::isfinite(yaw)) throw FieldError(kField, text, "turns by no angle", kUse);
  place.yaw = rounded(std::remainder(yaw, 360));
  if (place.yaw == -180) place.yaw = 180;
}

std::string text_of(const PlaceChoice& place) {
  if (place.in == PlaceChoice::In::roof) return kRoof;
  return fmt::format("{}{},{},{},{}", place.in == PlaceChoice::In::world ? kWorld : "", place.at.x(),
                     place.at.y(), place.at.z(), place.yaw);
}

}  // namespace mirage
