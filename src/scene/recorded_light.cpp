#include "scene/recorded_light.h"

#include <fmt/format.h>
#include <libnova/dynamical_time.h>
#include <libnova/julian_day.h>
#include <libnova/nutation.h>
#include <libnova/refraction.h>
#include <libnova/sidereal_time.h>
#include <libnova/solar.h>
#include <libnova/transform.h>

#include <Eigen/QR>
#include <algorithm>
#include <array>
#include <atomic>
#include <charconv>
#include <chrono>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "base/error.h"
#include "base/image.h"
#include "base/intervals.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/sizes.h"
#include "base/types.h"
#include "sensors/lighting.h"

namespace mirage {
namespace {

constexpr double kMinRoadDistance = 5, kMaxRoadDistance = 20, kAside = 1.5, kThickness = 0.15;  // m
constexpr std::size_t kMinReturns = 50;                                                         // returns
constexpr double kGroundQuantile = 0.2;  // quantile of the heights in the corridor: under cars and kerbs
// Darker is a road in the shade of trees beside sunlit cars, brighter one that mirrors a low sun between
// shaded ones.
constexpr double kDarkest = 0.5, kBrightest = 3;

constexpr int kAzimuths = 36;
constexpr double kElevations[] = {15, 20, 26, 33, 41, 50, 60};  // degrees; shadows' lengths 3.7 … 0.6 heights
constexpr double kMaxGroundDistance = 35;  // m to a vehicle: further ones have too few ground returns
constexpr double kAround = 3.5;            // m from a vehicle's outline
constexpr double kContact = 0.25;          // m: darker in any light, and within the labels' error
constexpr double kCaster = 15;             // m from a sample to the middle of what can shade it
constexpr double kCell = 0.15;             // m: returns of a cell count as one
constexpr double kGround = 0.2;            // m between a ground return and the vehicle's bottom
constexpr int kRivalDegrees = 40;          // degrees of azimuth: a rival direction
constexpr int kMinCount = 60;              // samples around a vehicle
constexpr double kContrasts[] = {0.3, 0.5, 0.8, 1.2, 1.7};  // log luminance outside less inside
constexpr double kMinConfidence = 5;                        // log likelihood over that of every rival
constexpr double kBody = 0.8;  // of the box's height: a car is narrower than its box at the top

/// A box that casts a shadow.
struct Caster {
  Box3 box;
  double cosine, sine;
  explicit Caster(const Box3& b) : box(b), cosine(std::cos(b.bev.yaw)), sine(std::sin(b.bev.yaw)) {}
  Vec3d turned(const Vec3d& v) const {
    return {cosine * v.x() + sine * v.y(), cosine * v.y() - sine * v.x(), v.z()};
  }
  Vec3d local(const Vec3d& p) const { return turned(p - Vec3d(box.bev.x, box.bev.y, box.bottom)); }
  /// Distance (m) from the outline, seen from above; 0 inside.
  double distance(const Vec3d& p) const {
    const Vec3d at = local(p);
    return std::hypot(std::max(0.0, std::abs(at.x()) - box.bev.length / 2),
                      std::max(0.0, std::abs(at.y()) - box.bev.width / 2));
  }
};

/// Whether the ray from `from` along `way` (both in the caster's frame) meets its box.
bool meets(const Caster& caster, const Vec3d& from, const Vec3d& way) {
  const double along = caster.box.bev.length / 2, across = caster.box.bev.width / 2;
  const auto [enter, leave] =
      ray_within(from, way, {-along, -across, 0.1}, {along, across, kBody * caster.box.height});
  return enter <= leave;
}

struct GroundSample {
  Vec3d p_velo;
  double log_luminance = 0, reflectance = 0;
};

bool in_convex(const std::vector<Vec2d>& hull, const Vec2d& p) {
  for (std::size_t i = 0; i < hull.size(); ++i) {
    const Vec2d a = hull[i], edge = hull[(i + 1) % hull.size()] - a;
    if (cross(edge, p - a) < 0) return false;
  }
  return hull.size() >= 3;
}

/// Convex hull of a box in the photograph; empty if it reaches behind the camera.
std::vector<Vec2d> outline(const Frame& frame, const Box3& box) {
  std::vector<Vec2d> points;
  for (const Vec3d& corner : corners(box)) {
    const Vec3d p = frame.calibration.camera_from_velo * corner;
    if (p.z() < 0.1) return {};
    points.push_back(frame.calibration.camera.project(p));
  }
  return convex_hull(std::move(points));
}

bool is_vehicle(const Label& label) {
  return has_box(label) && (label.type == "Car" || label.type == "Van" || label.type == "Truck");
}

/// The visible ground around one vehicle, one sample a cell.
std::vector<GroundSample> ground_around(const Frame& frame, const Caster& vehicle,
                                        const std::vector<Caster>& casters,
                                        const std::vector<std::vector<Vec2d>>& outlines) {
  std::map<std::pair<long, long>, std::pair<GroundSample, int>> cells;
  for (const LidarPoint& point : frame.sweep) {
    const Vec3d p = point.position().cast<double>();
    if (!p.allFinite() || std::abs(p.z() - vehicle.box.bottom) > kGround || vehicle.distance(p) > kAround)
      continue;
    const Vec3d p_camera = frame.calibration.camera_from_velo * p;
    if (p_camera.z() < 1) continue;
    const Vec2d at = frame.calibration.camera.project(p_camera);
    const long u = std::lround(at.x()), v = std::lround(at.y());
    if (u < 0 || v < 0 || u >= frame.image.width || v >= frame.image.height) continue;
    if (std::any_of(casters.begin(), casters.end(),
                    [&](const Caster& c) { return c.distance(p) < kContact; }))
      continue;
    if (std::any_of(outlines.begin(), outlines.end(), [&](const auto& hull) { return in_convex(hull, at); }))
      continue;
    const float* rgb = &frame.image.at(static_cast<int>(u), static_cast<int>(v), 0);
    auto& [sample, count] = cells[{std::lround(p.x() / kCell), std::lround(p.y() / kCell)}];
    sample.p_velo += p;
    sample.log_luminance += std::log(std::max(1e-3f, luminance(rgb)));
    sample.reflectance += point.reflectance;
    ++count;
  }
  std::vector<GroundSample> samples;
  for (auto& [cell, sum] : cells)
    samples.push_back({sum.first.p_velo / sum.second, sum.first.log_luminance / sum.second,
                       sum.first.reflectance / sum.second});
  return samples;
}

/// Least squares of log luminance on the shade and on covariates (the return's reflectance, which does not
/// depend on the sun, and a gradient over the ground). By the Frisch–Waugh theorem, the covariates are first
/// projected out of luminance and shade.
class Ground {
 public:
  explicit Ground(std::vector<GroundSample> samples) : samples_(std::move(samples)) {
    const auto n = static_cast<Eigen::Index>(samples_.size());
    Eigen::MatrixXd other(n, kOther);
    luminance_.resize(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const GroundSample& sample = samples_[as_size(i)];
      const double r = sample.reflectance;
      other.row(i) << 1, r, r * r, sample.p_velo.x(), sample.p_velo.y();
      luminance_[i] = sample.log_luminance;
    }
    basis_ = Eigen::ColPivHouseholderQR<Eigen::MatrixXd>(other).householderQ() *
             Eigen::MatrixXd::Identity(n, kOther);
    luminance_ = project_out(luminance_);
    squares_ = std::max(1e-4 * static_cast<double>(n), luminance_.squaredNorm());
  }
  const std::vector<GroundSample>& samples() const { return samples_; }
  /// Log likelihood ratio of a shade that darkens by each of kContrasts to no shadow; n samples count as √n,
  /// because neighbours correlate.
  std::array<double, std::size(kContrasts)> log_likelihood_ratios(const Eigen::VectorXd& shaded) const {
    const Eigen::VectorXd shade = project_out(shaded);
    const double across = shade.dot(luminance_), own = shade.squaredNorm();
    std::array<double, std::size(kContrasts)> log_likelihood_ratios;
    for (std::size_t c = 0; c < log_likelihood_ratios.size(); ++c) {
      const double rest = squares_ + 2 * kContrasts[c] * across + kContrasts[c] * kContrasts[c] * own;
      log_likelihood_ratios[c] =
          -0.5 * std::sqrt(static_cast<double>(samples_.size())) * std::log(std::max(rest / squares_, 1e-3));
    }
    return log_likelihood_ratios;
  }

 private:
  static constexpr int kOther = 5;
  Eigen::VectorXd project_out(const Eigen::VectorXd& of) const {
    return of - basis_ * (basis_.transpose() * of);
  }
  std::vector<GroundSample> samples_;
  Eigen::MatrixXd basis_;
  Eigen::VectorXd luminance_;
  double squares_ = 0;
};

constexpr double kRoofDrop = 0.15;  // m; vertices of a fitted vehicle no further below its roof belong to it
constexpr int kPaintSamples = 32;   // pixels along each side of the median's window

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
  const auto value = try_parse_number<double>(text, true);
  if (!value)
    throw FieldError("sun", word, fmt::format("the {} \"{}\" is not a number", what, text),
                     std::string("use ") + kForms);
  if (!(*value >= low && *value <= high))
    throw FieldError("sun", word, fmt::format("the {} {} is out of range", what, text),
                     fmt::format("use {} degrees", Range{low, high}.words()));
  return *value;
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

std::optional<Vec3d> road_radiance(const Frame& frame) {
  std::vector<Vec3d> corridor;
  for (const LidarPoint& point : frame.sweep) {
    const Vec3d p = point.position().cast<double>();
    if (!(p.x() >= kMinRoadDistance && p.x() <= kMaxRoadDistance && std::abs(p.y()) <= kAside)) continue;
    const bool on_object = std::any_of(frame.labels.begin(), frame.labels.end(), [&](const Label& label) {
      return has_box(label) && contains(label.box, p, kThickness);
    });
    if (!on_object) corridor.push_back(p);
  }
  if (corridor.size() < kMinReturns) return std::nullopt;
  std::vector<double> heights;
  for (const Vec3d& p : corridor) heights.push_back(p.z());
  const double ground = quantile(heights, kGroundQuantile);
  std::array<std::vector<double>, 3> colours;
  for (const Vec3d& p : corridor) {
    const Vec3d p_camera = frame.calibration.camera_from_velo * p;
    if (std::abs(p.z() - ground) > kThickness || p_camera.z() <= 0) continue;
    const Vec2d pixel = frame.calibration.camera.project(p_camera);
    const long u = std::lround(pixel.x()), v = std::lround(pixel.y());
    if (u < 0 || v < 0 || u >= frame.image.width || v >= frame.image.height) continue;
    for (int c = 0; c < 3; ++c)
      colours[as_size(c)].push_back(frame.image.at(static_cast<int>(u), static_cast<int>(v), c));
  }
  if (colours[0].size() < kMinReturns) return std::nullopt;
  return Vec3d(quantile(colours[0], 0.5), quantile(colours[1], 0.5), quantile(colours[2], 0.5));
}

Lighting with_road_exposure(const Frame& frame) {
  Lighting lighting = frame.lighting;
  const std::optional<Vec3d> road = road_radiance(frame);
  if (!road) return lighting;
  const Vec3d level = kRoadAlbedo * shade(Vec3d::UnitZ(), lighting);
  for (int c = 0; c < 3; ++c) {
    if (!(level[c] > 0)) continue;
    const double gain = std::clamp((*road)[c] / level[c], kDarkest, kBrightest);
    lighting.sun[c] *= gain;
    lighting.ambient[c] *= gain;
    lighting.hemisphere[c] *= gain;
  }
  return lighting;
}

std::optional<Vec3d> sun_from_shadows(const Frame& frame) {
  std::vector<Caster> casters;
  std::vector<std::vector<Vec2d>> outlines;
  for (const Label& label : frame.labels)
    if (has_box(label)) {
      casters.emplace_back(label.box);
      outlines.push_back(outline(frame, label.box));
    }
  constexpr std::size_t kHeights = std::size(kElevations), kLevels = std::size(kContrasts);
  std::vector<std::array<double, kLevels>> score(kAzimuths * kHeights);
  for (auto& s : score) s.fill(0);
  for (const Label& label : frame.labels) {
    if (!is_vehicle(label) || horizontal_distance(label.box.bev) > kMaxGroundDistance) continue;
    std::vector<GroundSample> ground_samples = ground_around(frame, Caster(label.box), casters, outlines);
    if (ground_samples.size() < kMinCount) continue;
    const Ground ground(std::move(ground_samples));
    const auto& samples = ground.samples();
    std::vector<const Caster*> near;
    for (const Caster& c : casters)
      if (horizontal_distance(c.box.bev, label.box.bev) < kCaster) near.push_back(&c);
    std::vector<std::vector<Vec3d>> local(near.size());  // the samples in each caster's frame
    for (std::size_t c = 0; c < near.size(); ++c)
      for (const GroundSample& sample : samples) local[c].push_back(near[c]->local(sample.p_velo));
    Eigen::VectorXd shaded(static_cast<Eigen::Index>(samples.size()));
    for (std::size_t k = 0; k < score.size(); ++k) {
      const Vec3d way = unit_vector(static_cast<double>(k / kHeights) * 360 / kAzimuths * kDegree,
                                    kElevations[k % kHeights] * kDegree);
      shaded.setZero();
      for (std::size_t c = 0; c < near.size(); ++c) {
        const Vec3d turned = near[c]->turned(way);
        for (std::size_t i = 0; i < samples.size(); ++i) {
          double& shade = shaded[static_cast<Eigen::Index>(i)];
          if (shade == 0 && meets(*near[c], local[c][i], turned)) shade = 1;
        }
      }
      const auto log_likelihood_ratios = ground.log_likelihood_ratios(shaded);
      for (std::size_t c = 0; c < kLevels; ++c) score[k][c] += log_likelihood_ratios[c];
    }
  }
  std::vector<double> highest;
  for (const auto& s : score) highest.push_back(*std::max_element(s.begin(), s.end()));
  const auto k = as_size(std::max_element(highest.begin(), highest.end()) - highest.begin());
  // The lowest contrast is not a shadow.
  if (!(highest[k] > 0) || highest[k] == score[k].front()) return std::nullopt;
  const int azimuth = static_cast<int>(k / kHeights);
  double other = 0;
  for (std::size_t i = 0; i < score.size(); ++i) {
    const int apart = std::abs(static_cast<int>(i / kHeights) - azimuth);
    if (std::min(apart, kAzimuths - apart) * 360 / kAzimuths > kRivalDegrees)
      other = std::max(other, highest[i]);
  }
  if (!(highest[k] - other > kMinConfidence)) return std::nullopt;
  return unit_vector(azimuth * 360.0 / kAzimuths * kDegree, kElevations[k % kHeights] * kDegree);
}

Vec3d vehicle_paint(const Frame& frame, const Label& host) {
  const ImageF& image = frame.image_of(as_size(host.camera));
  const int u0 = std::max(0, static_cast<int>(host.left)),
            u1 = std::min(image.width, static_cast<int>(host.right));
  const int v0 = std::max(0, static_cast<int>(host.top + 0.4 * (host.bottom - host.top)));
  const int v1 = std::min(image.height, static_cast<int>(host.top + 0.8 * (host.bottom - host.top)));
  Vec3d albedo = Vec3d::Constant(0.3);
  if (u1 <= u0 || v1 <= v0) return albedo;
  const Lighting& light = frame.lighting;
  const int step_u = 1 + (u1 - u0 - 1) / kPaintSamples, step_v = 1 + (v1 - v0 - 1) / kPaintSamples;
  for (int c = 0; c < 3; ++c) {
    std::vector<float> values;
    for (int v = v0; v < v1; v += step_v)
      for (int u = u0; u < u1; u += step_u) values.push_back(image.at(u, v, c));
    const double received = light.ambient[c] + light.hemisphere[c] / 2 + light.sun[c] / 3;
    albedo[c] = std::clamp(lower_quantile(std::move(values), 0.5) / std::max(received, 1e-3), 0.02, 0.85);
  }
  return albedo;
}

LightSurroundings light_surroundings(const Frame& frame, const Carrier& carrier) {
  const Label& host = carrier.label;
  LightSurroundings around;
  around.velo_from_roof = carrier.velo_from_roof;
  around.paint = vehicle_paint(frame, host);
  around.road = Vec3d::Constant(kRoadAlbedo);
  const Transform roof_from_velo = carrier.velo_from_roof.inverse();
  const double l = host.box.bev.length, w = host.box.bev.width, h = host.box.height;
  around.deck_below = (1 - saloon::kWaist) * h;
  if (carrier.shape && !carrier.shape->faces.empty()) {
    around.roof.setEmpty();
    around.deck.setEmpty();
    double lowest = 0;
    for (const std::size_t i : used_vertices(*carrier.shape)) {
      const Vec3d p = roof_from_velo * carrier.shape->vertices[i];
      around.deck.extend(Vec2d(p.head<2>()));
      if (p.z() > -kRoofDrop) around.roof.extend(Vec2d(p.head<2>()));
      lowest = std::min(lowest, p.z());
    }
    around.road_below = -lowest;
    if (!around.roof.isEmpty()) return around;
  }
  const Vec3d centre = roof_from_velo * Vec3d(host.box.bev.x, host.box.bev.y, host.box.bottom);
  around.road_below = -centre.z();
  const Vec2d middle = centre.head<2>();
  around.deck = {middle - Vec2d(l, w) / 2, middle + Vec2d(l, w) / 2};
  around.roof = {middle + Vec2d(saloon::kRoofRear * l, -saloon::kRoofWidth * w / 2),
                 middle + Vec2d(saloon::kRoofFront * l, saloon::kRoofWidth * w / 2)};
  return around;
}

SunPosition sun_position(double latitude, double longitude, const UtcTime& time) {
  ln_date date{time.year, time.month, time.day, time.hour, time.minute, time.second};
  const double day = ln_get_julian_day(&date);
  // libnova's longitude of the sun (VSOP87) refers to the equinox of 2000 without aberration, and
  // ln_get_solar_equ_coords corrects neither: 0.16° in 2011. Both corrections follow.
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
  // Refraction applies above the horizon only: below it the formula has no meaning.
  const double lifted = seen.alt > -1 ? ln_get_refraction_adj(seen.alt, 1010, 10) : 0;
  return {std::fmod(seen.az + 180, 360.0) * kDegree, (seen.alt + lifted) * kDegree};  // from south
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
    const std::optional<Vec3d> to_sun = sun_from_shadows(frame);
    static std::atomic_flag warned;
    if (to_sun)
      lighting.to_sun_velo = *to_sun;
    else if (!warned.test_and_set())
      spdlog::warn("sun photo: the shadows in frame {} do not tell; such frames keep their own lighting",
                   frame.id);
  }
  return lighting;
}

}  // namespace mirage
