// A vehicle of a finished `mirage drive` for `mirage view`: detections and tracks are read from the drive's
// folder; pictures and returns are simulated again.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "attack/run.h"
#include "attack/vehicle_drive.h"
#include "frames/frame_store.h"
#include "validation/view/frame_pack.h"

namespace mirage {

/// The vehicle, and replacements for the drive's object and data.
struct DriveChoice {
  std::filesystem::path drive;  ///< folder of mirage drive
  std::string vehicle;  ///< SEQUENCE_TRACK; empty: the one whose gap of detection the object prolongs most
  std::filesystem::path run;   ///< or mesh, where it has moved; empty: the drive's
  std::filesystem::path data;  ///< likewise
  TrustRun trust = TrustRun::no;
};

class DriveView {
 public:
  /// InputError if the folder is not a finished drive, lacks that vehicle (the error lists the vehicles), or
  /// needs untrusted code; if the data set lacks a frame of the vehicle; or if the object or the frames
  /// differ in content from those that the drive judged.
  explicit DriveView(const DriveChoice& choice);

  /// The frames in which the vehicle is labelled, in their order.
  const std::vector<std::string>& frames() const { return frames_; }
  const AttackSettings& settings() const { return run_.settings; }
  const std::string& object() const { return object_; }
  const std::string& detector() const { return detector_; }
  double score_threshold() const { return score_threshold_; }
  const std::string& name() const { return name_; }  ///< SEQUENCE_TRACK
  /// to_json(VehicleDrive).
  nlohmann::json vehicle() const { return to_json(vehicle_); }

  /// The object on the vehicle in one of frames(), and the boxes and tracks that were judged there.
  void add(ViewFrame& view);

 private:
  /// The detections of one version, by frame.
  using Shown = std::vector<ViewDetections>;

  Run run_;
  VehicleDrive vehicle_;
  std::string name_, object_, detector_;
  double score_threshold_ = 0;
  Shown clean_, attacked_;
  bool learned_on_ = false;  ///< whether the object was learned on the vehicle, in any frame
  std::vector<std::string> frames_;
  std::map<std::string, std::size_t> places_;  ///< of frames
  std::vector<HostId> hosts_;
  std::unique_ptr<FrameStore> store_;
  std::vector<Carrier> carriers_;
};

/// The vehicle's frames as a moving picture, as recorded beside with the object: a .webp or .gif of 10 frames
/// a second.
class DriveAnimation {
 public:
  /// InputError for another kind of file.
  explicit DriveAnimation(std::filesystem::path file);
  ~DriveAnimation();
  DriveAnimation(const DriveAnimation&) = delete;
  DriveAnimation& operator=(const DriveAnimation&) = delete;

  /// The next of the drive's frames.
  void add(const ViewFrame& view);
  /// Writes the file by validation/view/animation.py. Failure where Python or Pillow is missing.
  void write(const DriveView& drive);

 private:
  std::filesystem::path file_, folder_;
  nlohmann::json frames_ = nlohmann::json::array();
};

}  // namespace mirage
