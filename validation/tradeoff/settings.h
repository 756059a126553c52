// What a speed–accuracy study is asked for.
#pragma once

#include <cstdint>
#include <filesystem>

#include "attack/run.h"
#include "detection/detector.h"

namespace mirage {

struct TradeoffSettings {
  Overrides asked;                 ///< in place of the run's settings, or of the defaults
  FrameSource source;              ///< what follows; filled in by tradeoff()
  std::filesystem::path run, out;  ///< run: whose adversary and hosts; empty: a random mesh on any car
  TrustRun trust = TrustRun::no;   ///< whether code that the run names may be loaded
  int hosts = 8;                   ///< at most, evenly over the range of distances
  int frames = 12;                 ///< looked at for hosts, evenly over the set; 0: all
  int repeats = 5;                 ///< of each timing
  int reference_samples = 16;      ///< along a pixel's side (CameraStudySettings)
  int sharp_samples = 8;
  int directions = 24;
  bool grid = true;        ///< the joint grid of σ, γ, cut-off and samples: recommendations need it
  int depth_frames = 6;    ///< on which depth completion is scored; 0: leave that out
  int detector_hosts = 4;  ///< on which the detector's passes are timed and compared; 0: leave that out
  bool cycles = false;     ///< light effects and samples of Blender Cycles as well
  int cycles_hosts = 2, cycles_samples = 256;  ///< samples: of the reference
  double attack_seconds = 0;  ///< > 0: attacks of so long at each quality, precision and locality
  DetectorOptions detector;   ///< of these attacks and of the passes
  std::uint64_t seed = 0;
  bool quiet = false;
};

}  // namespace mirage
