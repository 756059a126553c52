// Detections on disk: what `mirage detect` writes, and what other people's detectors do.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "detection/detector.h"
#include "scene/data/kitti_results.h"

namespace mirage {

/// Proposals as KITTI's results hold them: class Car, upright() in the whole sweep; one that is judged in
/// the picture gives no box in space.
std::vector<KittiDetection> kitti_detections(std::span<const Detection> proposals, Matching matching,
                                             const Frame& frame);

/// A detection as detections.json has it.
struct ListedDetection {
  double score = 0;
  std::optional<Box3> box;  ///< without a height where the file tells none
  std::optional<PictureBox> picture;
};

/// The detections of a data set's frames.
class DetectionFiles {
 public:
  /// `path`: detections.json of mirage detect (or its folder), a folder of KITTI result files ID.txt (or one
  /// that holds them as data/ID.txt), or one such file. InputError if it is none of these, or detections.json
  /// holds what can't be read.
  explicit DetectionFiles(const std::filesystem::path& path);

  /// Whether the frame has been looked at; a frame without detections has.
  bool has(const std::string& id) const;
  /// The frame's detections by falling score; none if it has not been looked at. InputError naming file and
  /// field for what can't be read.
  std::vector<KittiDetection> of(const Frame& frame) const;
  /// As it was given.
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  std::map<std::string, std::filesystem::path> texts_;          ///< by frame
  std::map<std::string, std::vector<ListedDetection>> frames_;  ///< of detections.json, by frame
};

}  // namespace mirage
