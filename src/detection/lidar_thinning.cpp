#include "detection/lidar_thinning.h"

#include <algorithm>
#include <cmath>

#include "base/random.h"
#include "scene/occlusion.h"

namespace mirage {
namespace {

constexpr double kObjects = 0.3;               // share of the cars that lose returns
constexpr double kLeast = 0.7;                 // share of its returns that such a car loses at least
constexpr double kGround = 0.2;                // m over the lowest return around: still the road's
constexpr double kAround = 0.5, kGrown = 0.1;  // m: returns scatter around a surface

void keep(std::vector<LidarPoint>& points, const std::vector<char>& kept) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (kept[i]) points[count++] = points[i];
  points.resize(count);
}

bool over(const BevBox& box, const LidarPoint& point, double grown) {
  return contains(Box3{box, -1e6, 2e6}, point.position().cast<double>(), grown);
}

void lose_returns(const std::vector<LidarPoint>& points, const BevBox& box, std::vector<char>& kept,
                  RandomStream& random) {
  const double lost = random.uniform(kLeast, 1);
  double ground = 1e9;
  for (const LidarPoint& p : points)
    if (over(box, p, kAround)) ground = std::min<double>(ground, p.z);
  for (std::size_t i = 0; i < points.size(); ++i)
    if (points[i].z > ground + kGround && over(box, points[i], kGrown) && random.uniform() < lost)
      kept[i] = 0;
}

}  // namespace

void thin_lidar(CompactFrame& frame, const LidarModel& lidar, double share, std::uint64_t seed,
                std::uint64_t index) {
  RandomStream random(seed, "lidar thinning", index);
  if (random.uniform() >= share) return;
  std::vector<char> kept(frame.points.size(), 1);
  if (random.uniform() < 0.5) {
    const int step = 2 << random.below(3), first = random.below(step);
    const std::vector<int> beams = beams_of(frame.points, lidar);
    for (std::size_t i = 0; i < beams.size(); ++i) kept[i] = beams[i] >= 0 && beams[i] % step == first;
  } else {
    // What looks like a car loses as much: a gap in the sweep must not mean a car.
    for (const auto* boxes : {&frame.truth.space.boxes, &frame.truth.space.look_alikes})
      for (const ObjectBoxes& object : *boxes)
        if (random.uniform() < kObjects) lose_returns(frame.points, object.box.bev, kept, random);
  }
  keep(frame.points, kept);
}

}  // namespace mirage
