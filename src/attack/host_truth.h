// What a detector's boxes are compared with when an adversary stands on a host's roof.
#pragma once

#include <optional>
#include <vector>

#include "detection/detector.h"
#include "frames/host_id.h"
#include "simulation/insertion.h"

namespace mirage {

/// The box around the object's pixels (S > 0.5), clipped to the picture; none where it shows no pixel.
std::optional<PictureBox> silhouette_box(const Simulated& simulated);

/// The host's boxes and those of every road user of its frame (is_road_user), as rectangles of one plane.
///
/// In the picture the host has a second box where an object is seen: its label's joined with the object's
/// silhouette. A box around car and object is no miss, and no false positive. DontCare regions are among the
/// labels there: nobody knows what stands in them.
class HostTruth {
 public:
  /// In the bird's-eye view. `labels`: every labelled road user of the frame, the host among them.
  HostTruth(const BevBox& host, std::vector<BevBox> labels)
      : plane_(Plane::bev), host_({host}), labels_(std::move(labels)) {}
  /// Of a label of the frame. `object`: its silhouette_box(), of which only Plane::picture takes notice.
  HostTruth(const Frame& frame, const Label& host, Plane plane, const std::optional<PictureBox>& object = {});

  /// Where its boxes are compared.
  Plane plane() const { return plane_; }
  /// The host's box: the label's.
  const BevBox& host() const { return host_.front(); }
  /// Largest IoU with a box of the host.
  double host_iou(const Proposal& proposal) const;
  /// Largest IoU with a box of any label; 1 for a box that lies by half or more in a DontCare region.
  double label_iou(const Proposal& proposal) const;
  /// Whether the proposal lies by half or more in a DontCare region. Regions are boxes of the picture: one
  /// from above is projected as a box of a car's height that stands where the host stands.
  bool in_dont_care(const Proposal& proposal) const;
  /// The labels' boxes, the host's own among them.
  const std::vector<BevBox>& labels() const { return labels_; }

 private:
  Plane plane_;
  std::vector<BevBox> host_, labels_;
  std::vector<BevBox> dont_care_;  ///< rectangles of the picture, in either plane
  Calibration calibration_;        ///< in the bird's-eye view, where there are regions
  double ground_ = 0;              ///< m, `velo`: the host's bottom
};

}  // namespace mirage
