#include "sensors/lidar_effects.h"

#include <algorithm>
#include <numbers>
#include <numeric>

#include "base/error.h"
#include "base/sizes.h"

namespace mirage {

namespace {

// From the cars of KITTI's tracking drives 0000 and 0003: validation/studies/real_to_sim.py --data DRIVES.
constexpr double kDarkFloor = 0.03, kDarkPower = 0.3;

}  // namespace

double arrival_probability(double signal, const LidarEffects& effects) {
  return effects.signal_floor > 0 ? 1 - std::exp(-signal / effects.signal_floor) : 1;
}

double surface_probability(double reflectivity, const LidarEffects& effects) {
  if (!(effects.dark_floor > 0)) return 1;
  return 1 - std::exp(-std::pow(std::max(reflectivity, 0.0) / effects.dark_floor, kDarkPower));
}

std::optional<double> reported_range(double range, double arrives, const FiringChance& chance,
                                     const LidarEffects& effects, double range_min, double range_max) {
  const double reported = range + chance.range_error;
  if (chance.lost < effects.drop_out || chance.weak > arrives || reported < range_min || reported > range_max)
    return std::nullopt;
  return reported;
}

LidarEffects parse_lidar_effects(const std::string& words, const Vec2d& divergence) {
  LidarEffects effects;
  if (words == "ideal") return effects;
  std::vector<std::string> known = {"noise", "drop-out", "dark-loss", "divergence", "motion", "albedo"};
  if (words.find(',') == words.npos) known.insert(known.begin(), {"ideal", "as-recorded", "unit"});
  if (words.empty()) throw unknown_word("lidar_effects", words, known);
  for (const std::string& word : listed_words(words == "unit" ? "noise,drop-out,divergence" : words)) {
    if (word == "noise") {
      effects.range_sigma = 0.012;
    } else if (word == "drop-out") {
      effects.drop_out = 0.015;
      effects.signal_floor = 3e-5;
    } else if (word == "dark-loss") {
      effects.dark_floor = kDarkFloor;
    } else if (word == "divergence") {
      effects.divergence = divergence.isZero(0) ? Vec2d::Constant(2e-3) : divergence;
    } else if (word == "motion") {
      effects.velocity = Vec3d(15, 0, 0);
      effects.yaw_rate = 0.2;
    } else if (word == "albedo") {
      effects.albedo = true;
    } else {
      throw unknown_word("lidar_effects", word, known);
    }
  }
  return effects;
}

void check_effects(const LidarEffects& effects) {
  const auto demand = [](bool good, const char* field, const char* fix) {
    if (!good) throw InputError("LiDAR effects", field, "out of range or not finite", fix);
  };
  const auto within = [](double value, double low, double high) { return value >= low && value <= high; };
  demand(within(effects.range_sigma, 0, 10), "range_sigma", "give metres from 0 to 10");
  demand(within(effects.drop_out, 0, 1), "drop_out", "give a share from 0 to 1");
  demand(within(effects.signal_floor, 0, 1e3), "signal_floor", "give 1/m² from 0 to 1000");
  demand(within(effects.dark_floor, 0, 1e3), "dark_floor", "give a reflectivity from 0 to 1000");
  demand(within(effects.divergence.x(), 0, 0.2) && within(effects.divergence.y(), 0, 0.2), "divergence",
         "give radians from 0 to 0.2");
  demand(within(effects.pulse_length, 0, 100), "pulse_length", "give metres from 0 to 100");
  demand(effects.velocity.allFinite() && effects.velocity.norm() <= 200, "velocity", "give up to 200 m/s");
  demand(within(effects.yaw_rate, -20, 20), "yaw_rate", "give rad/s from -20 to 20");
  demand(within(effects.beam_bias_sigma, 0, 10), "beam_bias_sigma", "give metres from 0 to 10");
  demand(within(effects.angle_sigma, 0, 0.2), "angle_sigma", "give radians from 0 to 0.2");
  demand(within(effects.reflectance_sigma, 0, 10), "reflectance_sigma", "give a number from 0 to 10");
  demand(within(effects.dark_level, 0, 1), "dark_level", "give a reflectance from 0 to 1");
  demand(within(effects.reflectance_step, 0, 1), "reflectance_step", "give a reflectance from 0 to 1");
}

std::vector<SubRay> beam_pattern(const LidarEffects& effects) {
  std::vector<SubRay> pattern(1);
  if (!effects.has_divergence()) return pattern;
  double total = 1;
  for (int ring = 1; ring <= 2; ++ring)
    for (int i = 0; i < 6 * ring; ++i) {
      const double radius = ring / 2.0, turn = 2 * std::numbers::pi * i / (6 * ring);
      const double weight = std::exp(-2 * radius * radius);
      pattern.push_back(
          {Vec2d(std::cos(turn), std::sin(turn)).cwiseProduct(effects.divergence) * (radius / 2), weight});
      total += weight;
    }
  for (SubRay& sub : pattern) sub.weight /= total;
  return pattern;
}

Vec3d turned(const Vec3d& direction, const Vec2d& angle) {
  const Vec3d left = Vec3d(-direction.y(), direction.x(), 0).normalized();
  return (direction + angle.x() * left + angle.y() * direction.cross(left)).normalized();
}

Transform start_from_moment(const LidarEffects& effects, double time) {
  Transform pose = Transform::Identity();
  pose.linear() = Eigen::AngleAxisd(effects.yaw_rate * time, Vec3d::UnitZ()).toRotationMatrix();
  pose.translation() = effects.velocity * time;
  return pose;
}

void strongest_echo(std::span<const Reflection> reflections, double pulse_length, Echo& echo) {
  echo.strongest = -1;
  echo.members.clear();
  std::vector<int> order(reflections.size());
  std::iota(order.begin(), order.end(), 0);
  const auto at = [&](int i) -> const Reflection& { return reflections[as_size(i)]; };
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return at(a).range < at(b).range; });
  double best = 0;
  for (std::size_t first = 0, end = 0; first < order.size(); first = end) {
    double sum = 0;
    for (end = first; end < order.size(); ++end) {
      if (end > first && at(order[end]).range - at(order[end - 1]).range > pulse_length) break;
      sum += at(order[end]).strength;
    }
    if (!(sum > best)) continue;
    best = sum;
    echo.members.assign(order.begin() + static_cast<std::ptrdiff_t>(first),
                        order.begin() + static_cast<std::ptrdiff_t>(end));
  }
  for (int i : echo.members)
    if (echo.strongest < 0 || at(i).strength > at(echo.strongest).strength) echo.strongest = i;
}

}  // namespace mirage
