#include "detection/box_rows.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>

#include "base/child_process.h"
#include "base/error.h"
#include "scene/data/label_types.h"

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

OutsideWord read_outside_word(const nlohmann::json& told, const std::string& who) {
  using nlohmann::json;
  const auto bad = [&](const char* field, const std::string& problem, const char* fix) {
    throw FieldError("detector", who, std::string(field) + " " + problem, fix);
  };
  OutsideWord word;
  Capabilities& can = word.can;
  const json reads = told.value("reads", json::array({"image", "points"}));
  const auto bad_reads = [&] {
    bad("reads", "is " + reads.dump(), "name image, points, or cameras beside the first");
  };
  if (!reads.is_array() || reads.empty()) bad_reads();
  can.reads_image = can.reads_points = false;
  for (const json& input : reads) {
    if (!input.is_string()) bad_reads();
    const auto name = input.get<std::string>();
    if (name == "image")
      can.reads_image = true;
    else if (name == "points")
      can.reads_points = true;
    else
      can.reads.push_back(name);
  }
  const std::string finds = text_of(told, "finds", "boxes"), pictures = text_of(told, "pictures", "linear");
  can.version = text_of(told, "version", "");
  if (finds != "boxes" && finds != "picture") bad("finds", "is " + finds, "use boxes or picture");
  can.finds_bev = finds == "boxes", can.finds_picture = finds == "picture";
  if (pictures != "linear" && pictures != "srgb8") bad("pictures", "is " + pictures, "use linear or srgb8");
  word.bytes = pictures == "srgb8";
  const auto is_true = [&](const char* key) { return told.value(key, json()) == true; };
  can.has_gradients = is_true("gradient");
  can.finds_heights = can.finds_bev && is_true("heights");
  can.remembers = is_true("remembers");
  can.why_whole = is_true("local") ? "" : "it knows no other passes";
  if (const json types = told.value("classes", json::array()); !types.empty()) {
    can.types.clear();
    for (const json& type : types)
      can.types.push_back(kitti_type(type.is_string() ? type.get<std::string>() : type.dump()));
  }
  if (const auto region = told.find("region"); region != told.end()) {
    const bool numbers =
        region->is_array() && region->size() == 4 &&
        std::all_of(region->begin(), region->end(), [](const json& v) { return v.is_number(); });
    for (std::size_t i = 0; numbers && i < 4; ++i) word.region[i] = (*region)[i].get<double>();
    if (!numbers || !(word.region[0] < word.region[1] && word.region[2] < word.region[3]))
      bad("region", "is " + region->dump(), "give x_min, x_max, y_min, y_max in m");
  }
  return word;
}

std::vector<SensorData> clean_sensors_of(const SensorView& view, const Capabilities& can,
                                         const std::string& who) {
  if (!view.clean || !can.why_whole.empty() || !view.others.empty()) return {};
  SensorView before = view;
  before.image = view.clean->image, before.points = view.clean->points, before.clean = nullptr;
  return sensors(before, can, who);
}

bool all_finite(std::span<const float> values) {
  std::uint32_t bad = 0;  // without a branch, so that it is quick
  for (const float value : values) bad |= (std::bit_cast<std::uint32_t>(value) & 0x7f800000u) == 0x7f800000u;
  return bad == 0;
}

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
    if (!raw.identities.empty()) found.identity = raw.identities[i];
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
