// How the boxes of detections and labels are compared in suppression, AP, hosts, the objective and
// evaluation.
#pragma once

#include <array>
#include <string>

#include "base/sizes.h"
#include "geometry/box.h"

namespace mirage {

/// The boxes of one object. Unknown values are zero: bottom and height of a detector from above, the whole
/// box in space of one in the picture alone.
struct ObjectBoxes {
  ObjectBoxes() = default;  ///< all 0
  /// Seen from above: bottom, height and picture are 0.
  ObjectBoxes(const BevBox& from_above) : box{from_above, 0, 0} {}
  /// In space (m, ego) and in the first camera's picture (pixels).
  ObjectBoxes(const Box3& in_space, const PictureBox& in_picture) : box(in_space), picture(in_picture) {}
  /// In the first camera's picture alone (pixels): the box in space is 0.
  ObjectBoxes(const PictureBox& in_picture) : picture(in_picture) {}
  Box3 box;            ///< in space (m, ego)
  PictureBox picture;  ///< in a camera's picture (pixels)
  int camera = 0;      ///< that camera's index in sensors() (detector.h)
};

/// The overlap of two objects' boxes, in [0, 1]:
///     bev      intersection over union of the rectangles from above
///     space    of the boxes in 3-D
///     picture  of the boxes in the picture
///     centre   1 − d / 4 m, at least 0, with d the distance of the centres from above (Caesar et al., CVPR
///              2020: 4 m is nuScenes' widest limit, 2 m, where this is 0.5, that of its errors)
enum class MatchBy { own, bev, space, picture, centre };  ///< own: as Capabilities::matching chooses
constexpr auto words_of(MatchBy) {
  return std::to_array<const char*>({"own", "bev", "3d", "picture", "centre"});
}

/// One of these ways, own excepted.
struct Matching {
  MatchBy by = MatchBy::bev;

  /// The overlap, in [0, 1].
  double overlap(const ObjectBoxes& a, const ObjectBoxes& b) const;
  /// Between the centres: m from above, or pixels in the picture.
  double distance(const ObjectBoxes& a, const ObjectBoxes& b) const;
  /// The compared box as a rectangle: from above, or in the picture (pixels; x: columns, y: rows).
  BevBox flat(const ObjectBoxes& boxes) const {
    return in_picture() ? rectangle(boxes.picture) : boxes.box.bev;
  }
  /// The box's area from above (m²) or in the picture (pixels²).
  double area(const ObjectBoxes& a) const;
  /// The common area in the units of area(); 0 in pictures of two cameras.
  double intersection(const ObjectBoxes& a, const ObjectBoxes& b) const;
  /// Two detections with a larger overlap are of one vehicle. From above 0.1, because vehicles do not
  /// overlap; in the picture, where they hide each other, 0.5, and also by distance (2 m).
  double same() const { return by == MatchBy::bev || by == MatchBy::space ? 0.1 : 0.5; }
  /// Whether boxes are compared in the picture.
  bool in_picture() const { return by == MatchBy::picture; }
  /// "bev", "3d", "picture", "centre".
  std::string name() const { return words_of(by)[as_size(by)]; }
};

/// One matching of each kind.
inline constexpr Matching kFromAbove{MatchBy::bev}, kInSpace{MatchBy::space}, kInPicture{MatchBy::picture},
    kByCentre{MatchBy::centre};

/// For a table: "bird's-eye view".
std::string describe(Matching matching);

}  // namespace mirage
