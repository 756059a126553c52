// Scores depth completion back-ends side by side on a data set: against true depth where the set has it
// (mirage generate --depth), else on returns that were held back; and what their errors do to an object that
// is drawn on every car's roof.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "geometry/mesh.h"
#include "scene/depth_completion.h"

namespace mirage {

/// On what depth completions are compared.
struct DepthScoreOptions {
  std::filesystem::path data;
  std::size_t frames = 0;  ///< only the first N (0: all)
  double farthest = 80;    ///< m; pixels with truth beyond are not scored
  /// Share of the returns that is held back and scored on, chosen at random by (seed, frame); 0: none, score
  /// on true depth.
  double hidden = 0;
  std::uint64_t seed = 0;
  int border = 3;  ///< pixels around the skyline that count as object–sky border
};

/// Pixels of an object's silhouette and what occlusion by a completed depth does to them, against what it
/// does with true depth.
struct RoofPixels {
  std::size_t pixels = 0, wrongly_kept = 0, wrongly_dropped = 0;
  /// Counts a pixel of the object: whether the completed depth leaves it in sight, and the true one.
  void add(bool kept, bool rightly_kept);
};

/// One completion's errors and time.
struct DepthScore {
  std::string name;
  double seconds = 0;     ///< a frame
  double coverage = 0;    ///< share of the scored pixels with a value
  double sky_filled = 0;  ///< share of the pixels with nothing there (sky) that got a depth
  DepthErrors common;     ///< on the pixels where every back-end has a value
  DepthErrors filled;     ///< on all, missing ones filled as the benchmark does
  /// Hidden returns only: as `common`, without returns that a nearer kept one within 3 pixels contradicts
  /// (the unit sits beside the camera and sees behind things; the benchmark's own truth is cleaned of such).
  DepthErrors consistent;
  RoofPixels roof;    ///< the whole silhouette
  RoofPixels sky;     ///< its pixels with nothing behind (true depth: none)
  RoofPixels border;  ///< of these, the ones within `border` pixels of something
};

/// `adversary` goes on every labelled car's roof. Frames without true depth give no roof pixels. tell(done,
/// total) after each frame. InputError where options.hidden is 0 and a frame has no true depth, and where no
/// pixel is scored.
std::vector<DepthScore> score_depth(const DepthScoreOptions& options,
                                    std::span<const std::unique_ptr<DepthCompletion>> backends,
                                    const TexturedMesh& adversary,
                                    const std::function<void(std::size_t, std::size_t)>& progress);

/// Splits the returns: each is held back with probability `share`, by (seed, frame id).
void withhold(const Sweep& sweep, double share, std::uint64_t seed, const std::string& id, Sweep& remaining,
              Sweep& withheld);

}  // namespace mirage
