// Made-up evaluations for tests of the paper's tables and findings. Nothing in them was measured.
#pragma once

#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "detection/reliance.h"
#include "validation/paper/tables.h"

namespace mirage::test {

/// How many of `hosts` vehicles a frame are hidden and get a false positive `distance` m away; the first
/// ones.
struct MadeUp {
  int frames = 40, hosts = 5, hidden = 0, false_positive = 0;
  double distance = 30;
  double left = 0.3;  ///< best IoU with a hidden vehicle; 0.1 and less: it vanished
};

inline nlohmann::json outcomes_json(const MadeUp& made) {
  auto hosts = nlohmann::json::array(), list = nlohmann::json::array();
  for (int f = 0; f < made.frames; ++f)
    for (int h = 0; h < made.hosts; ++h) {
      // One frame in four is of the other kind, or there would be no spread to draw from.
      const bool odd = f % 4 == 0;
      const bool hidden = h < made.hidden && !odd, positive = h < made.false_positive && !odd;
      const std::string frame = fmt::format("{:06d}", f);
      hosts.push_back({{"frame", frame},
                       {"label", h},
                       {"range", 10.0 + h},
                       {"clean_iou", 0.9},
                       {"attacked_iou", hidden ? made.left : 0.85},
                       {"detected", true},
                       {"hidden", hidden},
                       {"false_positive", positive},
                       {"false_positive_distance", positive ? made.distance : 0}});
      if (positive)
        list.push_back({{"frame", frame}, {"label", h}, {"mesh", 0}, {"distance_from_host", made.distance}});
    }
  return {{"vehicles", made.frames * made.hosts}, {"outcomes", hosts}, {"false_positives", {{"list", list}}}};
}

/// Of a detector that loses 20 points of AP by another frame's picture, or none.
inline Reliance made_up_reliance(bool uses_picture) {
  Reliance made;
  made.ap70 = 0.8;
  made.ap70_swapped = uses_picture ? 0.6 : 0.8;
  made.ap70_black = 0.5;
  made.drop = {made.ap70 - made.ap70_swapped, uses_picture ? 0.1 : -0.01, uses_picture ? 0.3 : 0.01};
  made.mean_delta_logit = uses_picture ? 2 : 0.07;
  made.frames = 40;
  made.vehicles = 200;
  return made;
}

inline nlohmann::json evaluation_json(const MadeUp& learned, const MadeUp& random, bool uses_picture = true) {
  nlohmann::json json = outcomes_json(learned);
  json["reliance"] = to_json(made_up_reliance(uses_picture));
  json["random"] = outcomes_json(random);
  json["random"]["meshes"] = 1;
  json["sized"] = json["cuboid"] = json["random"];
  return json;
}

}  // namespace mirage::test
