#include "attack/road_users.h"

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

}  // namespace mirage
