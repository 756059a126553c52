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
#include "base/types.h"
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
  visit({.name = "track_distance",
         .help = "largest centre distance of a match by distance, m",
         .range = {0, 100}},
        s.farthest);
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
  /// Starts without tracks.
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
    TrackState state;
  };
  void predict(Track& track, double frames) const;
  void update(Track& track, const Box3& box) const;

  TrackerSettings settings_;
  std::vector<Track> tracks_;
  double time_ = 0;
  bool started_ = false;
  int born_ = 0;
};

// Where a thing was over time, from measurements with noise: the fixed-interval smoother of Rauch, Tung and
// Striebel (AIAA Journal 3, 1965) for motion of nearly constant velocity. Each of x, y, z and the heading is
// a filter of its own, with state (p, v), acceleration as white noise of density q, and steps dt:
//
//   F = [1 dt; 0 1]    Q = q [dt³/3 dt²/2; dt²/2 dt]    z = p + noise of σ
//   backwards:  x_k ← x_k + C (x_{k+1} − F x_k),  C = P_k Fᵀ (F P_k Fᵀ + Q)⁻¹
//
// Measurements further than 2 σ off the first answer count less by Huber's weights, and the smoother runs
// once more.

/// A measured place and heading.
struct PlaceMeasurement {
  double time = 0;  ///< s
  Vec3d position = Vec3d::Zero();
  double yaw = 0;                         ///< rad; whole turns do not matter
  Vec3d sigma = Vec3d(0.06, 0.06, 0.03);  ///< m, of the position
  double yaw_sigma = 0.02;                ///< rad
};

/// The smoothed place at a measurement's time.
struct SmoothPlace {
  Vec3d position = Vec3d::Zero(), velocity = Vec3d::Zero();  ///< m, m/s
  double yaw = 0, yaw_rate = 0;                              ///< rad, rad/s
};

/// One answer a measurement. InputError for times that do not rise and for a σ that is not positive.
std::vector<SmoothPlace> smooth(std::span<const PlaceMeasurement> measurements);

/// m: noise of places along a track that is independent from one to the next, from their second differences
/// d: √(mean |d|² / 6), which is free of constant velocity. Of three places only those count whose two steps
/// of time are alike (to a tenth): across a pause of the track constant velocity has a second difference,
/// too. 0 where there are none.
double jitter(std::span<const Vec3d> places, std::span<const double> times);

// How well tracks follow the truth, from similarities of their boxes in [0, 1], frame by frame.
//
// CLEAR MOT (Bernardin and Stiefelhagen, EURASIP Journal on Image and Video Processing 2008), at one least
// similarity. In each frame pairs of the frame before are kept where they still match, the rest is assigned
// for the largest similarity:
//
//   MOTA = 1 − (FN + FP + IDSW) / truths      IDSW: a truth is matched by another track than when it last was
//   MOTP = mean similarity of the matches     fragments: a truth that was matched is again, after a gap
//   mostly tracked: matched in more than 0.8 of its frames; mostly lost: in less than 0.2
//
// HOTA (Luiten et al., International Journal of Computer Vision 129, 2021), over the thresholds α = 0.05,
// 0.10 … 0.95. Pairs are assigned by similarity times how well the two fit over the whole sequence; TPA, FNA
// and FPA of a match c count the frames of its truth and its track in which both, the truth alone, the track
// alone are there:
//
//   DetA = TP / (TP + FN + FP)   AssA = 1/TP Σ_c TPA(c) / (TPA(c) + FNA(c) + FPA(c))   HOTA = √(DetA · AssA)
//
// Both as their authors' evaluation code has them (TrackEval).

/// Who is there in a frame, and how alike their boxes are.
struct TrackFrame {
  std::vector<int> truths, tracks;  ///< identities, none twice; of several sequences each has its own
  Eigen::MatrixXd similarity;       ///< truths × tracks, in [0, 1]
};

/// See the header.
struct TrackScores {
  int truths = 0, tracks = 0;  ///< boxes over all frames
  int matches = 0, misses = 0, false_positives = 0, switches = 0, fragments = 0;
  int mostly_tracked = 0, mostly_lost = 0, identities = 0;  ///< of `identities` truths
  double mota = 0, motp = 0;
  double hota = 0, deta = 0, assa = 0;  ///< means over α
};
template <class Visitor, FieldsOf<TrackScores> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "truths", s.truths, "tracks", s.tracks, "matches", s.matches, "misses", s.misses,
              "false_positives", s.false_positives, "switches", s.switches, "fragments", s.fragments,
              "mostly_tracked", s.mostly_tracked, "mostly_lost", s.mostly_lost, "identities", s.identities,
              "mota", s.mota, "motp", s.motp, "hota", s.hota, "deta", s.deta, "assa", s.assa);
}

/// Frames in order of time, a sequence after the other. `least`: the similarity of a match of CLEAR MOT.
/// InputError for a similarity of another size than its frame's.
TrackScores score_tracks(std::span<const TrackFrame> frames, double least = 0.5);

}  // namespace mirage
