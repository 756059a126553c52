#include "attack/host_truth.h"

#include <algorithm>

#include "detection/average_precision.h"
#include "scene/data/kitti_results.h"

namespace mirage {

bool is_road_user(const Label& label) {
  return label.type != "DontCare" && label.type != "Misc";
}

std::vector<BevBox> ground_truth_boxes(const Frame& frame) {
  std::vector<BevBox> boxes;
  for (const Label& label : frame.labels)
    if (is_road_user(label) && has_box(label)) boxes.push_back(label.box.bev);
  return boxes;
}

namespace {

constexpr double kCarHeight = 1.5;  // m

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

std::optional<PictureBox> carried_box(const Simulated& simulated, const Placement& placement) {
  return placement.support == Support::roof || placement.grows_box ? silhouette_box(simulated) : std::nullopt;
}

HostTruth::HostTruth(const Frame& frame, const Label& host, Matching matching,
                     const std::optional<PictureBox>& object)
    : matching_(matching), host_({boxes_of(host)}), ground_(host.box.bottom) {
  for (const Label& label : frame.labels) {
    if (label.type == "DontCare") dont_care_.push_back(boxes_of(label));
    if (is_road_user(label) && (matching.in_picture() || has_box(label))) labels_.push_back(boxes_of(label));
  }
  if (!matching.in_picture()) {
    calibration_ = frame.calibration;
  } else if (object) {
    host_.emplace_back(joined(picture_box(host), *object));
    labels_.push_back(host_.back());
  }
}

HostTruth HostTruth::with_box(const Frame& frame, const Label& host, Matching matching, const BevBox& grown,
                              const std::optional<PictureBox>& object) {
  HostTruth truth(frame, host, matching, object);
  if (matching.in_picture()) {
    if (truth.host_.size() > 1) truth.host_.erase(truth.host_.begin());  // the joined one is left
  } else {
    truth.host_.front() = ObjectBoxes(grown);
    truth.labels_.push_back(truth.host_.front());
  }
  return truth;
}

HostTruth HostTruth::of_object(const Frame& frame, const Label& object, Matching matching) {
  HostTruth truth(frame, object, matching);
  truth.labels_.push_back(truth.host_.front());
  return truth;
}

double HostTruth::largest(const ObjectBoxes& found, const std::vector<ObjectBoxes>& others) const {
  double most = 0;
  for (const ObjectBoxes& other : others) most = std::max(most, matching_.overlap(found, other));
  return most;
}

double HostTruth::host_iou(const ObjectBoxes& found) const {
  return largest(found, host_);
}

double HostTruth::label_iou(const ObjectBoxes& found) const {
  if (!matching_.in_picture()) return largest(found, labels_);
  if (in_dont_care(found)) return 1;
  return std::max(largest(found, labels_), largest(found, dont_care_));
}

bool HostTruth::in_dont_care(const ObjectBoxes& found) const {
  if (dont_care_.empty()) return false;
  ObjectBoxes seen = found;
  if (!matching_.in_picture()) {
    Box3 box = found.box;
    if (!(box.height > 0)) box.bottom = ground_, box.height = kCarHeight;
    const auto there = projected(box, calibration_);
    if (!there) return false;
    seen.picture = *there;
  }
  return std::any_of(dont_care_.begin(), dont_care_.end(), [&](const ObjectBoxes& region) {
    return kInPicture.intersection(seen, region) >= kInPicture.area(seen) / 2;
  });
}

}  // namespace mirage
