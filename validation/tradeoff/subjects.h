// The settings and subjects of a speed–accuracy study: an adversary, the hosts that carry it, and the camera
// settings to compare.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "attack/run.h"
#include "base/parallel.h"
#include "detection/detector.h"
#include "frames/frame_store.h"
#include "frames/hosts.h"

namespace mirage {

struct TradeoffSettings {
  Overrides overrides;             ///< in place of the run's settings, or of the defaults
  FrameSource source;              ///< the frames; filled in by tradeoff()
  std::filesystem::path run, out;  ///< run: whose adversary and hosts; empty: a random mesh on any car
  TrustRun trust = TrustRun::no;   ///< whether code that the run names may be loaded
  int hosts = 8, frames = 12, repeats = 5;
  int reference_samples = 16, sharp_samples = 8, directions = 24;  ///< of CameraStudy
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
         .range = {2, Range::kMax}},
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
  visit({.name = "cycles_samples", .help = "samples of Cycles' reference", .range = {4, Range::kMax}},
        s.cycles_samples);
  visit({.name = "attack_seconds",
         .help = "length of an attack at each quality, precision and locality, and its success; 0: none",
         .range = kNotNegative},
        s.attack_seconds);
}

struct Subjects {
  TexturedMesh adversary;
  std::vector<HostId> hosts;  ///< by distance
};

/// The run's adversary and hosts; without a run (null) a random mesh, and cars of settings.source.data that
/// leave it in view. settings.hosts at most, evenly over their distances. InputError if no car can be used.
Subjects choose_subjects(const TradeoffSettings& settings, const Run* run, FrameStore& store);

/// `count` of the list, evenly over it; 0: all.
template <class T>
std::vector<T> evenly(const std::vector<T>& list, std::size_t count) {
  if (count == 0 || count >= list.size()) return list;
  std::vector<T> spread;
  for (std::size_t i = 0; i < count; ++i)
    spread.push_back(list[count == 1 ? list.size() / 2 : i * (list.size() - 1) / (count - 1)]);
  return spread;
}

/// Bounds the threads to one for as long as it lives.
class OneThread {
 public:
  OneThread() : before_(thread_count()) { set_thread_count(1); }
  ~OneThread() { set_thread_count(before_); }
  OneThread(const OneThread&) = delete;
  OneThread& operator=(const OneThread&) = delete;

 private:
  int before_;
};

/// One way to draw.
struct CameraVariant {
  std::string axis, label;
  SimulationSettings simulation;
  /// The picture is drawn at 1/shrink of its width and height, and its change is enlarged (bilinear).
  int shrink = 1;
};

/// Hard edges; `samples` along a pixel's side; by the plain loop in double or the fast rasteriser.
SimulationSettings hard_render(SimulationSettings settings, int samples, bool in_double);

/// One axis at a time around `baseline`: sigma, gamma, cut_off, edges (soft, hard), samples, image_scale,
/// arithmetic (float, double), and what each --quality ships (axis "quality").
std::vector<CameraVariant> axis_variants(const SimulationSettings& baseline);
/// All combinations of some σ, γ, cut-offs and samples, in float (axis "grid"). The baseline and every
/// quality are among them.
std::vector<CameraVariant> grid_variants(const SimulationSettings& baseline);

/// A point's "settings".
nlohmann::json settings_json(const CameraVariant& variant);

}  // namespace mirage
