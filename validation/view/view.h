// `mirage view`: a folder of frames as one page that opens offline, with or without a run or a detector's
// output.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

#include "attack/run.h"
#include "detection/detector.h"

namespace mirage {

struct ViewSettings {
  std::filesystem::path data;        ///< KITTI layout; empty: the run's
  std::filesystem::path run;         ///< of mirage attack: its adversary on its hosts; empty: none
  std::filesystem::path drive;       ///< of mirage drive: a vehicle of it (drive_view.h); empty: none
  std::string vehicle;               ///< of the drive; empty: the one that is hidden longest
  std::filesystem::path animation;   ///< of the vehicle, .webp or .gif; empty: none
  std::filesystem::path detections;  ///< detection/detect.h; empty: none
  std::filesystem::path page;        ///< the .html that is written
  /// The first `frames` frames; 0: all. With a run as shown_hosts() (validation/fidelity/validate.h).
  int frames = 0;
  Overrides overrides;            ///< in place of the run's
  TrustRun trust = TrustRun::no;  ///< of the run
  bool detect = true;             ///< with a run: its detector looks at the frames as recorded and attacked
  /// The detector; empty fields take the run's values.
  DetectorOptions detector = detector_of_the_run();
  double size =
      100;  ///< MB of the page at most: points are thinned, then pictures compressed more, until it fits
  bool quiet = false;
};

/// Writes the page (atomically), and the animation where one is asked for, and returns the content of the
/// result: page, bytes, frames, vehicles (attacked), learned_on (of them), hidden (not learned on), points,
/// kept_points, step and quality (the coarsest of any frame), seconds; with `detections` frames_in_file (how
/// many of the frames they are of); and of a drive animation (its bytes) and vehicle.
nlohmann::json make_view(const ViewSettings& settings);

}  // namespace mirage
