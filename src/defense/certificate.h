// A guarantee that no object in a box on this roof can hide this car.
//
// The defended detector runs on every frame under several masks (roof_mask.h), and keeps the detections under
// any of them. Detections under a mask that covers the object do not depend on the object, so a car found
// under such a mask stays found. (PatchCleanser, Xiang et al., USENIX Security 2022, does this against
// patches in pictures; here a mask is a volume of the world that removes the pixels and returns it touches.)
//
// Two sets of masks:
//   known roof  the one mask is the object's own box: the upper bound of any masking defence.
//   lattice     boxes on a grid over the ground, at roof height, independent of the frame. Every object's box
//               is inside one of them, so the guarantee needs no knowledge of the roof.
// A certificate holds for a car as recorded; a car without one may still be found. The share of cars that no
// object can hide lies in a bracket. It is at least the certified share, and at most the share found with
// known objects on the roof, with or without a mask.
//
// A certificate needs only the lattice's masks that cover the car's roof, one to four. The other hundreds can
// add found cars under attack, and false alarms; they are evaluated on request.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "attack/evaluation.h"
#include "attack/score.h"
#include "base/fields.h"
#include "base/intervals.h"
#include "defense/roof_mask.h"

namespace mirage {

/// A grid of masks.
struct LatticeSettings {
  double step = 2;                         ///< m between centres, both ways
  double farthest = 50;                    ///< m from the `velo` origin to a centre, in view of the camera
  double roof_low = 1.1, roof_high = 2.2;  ///< m over the ground, which is level under the unit
};

template <class Visitor, FieldsOf<LatticeSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "step", .help = "with --lattice: the grid's step, m", .range = {0.1, 20}}, s.step);
  visit({.name = "farthest", .help = "with --lattice: the grid's reach, m", .range = {1, 200}}, s.farthest);
}

/// The grid's boxes for objects of these limits: any object_box(), whatever its heading, lies inside one if
/// its roof point is within `farthest` − step, in view and at these heights. `ground`: m, road's z in `velo`.
std::vector<Box3> lattice(const Calibration& calibration, const AdversaryLimits& limits, double ground,
                          const LatticeSettings& settings);
/// Whether the second lies inside the first.
bool covers(const Box3& mask, const Box3& box);

/// Settings of `certify`.
struct CertificateSettings {
  std::vector<double> sizes = {0.2, 0.4, 0.6, 0.8, 1.0};  ///< L of AdversaryLimits (limits_of_size), m
  bool with_lattice = false;                              ///< evaluates masks that cover a roof
  bool whole_lattice = false;                             ///< evaluates all masks: hundreds of passes a frame
  LatticeSettings lattice;
  double mask_pixels = MaskMargin().pixels, mask_metres = MaskMargin().metres;
  /// Random objects per host and size to check the premise, besides the adversaries; 0: no check.
  int objects = 20;
  std::uint64_t seed = 0;
  SimulationSettings simulation;          ///< simulation of these objects
  std::vector<TexturedMesh> adversaries;  ///< known objects: the bracket's other end
  /// Their outcomes from evaluate(). Empty: certify() evaluates them.
  std::span<const HostOutcome> attacked;
  EvaluationSettings evaluation;
};

/// All fields except `sizes`, a list of any length.
template <class Visitor, FieldsOf<CertificateSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit(
      {.name = "lattice", .help = "also certify without knowing the roofs: masks on a grid over the ground"},
      s.with_lattice);
  visit({.name = "whole_lattice",
         .help = "with --lattice: also run the detector under the masks that cover no car's roof, hundreds a "
                 "frame; this gives AP and the bracket's upper end"},
        s.whole_lattice);
  visit_fields(visit, s.lattice);
  visit({.name = "objects",
         .help = "random objects for each car and size, to check that the mask covers all that "
                 "they and known objects change; 0: no check",
         .range = kNotNegative},
        s.objects);
  visit({.name = "mask_pixels", .help = "the mask's margin in the picture, pixels", .range = {0, 1e4}},
        s.mask_pixels);
  visit({.name = "mask_metres", .help = "the mask's margin around the box, m", .range = {0, 100}},
        s.mask_metres);
}

/// One car at one size.
struct Certificate {
  double with_roof_iou = 0;  ///< best IoU with the car under its own roof's mask
  /// The best IoU over the lattice's masks that cover the roof; without `whole_lattice` the search stops
  /// above 0.7. 0 if no mask covers it.
  double lattice_iou = 0;
  /// The smallest IoU under the adversaries that stay in the box, without masks; clean_iou if there are none.
  double attacked_iou = 0;
  /// The same if detections under any mask of the whole lattice also count; not exact above 0.7.
  double survived_iou = 0;
  bool covered = false;     ///< whether a mask of the lattice covers the roof
  std::size_t removed = 0;  ///< returns that the roof's mask removes
  double hidden_share = 0;  ///< share of the picture's pixels that it hides
};

/// One car at every size.
struct CertifiedHost {
  HostId id;
  int track = -1;
  double range = 0;      ///< m
  double clean_iou = 0;  ///< best IoU of a detection in the frame as recorded
  /// Control: the same under a mask over the car itself. A car found there is found by its surroundings, or
  /// the mask removes nothing.
  double control_iou = 0;
  std::vector<Certificate> sizes;
};

/// Bounds of the share of cars that no object in the box can hide from a detector that keeps its detections
/// with and without masks.
struct Bracket {
  Interval certified, attacked;
};

/// Cars in one band of distance.
struct CertifiedBand {
  double nearest = 0, farthest = 0;  ///< m; the nearer end belongs to it
  int hosts = 0;
  Bracket known70, known50, lattice70, lattice50;  ///< lattice's `attacked`: of the whole lattice
};

/// Shares of the cars, with 95 % intervals (base/intervals.h).
struct CertifiedShares {
  double size = 0;                  ///< L, m
  Interval clean70, clean50;        ///< found as recorded, of all hosts
  Interval control70, control50;    ///< found under a mask over the car itself
  Interval attacked70, attacked50;  ///< found under every adversary in the box, without masks
  std::array<CertifiedBand, kScoreBands.size()> bands;  ///< all distances, then kScoreBands
  int covered = 0;                                      ///< hosts with a roof that some lattice mask covers
  int adversaries = 0;                                  ///< that the box holds
  std::size_t objects = 0;                              ///< objects for which the premise was checked
  std::size_t violations = 0;                           ///< objects that changed something outside the mask
};

/// Result of certify().
struct CertificateResult {
  std::vector<CertifiedHost> hosts;
  std::vector<CertifiedShares> shares;  ///< one a size
  std::vector<std::size_t> masks;       ///< lattice masks per frame (mean), one for each size
  /// AP at 0.7 on frames as recorded: without masks, and with the whole lattice, one a size.
  double clean_ap70 = 0;
  std::vector<double> lattice_ap70;
  ClusterCount clusters;  ///< of the hosts, for the shares' intervals
};

/// Certifies every host. FieldError for settings out of range, and for outcomes that lack a host or an
/// adversary. Interrupted between hosts. A collective call (base/ranks.h): ranks share the frames through the
/// store's cache, and only the first gets the result.
CertificateResult certify(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                          const LidarModel& lidar, const CertificateSettings& settings);

/// {"hosts": N, "sizes": [{"size", "clean_iou70", …, "bands": [{from_m, to_m (null: any), hosts, known70:
/// {certified, attacked}, …}]}], "outcomes": [...]}.
nlohmann::json to_json(const CertificateResult& result, const CertificateSettings& settings);

}  // namespace mirage
