#include "scene/rooftop.h"

namespace mirage {
namespace {

/// How far behind the box's centre a car's cabin is centred, as a share of its length: bonnets are longer
/// than boots (typical hatchbacks and saloons: 4–8 %).
constexpr double kCabinShift = 0.06;

}  // namespace

Rooftop BoxRooftopFinder::find(const Frame&, const Label& label) const {
  Rooftop rooftop;
  rooftop.velo_from_adversary =
      velo_from_box(label.box) *
      Eigen::Translation3d(-kCabinShift * label.box.bev.length, 0, label.box.height);
  return rooftop;
}

}  // namespace mirage
