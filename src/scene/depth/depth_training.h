// Training learned depth completion on generated frames with known depth (mirage generate --depth).
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "scene/depth/learned_depth.h"

namespace mirage {

/// How hard training makes it to trust the picture (see augmented_crop).
struct DepthAugmentation {
  double without_picture = 0;  ///< share of samples whose picture is one grey
  /// Largest share of a sample's returns that stray: by up to 3 pixels across, 2 up or down, and 5 % in
  /// range. Foliage, edges and moving things give such in recorded sweeps, generated ones hardly have them.
  double scatter = 0;
  int shift = 1;  ///< pixels by which returns may be off the picture together
};

struct DepthTrainingOptions {
  std::filesystem::path data, out;
  std::filesystem::path start = {};  ///< weights to start from; empty: fresh ones
  DepthAugmentation augmentation;
  std::string backend = "guided";
  std::int64_t steps = 4000;
  int batch = 2;
  int crop = 320;               ///< pixels of width of a sample; its height is the picture's
  double learning_rate = 2e-3;  ///< peak of the one-cycle schedule
  double minutes = 0;  ///< 0: no limit; otherwise the schedule ends at steps or minutes, which is first
  std::int64_t checkpoint_every = 250;
  double checkpoint_seconds = 0;  ///< > 0: also where so many seconds have passed since the last one
  std::size_t frames = 0;         ///< only the first N (0: all)
  std::uint64_t seed = 0;
  int threads = 0;
  bool quiet = false;
};

struct DepthTrainingResult {
  std::int64_t steps = 0;
  double seconds = 0, seconds_per_step = 0;
  std::array<double, 3> loss{};   ///< running means: total, depth, presence
  std::filesystem::path weights;  ///< out/BACKEND-depth.weights
};

/// Trains from scratch, or goes on from the checkpoint in `out` (which must be of the same options, or
/// InputError). What step s sees depends on (seed, s) alone: not on threads, nor on interruptions. A
/// checkpoint is written every checkpoint_every steps and on Ctrl-C (then Interrupted is thrown).
DepthTrainingResult train_depth(const DepthTrainingOptions& options);

/// A frame as training keeps it.
struct DepthFrame {
  ImageF image, sparse, truth;  ///< truth: 0 is sky
};
/// InputError where the frame has no true depth, or one of another size.
DepthFrame read_depth_frame(const std::filesystem::path& data, const std::string& id);

/// A crop of the frame, changed at random by (seed, index) alone: mirrored; all depths scaled by 0.85–1.15;
/// up to half of the returns hidden, and in some samples rectangles of them (dark cars and glass give none);
/// returns shifted together (calibration) and shaken in range; the picture's exposure, colour, contrast and
/// noise changed, or all of it left out.
DepthSample augmented_crop(const DepthFrame& frame, int width, std::uint64_t seed, std::uint64_t index,
                           const DepthAugmentation& augmentation = {});

}  // namespace mirage
