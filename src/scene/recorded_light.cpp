#include "scene/recorded_light.h"

#include <Eigen/QR>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include "base/angles.h"
#include "base/color.h"
#include "base/intervals.h"
#include "sensors/shading.h"

namespace mirage {
namespace {

constexpr double kNearestRoad = 5, kFarthestRoad = 20, kAside = 1.5, kThickness = 0.15;  // m
constexpr std::size_t kFewestReturns = 50;                                               // returns
constexpr double kGroundQuantile = 0.2;  // quantile of the heights in the corridor: under cars and kerbs
// Darker is a road in the shade of trees beside sunlit cars, brighter one that mirrors a low sun between
// shaded ones.
constexpr double kDarkest = 0.5, kBrightest = 3;

}  // namespace

std::optional<Vec3d> road_radiance(const Frame& frame) {
  std::vector<Vec3d> corridor;
  for (const LidarPoint& point : frame.sweep) {
    const Vec3d p = point.position().cast<double>();
    if (!(p.x() >= kNearestRoad && p.x() <= kFarthestRoad && std::abs(p.y()) <= kAside)) continue;
    const bool on_object = std::any_of(frame.labels.begin(), frame.labels.end(), [&](const Label& label) {
      return has_box(label) && contains(label.box, p, kThickness);
    });
    if (!on_object) corridor.push_back(p);
  }
  if (corridor.size() < kFewestReturns) return std::nullopt;
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
      colours[static_cast<std::size_t>(c)].push_back(
          frame.image.at(static_cast<int>(u), static_cast<int>(v), c));
  }
  if (colours[0].size() < kFewestReturns) return std::nullopt;
  return Vec3d(quantile(colours[0], 0.5), quantile(colours[1], 0.5), quantile(colours[2], 0.5));
}

Lighting with_road_exposure(const Frame& frame) {
  Lighting lighting = frame.lighting;
  const std::optional<Vec3d> road = road_radiance(frame);
  if (!road) return lighting;
  const Vec3d level = kRoadAlbedo * shade<double>(Vec3d::UnitZ(), lighting);
  for (int c = 0; c < 3; ++c) {
    if (!(level[c] > 0)) continue;
    const double gain = std::clamp((*road)[c] / level[c], kDarkest, kBrightest);
    lighting.sun[c] *= gain;
    lighting.ambient[c] *= gain;
    lighting.hemisphere[c] *= gain;
  }
  return lighting;
}

namespace {

constexpr int kAzimuths = 36;
constexpr double kElevations[] = {15, 20, 26, 33, 41, 50, 60};  // degrees; shadows' lengths 3.7 … 0.6 heights
constexpr double kFarthestGround = 35;  // m to a vehicle: further ones have too few ground returns
constexpr double kAround = 3.5;         // m from a vehicle's outline
constexpr double kContact = 0.25;       // m: darker in any light, and labels are no more exact
constexpr double kCaster = 15;          // m from a sample to the middle of what can shade it
constexpr double kCell = 0.15;          // m: returns of a cell count as one
constexpr double kGround = 0.2;         // m between a ground return and the vehicle's bottom
constexpr int kElsewhere = 40;          // degrees of azimuth: a rival direction
constexpr int kFewest = 60;             // samples around a vehicle
constexpr double kContrasts[] = {0.3, 0.5, 0.8, 1.2, 1.7};  // log luminance outside less inside
constexpr double kSure = 5;    // confidence that counts; the lowest contrast never does
constexpr double kBody = 0.8;  // of the box's height: a car is narrower than its box at the top

/// A box as shadows need it.
struct Caster {
  Box3 box;
  double cosine, sine;
  explicit Caster(const Box3& b) : box(b), cosine(std::cos(b.bev.yaw)), sine(std::sin(b.bev.yaw)) {}
  Vec3d turned(const Vec3d& v) const {
    return {cosine * v.x() + sine * v.y(), cosine * v.y() - sine * v.x(), v.z()};
  }
  Vec3d local(const Vec3d& p) const { return turned(p - Vec3d(box.bev.x, box.bev.y, box.bottom)); }
  /// m from the outline, seen from above; 0 inside.
  double distance(const Vec3d& p) const {
    const Vec3d at = local(p);
    return std::hypot(std::max(0.0, std::abs(at.x()) - box.bev.length / 2),
                      std::max(0.0, std::abs(at.y()) - box.bev.width / 2));
  }
};

/// Whether the ray from `from` along `way` (both in the caster's frame) meets its box.
bool meets(const Caster& caster, const Vec3d& from, const Vec3d& way) {
  const double low[] = {-caster.box.bev.length / 2, -caster.box.bev.width / 2, 0.1};
  const double high[] = {caster.box.bev.length / 2, caster.box.bev.width / 2, kBody * caster.box.height};
  double enter = 0, leave = 1e9;
  for (int k = 0; k < 3; ++k) {
    if (std::abs(way[k]) < 1e-9) {
      if (from[k] < low[k] || from[k] > high[k]) return false;
      continue;
    }
    const double a = (low[k] - from[k]) / way[k], b = (high[k] - from[k]) / way[k];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return enter <= leave;
}

struct GroundSample {
  Vec3d p_velo;
  double log_luminance = 0, reflectance = 0;
};

bool in_convex(const std::vector<Vec2d>& hull, const Vec2d& p) {
  for (std::size_t i = 0; i < hull.size(); ++i) {
    const Vec2d a = hull[i], edge = hull[(i + 1) % hull.size()] - a, to = p - a;
    if (edge.x() * to.y() - edge.y() * to.x() < 0) return false;
  }
  return hull.size() >= 3;
}

/// Convex hull (Andrew's monotone chain) of a box in the photograph; empty where it reaches behind the
/// camera.
std::vector<Vec2d> outline(const Frame& frame, const Box3& box) {
  std::vector<Vec2d> points, hull;
  for (const Vec3d& corner : corners(box)) {
    const Vec3d p = frame.calibration.camera_from_velo * corner;
    if (p.z() < 0.1) return {};
    points.push_back(frame.calibration.camera.project(p));
  }
  std::sort(points.begin(), points.end(),
            [](const Vec2d& a, const Vec2d& b) { return std::pair(a.x(), a.y()) < std::pair(b.x(), b.y()); });
  const auto chain = [&](auto begin, auto end) {
    const std::size_t start = hull.size();
    for (auto p = begin; p != end; ++p) {
      while (hull.size() >= start + 2) {
        const Vec2d u = hull[hull.size() - 1] - hull[hull.size() - 2], v = *p - hull[hull.size() - 1];
        if (u.x() * v.y() - u.y() * v.x() > 0) break;
        hull.pop_back();
      }
      hull.push_back(*p);
    }
    hull.pop_back();
  };
  chain(points.begin(), points.end());
  chain(points.rbegin(), points.rend());
  return hull;
}

bool casts(const Label& label) {
  return has_box(label);
}

bool is_vehicle(const Label& label) {
  return has_box(label) && (label.type == "Car" || label.type == "Van" || label.type == "Truck");
}

/// The ground in view around one vehicle, a sample a cell.
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

/// Least squares of log luminance on the shade and on what is no shadow (the return's reflectance, which no
/// sun changes, and a gradient over the ground): by the Frisch–Waugh theorem, luminance and shade are first
/// freed of the latter.
class Ground {
 public:
  explicit Ground(std::vector<GroundSample> samples) : samples_(std::move(samples)) {
    const auto n = static_cast<Eigen::Index>(samples_.size());
    Eigen::MatrixXd other(n, kOther);
    luminance_.resize(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const GroundSample& sample = samples_[static_cast<std::size_t>(i)];
      const double r = sample.reflectance;
      other.row(i) << 1, r, r * r, sample.p_velo.x(), sample.p_velo.y();
      luminance_[i] = sample.log_luminance;
    }
    basis_ = Eigen::ColPivHouseholderQR<Eigen::MatrixXd>(other).householderQ() *
             Eigen::MatrixXd::Identity(n, kOther);
    luminance_ = freed(luminance_);
    squares_ = std::max(1e-4 * static_cast<double>(n), luminance_.squaredNorm());
  }
  const std::vector<GroundSample>& samples() const { return samples_; }
  /// Log likelihood of the shade darkening by `contrast`, over that of no shadow, for each contrast.
  std::array<double, std::size(kContrasts)> gains(const Eigen::VectorXd& shaded) const {
    const Eigen::VectorXd shade = freed(shaded);
    const double across = shade.dot(luminance_), own = shade.squaredNorm();
    std::array<double, std::size(kContrasts)> gains;
    for (std::size_t c = 0; c < gains.size(); ++c) {
      const double rest = squares_ + 2 * kContrasts[c] * across + kContrasts[c] * kContrasts[c] * own;
      gains[c] =
          -0.5 * std::sqrt(static_cast<double>(samples_.size())) * std::log(std::max(rest / squares_, 1e-3));
    }
    return gains;
  }

 private:
  static constexpr int kOther = 5;
  Eigen::VectorXd freed(const Eigen::VectorXd& of) const { return of - basis_ * (basis_.transpose() * of); }
  std::vector<GroundSample> samples_;
  Eigen::MatrixXd basis_;
  Eigen::VectorXd luminance_;
  double squares_ = 0;
};

}  // namespace

SunEstimate sun_from_shadows(const Frame& frame) {
  std::vector<Caster> casters;
  std::vector<std::vector<Vec2d>> outlines;
  for (const Label& label : frame.labels)
    if (casts(label)) {
      casters.emplace_back(label.box);
      outlines.push_back(outline(frame, label.box));
    }
  constexpr std::size_t kHeights = std::size(kElevations), kLevels = std::size(kContrasts);
  std::vector<std::array<double, kLevels>> score(kAzimuths * kHeights);
  for (auto& s : score) s.fill(0);
  SunEstimate best;
  for (const Label& label : frame.labels) {
    if (!is_vehicle(label) || std::hypot(label.box.bev.x, label.box.bev.y) > kFarthestGround) continue;
    std::vector<GroundSample> ground_samples = ground_around(frame, Caster(label.box), casters, outlines);
    if (ground_samples.size() < kFewest) continue;
    const Ground ground(std::move(ground_samples));
    const auto& samples = ground.samples();
    ++best.vehicles;
    std::vector<const Caster*> near;
    for (const Caster& c : casters)
      if (std::hypot(c.box.bev.x - label.box.bev.x, c.box.bev.y - label.box.bev.y) < kCaster)
        near.push_back(&c);
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
      const auto gains = ground.gains(shaded);
      for (std::size_t c = 0; c < kLevels; ++c) score[k][c] += gains[c];
    }
  }
  std::vector<double> highest;
  for (const auto& s : score) highest.push_back(*std::max_element(s.begin(), s.end()));
  const auto k = static_cast<std::size_t>(std::max_element(highest.begin(), highest.end()) - highest.begin());
  if (!(highest[k] > 0)) return best;
  const int azimuth = static_cast<int>(k / kHeights);
  double other = 0;
  for (std::size_t i = 0; i < score.size(); ++i) {
    const int apart = std::abs(static_cast<int>(i / kHeights) - azimuth);
    if (std::min(apart, kAzimuths - apart) * 360 / kAzimuths > kElsewhere)
      other = std::max(other, highest[i]);
  }
  best.to_sun_velo = unit_vector(azimuth * 360.0 / kAzimuths * kDegree, kElevations[k % kHeights] * kDegree);
  best.score = highest[k];
  best.contrast = kContrasts[std::max_element(score[k].begin(), score[k].end()) - score[k].begin()];
  best.confidence = best.score - other;
  best.known = best.confidence > kSure && best.contrast > kContrasts[0];
  return best;
}

namespace {

constexpr double kRoofDrop = 0.15;  // m; vertices of a fitted vehicle no further below its roof belong to it
constexpr int kPaintSamples = 32;   // pixels along each side of the window that the median is taken over

}  // namespace

Vec3d vehicle_paint(const Frame& frame, const Label& host) {
  const ImageF& image = frame.image_of(static_cast<std::size_t>(host.camera));
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
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    const double received = light.ambient[c] + light.hemisphere[c] / 2 + light.sun[c] / 3;
    albedo[c] = std::clamp(*middle / std::max(received, 1e-3), 0.02, 0.85);
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

}  // namespace mirage
