// An example of a sensor plugin (simulation/sensor_abi.h): a toy automotive radar that measures range,
// azimuth and Doppler. Power falls with the fourth power of the range (Richards, Fundamentals of Radar Signal
// Processing, 2014, equation 1.9). A scatterer spreads over the main lobe of a Hann window, four bins wide
// (Harris, Proc. IEEE 66(1), 1978). LiDAR returns are the scatterers of the scene, mesh faces those
// of the object. Neither occludes the other. Doppler is over ground: the car's own speed is taken out, as
// radars report it.
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>
#include <memory>
#include <numbers>
#include <vector>

#include "simulation/sensor_abi.h"

namespace {

using Eigen::Vector3d;

/// Bins along one dimension of the measurement.
struct Axis {
  int bins;
  double first, width;  ///< where the first bin begins; m, rad or m/s
};
constexpr double kDegree = std::numbers::pi / 180;
constexpr std::array<Axis, 3> kAxes = {{{64, 0, 1.25}, {48, -60 * kDegree, 2.5 * kDegree}, {8, -16, 4}}};
constexpr double kReach = 2;          // bins on either side
constexpr double kPowerRange = 20;    // m, where a scatterer of 1 m² has the power 1
constexpr double kNoise = 1e-3;       // power of a bin without an echo
constexpr double kReturnArea = 0.02;  // m² of a return with reflectance 1
constexpr double kMinDistance = 1;    // m; nothing nearer is measured
const Vector3d kMount(2, 0, -1.2);    // m, ego: behind the front bumper

/// One echo, as it moves with its scatterer.
struct Echo {
  double area = 0;                ///< m²
  std::array<double, 3> at = {};  ///< range, azimuth, speed away from the radar
};

/// Shares of an echo's power in the bins of one axis: cos²(π x / 4) at x bins from the centre.
struct Lobe {
  int first = 0, count = 0;
  std::array<double, 5> share = {}, slope = {};  ///< slope: d share / d place

  Lobe(const Axis& axis, double place) {
    const double bin = (place - axis.first) / axis.width - 0.5;
    const double lowest = std::ceil(bin - kReach), highest = std::floor(bin + kReach);
    if (!(highest >= 0 && lowest <= axis.bins - 1)) return;
    first = std::max(0, static_cast<int>(lowest));
    count = std::min(axis.bins - 1, static_cast<int>(highest)) - first + 1;
    for (int i = 0; i < count; ++i) {
      const double angle = std::numbers::pi / (2 * kReach) * (first + i - bin);
      const auto k = static_cast<std::size_t>(i);
      share[k] = std::cos(angle) * std::cos(angle);
      slope[k] = std::sin(2 * angle) * std::numbers::pi / (2 * kReach) / axis.width;
    }
  }
};

/// Visits (bin, share, d share / d place) of an echo.
template <class Visit>
void for_each_bin(const Echo& echo, const Visit& visit) {
  const Lobe r(kAxes[0], echo.at[0]), a(kAxes[1], echo.at[1]), v(kAxes[2], echo.at[2]);
  for (int i = 0; i < r.count; ++i)
    for (int j = 0; j < a.count; ++j)
      for (int k = 0; k < v.count; ++k) {
        const auto x = static_cast<std::size_t>(i), y = static_cast<std::size_t>(j),
                   z = static_cast<std::size_t>(k);
        const auto bin = static_cast<std::size_t>(
            ((r.first + i) * kAxes[1].bins + a.first + j) * kAxes[2].bins + v.first + k);
        visit(bin, r.share[x] * a.share[y] * v.share[z],
              std::array{r.slope[x] * a.share[y] * v.share[z], r.share[x] * a.slope[y] * v.share[z],
                         r.share[x] * a.share[y] * v.slope[z]});
      }
}

/// Power at the radar of an echo of 1 m².
double fall(double range) {
  return std::pow(kPowerRange / range, 4);
}

Echo echo_of(const Vector3d& p, double area, const Vector3d& velocity) {
  const double range = p.norm();
  return {area, {range, std::atan2(p.y(), p.x()), velocity.dot(p) / range}};
}

/// The velocity of the road user that the point is on; 0 if it stands or is unknown.
Vector3d velocity_at(const MirageSensorScene& scene, const Vector3d& p) {
  constexpr double kMargin = 0.1;  // m
  for (int64_t i = 0; i < scene.body_count; ++i) {
    const MirageBody& body = scene.bodies[i];
    const Vector3d velocity(body.velocity[0], body.velocity[1], body.velocity[2]);
    const Vector3d offset = p - Vector3d(body.x, body.y, body.z);
    const double along = offset.x() * std::cos(body.yaw) + offset.y() * std::sin(body.yaw),
                 across = offset.y() * std::cos(body.yaw) - offset.x() * std::sin(body.yaw);
    if (velocity.allFinite() && std::abs(along) < body.length / 2 + kMargin &&
        std::abs(across) < body.width / 2 + kMargin && std::abs(offset.z()) < body.height / 2 + kMargin)
      return velocity;
  }
  return Vector3d::Zero();
}

std::size_t value_count() {
  return static_cast<std::size_t>(kAxes[0].bins) * static_cast<std::size_t>(kAxes[1].bins) *
         static_cast<std::size_t>(kAxes[2].bins);
}

/// A face of the object as the radar sees it: the area that it shows, squared over its own, so that an
/// edge-on face fades smoothly.
struct SeenFace {
  std::array<int32_t, 3> vertices = {};
  Vector3d first, second;   ///< edges from the first corner
  Vector3d centre, normal;  ///< from the radar; the normal is as long as the area
  double shown = 0;         ///< m² across the line of sight
};

struct Tape {
  std::vector<SeenFace> faces;
  Vector3d velocity;
  std::vector<double> power;
};

SeenFace seen_face(const MirageSensorObject& object, int64_t face) {
  SeenFace seen;
  std::array<Vector3d, 3> corner;
  for (std::size_t c = 0; c < 3; ++c) {
    seen.vertices[c] = object.faces[3 * face + static_cast<int64_t>(c)];
    corner[c] = Vector3d::Map(object.vertices + 3 * static_cast<int64_t>(seen.vertices[c])) - kMount;
  }
  seen.centre = (corner[0] + corner[1] + corner[2]) / 3;
  seen.first = corner[1] - corner[0], seen.second = corner[2] - corner[0];
  seen.normal = seen.first.cross(seen.second) / 2;
  seen.shown = -seen.normal.dot(seen.centre) / seen.centre.norm();
  return seen;
}

Echo echo_of(const SeenFace& face, const Vector3d& velocity) {
  return echo_of(face.centre, face.shown * face.shown / face.normal.norm(), velocity);
}

void measure(const MirageSensorScene& scene, const MirageSensorObject* object, const double* recorded,
             double* data, void** tape) {
  std::vector<double> power(value_count());
  const auto add = [&](const Echo& echo) {
    const double strength = echo.area * fall(echo.at[0]);
    for_each_bin(echo, [&](std::size_t bin, double share, const auto&) { power[bin] += strength * share; });
  };
  if (recorded)
    for (std::size_t i = 0; i < power.size(); ++i) power[i] = kNoise * std::expm1(recorded[i]);
  else
    for (int64_t i = 0; i < scene.point_count; ++i) {
      const float* point = scene.points + 4 * i;
      const Vector3d p(point[0], point[1], point[2]);
      if ((p - kMount).norm() > kMinDistance)
        add(echo_of(p - kMount, kReturnArea * point[3], velocity_at(scene, p)));
    }
  if (object) {
    auto made = std::make_unique<Tape>();
    made->velocity = Vector3d::Map(object->velocity);
    for (int64_t f = 0; f < object->face_count; ++f) {
      const SeenFace face = seen_face(*object, f);
      if (!(face.shown > 0 && face.centre.norm() > kMinDistance)) continue;
      add(echo_of(face, made->velocity));
      made->faces.push_back(face);
    }
    made->power = power;
    if (tape) *tape = made.release();
  }
  for (std::size_t i = 0; i < power.size(); ++i) data[i] = std::log1p(power[i] / kNoise);
}

void vjp(const Tape& tape, const double* d_data, double* d_vertices) {
  for (const SeenFace& face : tape.faces) {
    const Echo echo = echo_of(face, tape.velocity);
    const double strength = echo.area * fall(echo.at[0]);
    double d_strength = 0;
    std::array<double, 3> d_at = {};
    for_each_bin(echo, [&](std::size_t bin, double share, const std::array<double, 3>& slopes) {
      const double d_power = d_data[bin] / (kNoise + tape.power[bin]);
      d_strength += d_power * share;
      for (std::size_t c = 0; c < 3; ++c) d_at[c] += d_power * strength * slopes[c];
    });
    const double range = echo.at[0], area = face.normal.norm();
    const Vector3d towards = face.centre / range;
    d_at[0] -= 4 * d_strength * strength / range;
    const double d_area = d_strength * fall(range);
    // echo.area = shown² / area, shown = −normal · towards
    const double d_shown = d_area * 2 * face.shown / area;
    const Vector3d d_normal =
        -d_shown * towards - d_area * face.shown * face.shown / (area * area * area) * face.normal;
    const Vector3d d_towards = -d_shown * face.normal + d_at[2] * tape.velocity;
    Vector3d d_centre = d_at[0] * towards + (d_towards - towards * towards.dot(d_towards)) / range;
    const double flat = face.centre.head<2>().squaredNorm();
    d_centre += d_at[1] / flat * Vector3d(-face.centre.y(), face.centre.x(), 0);
    const Vector3d d_first = face.second.cross(d_normal) / 2, d_second = d_normal.cross(face.first) / 2;
    const std::array<Vector3d, 3> d_corner = {-d_first - d_second, d_first, d_second};
    for (std::size_t c = 0; c < 3; ++c)
      Vector3d::Map(d_vertices + 3 * static_cast<int64_t>(face.vertices[c])) += d_corner[c] + d_centre / 3;
  }
}

/// Runs the work; an exception becomes the plugin's error line.
template <class Work>
int guarded(char* error, size_t error_size, const Work& work) {
  try {
    work();
    return 0;
  } catch (const std::exception& problem) {
    std::snprintf(error, error_size, "%s", problem.what());
    return 1;
  }
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const MirageSensorApi* mirage_sensor_api() {
  static const MirageSensorWord word = {"radar",
                                        {kAxes[0].bins, kAxes[1].bins, kAxes[2].bins},
                                        {1, 0, 0, -kMount.x(), 0, 1, 0, -kMount.y(), 0, 0, 1, -kMount.z()}};
  static const MirageSensorApi api = {
      MIRAGE_SENSOR_ABI,
      [](const char*, char*, std::size_t) -> void* { return const_cast<MirageSensorWord*>(&word); },
      [](void*) {},
      [](void*) { return &word; },
      [](void*, const MirageSensorScene* scene, const MirageSensorObject* object, const double* recorded,
         double* data, void** tape, char* error, std::size_t error_size) {
        return guarded(error, error_size, [&] { measure(*scene, object, recorded, data, tape); });
      },
      [](void*, const void* tape, const double* d_data, double* d_vertices, double*, char* error,
         std::size_t error_size) {
        return guarded(error, error_size, [&] { vjp(*static_cast<const Tape*>(tape), d_data, d_vertices); });
      },
      [](void* tape) { delete static_cast<Tape*>(tape); }};
  return &api;
}
