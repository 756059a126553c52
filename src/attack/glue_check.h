// Whether somebody's detector is asked as it expects and answers as Mirage reads it: its boxes beside the
// labels, and how much of what it does its gradient tells.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "attack/clean_detections.h"
#include "frames/frame_store.h"

namespace mirage {

/// Medians over the vehicles with a box within 3 m, the best-scored one each; in the bird's-eye view.
struct BoxHabits {
  int vehicles = 0;                     ///< with such a box
  double length = 0, label_length = 0;  ///< m
  double width = 0, label_width = 0;    ///< m
  double along = 0, across = 0;         ///< m, in the vehicle's frame, from the label's centre
  double yaw = 0;                       ///< rad, how far off, in [0, π/2]: either way round counts
  double logit = 0;                     ///< of these boxes
  double other_logit = 0;               ///< of all others
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

/// How the loss changes when the object moves, and how much of that the gradient predicts.
struct SeenChange {
  int vehicles = 0;
  /// Σ predicted · measured / Σ measured² over steps of 1 cm forward and to the left, where measured is the
  /// change of the attack's loss from 1 cm on one side to 1 cm on the other. 1: all of it; 0: none; far
  /// above: the gradient is too large. What jumps (a ray that comes to hit, a network's own choices) keeps it
  /// below 1.
  double share = 0;
  /// Σ predicted · measured / √(Σ predicted² Σ measured²): whether it points where the change goes, however
  /// large it is.
  double cosine = 0;
  double largest = 0;  ///< of the measured changes, absolute
};
template <class Visitor, FieldsOf<SeenChange> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "vehicles", s.vehicles, "share", s.share, "cosine", s.cosine, "largest", s.largest);
}
/// Puts the start of an attack on the roofs of the first `vehicles` hosts that the detector finds.
/// Interrupted between vehicles.
SeenChange seen_change(Detector& detector, FrameStore& store, const std::vector<std::string>& frames,
                       int vehicles);

/// Rows of a table: what was found, boxes, logits, gradient, hints.
std::vector<std::pair<std::string, std::string>> rows_of(const CleanPerformance& found,
                                                         const BoxHabits& habits, const SeenChange& seen);

}  // namespace mirage
