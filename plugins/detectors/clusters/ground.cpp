#include "ground.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

namespace mirage::clusters {
namespace {

constexpr double kCircle = 2 * std::numbers::pi;
constexpr double kSteepest = 0.3;  // slope of a street

/// A place in the vertical plane of one sector: distance from the unit and height (m).
struct Low {
  double rho = 0, z = 0;
};

/// The ground under the unit, from lowest returns around it: (a, b, c) of z = a + b x + c y, by least squares
/// over those near the plane of before, from a level one at the height that most share.
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
  /// How far the ground may be from where the slope leads after a way without any (m).
  double play(double rho) const {
    constexpr double kNoise = 0.12, kBend = 0.06, kMost = 0.6;
    return std::min(kNoise + kBend * (rho - seen_.back().rho), kMost);
  }
  void add(const Low& ground) {
    constexpr double kBase = 4;  // m over which a slope is told
    seen_.push_back(ground);
    std::size_t far = seen_.size() - 1;
    while (far > 0 && ground.rho - seen_[far].rho < kBase) --far;
    const double run = ground.rho - seen_[far].rho, rise = ground.z - seen_[far].z;
    const double told = run > 0 ? rise / run : first_slope_;
    slope_ = std::clamp(run < kBase ? first_slope_ + (told - first_slope_) * run / kBase : told, -kSteepest,
                        kSteepest);
  }
  /// Between what was seen, or as the slope leads.
  double at(double rho) const {
    const auto next = std::upper_bound(seen_.begin(), seen_.end(), rho,
                                       [](double value, const Low& low) { return value < low.rho; });
    if (next == seen_.end()) return ahead(rho);
    if (next == seen_.begin()) return seen_.front().z;
    const Low &a = *(next - 1), &b = *next;
    return a.z + (b.z - a.z) * (rho - a.rho) / std::max(b.rho - a.rho, 1e-9);
  }
  /// How far the nearest ground is that was seen (m).
  double distance(double rho) const {
    double nearest = 1e9;
    for (std::size_t i = 1; i < seen_.size(); ++i) nearest = std::min(nearest, std::abs(seen_[i].rho - rho));
    return nearest;
  }

 private:
  std::vector<Low> seen_;
  double slope_, first_slope_;
};

double median_of(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

std::size_t Ground::sector_of(double x, double y) {
  const double turned = (std::atan2(y, x) + std::numbers::pi) / kCircle;
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
    return kCircle * (static_cast<double>(sector) + 0.5) / kSectors - std::numbers::pi;
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
          const auto other = static_cast<std::size_t>(static_cast<int>(sector + kSectors) + k) % kSectors;
          if (all || distance[other * kBins + bin] < seen) votes.push_back(raw[other * kBins + bin]);
        }
        if (!votes.empty()) break;
      }
      heights_[sector * kBins + bin] = median_of(votes);
    }
}

double Ground::height(double x, double y) const {
  const double bins = std::clamp(std::hypot(x, y) / kBin - 0.5, 0.0, kBins - 1.0);
  const auto low = std::min(static_cast<std::size_t>(bins), kBins - 2);
  const double* of = heights_.data() + sector_of(x, y) * kBins;
  return of[low] + (of[low + 1] - of[low]) * (bins - static_cast<double>(low));
}

}  // namespace mirage::clusters
