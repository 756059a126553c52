#include "cluster.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <numeric>
#include <unordered_map>

#include "base/intervals.h"
#include "base/sizes.h"

namespace mirage::clusters {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;
constexpr double kSteepest = 0.3;  // slope of a street

/// A place in the vertical plane of one sector: distance from the unit and height (m).
struct Low {
  double rho = 0, z = 0;
};

/// The ground under the unit, from lowest returns around it: (a, b, c) of z = a + b x + c y, by least squares
/// over those near the previous plane, from a level one at the height that most share.
Eigen::Vector3d plane_around(const std::vector<Eigen::Vector3d>& lowest) {
  Eigen::Vector3d plane = Eigen::Vector3d::Zero();
  if (lowest.empty()) return plane;
  constexpr double kLayer = 0.2;  // m
  std::map<int, int> layers;
  for (const Eigen::Vector3d& p : lowest) ++layers[static_cast<int>(std::floor(p.z() / kLayer))];
  int fullest = layers.begin()->first, most = 0;
  for (const auto& [layer, count] : layers) {
    const auto above = layers.find(layer + 1);
    const int both = count + (above == layers.end() ? 0 : above->second);
    if (both > most) most = both, fullest = layer;
  }
  plane.x() = kLayer * (fullest + 1);
  for (const double reach : {0.6, 0.5, 0.4, 0.3, 0.3, 0.3, 0.3}) {
    constexpr int kEnoughSeen = 20;
    Eigen::Matrix3d squares = Eigen::Vector3d(1e-6, 50, 50).asDiagonal();  // level where little is seen
    Eigen::Vector3d products = Eigen::Vector3d::Zero();
    int used = 0;
    for (const Eigen::Vector3d& p : lowest) {
      const Eigen::Vector3d at(1, p.x(), p.y());
      const double over = p.z() - at.dot(plane);
      if (!(over < reach && over > -1.5 * reach)) continue;
      squares += at * at.transpose();
      products += at * p.z();
      ++used;
    }
    if (used < kEnoughSeen) break;
    plane = squares.ldlt().solve(products);
  }
  const double slope = plane.tail<2>().norm();
  if (slope > kSteepest) plane.tail<2>() *= kSteepest / slope;
  return plane;
}

/// The ground in one sector, from the unit outward.
class Profile {
 public:
  /// `before`: the ground under the unit, as a height and a slope along the sector.
  explicit Profile(const Low& before, double slope) : seen_{before}, slope_(slope), first_slope_(slope) {}

  double ahead(double rho) const { return seen_.back().z + slope_ * (rho - seen_.back().rho); }
  /// How far the ground may be from the slope's height after a gap without ground (m).
  double play(double rho) const {
    constexpr double kNoise = 0.12, kBend = 0.06, kMax = 0.6;
    return std::min(kNoise + kBend * (rho - seen_.back().rho), kMax);
  }
  void add(const Low& ground) {
    constexpr double kBase = 4;  // m over which a slope is told
    seen_.push_back(ground);
    std::size_t far = seen_.size() - 1;
    while (far > 0 && ground.rho - seen_[far].rho < kBase) --far;
    const double run = ground.rho - seen_[far].rho, rise = ground.z - seen_[far].z;
    const double measured = run > 0 ? rise / run : first_slope_;
    slope_ = std::clamp(run < kBase ? first_slope_ + (measured - first_slope_) * run / kBase : measured,
                        -kSteepest, kSteepest);
  }
  /// Interpolated between seen ground, or along the slope.
  double at(double rho) const {
    const auto next = std::upper_bound(seen_.begin(), seen_.end(), rho,
                                       [](double value, const Low& low) { return value < low.rho; });
    if (next == seen_.end()) return ahead(rho);
    if (next == seen_.begin()) return seen_.front().z;
    const Low &a = *(next - 1), &b = *next;
    return a.z + (b.z - a.z) * (rho - a.rho) / std::max(b.rho - a.rho, 1e-9);
  }
  /// Distance to the nearest seen ground (m).
  double distance(double rho) const {
    double nearest = 1e9;
    for (std::size_t i = 1; i < seen_.size(); ++i) nearest = std::min(nearest, std::abs(seen_[i].rho - rho));
    return nearest;
  }

 private:
  std::vector<Low> seen_;
  double slope_, first_slope_;
};

constexpr double kFar = 80;      // m
constexpr double kClear = 0.2;   // m over the ground: higher returns are not the road's
constexpr double kTall = 2.5;    // m: higher returns join nothing
constexpr double kMaxSize = 20;  // m: the diagonal of a wall or a hedge
constexpr double kBehind = 0.5;  // m from which on a ray went through
constexpr int kMinCount = 3;
constexpr double kThin = 0.1;  // m: of the returns in a square of this side one is joined for all

/// How far returns of one thing lie apart: gaps in its surface, and more with the distance, as beams and
/// firings spread. AP hardly changes from 0.25 to 0.5 m and from 0.01 to 0.015 a metre.
double reach_at(double range) {
  constexpr double kGap = 0.3, kPart = 0.015;
  return kGap + kPart * range;
}

std::uint64_t cell_of(const Vec2d& p, double size) {
  const auto part = [&](double value) {
    return static_cast<std::uint64_t>(static_cast<std::uint32_t>(
        static_cast<std::int32_t>(std::floor(std::clamp(value / size, -1e9, 1e9)))));
  };
  return part(p.x()) << 32 | part(p.y());
}

/// Sets that are joined two at a time (union-find), each named by its smallest member.
class Sets {
 public:
  explicit Sets(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), 0u); }
  std::size_t of(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(std::size_t a, std::size_t b) {
    a = of(a), b = of(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::size_t> parent_;
};

/// Directions: azimuths (rad, within a turn of [−π, π]) and slopes (height by distance).
struct Window {
  double first = 1e9, last = -1e9, low = 1e9, high = -1e9;
};

/// The sweep's returns by azimuth, to count those in a window of directions.
class Directions {
 public:
  explicit Directions(std::span<const Return> returns) {
    for (const Return& p : returns) {
      const double rho = std::hypot(p.x, p.y);
      if (rho > 0) all_.push_back({std::atan2(p.y, p.x), p.z / rho, rho});
    }
    std::sort(all_.begin(), all_.end(), [](const One& a, const One& b) { return a.azimuth < b.azimuth; });
  }
  /// Number of returns beyond `rho` (m) in the window.
  int beyond(double rho, const Window& window) const {
    int count = 0;
    for (const double shift : {-kTurn, 0.0, kTurn}) {
      auto one = std::lower_bound(all_.begin(), all_.end(), window.first + shift,
                                  [](const One& a, double value) { return a.azimuth < value; });
      for (; one != all_.end() && one->azimuth <= window.last + shift; ++one)
        count += one->rho > rho && one->slope >= window.low && one->slope <= window.high;
    }
    return count;
  }

 private:
  struct One {
    double azimuth, slope, rho;
  };
  std::vector<One> all_;
};

/// A return that is not the ground's.
struct Standing {
  Return at;
  double over;  ///< m over the ground
};

Window outline_of(const std::vector<Standing>& thing) {
  const double middle = std::atan2(thing.front().at.y, thing.front().at.x);
  Window all;
  for (const Standing& p : thing) {
    const double azimuth = middle + std::remainder(std::atan2(p.at.y, p.at.x) - middle, kTurn),
                 slope = p.at.z / std::hypot(p.at.x, p.at.y);
    all.first = std::min(all.first, azimuth), all.last = std::max(all.last, azimuth);
    all.low = std::min(all.low, slope), all.high = std::max(all.high, slope);
  }
  return all;
}

/// The middle of the outline's lower half: above it a car has slopes and windows.
Window core_of(const Window& outline) {
  constexpr double kMargin = 0.1;  // share of the outline
  const double inside = kMargin * (outline.last - outline.first);
  return {outline.first + inside, outline.last - inside, outline.low, (outline.low + outline.high) / 2};
}

/// Returns a square radian in the outline, and a few degrees around a small one.
double density_around(const Window& outline, const Directions& directions) {
  constexpr double kLeast = 0.07;  // rad
  const auto widen = [](double& low, double& high) {
    const double more = std::max(0.0, kLeast - (high - low)) / 2;
    low -= more, high += more;
  };
  Window window = outline;
  widen(window.first, window.last);
  widen(window.low, window.high);
  return directions.beyond(0, window) / ((window.last - window.first) * (window.high - window.low));
}

}  // namespace

std::size_t Ground::sector_of(double x, double y) {
  const double turned = (std::atan2(y, x) + std::numbers::pi) / kTurn;
  return std::min(static_cast<std::size_t>(turned * kSectors), kSectors - 1);
}

Ground::Ground(std::span<const Return> returns) : heights_(kSectors * kBins, 0.0) {
  std::vector<std::vector<Low>> cells(kSectors * kBins);
  for (const Return& p : returns) {
    const double rho = std::hypot(p.x, p.y);
    const auto bin = static_cast<std::size_t>(std::min(rho / kBin, 1e6));
    if (bin >= kBins) continue;
    cells[sector_of(p.x, p.y) * kBins + bin].push_back({rho, p.z});
  }
  for (auto& cell : cells)
    std::sort(cell.begin(), cell.end(),
              [](const Low& a, const Low& b) { return a.z != b.z ? a.z < b.z : a.rho < b.rho; });

  constexpr double kAround = 20;  // m
  std::vector<Eigen::Vector3d> lowest;
  const auto azimuth = [](std::size_t sector) {
    return kTurn * (static_cast<double>(sector) + 0.5) / kSectors - std::numbers::pi;
  };
  for (std::size_t sector = 0; sector < kSectors; ++sector)
    for (std::size_t bin = 0; bin < static_cast<std::size_t>(kAround / kBin); ++bin) {
      const auto& cell = cells[sector * kBins + bin];
      if (cell.empty()) continue;
      const double at = azimuth(sector);
      lowest.emplace_back(cell[0].rho * std::cos(at), cell[0].rho * std::sin(at), cell[0].z);
    }
  const Eigen::Vector3d plane = plane_around(lowest);

  std::vector<double> raw(heights_.size()), distance(heights_.size());
  for (std::size_t sector = 0; sector < kSectors; ++sector) {
    const double c = std::cos(azimuth(sector)), s = std::sin(azimuth(sector));
    Profile profile({0, plane.x()}, plane.y() * c + plane.z() * s);
    for (std::size_t bin = 0; bin < kBins; ++bin)
      for (const Low& low : cells[sector * kBins + bin]) {
        const double over = low.z - profile.ahead(low.rho), play = profile.play(low.rho);
        if (over < -play) continue;  // an echo from below
        if (over < play) profile.add(low);
        break;
      }
    for (std::size_t bin = 0; bin < kBins; ++bin) {
      const double rho = kBin * (static_cast<double>(bin) + 0.5);
      raw[sector * kBins + bin] = profile.at(rho);
      distance[sector * kBins + bin] = profile.distance(rho);
    }
  }

  constexpr int kVoters = 3;  // sectors to each side
  std::vector<double> votes;
  for (std::size_t sector = 0; sector < kSectors; ++sector)
    for (std::size_t bin = 0; bin < kBins; ++bin) {
      const double seen = std::max(2.0, 0.15 * kBin * static_cast<double>(bin));
      for (const bool all : {false, true}) {
        votes.clear();
        for (int k = -kVoters; k <= kVoters; ++k) {
          const auto other = as_size(static_cast<int>(sector + kSectors) + k) % kSectors;
          if (all || distance[other * kBins + bin] < seen) votes.push_back(raw[other * kBins + bin]);
        }
        if (!votes.empty()) break;
      }
      heights_[sector * kBins + bin] = lower_quantile(votes, 0.5);
    }
}

double Ground::height(double x, double y) const {
  const double bins = std::clamp(std::hypot(x, y) / kBin - 0.5, 0.0, kBins - 1.0);
  const auto low = std::min(static_cast<std::size_t>(bins), kBins - 2);
  const double* of = heights_.data() + sector_of(x, y) * kBins;
  return of[low] + (of[low + 1] - of[low]) * (bins - static_cast<double>(low));
}

std::vector<int> cluster_numbers(const std::vector<Vec2d>& places, const std::vector<double>& reach,
                                 double longest) {
  std::unordered_map<std::uint64_t, std::vector<std::size_t>> cells;
  for (std::size_t i = 0; i < places.size(); ++i) cells[cell_of(places[i], longest)].push_back(i);
  Sets sets(places.size());
  for (std::size_t i = 0; i < places.size(); ++i)
    for (int row = -1; row <= 1; ++row)
      for (int column = -1; column <= 1; ++column) {
        const auto cell = cells.find(cell_of(places[i] + longest * Vec2d(row, column), longest));
        if (cell == cells.end()) continue;
        for (const std::size_t k : cell->second) {
          if (k >= i) break;
          if ((places[i] - places[k]).norm() <= std::min(reach[i], reach[k])) sets.join(i, k);
        }
      }
  std::vector<int> number(places.size());
  int count = 0;
  for (std::size_t i = 0; i < places.size(); ++i) number[i] = sets.of(i) == i ? count++ : number[sets.of(i)];
  return number;
}

std::vector<Cluster> clusters_of(std::span<const Return> returns) {
  const Ground ground(returns);
  const Directions directions(returns);
  std::vector<Standing> standing;
  std::vector<std::size_t> thinned;  // which of `places` shows it
  std::unordered_map<std::uint64_t, std::size_t> squares;
  std::vector<Vec2d> places;
  std::vector<double> reach;
  for (const Return& p : returns) {
    const double rho = std::hypot(p.x, p.y);
    if (!(rho <= kFar)) continue;
    const double over = p.z - ground.height(p.x, p.y);
    if (!(over > kClear && over < kTall)) continue;
    const Vec2d place(p.x, p.y);
    const auto [square, fresh] = squares.try_emplace(cell_of(place, kThin), places.size());
    if (fresh) places.push_back(place), reach.push_back(reach_at(rho));
    standing.push_back({p, over});
    thinned.push_back(square->second);
  }
  const std::vector<int> number = cluster_numbers(places, reach, reach_at(kFar));
  const std::size_t count = number.empty() ? 0 : as_size(*std::max_element(number.begin(), number.end())) + 1;
  std::vector<std::vector<Standing>> things(count);
  for (std::size_t i = 0; i < standing.size(); ++i)
    things[as_size(number[thinned[i]])].push_back(standing[i]);

  std::vector<Cluster> found;
  std::vector<Vec2d> from_above;
  for (const auto& thing : things) {
    if (static_cast<int>(thing.size()) < kMinCount) continue;
    Cluster cluster;
    cluster.returns = static_cast<int>(thing.size());
    double farthest = 0;
    from_above.clear();
    for (const Standing& p : thing) {
      from_above.emplace_back(p.at.x, p.at.y);
      cluster.height = std::max(cluster.height, p.over);
      farthest = std::max<double>(farthest, std::hypot(p.at.x, p.at.y));
    }
    cluster.seen = closest_rectangle(from_above);
    if (std::hypot(cluster.seen.along.size(), cluster.seen.across.size()) > kMaxSize) continue;
    const BevBox box = cluster.seen.box();
    cluster.ground = ground.height(box.x, box.y);
    const Window outline = outline_of(thing);
    cluster.passed = directions.beyond(farthest + kBehind, core_of(outline));
    cluster.density = density_around(outline, directions);
    found.push_back(cluster);
  }
  return found;
}

}  // namespace mirage::clusters
