// Checks the glue code of a user's detector: its boxes against the labels, and its gradient against measured
// changes of the loss.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "attack/clean_detections.h"
#include "frames/frame_store.h"

namespace mirage {

/// Medians in the bird's-eye view, over vehicles with a box within 3 m (the best-scored one).
struct BoxHabits {
  int vehicles = 0;                     ///< with a box within 3 m
  double length = 0, label_length = 0;  ///< m
  double width = 0, label_width = 0;    ///< m
  double along = 0, across = 0;         ///< m, in the vehicle's frame, from the label's centre
  double yaw = 0;                       ///< rad, heading error in [0, π/2], modulo π
  double logit = 0;                     ///< of these boxes
  double other_logit = 0;               ///< median logit of all other boxes
  int others = 0;
};
template <class Visitor, FieldsOf<BoxHabits> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "vehicles", s.vehicles, "length", s.length, "label_length", s.label_length, "width",
              s.width, "label_width", s.label_width, "along", s.along, "across", s.across, "yaw", s.yaw,
              "logit", s.logit, "others", s.others, "other_logit", s.other_logit);
}
/// Compares each host's label with the best-scored detection within 3 m of its centre
/// (CleanFrame::proposals).
BoxHabits box_habits(const std::vector<CleanFrame>& frames);

/// Change of the loss when the object moves, and the part of it that the gradient predicts.
struct SeenChange {
  int vehicles = 0;
  /// Σ predicted · measured / Σ measured² over steps of 1 cm forward and to the left. Measured: change of the
  /// attack's loss from 1 cm on one side to 1 cm on the other. 1: the gradient predicts the whole change; 0:
  /// none of it; far above 1: the gradient is too large. Discontinuities (a ray that starts to hit, discrete
  /// choices in a network) keep it below 1.
  double share = 0;
  /// Σ predicted · measured / √(Σ predicted² Σ measured²): whether the gradient's direction is right,
  /// whatever its length.
  double cosine = 0;
  double largest = 0;  ///< largest absolute measured change
};
template <class Visitor, FieldsOf<SeenChange> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "vehicles", s.vehicles, "share", s.share, "cosine", s.cosine, "largest", s.largest);
}
/// Measures this with an attack's start mesh on the roofs of the first `vehicles` hosts that the detector
/// finds. Interrupted between vehicles.
SeenChange seen_change(Detector& detector, FrameStore& store, const std::vector<std::string>& frames,
                       int vehicles);

/// Table rows (name, text): vehicles found, boxes, logits, gradient, hints.
std::vector<std::pair<std::string, std::string>> rows_of(const CleanPerformance& found,
                                                         const BoxHabits& habits, const SeenChange& seen);

}  // namespace mirage
