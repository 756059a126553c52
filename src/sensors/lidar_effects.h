// Effects of a spinning LiDAR beyond one thin, noiseless ray a firing. Every effect is off by default. The
// same settings serve generated sweeps (sensors/lidar_sweep.h) and returns on an inserted object
// (simulation/insertion.h).
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/fields.h"

namespace mirage {

/// Deviations of a real unit from ideal rays. All off by default.
struct LidarEffects {
  /// Range noise (m).
  double range_sigma = 0;

  /// Share of the returns that are lost at random.
  double drop_out = 0;
  /// Drop-out with range and incidence (1/m²): arrival_probability(). 0: all arrive.
  double signal_floor = 0;
  /// Drop-out of dark surfaces at any range: surface_probability(). 0: none is lost.
  double dark_floor = 0;

  /// Full angle of the beam (rad; horizontal, vertical) at which a Gaussian profile has fallen to 1/e². The
  /// cone is sampled by 19 rays; those whose ranges follow each other within `pulse_length` (m) make one
  /// echo, the echo with the largest sum of weight · returned_signal() is the return: at the range of its
  /// strongest ray, in the direction of the beam's axis, with the weighted sum of its rays' reflectances. 0:
  /// one ray.
  Vec2d divergence = Vec2d::Zero();
  double pulse_length = 0.6;  ///< half of c · 4 ns, the HDL-64E's pulse

  /// Reflectance from the surface's colour: mean of the three channels of the texel (or albedo) hit, times
  /// the cosine of the incidence, in place of a constant reflectivity.
  bool albedo = false;

  /// Motion during the sweep: velocity (m/s, in `velo`) and yaw rate (rad/s, about the velo origin) of the
  /// vehicle relative to the scene. A firing at time t (LidarModel::firing_time) starts at the unit's
  /// position at t. Its return is written in the unit's frame of that moment, as in an uncompensated
  /// recording.
  Vec3d velocity = Vec3d::Zero();
  double yaw_rate = 0;

  // Whole sweeps only: a recorded sweep contains them, and rays through its returns follow them.
  double beam_bias_sigma = 0;    ///< m, constant per beam: calibration residual
  double angle_sigma = 0;        ///< rad, of azimuth and elevation
  double reflectance_sigma = 0;  ///< of the reported reflectance
  double dark_level = 0;         ///< reflectance that is reported as 0
  double reflectance_step = 0;   ///< reported reflectances are multiples of this; 0: any

  /// Key of the random streams of an inserted object's returns (whole sweeps take theirs as an argument).
  std::uint64_t seed = 0;

  /// Whether the unit moves during a turn.
  bool moving() const { return yaw_rate != 0 || !velocity.isZero(0); }
  /// Whether a beam has divergence.
  bool has_divergence() const { return !divergence.isZero(0); }
  /// Whether returns are lost.
  bool losing() const { return drop_out > 0 || signal_floor > 0 || dark_floor > 0; }
  /// Whether an inserted object's returns differ from ideal ones.
  bool any() const { return losing() || range_sigma > 0 || has_divergence() || albedo || moving(); }
};

/// The effects on an inserted object's returns.
template <class Visitor, FieldsOf<LidarEffects> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "range_sigma", .range = {0, 10}, .option = ""}, s.range_sigma);
  visit({.name = "drop_out", .range = kShare, .option = ""}, s.drop_out);
  visit({.name = "signal_floor", .range = {0, 1e3}, .option = ""}, s.signal_floor);
  visit({.name = "dark_floor", .range = {0, 1e3}, .option = "", .lacking = "0"}, s.dark_floor);
  visit({.name = "divergence", .range = {0, 0.2}, .option = ""}, s.divergence);
  visit({.name = "pulse_length", .range = {0, 100}, .option = ""}, s.pulse_length);
  visit({.name = "albedo", .option = ""}, s.albedo);
  visit({.name = "velocity", .range = {-200, 200}, .option = ""}, s.velocity);
  visit({.name = "yaw_rate", .range = {-20, 20}, .option = ""}, s.yaw_rate);
  visit({.name = "seed", .option = ""}, s.seed);
}

/// The light returned by a surface (1/m²), without factors of the unit: ρ cos^0.7 θ / r². Real surfaces,
/// rougher than Lambert's, return more at grazing incidence than his cosine. Whole sweeps and inserted
/// objects derive their echoes' strengths and their losses from it.
template <class S>
S returned_signal(S reflectivity, S cosine, S range) {
  return reflectivity * std::pow(cosine, S(0.7)) / (range * range);
}

/// Probability that a return of that signal is reported: 1 − exp(−signal / signal_floor); 1 without a floor.
double arrival_probability(double signal, const LidarEffects& effects);

/// Probability that a surface of reflectivity ρ returns at all: 1 − exp(−(ρ / dark_floor)^0.3); 1 without a
/// floor. On recorded cars, black paint loses half of the rays, at 8 m as at 30 m and hardly more at grazing
/// incidence; bright paint loses a tenth. Inserted objects only: generated sweeps have their own surfaces.
double surface_probability(double reflectivity, const LidarEffects& effects);

/// Random draws of a firing, independent of its target.
struct FiringChance {
  double range_error = 0;  ///< m
  double lost = 1;         ///< uniform in [0, 1): below drop_out the return is lost
  double weak = 0;         ///< uniform in [0, 1): above reported_range()'s `arrives` the return is lost
};
/// The range (m) that a unit with these range limits reports of an echo; nullopt if the return is lost.
/// `arrives`: arrival_probability() of its signal, times the surface's own losses.
std::optional<double> reported_range(double range, double arrives, const FiringChance& chance,
                                     const LidarEffects& effects, double range_min, double range_max);

/// Effects by word. "ideal": none. "unit": noise, drop-out and divergence, which every unit has. Or a
/// list with commas of: noise (σ 12 mm), drop-out (1.5 %, and by signal: floor 3e-5 /m²), divergence (of the
/// unit, `divergence` in rad; if zero, the HDL-64E's 2 mrad), dark-loss (as on recorded
/// cars: floor 0.03), motion (15 m/s and 0.2 rad/s: an uncompensated sweep), albedo (reflectance from the
/// texels). FieldError naming lidar_effects otherwise.
LidarEffects parse_lidar_effects(const std::string& words, const Vec2d& divergence);

/// InputError naming the field, for a value that is not finite, a negative spread, a share outside [0, 1], a
/// beam wider than 0.2 rad, a speed beyond 200 m/s or 20 rad/s.
void check_effects(const LidarEffects& effects);

/// A ray of a beam's cone: turned by `angle` (rad; to the left, down) from the axis, with its share of the
/// light.
struct SubRay {
  Vec2d angle = Vec2d::Zero();
  double weight = 1;
};

/// Without divergence the axis only; otherwise the axis and rings of 6 and 12 rays at half and all of the
/// half angle. Weights sum to 1.
std::vector<SubRay> beam_pattern(const LidarEffects& effects);

/// `direction` (unit, `velo`) turned by a small angle to its left (horizontal) and downwards.
Vec3d turned(const Vec3d& direction, const Vec2d& angle);

/// The vehicle's pose at time t (s), in its frame at time 0.
Transform start_from_moment(const LidarEffects& effects, double time);

/// A contribution to the received light.
struct Reflection {
  double range = 0;     ///< m
  double strength = 0;  ///< weight · returned_signal()
};

/// The strongest echo of a firing: its reflections and the strongest of them. Ties go to the nearer one.
struct Echo {
  int strongest = -1;        ///< index; −1: no return
  std::vector<int> members;  ///< indices, by range
};
/// The echo with the most energy. Reflections within `pulse_length` (m) of the one before join its echo.
/// Reuses `echo`'s memory.
void strongest_echo(std::span<const Reflection> reflections, double pulse_length, Echo& echo);

}  // namespace mirage
