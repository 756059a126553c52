// Which labels are vehicles and people, in the eyes of an attack's objective and of its evaluation.
#pragma once

#include <optional>
#include <vector>

#include "detection/detector.h"
#include "frames/host_id.h"
#include "scene/frame.h"
#include "simulation/insertion.h"

namespace mirage {

/// A box on it is no false positive. DontCare regions are none, nor is "Misc": what looks like a car and is
/// none (the generator's hedges and stacks of goods) is background to a detector, under attack too.
bool is_road_user(const Label& label);

/// BEV boxes of every labelled road user.
std::vector<BevBox> ground_truth_boxes(const Frame& frame);

// What a detector's boxes are compared with when an adversary stands on a host's roof.

/// The box around the object's pixels (S > 0.5), clipped to the picture; none where it shows no pixel.
std::optional<PictureBox> silhouette_box(const Simulated& simulated);
/// That of an object which stands on its carrier, or grows its box; none of one that stands free: a box
/// around a vehicle and what is beside it is no box of the vehicle.
std::optional<PictureBox> carried_box(const Simulated& simulated, const Placement& placement);

/// The host's boxes and those of every road user of its frame (is_road_user), for one way of comparing them.
///
/// In the picture the host has second boxes where an object is seen: its label's joined with the object's
/// silhouette. A box around car and object is no miss, and no false positive. DontCare regions are among the
/// labels there: nobody knows what stands in them.
class HostTruth {
 public:
  /// From above. `labels`: every labelled road user of the frame, the host among them.
  HostTruth(const BevBox& host, std::vector<ObjectBoxes> labels)
      : host_({ObjectBoxes(host)}), labels_(std::move(labels)) {}
  /// Of a label of the frame. `object`: its carried_box(), of which Matching::in_picture alone takes
  /// notice.
  HostTruth(const Frame& frame, const Label& host, Matching matching,
            const std::optional<PictureBox>& object = {});
  /// The same of a host whose box is another than the label's: `grown`, and in the picture the label's joined
  /// with the object's.
  static HostTruth with_box(const Frame& frame, const Label& host, Matching matching, const BevBox& grown,
                            const std::optional<PictureBox>& object);

  /// Of a thing that the frame's labels do not know (own_label()): no box on it is a false positive.
  static HostTruth of_object(const Frame& frame, const Label& object, Matching matching);

  /// How its boxes are compared.
  const Matching& matching() const { return matching_; }
  /// The host's boxes: the label's.
  const ObjectBoxes& host() const { return host_.front(); }
  /// Largest overlap with a box of the host.
  double host_iou(const ObjectBoxes& found) const;
  /// Largest overlap with a box of any label; 1 in the picture for a box that lies by half or more in a
  /// DontCare region.
  double label_iou(const ObjectBoxes& found) const;
  /// Whether what is found lies by half or more in a DontCare region. Regions are boxes of the picture: a box
  /// in space is projected, with a car's height, and standing where the host stands, where it tells neither.
  bool in_dont_care(const ObjectBoxes& found) const;
  /// The labels' boxes, the host's own among them.
  const std::vector<ObjectBoxes>& labels() const { return labels_; }

 private:
  double largest(const ObjectBoxes& found, const std::vector<ObjectBoxes>& others) const;

  Matching matching_;
  std::vector<ObjectBoxes> host_, labels_;
  std::vector<ObjectBoxes> dont_care_;  ///< boxes of the picture, whatever is compared
  Calibration calibration_;             ///< in space, where there are regions
  double ground_ = 0;                   ///< m, `velo`: the host's bottom
};

}  // namespace mirage
