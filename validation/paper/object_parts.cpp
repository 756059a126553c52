#include "validation/paper/object_parts.h"

namespace mirage::paper {
namespace {

/// "texture alone, image": the sensor comes last, as in the other tables.
std::string label(const PartArm& arm) {
  const std::string learned = !arm.parts.empty()      ? arm.parts + " alone"
                              : arm.target == "lidar" ? "shape"
                                                      : "shape and texture";
  return learned + ", " + target_title(arm.target);
}

}  // namespace

const std::vector<PartArm>& part_arms() {
  static const std::vector<PartArm> all = {
      {"image", ""},     {"image", "shape"}, {"image", "texture"}, {"image", "size"},   {"lidar", ""},
      {"lidar", "size"}, {"both", ""},       {"both", "shape"},    {"both", "texture"}, {"both", "size"}};
  return all;
}

Table parts_table(CaseList& list) {
  Table table{
      "parts",
      "What of the object hides: fusion, KITTI rig",
      "What is learned, and through which sensor; the rest stays the paper's start, an ellipsoid of 0.75 of "
      "the box in plain grey. Through LiDAR no gradient reaches the texture. Size: three half lengths alone.",
      {{"vanished", "vanished"},
       {"net_vanished", "vanished, net of its size"},
       {"fn_asr", "FN ASR"},
       {"fp_asr", "FP ASR"},
       {"asr", "ASR"},
       {"net", "ASR net of its size"}},
      {}};
  for (const PartArm& arm : part_arms()) {
    if (list.quick() && arm.target != "both") continue;
    Row row;
    row.label = label(arm);
    row.rig = "kitti64";
    const bool standing = arm.parts.empty() && arm.target == "both";
    row.evaluation =
        list.evaluate(list.attack("kitti64", "fusion", arm.target, {.parts = arm.parts}), standing, standing);
    row.image = arm.target == "image";
    table.rows.push_back(row);
  }
  return table;
}

}  // namespace mirage::paper
