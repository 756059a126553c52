#include "detection/matching.h"

#include <algorithm>
#include <cmath>

namespace mirage {
namespace {

constexpr double kWidest = 4;  // m

}  // namespace

double Matching::overlap(const ObjectBoxes& a, const ObjectBoxes& b) const {
  if (in_picture() && a.camera != b.camera) return 0;
  if (by == MatchBy::space) return iou(a.box, b.box);
  if (by == MatchBy::centre) return std::max(0.0, 1 - distance(a, b) / kWidest);
  return iou(flat(a), flat(b));
}

double Matching::distance(const ObjectBoxes& a, const ObjectBoxes& b) const {
  const BevBox p = flat(a), q = flat(b);
  return horizontal_distance(p, q);
}

double Matching::area(const ObjectBoxes& a) const {
  const BevBox box = flat(a);
  return box.length * box.width;
}

double Matching::intersection(const ObjectBoxes& a, const ObjectBoxes& b) const {
  return in_picture() && a.camera != b.camera ? 0 : intersection_area(flat(a), flat(b));
}

std::string describe(Matching matching) {
  const auto words = std::to_array<const char*>(
      {"", "bird's-eye view", "boxes in 3-D", "boxes in the picture", "distance of the centres"});
  return words[as_size(matching.by)];
}

}  // namespace mirage
