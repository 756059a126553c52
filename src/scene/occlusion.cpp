#include "scene/occlusion.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "base/sizes.h"
#include "base/types.h"

namespace mirage {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kNearAngle = 0.1 * kPi / 180;

/// Distance of a point from the unit's axis (m), never 0.
double horizontal_distance(const Vec3d& p) {
  return std::max(p.head<2>().norm(), 1e-6);
}

std::vector<BeamLine> lines_of(const LidarModel& lidar) {
  std::vector<BeamLine> lines;
  for (const LidarBeam& beam : lidar.beams) lines.push_back({beam.height, std::tan(beam.elevation)});
  return lines;
}

/// The firing's azimuth at which a laser passes a point (rad; in the unit's frame, not wrapped).
double firing_through(const LidarBeam& beam, const Vec3d& p) {
  const double sideways = std::asin(std::clamp(beam.lateral / horizontal_distance(p), -1.0, 1.0));
  return std::atan2(p.y(), p.x()) - beam.azimuth_offset - sideways;
}

/// Angle between a return and a ray, seen from the ray's origin.
double angle_to(const LidarRay& ray, const Vec3d& p) {
  const Vec3d offset = p - ray.origin;
  return std::atan2(ray.direction.cross(offset).norm(), ray.direction.dot(offset));
}

/// Index of the firing nearest to `azimuth`; −1 if it is further than `reach`.
int nearest_firing(const std::vector<double>& firings, double azimuth, double reach) {
  if (firings.empty()) return -1;
  const auto next = std::lower_bound(firings.begin(), firings.end(), azimuth) - firings.begin();
  const std::size_t count = firings.size(), after = as_size(next) % count,
                    before = (after + count - 1) % count;
  const double to_after = std::abs(wrap_angle(firings[after] - azimuth)),
               to_before = std::abs(wrap_angle(firings[before] - azimuth));
  if (std::min(to_after, to_before) > reach) return -1;
  return static_cast<int>(to_after <= to_before ? after : before);
}

double angle_off_beam(const std::vector<BeamLine>& lines, const Vec3d& p, std::size_t& beam) {
  const double rho = horizontal_distance(p);
  beam = nearest_line(lines, rho, p.z());
  return (p.z() - lines[beam].height - rho * lines[beam].slope) / std::hypot(1.0, lines[beam].slope) /
         std::max(p.norm(), 1e-3);
}

/// The motion that puts most of the points on beams: the best of steady drives at several speeds, refined by
/// Gauss-Newton, far points first.
SweepMotion motion_of(const std::vector<Vec3d>& points, std::vector<double>& phases, const LidarModel& lidar,
                      const SweepMotion& still) {
  constexpr double kFastest = 3, kBetween = 0.25;  // m a turn
  constexpr double kMinDistance = 2, kScale = 0.03 * kPi / 180;
  constexpr std::size_t kMax = 6000;
  constexpr int kRounds = 20;
  const std::vector<BeamLine> lines = lines_of(lidar);
  std::vector<std::size_t> looked;
  const std::size_t every = points.size() / kMax + 1;
  for (std::size_t i = 0; i < points.size(); i += every)
    if (points[i].norm() > kMinDistance) looked.push_back(i);
  const auto off = [&](const SweepMotion& by, double scale) {
    double sum = 0;
    for (const std::size_t i : looked) {
      std::size_t beam = 0;
      double phase = phases[i];
      const double angle = angle_off_beam(lines, by.seen(points[i], phase), beam) / scale;
      sum += angle * angle / (1 + angle * angle);
    }
    return sum;
  };
  SweepMotion best = still;
  double least = off(best, 3 * kScale);
  const Vec3d ahead = lidar.velo_from_lidar.linear().transpose() * Vec3d::UnitX();
  for (double by = -kFastest; by <= kFastest; by += kBetween)
    for (const double reference : {0.0, 0.5, 1.0}) {
      SweepMotion candidate = still;
      candidate.turn = by * ahead;
      candidate.start = -reference * by * ahead;
      if (const double value = off(candidate, 3 * kScale); value < least) least = value, best = candidate;
    }
  for (int round = 0; round < kRounds; ++round) {
    const double scale = kScale * std::max(1.0, 10.0 - round);
    using Six = Eigen::Matrix<double, 6, 1>;
    Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Identity() * (scale * scale);
    Six right = Six::Zero();
    for (const std::size_t i : looked) {
      double phase = phases[i];
      const Vec3d p = best.seen(points[i], phase);
      std::size_t beam = 0;
      const double angle = angle_off_beam(lines, p, beam), weight = 1 / (1 + std::pow(angle / scale, 2));
      const Vec3d outward(p.x() / horizontal_distance(p), p.y() / horizontal_distance(p), 0);
      const Vec3d gradient = (Vec3d::UnitZ() - lines[beam].slope * outward) /
                             std::hypot(1.0, lines[beam].slope) / std::max(p.norm(), 1e-3);
      Six row;
      row << gradient, phase * gradient;
      normal += weight * row * row.transpose();
      right += weight * angle * row;
    }
    const Six step = normal.ldlt().solve(right);
    best.start += step.head<3>();
    best.turn += step.tail<3>();
  }
  // The cut as the moving unit saw it: midway between the first and the last return.
  double first = 1, last = 0;
  for (const std::size_t i : looked) {
    double phase = phases[i];
    best.seen(points[i], phase);
    first = std::min(first, phase), last = std::max(last, phase);
  }
  if (best.whole) {
    const double later = (first + last - 1) / 2;
    best.cut += later * 2 * kPi;
    best.start += later * best.turn;
    for (double& phase : phases) phase -= later;
  }
  return best;
}

}  // namespace

std::size_t nearest_line(std::span<const BeamLine> lines, double rho, double z) {
  std::size_t low = 0, high = lines.size() - 1;  // heights fall with the index
  while (high - low > 1) {
    const std::size_t middle = (low + high) / 2;
    (lines[middle].at(rho) >= z ? low : high) = middle;
  }
  return std::abs(lines[low].at(rho) - z) <= std::abs(lines[high].at(rho) - z) ? low : high;
}

std::vector<int> beams_of(std::span<const LidarPoint> points, const LidarModel& lidar) {
  const std::vector<BeamLine> lines = lines_of(lidar);
  const Transform lidar_from_velo = lidar.velo_from_lidar.inverse();
  std::vector<int> beams;
  beams.reserve(points.size());
  for (const LidarPoint& point : points) {
    const Vec3d p = lidar_from_velo * point.position().cast<double>();
    beams.push_back(p.allFinite() && !lidar.beams.empty()
                        ? static_cast<int>(nearest_line(lines, horizontal_distance(p), p.z()))
                        : -1);
  }
  return beams;
}

double SweepMotion::phase(double azimuth) const {
  if (!whole) return wrap_angle(azimuth) / (2 * kPi);
  const double turned = (azimuth - cut) / (2 * kPi);
  return turned - std::floor(turned);
}

Vec3d SweepMotion::seen(const Vec3d& p, double& phase_) const {
  if (turn.isZero(0)) return p - start;
  constexpr int kRounds = 4;  // each leaves a sixth of |turn| / distance
  for (int round = 0; round < kRounds; ++round) {
    const Vec3d q = p - at(phase_);
    const double looked = phase(std::atan2(q.y(), q.x()));
    phase_ = looked + std::round(phase_ - looked);
  }
  return p - at(phase_);
}

SweepMotion no_motion(std::span<const Vec3d> points, std::vector<double>& phases) {
  constexpr std::size_t kSectors = 36;
  constexpr double kNothing = 0.1;   // m: a nearer point is an empty firing
  constexpr double kOneTurn = 0.05;  // tolerance of a sweep's turn
  std::array<bool, kSectors> looked{};
  bool any = false;
  double first = 0, last = 0, turned = 0;
  phases.clear();
  for (const Vec3d& p : points) {
    if (p.norm() > kNothing) {
      const double azimuth = std::atan2(p.y(), p.x());
      looked[static_cast<std::size_t>((azimuth + kPi) / (2 * kPi) * kSectors) % kSectors] = true;
      if (any) turned += wrap_angle(azimuth - last) / (2 * kPi);
      if (!any) first = azimuth;
      any = true;
      last = azimuth;
    }
    phases.push_back(turned);
  }
  SweepMotion motion;
  motion.whole = std::count(looked.begin(), looked.end(), true) >= static_cast<std::ptrdiff_t>(kSectors) - 1;
  if (motion.whole) motion.cut = first;
  const bool by_firing = motion.whole && std::abs(std::abs(turned) - 1) < kOneTurn;
  for (std::size_t i = 0; i < phases.size(); ++i)
    phases[i] = by_firing ? phases[i] + (turned < 0) : motion.phase(std::atan2(points[i].y(), points[i].x()));
  return motion;
}

SweepIndex::SweepIndex(const Sweep& sweep, const LidarModel& lidar) : lidar_(lidar) {
  const bool free = lidar.encoder_step == 0;
  const double explained = free ? 0.99 : 0.95;
  constexpr std::size_t kMinCount = 500;  // returns needed to find a motion
  build(sweep, {}, {}, false);
  if (assigned_share_ >= explained || returns_.size() - as_size(skipped_) < kMinCount ||
      lidar.beams.size() < 2)
    return;
  std::vector<Vec3d> points;
  for (const Return& r : returns_)
    if (r.beam >= 0) points.push_back(lidar.velo_from_lidar.inverse() * r.p_velo);
  std::vector<double> phases;
  const SweepMotion still = no_motion(points, phases);
  const auto take_if_better = [&](const SweepMotion& motion, bool own_firings) {
    SweepIndex other;
    other.lidar_ = lidar_;
    other.build(sweep, phases, motion, own_firings);
    if (other.assigned_share_ > assigned_share_) *this = std::move(other);
  };
  if (free) take_if_better(still, true);
  if (assigned_share_ < explained) {
    const SweepMotion moving = motion_of(points, phases, lidar, still);
    take_if_better(moving, false);
    if (free) take_if_better(moving, true);
  }
}

Vec3d SweepIndex::seen_by_unit(const Vec3d& p_velo) const {
  const Vec3d p = lidar_.velo_from_lidar.inverse() * p_velo;
  if (motion_.none()) return p;
  double phase = motion_.phase(std::atan2(p.y(), p.x()));
  return motion_.seen(p, phase);
}

void SweepIndex::build(const Sweep& sweep, std::span<const double> phases, const SweepMotion& motion,
                       bool own_firings) {
  motion_ = motion;
  lines_ = lines_of(lidar_);
  returns_.reserve(sweep.size());
  std::size_t seen = 0;  // index into `phases`, which has no entry for skipped returns
  for (const LidarPoint& point : sweep) {
    const Vec3d p_velo = point.position().cast<double>();
    Vec3d p = lidar_.velo_from_lidar.inverse() * p_velo;
    if (!p.allFinite() || lidar_.beams.empty()) {
      returns_.push_back({p_velo, -1, 0, 0});
      ++skipped_;
      continue;
    }
    double phase = seen < phases.size() ? phases[seen++] : 0;
    if (!motion_.none()) p = motion_.seen(p, phase);
    const auto beam = static_cast<int>(nearest_line(lines_, horizontal_distance(p), p.z()));
    returns_.push_back({p_velo, beam, wrap_angle(firing_through(lidar_.beams[as_size(beam)], p)), phase});
  }
  own_firings ? find_own_firings() : find_firings();
  for (const LidarBeam& b : lidar_.beams) {
    elevations_.push_back({std::cos(b.elevation), std::sin(b.elevation)});
    offsets_.push_back({std::cos(b.azimuth_offset), std::sin(b.azimuth_offset)});
  }
  for (double azimuth : firings_) turns_.push_back({std::cos(azimuth), std::sin(azimuth)});
  assign();
}

/// LidarModel::ray_at from tables of cosines and sines.
LidarRay SweepIndex::ray_of_cell(std::size_t beam, std::size_t firing) const {
  const LidarBeam& b = lidar_.beams[beam];
  const Turn &elevation = elevations_[beam], &offset = offsets_[beam], &turn = turns_[firing];
  const double ca = turn.cosine * offset.cosine - turn.sine * offset.sine,
               sa = turn.sine * offset.cosine + turn.cosine * offset.sine;
  Vec3d origin(-b.lateral * sa, b.lateral * ca, b.height);
  if (!motion_.none()) origin += motion_.at(motion_.phase(std::atan2(sa, ca)));
  return {
      lidar_.velo_from_lidar * origin,
      lidar_.velo_from_lidar.linear() * Vec3d(elevation.cosine * ca, elevation.cosine * sa, elevation.sine)};
}

void SweepIndex::find_firings() {
  if (lidar_.encoder_step > 0) {
    const auto steps = as_size(std::lround(2 * kPi / lidar_.encoder_step));
    std::vector<int> seen(steps, 0);
    for (const Return& r : returns_)
      if (r.beam >= 0) ++seen[as_size(std::lround((r.firing + kPi) / lidar_.encoder_step)) % steps];
    // Few returns that noise moves to the next step fall on the same step.
    const int enough = std::max(2, static_cast<int>(lidar_.beams.size()) / 8);
    for (std::size_t step = 0; step < steps; ++step)
      if (seen[step] >= enough) firings_.push_back(-kPi + static_cast<double>(step) * lidar_.encoder_step);
    if (!firings_.empty()) return;  // an empty sweep: the model's firings
  }
  const int columns = lidar_.azimuth_count();
  for (int column = 0; column < columns; ++column) {
    const double azimuth = wrap_angle(lidar_.firing_azimuth(column));
    // A field of view of a whole turn ends where it began.
    if (column == 0 || std::abs(wrap_angle(azimuth - firings_.front())) > lidar_.azimuth_step / 2)
      firings_.push_back(azimuth);
  }
  std::sort(firings_.begin(), firings_.end());
}

void SweepIndex::find_own_firings() {
  constexpr std::ptrdiff_t kBins = 16, kApart = 7, kAround = 4;  // of a step
  const auto bins = static_cast<std::ptrdiff_t>(std::lround(kBins * 2 * kPi / lidar_.azimuth_step));
  const double width = 2 * kPi / static_cast<double>(bins);
  std::vector<int> counts(as_size(bins));
  std::vector<double> sums(counts.size());  // of the returns' positions within their bin
  const auto wrapped = [&](std::ptrdiff_t bin) { return as_size((bin % bins + bins) % bins); };
  for (const Return& r : returns_) {
    if (r.beam < 0) continue;
    const double place = (r.firing + kPi) / width;
    const auto bin = wrapped(static_cast<std::ptrdiff_t>(std::floor(place)));
    ++counts[bin];
    sums[bin] += place - std::floor(place);
  }
  std::vector<int> near(counts.size());
  for (std::ptrdiff_t b = 0; b < bins; ++b)
    for (std::ptrdiff_t k = -kAround; k <= kAround; ++k)
      near[wrapped(b)] += static_cast<int>(kAround + 1 - std::abs(k)) * counts[wrapped(b + k)];
  const int enough = std::max(2, static_cast<int>(lidar_.beams.size()) / 8);
  for (std::ptrdiff_t b = 0; b < bins; ++b) {
    bool highest = true;
    for (std::ptrdiff_t k = -kApart; k <= kApart && highest; ++k)
      highest = k < 0 ? near[wrapped(b + k)] < near[wrapped(b)] : near[wrapped(b + k)] <= near[wrapped(b)];
    int count = 0;
    double sum = 0;
    for (std::ptrdiff_t k = -kAround; k <= kAround; ++k) {
      const std::size_t at = wrapped(b + k);
      count += counts[at];
      sum += static_cast<double>(k) * counts[at] + sums[at];
    }
    if (highest && count >= enough)
      firings_.push_back(wrap_angle(-kPi + (static_cast<double>(b) + sum / count) * width));
  }
  std::sort(firings_.begin(), firings_.end());
}

void SweepIndex::assign() {
  cells_.assign(lidar_.beams.size() * firings_.size(), -1);
  const double reach = (lidar_.encoder_step > 0 ? lidar_.encoder_step : lidar_.azimuth_step) / 2 + 1e-9;
  std::vector<double> angles(returns_.size(), kPi);
  for (std::size_t i = 0; i < returns_.size(); ++i) {
    const Return& r = returns_[i];
    if (r.beam < 0) continue;
    int loser = static_cast<int>(i);
    if (const int firing = nearest_firing(firings_, r.firing, reach); firing >= 0) {
      const auto f = as_size(firing);
      angles[i] = angle_to(ray_of_cell(as_size(r.beam), f), r.p_velo);
      int& holder = cells_[as_size(r.beam) * firings_.size() + f];
      if (holder < 0 || angles[i] < angles[as_size(holder)]) std::swap(holder, loser);
    }
    if (loser >= 0) extra_.push_back(loser);
  }
  std::size_t near = 0;
  for (int point : cells_) near += point >= 0 && angles[as_size(point)] <= kNearAngle;
  assigned_share_ = returns_.empty() ? 0 : static_cast<double>(near) / static_cast<double>(returns_.size());
}

SweepRay SweepIndex::ray_of(int point, int firing) const {
  const Return& r = returns_[as_size(point)];
  const LidarBeam& b = lidar_.beams[as_size(r.beam)];
  const double azimuth = r.firing + b.azimuth_offset;
  Vec3d from(-b.lateral * std::sin(azimuth), b.lateral * std::cos(azimuth), b.height);
  if (!motion_.none()) from += motion_.at(r.phase);
  const Vec3d origin = lidar_.velo_from_lidar * from;
  const double range = std::max((r.p_velo - origin).norm(), 1e-6);
  return {{origin, (r.p_velo - origin) / range}, r.beam, firing, r.firing, point, range};
}

SweepRay SweepIndex::ray_at(std::size_t beam, std::size_t firing) const {
  const int point = cells_[beam * firings_.size() + firing], f = static_cast<int>(firing);
  if (point >= 0) return ray_of(point, f);
  return {ray_of_cell(beam, firing), static_cast<int>(beam), f, firings_[firing], -1, 0};
}

std::vector<SweepRay> SweepIndex::rays_through(const Vec3d& centre_velo, double radius) const {
  constexpr double kSlack = 0.01;  // rad: a return's own ray against that of its cell
  std::vector<SweepRay> rays;
  const auto add = [&](const SweepRay& candidate) {
    const Vec3d offset = centre_velo - candidate.ray.origin;
    if (offset.dot(candidate.ray.direction) > -radius &&
        candidate.ray.direction.cross(offset).norm() <= radius)
      rays.push_back(candidate);
  };
  const Vec3d centre = seen_by_unit(centre_velo);
  const double rho = centre.head<2>().norm(), azimuth = std::atan2(centre.y(), centre.x());
  const std::size_t count = firings_.size();
  for (std::size_t b = 0; b < lidar_.beams.size() && count > 0; ++b) {
    const LidarBeam& beam = lidar_.beams[b];
    const double reach = radius + std::abs(beam.lateral);
    // In the plane of horizontal distance and height a laser is one line and the ball a disc.
    const double miss =
        (beam.height - centre.z()) * std::cos(beam.elevation) + rho * std::sin(beam.elevation);
    if (std::abs(miss) > reach + kSlack * (rho + radius)) continue;
    const double half = reach < rho ? std::min(kPi, std::asin(reach / rho) + kSlack) : kPi;
    const double from = wrap_angle(azimuth - beam.azimuth_offset - half);
    const auto first = as_size(std::lower_bound(firings_.begin(), firings_.end(), from) - firings_.begin());
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t f = (first + k) % count;
      const double turned = firings_[f] - from;
      if ((turned < 0 ? turned + 2 * kPi : turned) > 2 * half) break;
      add(ray_at(b, f));
    }
  }
  for (int point : extra_) add(ray_of(point, -1));
  return rays;
}

std::optional<RasterCell> SweepIndex::cell_at(const Vec3d& p_velo) const {
  const std::size_t lasers = lidar_.beams.size();
  if (lasers < 2 || firings_.empty() || !p_velo.allFinite()) return std::nullopt;
  const Vec3d p = seen_by_unit(p_velo);
  const double rho = horizontal_distance(p);
  const std::size_t b = nearest_line(lines_, rho, p.z());
  const auto height = [&](std::size_t k) { return lines_[k].at(rho); };
  const double above = b > 0 ? height(b - 1) - height(b) : height(0) - height(1),
               below = b + 1 < lasers ? height(b) - height(b + 1) : above;
  const double pitch = (above + below) / 2, off = p.z() - height(b);
  if (!(pitch > 0) || off > above / 2 || -off > below / 2) return std::nullopt;

  const LidarBeam& beam = lidar_.beams[b];
  const double azimuth = wrap_angle(firing_through(beam, p));
  const int firing = nearest_firing(firings_, azimuth, lidar_.azimuth_step);
  if (firing < 0) return std::nullopt;
  const auto f = as_size(firing), count = firings_.size();
  // A gap in the firings does not belong to the cell.
  const auto to = [&](std::size_t other) {
    return std::min(std::abs(wrap_angle(firings_[other] - firings_[f])), 2 * lidar_.azimuth_step);
  };
  const double turn =
      count < 3 ? lidar_.azimuth_step : (to((f + 1) % count) + to((f + count - 1) % count)) / 2;
  if (!(turn > 0)) return std::nullopt;

  RasterCell cell;
  cell.ray = ray_at(b, f);
  const Vec3d outward(p.x() / rho, p.y() / rho, 0), left(-outward.y(), outward.x(), 0);
  const double sine = std::clamp(beam.lateral / rho, -0.999, 0.999);
  const Eigen::Matrix3d& turned = lidar_.velo_from_lidar.linear();
  cell.left_per_metre = turned * (left + sine / std::sqrt(1 - sine * sine) * outward) / (rho * turn);
  cell.up_per_metre = turned * (Vec3d::UnitZ() - (p.z() - beam.height) / rho * outward) / pitch;
  return cell;
}

}  // namespace mirage
