#include "sensors/light_sun.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "geometry/atlas_triangles.h"

namespace mirage {
namespace {

constexpr int kUnseenRays = 2;  // 2² rays from a side that only reflections show
constexpr int kMostParts = 8;   // a texel is split into 8² at most

class SunTracer {
 public:
  SunTracer(const LightNodes& nodes, RayPencil* pencil, const Vec3d& to_sun, int resolution,
            const VisibleLightSettings& settings)
      : nodes_(nodes),
        pencil_(pencil),
        to_sun_(to_sun.cast<float>()),
        resolution_(resolution),
        settings_(settings),
        lit_(nodes.wholes.size()),
        resolutions_(nodes.faces, resolution) {
    shares_.of_nodes.assign(static_cast<std::size_t>(nodes.nodes()), 0);
  }

  SunShares run(const std::vector<std::vector<Vec3f>>& met_points) {
    if (pencil_) {
      pencil_->along(to_sun_);
      look_from_sides(met_points);
      refine();
    }
    share_to_nodes();
    share_to_parts();
    return std::move(shares_);
  }

 private:
  /// The points of one side that look at the sun: the centroids of n² parts.
  struct Samples {
    int n = 0;
    std::vector<std::uint8_t> lit;  ///< whether each sees it
  };

  bool is_turned_to_sun(const LightLeaf& leaf) const { return leaf.normal.dot(to_sun_) > 0; }
  static Vec3f at(const LightLeaf& leaf, const Vec2d& b01) {
    return leaf.at(static_cast<float>(b01.y()), static_cast<float>(1 - b01.sum()));
  }
  /// Whether each ray from there reaches the sun.
  std::vector<std::uint8_t> look(const std::vector<Vec3f>& starts) {
    std::vector<std::uint8_t> sees(starts.size(), 0);
    if (starts.empty()) return sees;
    shares_.rays += starts.size();
    std::vector<RayPencil::Met> met(starts.size());
    pencil_->intersect(starts, met);
    for (std::size_t i = 0; i < starts.size(); ++i) sees[i] = met[i].face < 0;
    return sees;
  }

  void look_from_sides(const std::vector<std::vector<Vec3f>>& met_points) {
    const std::vector<Vec2d> many = texel_centroids(settings_.sun_samples),
                             few = texel_centroids(kUnseenRays);
    std::vector<Vec3f> starts;
    for (std::size_t side = 0; side < lit_.size(); ++side) {
      const LightLeaf& whole = nodes_.wholes[side];
      if (!is_turned_to_sun(whole)) continue;
      const bool seen = nodes_.is_side_seen(side);
      const std::vector<Vec3f>& met = met_points[nodes_.first_node(side)];
      if (met.empty() && nodes_.side(nodes_.face_of(side)) != side) continue;  // nothing shows it
      const std::vector<Vec2d>& points = seen ? many : few;
      lit_[side].n = seen ? settings_.sun_samples : kUnseenRays;
      for (std::size_t k = 0; k < points.size(); ++k)
        starts.push_back(seen || met.empty() ? at(whole, points[k]) : met[k * met.size() / points.size()]);
    }
    const auto first_cell = static_cast<std::size_t>(nodes_.patches());
    for (std::size_t i = first_cell; i < nodes_.leaves.size(); ++i)
      if (is_turned_to_sun(nodes_.leaves[i])) starts.push_back(nodes_.leaves[i].at(0.5f, 0.5f));
    const std::vector<std::uint8_t> sees = look(starts);
    auto next = sees.begin();
    for (Samples& samples : lit_) {
      samples.lit.assign(next, next + samples.n * samples.n);
      next += samples.n * samples.n;
    }
    for (std::size_t i = first_cell; i < nodes_.leaves.size(); ++i)
      if (is_turned_to_sun(nodes_.leaves[i])) shares_.of_nodes[i] = *next++;
  }

  /// Looks again from the sides that a shadow's border runs through, as finely as the camera sees them.
  void refine() {
    std::vector<std::size_t> bordered;
    std::vector<Vec3f> starts;
    for (std::size_t side = 0; side < lit_.size(); ++side) {
      Samples& samples = lit_[side];
      const auto& lit = samples.lit;
      if (!nodes_.is_side_seen(side) || std::find(lit.begin(), lit.end(), 0) == lit.end() ||
          std::find(lit.begin(), lit.end(), 1) == lit.end())
        continue;
      const double texel = nodes_.angles[side] / (resolution_ * resolution_),
                   parts = std::min<double>(std::ceil(std::sqrt(texel / settings_.sun_angle)), kMostParts);
      if (!(parts > 1)) continue;
      bordered.push_back(side);
      samples.n = resolution_ * static_cast<int>(parts);
      resolutions_[nodes_.face_of(side)] = samples.n;
      for (const Vec2d& point : centroids(samples.n)) starts.push_back(at(nodes_.wholes[side], point));
    }
    const std::vector<std::uint8_t> sees = look(starts);
    auto next = sees.begin();
    for (const std::size_t side : bordered) {
      const auto end = next + lit_[side].n * lit_[side].n;
      lit_[side].lit.assign(next, end);
      next = end;
    }
  }

  /// The share of a side's samples that are lit.
  static double share(const Samples& samples, const std::vector<int>& some) {
    int count = 0;
    for (const int k : some) count += samples.lit[static_cast<std::size_t>(k)];
    return static_cast<double>(count) / static_cast<double>(some.size());
  }
  /// Which of n² samples stand for each of p² parts of a side.
  const std::vector<std::vector<int>>& samples_of(int p, int n) {
    for (const auto& [key, lists] : lists_)
      if (key == std::pair(p, n)) return lists;
    lists_.emplace_back(std::pair(p, n), centroids_within(p, n));
    return lists_.back().second;
  }

  void share_to_nodes() {
    for (std::size_t side = 0; side < lit_.size(); ++side) {
      if (lit_[side].n == 0) continue;
      std::size_t node = nodes_.first_node(side);
      for (const auto& some : samples_of(nodes_.parts[side], lit_[side].n))
        shares_.of_nodes[node++] = share(lit_[side], some);
    }
  }

  void share_to_parts() {
    shares_.parts = TexelGrid(std::move(resolutions_));
    shares_.of_parts.assign(static_cast<std::size_t>(shares_.parts.first.back()), 0);
    for (std::size_t f = 0; f < nodes_.faces; ++f) {
      const Samples& samples = lit_[nodes_.side(f)];
      if (samples.n == 0) continue;
      float* part = &shares_.of_parts[shares_.parts.first_texel(f)];
      if (samples.n == shares_.parts.resolution_of(f)) {
        std::copy(samples.lit.begin(), samples.lit.end(), part);
        continue;
      }
      for (const auto& some : samples_of(shares_.parts.resolution_of(f), samples.n))
        *part++ = static_cast<float>(share(samples, some));
    }
  }

  /// Centroids of n² parts of a side.
  const std::vector<Vec2d>& centroids(int n) {
    for (const auto& [key, points] : centroids_)
      if (key == n) return points;
    centroids_.emplace_back(n, texel_centroids(n));
    return centroids_.back().second;
  }

  const LightNodes& nodes_;
  RayPencil* pencil_;
  const Vec3f to_sun_;
  int resolution_;
  const VisibleLightSettings& settings_;
  std::vector<Samples> lit_;      ///< of each side; none of one that is turned away
  std::vector<int> resolutions_;  ///< of each face: of its shown parts
  std::vector<std::pair<int, std::vector<Vec2d>>> centroids_;
  std::vector<std::pair<std::pair<int, int>, std::vector<std::vector<int>>>> lists_;
  SunShares shares_;
};

}  // namespace

SunShares share_sun(const LightNodes& nodes, RayPencil* pencil,
                    const std::vector<std::vector<Vec3f>>& met_points, const Vec3d& to_sun, int resolution,
                    const VisibleLightSettings& settings) {
  return SunTracer(nodes, pencil, to_sun, resolution, settings).run(met_points);
}

}  // namespace mirage
