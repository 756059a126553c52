#include "scene/sun.h"

#include <fmt/format.h>
#include <libnova/dynamical_time.h>
#include <libnova/julian_day.h>
#include <libnova/nutation.h>
#include <libnova/refraction.h>
#include <libnova/sidereal_time.h>
#include <libnova/solar.h>
#include <libnova/transform.h>

#include <atomic>
#include <charconv>
#include <chrono>
#include <cmath>
#include <numbers>
#include <vector>

#include "base/angles.h"
#include "base/error.h"
#include "base/logging.h"
#include "base/words.h"
#include "scene/recorded_light.h"

namespace mirage {
namespace {

constexpr const char* kForms = "AZIMUTH,ELEVATION or LAT,LON,YYYY-MM-DDTHH:MM:SSZ,HEADING (degrees)";

std::vector<std::string> split(const std::string& word) {
  std::vector<std::string> parts(1);
  for (const char c : word) {
    if (c == ',')
      parts.emplace_back();
    else if (c != ' ')
      parts.back() += c;
  }
  return parts;
}

/// `text` as a finite number within [low, high]. `what` names it in the error.
double number(const std::string& word, const std::string& text, const char* what, double low, double high) {
  double value = 0;
  const char *begin = text.data() + (text.starts_with('+') ? 1 : 0), *end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(begin, end, value);
  if (error != std::errc() || stop != end || begin == end)
    throw FieldError("sun", word, fmt::format("the {} \"{}\" is not a number", what, text),
                     std::string("use ") + kForms);
  if (!(value >= low && value <= high))
    throw FieldError("sun", word, fmt::format("the {} {} is out of range", what, text),
                     fmt::format("use {} degrees", Range{low, high}.words()));
  return value;
}

UtcTime parse_time(const std::string& word, const std::string& text) {
  const auto wrong = [&](const std::string& problem) {
    return FieldError("sun", word, fmt::format("the time \"{}\" {}", text, problem),
                      "give UTC as YYYY-MM-DDTHH:MM:SSZ, e.g. 2011-09-26T13:02:25Z");
  };
  constexpr const char* kForm = "dddd-dd-ddTdd:dd:dd";
  constexpr std::size_t kLength = 19;
  bool fits = text.size() > kLength && text.back() == 'Z';
  for (std::size_t i = 0; fits && i < kLength; ++i)
    fits = kForm[i] == 'd' ? text[i] >= '0' && text[i] <= '9' : text[i] == kForm[i];
  for (std::size_t i = kLength; fits && i + 1 < text.size(); ++i)
    fits = i == kLength ? text[i] == '.' : text[i] >= '0' && text[i] <= '9';
  if (!fits) throw wrong("is not of that form");
  const auto digits = [&](std::size_t from, std::size_t count) {
    return std::stoi(text.substr(from, count));
  };
  UtcTime time{digits(0, 4), digits(5, 2), digits(8, 2), digits(11, 2), digits(14, 2), 0};
  std::from_chars(text.data() + 17, text.data() + text.size() - 1, time.second);
  const std::chrono::year_month_day date(std::chrono::year(time.year),
                                         std::chrono::month(static_cast<unsigned>(time.month)),
                                         std::chrono::day(static_cast<unsigned>(time.day)));
  if (!date.ok() || time.hour > 23 || time.minute > 59 || time.second >= 60) throw wrong("does not exist");
  return time;
}

Vec3d from_place(const std::string& word, const std::vector<std::string>& parts) {
  const double latitude = number(word, parts[0], "latitude", -90, 90) * kDegree;
  const double longitude = number(word, parts[1], "longitude", -180, 180) * kDegree;
  const UtcTime time = parse_time(word, parts[2]);
  const double heading = number(word, parts[3], "heading", -360, 360) * kDegree;
  const SunPosition sun = sun_position(latitude, longitude, time);
  if (!(sun.elevation > 0))
    throw FieldError(
        "sun", word,
        fmt::format("the sun is {:.1f} degrees below the horizon there and then", -sun.elevation / kDegree),
        "give a time of day (UTC) or AZIMUTH,ELEVATION");
  return unit_vector(std::numbers::pi / 2 - sun.azimuth - heading, sun.elevation);
}

}  // namespace

SunPosition sun_position(double latitude, double longitude, const UtcTime& time) {
  ln_date date{time.year, time.month, time.day, time.hour, time.minute, time.second};
  const double day = ln_get_julian_day(&date);
  // libnova's longitude of the sun (VSOP87) is of the equinox of 2000 and without aberration, which its
  // ln_get_solar_equ_coords leaves so: 0.16° in 2011. Here both are put in.
  const double dynamical = ln_get_jde(day), centuries = (dynamical - JD2000) / 36525;
  ln_helio_posn sun{};
  ln_get_solar_geom_coords(dynamical, &sun);
  ln_nutation nutation{};
  ln_get_nutation(dynamical, &nutation);
  // General precession in longitude: Capitaine, Wallace & Chapront, A&A 412 (2003), p_A.
  const double precession = (5028.796195 + 1.1054348 * centuries) * centuries / 3600;
  const double aberration = -20.4898 / 3600 / sun.R;  // SPA, equation 26
  ln_lnlat_posn ecliptic{sun.L + precession + nutation.longitude + aberration, sun.B};
  ln_equ_posn equatorial{};
  ln_get_equ_from_ecl(&ecliptic, dynamical, &equatorial);
  ln_lnlat_posn observer{longitude / kDegree, latitude / kDegree};
  ln_hrz_posn seen{};
  ln_get_hrz_from_equ_sidereal_time(&equatorial, &observer, ln_get_apparent_sidereal_time(day), &seen);
  // Refraction is of the seen air: not below the horizon, where the formula has no meaning.
  const double lifted = seen.alt > -1 ? ln_get_refraction_adj(seen.alt, 1010, 10) : 0;
  return {std::fmod(seen.az + 180, 360.0) * kDegree, (seen.alt + lifted) * kDegree};  // libnova's 0 is south
}

SunChoice parse_sun(const std::string& word) {
  if (word == kDefaultSun) return {};
  if (word == "photo") return {word, {}, true};
  const std::vector<std::string> parts = split(word);
  if (parts.size() == 4) return {word, from_place(word, parts), false};
  if (parts.size() != 2) throw unknown_word("sun", word, {kDefaultSun, "photo"}, kForms);
  const double azimuth = number(word, parts[0], "azimuth", -360, 360);
  const double elevation = number(word, parts[1], "elevation", 0, 90);
  if (!(elevation > 0))
    throw FieldError("sun", word, "the sun is on the horizon", "give an elevation over 0 degrees");
  return {word, unit_vector(azimuth * kDegree, elevation * kDegree), false};
}

Lighting with_sun(const Frame& frame, const SunChoice& choice) {
  Lighting lighting = frame.lighting;
  if (choice.to_sun_velo) lighting.to_sun_velo = *choice.to_sun_velo;
  if (choice.photo) {
    const SunEstimate estimate = sun_from_shadows(frame);
    static std::atomic_flag said;
    if (estimate.known)
      lighting.to_sun_velo = estimate.to_sun_velo;
    else if (!said.test_and_set())
      spdlog::warn("sun photo: the shadows in frame {} do not tell; such frames keep their own lighting",
                   frame.id);
  }
  return lighting;
}

}  // namespace mirage
