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
  int hosts = 8, frames = 12, repeats = 5;
  int reference_samples = 16, sharp_samples = 8, directions = 24;  ///< of CameraStudySettings
  bool grid = true;  ///< the joint grid of σ, γ, cut-off and samples: recommendations need it
  int depth_frames = 6, detector_hosts = 4;
  bool cycles = false;
  int cycles_hosts = 2, cycles_samples = 256;
  double attack_seconds = 0;
  DetectorOptions detector;  ///< of these attacks and of the passes
  std::uint64_t seed = 0;
  bool quiet = false;
};
template <class Visitor, FieldsOf<TradeoffSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "hosts", .help = "vehicles at most, evenly over their distances", .range = kFromOne},
        s.hosts);
  visit({.name = "frames",
         .help = "frames looked at for hosts, evenly over the set; 0: all",
         .range = kNotNegative},
        s.frames);
  visit({.name = "repeats", .help = "repeats of each timing", .range = kFromOne}, s.repeats);
  visit({.name = "reference_samples",
         .help = "samples along a pixel's side of the reference",
         .range = {2, 32}},
        s.reference_samples);
  visit({.name = "directions",
         .help = "directions of the finite differences of the hard render",
         .range = {2, Range::kMost}},
        s.directions);
  visit({.name = "depth_frames",
         .help = "frames on which depth completion is scored; 0: none",
         .range = kNotNegative},
        s.depth_frames);
  visit({.name = "detector_hosts",
         .help = "vehicles on which ways of the detector's passes are timed and compared; 0: none",
         .range = kNotNegative},
        s.detector_hosts);
  visit({.name = "cycles", .help = "light effects and samples of Blender Cycles as well"}, s.cycles);
  visit({.name = "cycles_hosts", .help = "vehicles rendered in Cycles", .range = kFromOne}, s.cycles_hosts);
  visit({.name = "cycles_samples", .help = "samples of Cycles' reference", .range = {4, Range::kMost}},
        s.cycles_samples);
  visit({.name = "attack_seconds",
         .help = "length of an attack at each quality, precision and locality, and its success; 0: none",
         .range = kNotNegative},
        s.attack_seconds);
}

}  // namespace mirage
