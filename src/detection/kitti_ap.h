// Average precision by the rules of KITTI's development kit (Geiger et al., CVPR 2012; evaluate_object with
// the 40 recalls of 2019), so that a figure can stand beside the benchmark's. average_precision.h has
// Mirage's own rules, which are milder:
//
//                        here, as in the kit                      average_precision.h
//   boxes to be found    Car of the level, wherever it stands     the same; bev: inside the searched region
//   ignored              Vans, harder cars                        bev: the same; picture: trucks, trams, too
//   a false alarm on     only where IoU exceeds the limit;        IoU reaches the limit, or half of the
//   these is forgiven    DontCare, picture alone: the covered     detection lies inside
//                        share of the detection exceeds it
//   low detections       under the level's height neither hit     bev: as a car's at that distance; picture:
//                        nor false alarm                          hits count
//   the curve            41 scores, at hits 1/40 of recall apart  every score
//
// With fewer cars of a level than 41 the kit leaves the end of the curve at zero: of 25 cars it gives at most
// 60 %.
#pragma once

#include <array>
#include <nlohmann/json.hpp>
#include <span>
#include <vector>

#include "detection/average_precision.h"
#include "scene/data/kitti_results.h"

namespace mirage {

/// One frame as the kit's files have it: every detection has a box in the picture, of no area where the
/// camera sees nothing of it.
struct KittiFrame {
  std::vector<Label> labels;
  std::vector<KittiDetection> detections;
  bool labelled = true;  ///< false: what is found there is neither a hit nor a false alarm
};
/// A detector's own boxes in the picture, else those of the upright boxes projected (kitti_detections).
KittiFrame kitti_frame(const Frame& frame, std::span<const Detection> detections, Matching matching,
                       const std::vector<std::string>& types = {kCars});

/// AP of a level, and how many cars it asks for.
struct KittiPrecision {
  double average_precision = 0;  ///< in [0, 1]; 0 without cars
  int cars = 0;
};
/// At overlaps above `min_iou`: from above, the kit's "ground", or in the picture, its "image".
KittiPrecision kitti_average_precision(std::span<const KittiFrame> frames, Matching matching,
                                       Difficulty level, double min_iou);

/// result.json's "kitti_ap": {iou: 0.7, cars: {easy, moderate, hard}, and for each way "bev" or "image"
/// {easy, moderate, hard}; iou50: the same at 0.5}. A level without cars is null.
nlohmann::json kitti_ap_json(std::span<const KittiFrame> frames, std::span<const Matching> ways);

}  // namespace mirage
