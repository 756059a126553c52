#include "detection/box_rows.h"

#include <fmt/format.h>

#include "base/error.h"

namespace mirage {
namespace {

Detection detection_of(const float* row, std::size_t columns, bool in_picture) {
  Detection found;
  if (in_picture)
    found.picture = {row[0], row[1], row[2], row[3]};
  else if (columns == 5)
    found.box.bev = {row[0], row[1], row[2], row[3], row[4]};
  else
    found.box = {{row[0], row[1], row[3], row[4], row[6]}, row[2] - row[5] / 2.0, row[5]};
  if (columns == 9) found.velocity = Vec3d(row[7], row[8], 0);
  return found;
}

}  // namespace

bool BoxRows::knows(std::size_t columns, bool in_picture) {
  return in_picture ? columns == 4 : columns == 5 || columns == 7 || columns == 9;
}

const char* BoxRows::guide() {
  return "give boxes [M,5] (x, y, length, width in m, yaw in rad), [M,7] (x, y, z, length, width, height, "
         "yaw) "
         "or [M,9] (and vx, vy), for boxes in the picture [M,4], and logits [M]";
}

std::vector<Detection> BoxRows::proposals(const RawBoxes& raw, const Capabilities& can,
                                          double score_threshold, int width, int height,
                                          const std::string& who) {
  count_ = raw.count;
  places_.clear();
  std::vector<Detection> kept;
  for (std::size_t i = 0; i < count_; ++i) {
    const int type = raw.classes.empty() ? 0 : raw.classes[i];
    if (type < 0 || static_cast<std::size_t>(type) >= can.types.size())
      throw InputError(who, fmt::format("box {} of {}", i, count_),
                       fmt::format("is of class {}, and {} are named", type, can.types.size()),
                       "name all classes in the order of their numbers");
    Detection found = detection_of(raw.boxes + i * raw.columns, raw.columns, !can.finds_bev);
    found.logit = raw.logits[i];
    found.type = type;
    if (!(found.score() > score_threshold)) continue;
    kept.push_back(std::move(found));
    places_.push_back(i);
  }
  check_proposals(kept, can.matching(), who);
  for (Detection& found : kept) found.picture = within(found.picture, width, height);
  return kept;
}

std::vector<float> BoxRows::of_rows(std::span<const double> d_logits) const {
  std::vector<float> all(count_);
  for (std::size_t i = 0; i < d_logits.size(); ++i) all[places_[i]] = static_cast<float>(d_logits[i]);
  return all;
}

}  // namespace mirage
