// The points of depth completion in a speed–accuracy study.
#pragma once

#include <string>
#include <vector>

#include "geometry/mesh.h"
#include "validation/tradeoff/subjects.h"

namespace mirage {

struct DepthPoints {
  std::vector<TradeoffPoint> points;  ///< group "depth", axis "back_end"
  std::string reference;              ///< in words; empty if nothing was scored
};

/// Every back-end that can be loaded on the data set's first settings.depth_frames frames (0: none), against
/// true depth where all of them have it, else on a fifth of the returns, held back. Times are wall-clock, of
/// one thread. Errors of score_depth.
DepthPoints depth_points(const TradeoffSettings& settings, const TexturedMesh& adversary);

// The points of the camera and of the LiDAR, over all hosts of a speed–accuracy study.

/// What the camera's references are worth; means over hosts.
struct CameraReference {
  double self_cosine = 0;   ///< CameraStudy::self_cosine
  Agreement sharp;          ///< CameraStudy::sharp_agreement
  std::vector<int> pixels;  ///< of each host's object
};

struct SensorPoints {
  std::vector<TradeoffPoint> points;  ///< groups "camera" and "lidar", in this order
  CameraReference reference;
};

/// Draws and traces every host in every way (subjects.h, sensor_studies.h), one thread at a time. Off the
/// grid the camera's points also have the gradient of the adversary with each face in the mean of its
/// colours, "plain_faces_cosine" and "plain_faces_norm". Interrupted between drawings.
SensorPoints sensor_points(const TradeoffSettings& settings, const Subjects& subjects, FrameStore& store);

}  // namespace mirage
