#include "scene/place_choice.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "base/config.h"
#include "base/error.h"
#include "base/names.h"
#include "base/sizes.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using In = PlaceChoice::In;

constexpr const char *kField = "placement", *kRoof = "roof", *kWorld = "world:", *kFile = ".toml";
constexpr const char* kUse = "use X,Y,Z,YAW or world:X,Y,Z,YAW (m, degrees), a shipped placement or a file";

/// Rounds to 1e-9, so that an angle has one value, with or without a full turn; 0 has no sign.
double rounded(double value) {
  return std::round(value * 1e9) / 1e9 + 0.0;
}

double rounded_yaw(double degrees) {
  const double yaw = rounded(std::remainder(degrees, 360));
  return yaw == -180 ? 180 : yaw;
}

PlaceChoice read_numbers(const std::string& text) {
  PlaceChoice place;
  const bool world = text.starts_with(kWorld);
  place.in = world ? In::world : In::vehicle;
  const std::vector<std::string> words = listed_words(world ? text.substr(std::string(kWorld).size()) : text);
  if (words.size() != 4) throw FieldError(kField, text, "is not a place", kUse);
  for (int i = 0; i < 3; ++i) {
    place.at[i] = rounded(parse_number(words[as_size(i)], kField));
    if (!(std::abs(place.at[i]) <= kMaxPlaceDistance))
      throw FieldError(kField, text, fmt::format("lies beyond {:g} m", kMaxPlaceDistance), kUse);
  }
  const double yaw = parse_number(words[3], kField);
  if (!std::isfinite(yaw)) throw FieldError(kField, text, "turns by no angle", kUse);
  place.yaw = rounded_yaw(yaw);
  return place;
}

/// Depth (m) to which the volume reaches into the host through the side at which it stands; ≤ 0: none.
double reach_into_host(const PlaceChoice& place) {
  const double c = std::abs(std::cos(place.yaw * kDegree)), s = std::abs(std::sin(place.yaw * kDegree));
  const double along = (c * place.volume.x() + s * place.volume.y()) / 2;
  const double across = (s * place.volume.x() + c * place.volume.y()) / 2;
  switch (place.in) {
    case In::front:
      return along - place.at.x();
    case In::rear:
      return along + place.at.x();
    case In::left:
      return across - place.at.y();
    case In::right:
      return across + place.at.y();
    default:
      return 0;
  }
}

PlaceChoice read_keys(ConfigTable table, const fs::path& file, const std::string& prefix,
                      const std::string& name) {
  const auto fail = [&](const std::string& key, const std::string& problem, const std::string& fix) {
    throw InputError(file.string(), prefix + key, problem, fix);
  };
  PlaceChoice place;
  place.name = name;
  place.what = table.text("what");
  const auto read_word = [&]<class E>(const char* key, E& value) {
    const auto words = words_of(E());
    const std::string text = table.text(key);
    const auto found = std::ranges::find(words, text);
    if (found == words.end()) fail(key, text + " is unknown", use_one_of(text, {words.begin(), words.end()}));
    value = static_cast<E>(found - words.begin());
  };
  read_word("anchor", place.in);
  if (place.in == In::world)
    fail("anchor", "a file says where on a host the object stands", "name a side of it");
  const auto at = table.numbers("offset", 3, -kMaxPlaceDistance, kMaxPlaceDistance);
  for (int i = 0; i < 3; ++i) place.at[i] = rounded(at[as_size(i)]);
  place.yaw = rounded_yaw(table.number("yaw", -360, 360));
  place.volume = Vec3d(table.numbers("volume", 3, kMinObject, kMaxObject).data());
  read_word("box", place.box);
  read_word("victim", place.victim);
  if (place.victim == Victim::neighbour)
    place.within = table.number("within", kMinObject, kMaxPlaceDistance);
  else if (table.has("within"))
    fail("within", fmt::format("is of a neighbour, and the victim is the {}", to_word(place.victim)),
         "remove it");
  table.check_all_known();
  if (place.at.z() < 0)
    fail("offset[2]", place.in == In::roof ? "is below the roof" : "is under the ground", "use 0 or more");
  constexpr double kRounding = 1e-9;
  if (const double reach = reach_into_host(place); reach > kRounding)
    fail("offset", fmt::format("the volume reaches {:.3g} m into the host", reach),
         fmt::format("move it {:.3g} m outward", reach));
  return place;
}

PlaceChoice read_file_of(const std::string& text) {
  if (!text.ends_with(kFile))
    return read_place(shipped_choice("scenes/placements", kFile, text, kField,
                                     "a file (.toml), X,Y,Z,YAW or world:X,Y,Z,YAW"),
                      text);
  if (printable(text) != text)
    throw FieldError(kField, printable(text), "has letters that no settings file can hold", "rename it");
  if (!fs::is_regular_file(text))
    throw FieldError(kField, text, "no such file", "copy one of scenes/placements and change it");
  return read_place(text, fs::absolute(text).lexically_normal().string());
}

}  // namespace

PlaceChoice read_place(const fs::path& file, const std::string& name) {
  return read_keys(ConfigTable::read(file), file, "", name);
}

PlaceChoice read_place(const nlohmann::json& stored, const fs::path& file, const std::string& key,
                       const std::string& name) {
  return read_keys(ConfigTable::of(file, key, stored), file, key + ".", name);
}

void set_from_text(const std::string& text, PlaceChoice& place) {
  const bool file =
      text.ends_with(kFile) || (text.find(',') == std::string::npos && !text.starts_with(kWorld));
  place = file ? read_file_of(text) : read_numbers(text);
}

std::string text_of(const PlaceChoice& place) {
  if (place.of_file()) return place.name;
  if (place.in == In::roof) return kRoof;
  return fmt::format("{}{},{},{},{}", place.in == In::world ? kWorld : "", place.at.x(), place.at.y(),
                     place.at.z(), place.yaw);
}

nlohmann::json to_json(const PlaceChoice& place) {
  const auto list = [](const Vec3d& v) { return nlohmann::json{v.x(), v.y(), v.z()}; };
  nlohmann::json json = {{"what", place.what},
                         {"anchor", to_word(place.in)},
                         {"offset", list(place.at)},
                         {"yaw", place.yaw},
                         {"volume", list(place.volume)},
                         {"box", to_word(place.box)},
                         {"victim", to_word(place.victim)}};
  if (place.victim == Victim::neighbour) json["within"] = place.within;
  return json;
}

nlohmann::json content_of(const PlaceChoice& place) {
  if (!place.of_file()) return text_of(place);
  nlohmann::json stored = to_json(place), plain = to_json(PlaceChoice());
  plain["what"] = stored["what"];
  return stored == plain ? nlohmann::json(kRoof) : stored;
}

}  // namespace mirage
