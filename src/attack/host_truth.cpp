#include "attack/host_truth.h"

#include <algorithm>

#include "attack/road_users.h"
#include "detection/average_precision.h"
#include "scene/data/kitti_results.h"

namespace mirage {
namespace {

constexpr double kCarHeight = 1.5;  // m

double largest_iou(const BevBox& box, const std::vector<BevBox>& others) {
  double largest = 0;
  for (const BevBox& other : others) largest = std::max(largest, iou(box, other));
  return largest;
}

}  // namespace

std::optional<PictureBox> silhouette_box(const Simulated& simulated) {
  const Image<double>& rgba = simulated.rgba;
  const int last_column = simulated.image.width - 1, last_row = simulated.image.height - 1;
  PixelRect rect{last_column + 1, last_row + 1, 0, 0};
  for (int y = 0; y < rgba.height; ++y)
    for (int x = 0; x < rgba.width; ++x) {
      const int u = simulated.rect.u0 + x, v = simulated.rect.v0 + y;
      if (!(rgba.at(x, y, 3) > 0.5) || u < 0 || v < 0 || u > last_column || v > last_row) continue;
      rect = {std::min(rect.u0, u), std::min(rect.v0, v), std::max(rect.u1, u + 1), std::max(rect.v1, v + 1)};
    }
  if (rect.empty()) return std::nullopt;
  return PictureBox{std::max(0.0, rect.u0 - 0.5), std::max(0.0, rect.v0 - 0.5),
                    std::min<double>(last_column, rect.u1 - 0.5), std::min<double>(last_row, rect.v1 - 0.5)};
}

HostTruth::HostTruth(const Frame& frame, const Label& host, Plane plane,
                     const std::optional<PictureBox>& object)
    : plane_(plane) {
  for (const Label& label : frame.labels)
    if (label.type == "DontCare") dont_care_.push_back(rectangle(picture_box(label)));
  if (plane == Plane::bev) {
    host_ = {host.box.bev};
    labels_ = ground_truth_boxes(frame);
    calibration_ = frame.calibration;
    ground_ = host.box.bottom;
    return;
  }
  host_ = {rectangle(picture_box(host))};
  for (const Label& label : frame.labels)
    if (is_road_user(label)) labels_.push_back(rectangle(picture_box(label)));
  if (!object) return;
  host_.push_back(rectangle(joined(picture_box(host), *object)));
  labels_.push_back(host_.back());
}

double HostTruth::host_iou(const Proposal& proposal) const {
  return largest_iou(rectangle(proposal, plane_), host_);
}

double HostTruth::label_iou(const Proposal& proposal) const {
  const BevBox box = rectangle(proposal, plane_);
  if (plane_ == Plane::bev) return largest_iou(box, labels_);
  if (in_dont_care(proposal)) return 1;
  return std::max(largest_iou(box, labels_), largest_iou(box, dont_care_));
}

bool HostTruth::in_dont_care(const Proposal& proposal) const {
  if (dont_care_.empty()) return false;
  BevBox box = rectangle(proposal, plane_);
  if (plane_ == Plane::bev) {
    const auto seen = projected({box, ground_, kCarHeight}, calibration_);
    if (!seen) return false;
    box = rectangle(*seen);
  }
  return std::any_of(dont_care_.begin(), dont_care_.end(), [&](const BevBox& region) {
    return intersection_area(box, region) >= box.length * box.width / 2;
  });
}

}  // namespace mirage
