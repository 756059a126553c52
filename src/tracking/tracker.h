// The assignment problem: which rows belong to which columns (Kuhn, Naval Research Logistics Quarterly 2,
// 1955). Solved as a flow of least cost by successive shortest paths (Boost.Graph).
#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "base/fields.h"
#include "geometry/box.h"

namespace mirage {

/// Pairs (row, column), by rising row: as many as there can be, and of these choices the one of least total
/// cost. No row and no column is in two pairs. Pairs that cost more than `most`, or whose cost is no number,
/// are never made. Costs count to 1e-12 of their range.
std::vector<std::pair<int, int>> assign(const Eigen::MatrixXd& cost,
                                        double most = std::numeric_limits<double>::max());

// A tracker of boxes in space: constant-velocity Kalman filter and Hungarian assignment, with the settings of
// AB3DMOT (Weng, Wang, Held and Kitani, 3D Multi-Object Tracking: A Baseline and New Evaluation Metrics, IROS
// 2020), which needs no training and on which most trackers of boxes build.
//
// State of a track, in the world: x = (x, y, z, θ, l, w, h, vx, vy, vz), with the box's centre, heading and
// sides. A step of time dt, counted in the published settings' frames of 0.1 s:
//
//   x ← F x,  P ← F P Fᵀ + Q    F = I with dt at (x, vx), (y, vy), (z, vz)
//   S = H P Hᵀ + R,  K = P Hᵀ S⁻¹,  x ← x + K (z − H x),  P ← (I − K H) P       z: a detection's seven
//   numbers
//
//   R = I₇    Q = diag(1₇, 0.01₃)    P₀ = diag(10₇, 10⁴₃)
//
// Detections are assigned to predicted boxes; a heading that points the other way is turned by π first. A
// detection that no track takes begins one. A track is confirmed from its `birth`-th detection on, coasts on
// its prediction where it has no detection, and ends at its `death`-th miss in a row. (The authors' code
// confirms every track in a sequence's first three frames; here a track earns it there, too.)
//
// Boxes are in a world that does not move with the car: what stands still has no velocity.

/// By what a detection belongs to a predicted box: their overlap in space, or the distance of their centres
/// seen from above.
enum class TrackMatching { iou, distance };
constexpr auto words_of(TrackMatching) {
  return std::to_array<const char*>({"iou", "distance"});
}

/// The published settings.
struct TrackerSettings {
  int birth = 3;  ///< detections that confirm a track
  int death = 2;  ///< misses in a row that end it
  TrackMatching matching = TrackMatching::iou;
  double least_iou = 0.01;  ///< of a match by overlap
  double farthest = 2;      ///< m, of a match by distance
};

template <class Visitor, FieldsOf<TrackerSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "birth", .help = "detections that confirm a track", .range = {1, 100}}, s.birth);
  visit({.name = "death", .help = "misses in a row that end a track", .range = {1, 100}}, s.death);
  visit({.name = "track_by", .help = "what ties a detection to a track: iou (in space) or distance"},
        s.matching);
  visit({.name = "track_iou", .help = "least IoU of a match by overlap", .range = {0, 1}}, s.least_iou);
  visit({.name = "track_distance", .help = "m; farthest match by distance", .range = {0, 100}}, s.farthest);
}

/// A detection in the world.
struct TrackedDetection {
  Box3 box;
  double score = 0;
};

/// A track at the time of the last step.
struct TrackState {
  int id = 0;                      ///< from 1, in the order of birth
  Box3 box;                        ///< in the world
  Vec3d velocity = Vec3d::Zero();  ///< m/s
  int hits = 0;                    ///< detections so far
  int misses = 0;                  ///< steps since its last one
  bool confirmed = false;
  int detection = -1;  ///< of this step, by place; -1: it coasts
  double score = 0;    ///< of its last detection
};

/// One sequence's tracks. Its answers depend on nothing but what it was told.
class Tracker {
 public:
  explicit Tracker(const TrackerSettings& settings = {}) : settings_(settings) {}
  /// Takes the detections of the next frame, at `time` (s, later than the last one's), and says where all
  /// living tracks are, confirmed or not, by rising id. InputError for a time that does not rise.
  std::vector<TrackState> step(double time, std::span<const TrackedDetection> detections);

 private:
  using State = Eigen::Matrix<double, 10, 1>;
  using Covariance = Eigen::Matrix<double, 10, 10>;
  struct Track {
    State x;
    Covariance p;
    TrackState said;
  };
  void predict(Track& track, double frames) const;
  void update(Track& track, const Box3& box) const;

  TrackerSettings settings_;
  std::vector<Track> tracks_;
  double time_ = 0;
  bool started_ = false;
  int born_ = 0;
};

}  // namespace mirage
