// Which side of a fusion is the weaker one, and whether what was learned against one works on the others.
// Everything is net of random meshes of the learned one's size: vanished and missed at IoU 0.7, the seed's.
#include <fmt/format.h>

#include "validation/paper/fusions.h"
#include "validation/paper/hiding_checks.h"

namespace mirage::paper {
namespace {

Cell cell(const Evidence& evidence, const std::string& rig, const Attacked& attacked,
          const std::string& judge) {
  return cell_of(evidence, cell_case(rig, attacked, judge));
}

Finding net(const Evidence& evidence) {
  return on_each_rig("fusions-net",
                     "Not in the paper: a learned mesh hides more than a random one of its size",
                     [&](const std::string& rig, std::vector<Check>& checks) {
                       for (const std::string& detector : fusion_detectors())
                         if (const Cell own = cell(evidence, rig, through_all(detector), detector))
                           checks.push_back(more_than_its_size(title(rig) + ", " + detector, own));
                     });
}

Finding sides(const Evidence& evidence) {
  return on_each_rig(
      "fusions-side", "Not in the paper: the picture is the weaker side of a fusion, net of the mesh's size",
      [&](const std::string& rig, std::vector<Check>& checks) {
        for (const std::string& detector : fused_detectors()) {
          const Cell image = cell(evidence, rig, {detector, "image"}, detector),
                     lidar = cell(evidence, rig, {detector, "lidar"}, detector);
          if (!image || !lidar) continue;
          checks.push_back(about_images(
              by_both(
                  title(rig) + ", " + detector, {image.learned, image.sized, lidar.learned, lidar.sized},
                  [&](const HidingRule& rule) {
                    return net_difference({image.learned, image.sized}, {lidar.learned, lidar.sized}, rule);
                  },
                  [&](const HidingRule& rule) {
                    return fmt::format("net {} through the image, {} through LiDAR, image − LiDAR",
                                       net_points(image, rule), net_points(lidar, rule));
                  }),
              {image.learned, lidar.learned}));
        }
      });
}

Finding transfer_between(const Evidence& evidence) {
  return on_each_rig(
      "fusions-transfer",
      "Not in the paper: what is learned against one fusion hides from the others, net of its size",
      [&](const std::string& rig, std::vector<Check>& checks) {
        for (const std::string& from : fused_detectors())
          for (const std::string& onto : fused_detectors())
            if (const Cell moved = cell(evidence, rig, through_all(from), onto); moved && from != onto)
              checks.push_back(more_than_its_size(fmt::format("{}, {} → {}", title(rig), from, onto), moved));
      });
}

}  // namespace

std::vector<Finding> fusion_findings(const Evidence& evidence) {
  return {net(evidence), sides(evidence), transfer_between(evidence)};
}

}  // namespace mirage::paper
