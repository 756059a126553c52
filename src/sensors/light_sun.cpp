#include "sensors/light_sun.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "geometry/texel_grid.h"

namespace mirage {
namespace {

constexpr int kUnseenRays = 2;  // 2² rays from a side that only reflections show
constexpr int kMostParts = 8;   // a texel is split into 8² at most
/// A border is looked for this many edges of samples' triangles around where two differ.
constexpr double kBorder = 2.1;

class SunTracer {
 public:
  SunTracer(const LightNodes& nodes, RayPencil* pencil, RayPencil* beside, const Vec3d& to_sun,
            int resolution, const VisibleLightSettings& settings)
      : nodes_(nodes),
        pencil_(pencil),
        beside_(beside),
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
      if (beside_) beside_->along(to_sun_);
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
    if (beside_) {
      beside_->intersect(starts, met);
      for (std::size_t i = 0; i < starts.size(); ++i) sees[i] = sees[i] && met[i].face < 0;
    }
    return sees;
  }

  void look_from_sides(const std::vector<std::vector<Vec3f>>& met_points) {
    const std::vector<Vec2d>&many = texel_centroids(settings_.sun_samples),
          &few = texel_centroids(kUnseenRays);
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

  /// Looks again from the sides that a shadow's border runs through, as finely as the camera sees them, where
  /// it may run.
  void refine() {
    struct Again {
      std::size_t side;
      std::vector<std::uint8_t> lit;    ///< of each part: as what was found before says
      std::vector<std::size_t> places;  ///< of rays: which part
    };
    std::vector<Again> bordered;
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
      const int n = resolution_ * static_cast<int>(parts);
      const std::vector<std::uint8_t> near = near_border(samples);
      const std::vector<Vec2d>& points = texel_centroids(n);
      const std::vector<int>& sample_of = texels_of_centroids(n, samples.n);
      Again again{side, std::vector<std::uint8_t>(points.size()), {}};
      for (std::size_t i = 0; i < points.size(); ++i) {
        const auto sample = static_cast<std::size_t>(sample_of[i]);
        again.lit[i] = lit[sample];
        if (!near[sample]) continue;
        again.places.push_back(i);
        starts.push_back(at(nodes_.wholes[side], points[i]));
      }
      samples.n = n;
      resolutions_[nodes_.face_of(side)] = n;
      bordered.push_back(std::move(again));
    }
    const std::vector<std::uint8_t> sees = look(starts);
    auto next = sees.begin();
    for (Again& again : bordered) {
      for (const std::size_t place : again.places) again.lit[place] = *next++;
      lit_[again.side].lit = std::move(again.lit);
    }
  }

  /// Of each sample of a side, whether one of those near it sees the sun where it does not.
  static std::vector<std::uint8_t> near_border(const Samples& samples) {
    const std::vector<std::vector<int>>& around = texel_neighbours(samples.n, kBorder);
    std::vector<std::uint8_t> near(samples.lit.size(), 0);
    for (std::size_t i = 0; i < near.size(); ++i)
      for (const int k : around[i]) near[i] |= samples.lit[i] != samples.lit[static_cast<std::size_t>(k)];
    return near;
  }
  /// The share of a side's samples that are lit.
  static double share(const Samples& samples, const std::vector<int>& some) {
    int count = 0;
    for (const int k : some) count += samples.lit[static_cast<std::size_t>(k)];
    return static_cast<double>(count) / static_cast<double>(some.size());
  }
  void share_to_nodes() {
    for (std::size_t side = 0; side < lit_.size(); ++side) {
      if (lit_[side].n == 0) continue;
      std::size_t node = nodes_.first_node(side);
      for (const auto& some : centroids_within(nodes_.parts[side], lit_[side].n))
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
      for (const auto& some : centroids_within(shares_.parts.resolution_of(f), samples.n))
        *part++ = static_cast<float>(share(samples, some));
    }
  }

  const LightNodes& nodes_;
  RayPencil *pencil_, *beside_;
  const Vec3f to_sun_;
  int resolution_;
  const VisibleLightSettings& settings_;
  std::vector<Samples> lit_;      ///< of each side; none of one that is turned away
  std::vector<int> resolutions_;  ///< of each face: of its shown parts
  SunShares shares_;
};

}  // namespace

SunShares share_sun(const LightNodes& nodes, RayPencil* pencil, RayPencil* beside,
                    const std::vector<std::vector<Vec3f>>& met_points, const Vec3d& to_sun, int resolution,
                    const VisibleLightSettings& settings) {
  return SunTracer(nodes, pencil, beside, to_sun, resolution, settings).run(met_points);
}

}  // namespace mirage
