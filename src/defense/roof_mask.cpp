#include "defense/roof_mask.h"

#include <algorithm>
#include <cmath>

#include "base/sizes.h"

namespace mirage {
namespace {

constexpr double kNear = 0.1;  // m, least depth of a box corner for projection
constexpr int kRing = 8;       // width of the ring of pixels whose mean fills the rectangle

/// The box grown by the mask's margins.
class DilatedBox {
 public:
  DilatedBox(const Box3& box, const MaskMargin& margin)
      : box_from_velo_(velo_from_box(box).inverse()),
        low_(-box.bev.length / 2, -box.bev.width / 2, 0),
        high_(box.bev.length / 2, box.bev.width / 2, box.height),
        margin_(margin) {}

  bool is_met_on_the_way_to(const Vec3d& point_velo) const {
    if (!point_velo.allFinite()) return false;
    const Vec3d origin = box_from_velo_.translation(), way = box_from_velo_.linear() * point_velo;
    if (!segment_meets(origin, way, margin_.metres + margin_.beam_origin)) return false;
    // A beam's offset from the segment falls linearly from `beam_origin` to 0 at the point. With q(t) on the
    // segment: is |q(t) − box| ≤ metres + beam_origin (1 − t) for some t? The difference of the two is convex
    // in t.
    const auto excess = [&](double t) {
      return distance(origin + t * way) - margin_.beam_origin * (1 - t) - margin_.metres;
    };
    double low = 0, high = 1;
    for (int i = 0; i < kSteps; ++i) {
      const double a = low + (high - low) / 3, b = high - (high - low) / 3;
      const double at_a = excess(a), at_b = excess(b);
      if (at_a <= 0 || at_b <= 0) return true;
      (at_a < at_b ? high : low) = at_a < at_b ? b : a;
    }
    // The remaining interval is negligible, and the tolerance errs on the safe side.
    return std::min({excess(low), excess(high), excess((low + high) / 2)}) <= kHair;
  }

 private:
  static constexpr int kSteps = 40;
  static constexpr double kHair = 1e-6;  // m

  double distance(const Vec3d& p) const { return (p - p.cwiseMax(low_).cwiseMin(high_)).norm(); }

  /// Kay and Kajiya's slab test (1986) for the box grown by `grow`.
  bool segment_meets(const Vec3d& origin, const Vec3d& way, double grow) const {
    double enter = 0, leave = 1;
    for (int k = 0; k < 3; ++k) {
      const double low = low_[k] - grow - origin[k], high = high_[k] + grow - origin[k];
      if (way[k] == 0) {
        if (low > 0 || high < 0) return false;
        continue;
      }
      const double a = low / way[k], b = high / way[k];
      enter = std::max(enter, std::min(a, b));
      leave = std::min(leave, std::max(a, b));
    }
    return enter <= leave;
  }

  Transform box_from_velo_;
  Vec3d low_, high_;
  MaskMargin margin_;
};

/// Pixels that an object in the box can touch.
PixelRect hidden_pixels(const Calibration& calibration, const Box3& box, double margin) {
  const PinholeCamera& camera = calibration.camera;
  const PixelRect all{0, 0, camera.width, camera.height};
  Eigen::AlignedBox2d seen;
  int before = 0, behind = 0;
  for (const Vec3d& corner : corners(box)) {
    const Vec3d p_camera = calibration.camera_from_velo * corner;
    ++(p_camera.z() > kNear ? before : behind);
    if (p_camera.z() > kNear) seen.extend(camera.project(p_camera));
  }
  if (before == 0) return {};
  if (behind > 0) return all;
  const auto within = [](double x, int size) { return static_cast<int>(std::clamp(x, 0.0, double(size))); };
  PixelRect rect{within(std::floor(seen.min().x() - margin), camera.width),
                 within(std::floor(seen.min().y() - margin), camera.height),
                 within(std::ceil(seen.max().x() + margin) + 1, camera.width),
                 within(std::ceil(seen.max().y() + margin) + 1, camera.height)};
  return rect.empty() ? PixelRect{} : rect;
}

/// Fills the rectangle with the mean colour of the pixels within kRing of it; mid-grey if there are none.
void fill(ImageF& image, const PixelRect& rect) {
  const int u0 = std::max(0, rect.u0 - kRing), u1 = std::min(image.width, rect.u1 + kRing);
  const int v0 = std::max(0, rect.v0 - kRing), v1 = std::min(image.height, rect.v1 + kRing);
  const auto inside = [&](int u, int v) {
    return u >= rect.u0 && u < rect.u1 && v >= rect.v0 && v < rect.v1;
  };
  std::vector<double> sum(as_size(image.channels), 0);
  int count = 0;
  for (int v = v0; v < v1; ++v)
    for (int u = u0; u < u1; ++u) {
      if (inside(u, v)) continue;
      for (int c = 0; c < image.channels; ++c) sum[as_size(c)] += image.at(u, v, c);
      ++count;
    }
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      for (int c = 0; c < image.channels; ++c)
        image.at(u, v, c) = count > 0 ? static_cast<float>(sum[as_size(c)] / count) : 0.18f;
}

}  // namespace

double beam_origin_spread(const LidarModel& lidar) {
  double spread = 0;
  for (std::size_t beam = 0; beam < lidar.beams.size(); ++beam)
    spread = std::max(spread, lidar.ray(static_cast<int>(beam), 0).origin.norm());
  return spread;
}

Box3 object_box(const Transform& velo_from_adversary, const AdversaryLimits& limits) {
  const Transform& pose = velo_from_adversary;
  const Vec3d at = pose.translation();
  Box3 box;
  box.bev = {at.x(), at.y(), 2 * limits.half.x(), 2 * limits.half.y(), std::atan2(pose(1, 0), pose(0, 0))};
  box.bottom = at.z();
  box.height = 2 * limits.half.z();
  return box;
}

bool passes_through(const Vec3d& point_velo, const Box3& box, const MaskMargin& margin) {
  return DilatedBox(box, margin).is_met_on_the_way_to(point_velo);
}

MaskedFrame masked(const ImageF& image, std::span<const LidarPoint> sweep, const Calibration& calibration,
                   const Box3& box, const MaskMargin& margin) {
  MaskedFrame result;
  result.image = image;
  result.hidden = hidden_pixels(calibration, box, margin.pixels);
  if (!result.hidden.empty()) fill(result.image, result.hidden);
  const DilatedBox grown(box, margin);
  result.sweep.reserve(sweep.size());
  for (const LidarPoint& point : sweep)
    if (!grown.is_met_on_the_way_to(point.position().cast<double>())) result.sweep.push_back(point);
  result.removed = sweep.size() - result.sweep.size();
  return result;
}

}  // namespace mirage
