// Scores depth completion back-ends side by side on a data set: against true depth if the set has it (mirage
// generate --depth), otherwise on held-back returns. Also scores the effect of their errors on an object
// drawn on every car's roof.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "geometry/mesh.h"
#include "scene/depth_completion.h"

namespace mirage {

/// The data on which depth completions are compared.
struct DepthScoreOptions {
  std::filesystem::path data;
  std::size_t frames = 0;  ///< only the first N (0: all)
  double farthest = 80;    ///< m; pixels with truth beyond are not scored
  /// Share of the returns that is held back and scored on, drawn at random by (seed, frame); 0: score on true
  /// depth.
  double hidden = 0;
  std::uint64_t seed = 0;
  int border = 3;  ///< pixels around the skyline that count as object–sky border
};

/// Pixels of an object's silhouette, and how many of them occlusion by the completed depth decides otherwise
/// than occlusion by the true depth.
struct RoofPixels {
  std::size_t pixels = 0, wrongly_kept = 0, wrongly_dropped = 0;
  /// Counts a pixel of the object: whether the completed and the true depth leave it in sight.
  void add(bool kept, bool rightly_kept);
};

/// One completion's errors and time.
struct DepthScore {
  std::string name;
  double seconds = 0;     ///< a frame
  double coverage = 0;    ///< share of the scored pixels with a value
  double sky_filled = 0;  ///< share of the pixels with nothing there (sky) that got a depth
  DepthErrors common;     ///< on the pixels where every back-end has a value
  DepthErrors filled;     ///< on all; missing values filled as by the benchmark
  /// Hidden returns only: as `common`, without returns that a nearer kept one within 3 pixels contradicts
  /// (the unit sits beside the camera and sees behind objects; the benchmark cleans its truth of them).
  DepthErrors consistent;
  RoofPixels roof;    ///< the whole silhouette
  RoofPixels sky;     ///< its pixels without true depth behind
  RoofPixels border;  ///< of these, the ones within `border` pixels of something
};

/// Places `adversary` on every labelled car's roof. Frames without true depth give no roof pixels. Calls
/// progress(done, total) after each frame. InputError if options.hidden is 0 and a frame has no true depth,
/// and if no pixel is scored.
std::vector<DepthScore> score_depth(const DepthScoreOptions& options,
                                    std::span<const std::unique_ptr<DepthCompletion>> backends,
                                    const TexturedMesh& adversary,
                                    const std::function<void(std::size_t, std::size_t)>& progress);

/// Splits the returns: each is held back with probability `share`, by (seed, frame id).
void withhold(const Sweep& sweep, double share, std::uint64_t seed, const std::string& id, Sweep& remaining,
              Sweep& withheld);

}  // namespace mirage
