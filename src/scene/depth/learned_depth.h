// Learned depth completion, loaded from a plugin (depth_abi.h), and the one way to get any back-end by name.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/schedule.h"
#include "scene/depth_completion.h"

namespace mirage {

/// What completes depth where nothing else is asked for.
inline constexpr const char* kDefaultDepth = "ip-basic";

/// Which back-end.
struct DepthOptions {
  /// ip-basic, with -multiscale, -bilateral and -extrapolated appended in this order for its variants; guided
  /// (plugins/guided.so beside the program); or a plugin's path (*.so).
  std::string backend = kDefaultDepth;
  std::filesystem::path weights = {};  ///< of a learned one; empty: the shipped ones
  bool fresh = false;                  ///< freshly initialised weights, drawn from the seed
  std::uint64_t seed = 0;
  int threads = 0;  ///< of a training step; 0: thread_count()
};

/// A picture, its returns and what is really there: H×W, m; 0 nothing (sky), negative not known.
struct DepthSample {
  ImageF image, sparse, truth;
};

/// A completion with weights, from a plugin.
class LearnedDepth : public DepthCompletion {
 public:
  /// total, depth and presence loss of one optimiser step on the samples' mean.
  virtual std::array<float, 3> train_step(std::span<const DepthSample> samples, double learning_rate) = 0;
  /// Writes the weights, and the optimiser's state for resuming. Failure if the file can't be written.
  virtual void save(const std::filesystem::path& file, bool with_optimiser) = 0;
};

/// InputError, one line: an unknown name, a missing, unloadable or wrong-version plugin, missing or unfit
/// weights. The object's complete() reports pixels that are not finite (InputError) and skips such returns; a
/// plugin that fails, throws or gives a depth that is no finite number ends in Failure.
std::unique_ptr<DepthCompletion> load_depth_completion(const DepthOptions& options);
/// What a back-end's answers depend on besides its input: name, or plugin and weights by content, and the
/// threads that a plugin may use. InputError as load_depth_completion's.
std::string depth_identity(const DepthOptions& options);
/// Whether a word names a back-end that ships with the program; other names are paths of plugins: code.
bool is_shipped_depth(const std::string& backend);
/// For training: a completion that has weights. Errors as load_depth_completion's.
std::unique_ptr<LearnedDepth> load_learned_depth(const DepthOptions& options);

// Training learned depth completion on generated frames with known depth (mirage generate --depth).

/// How hard training makes it to trust the picture (see augmented_crop).
struct DepthAugmentation {
  double without_picture = 0;  ///< share of samples whose picture is one grey
  /// Largest share of a sample's returns that stray: by up to 3 pixels across, 2 up or down, and 5 % in
  /// range. Foliage, edges and moving things give such in recorded sweeps, generated ones hardly have them.
  double scatter = 0;
  int shift = 1;  ///< pixels by which returns may be off the picture together
};

/// What a training of depth completion is asked for beside what every training is.
struct DepthLearning {
  std::string backend = "guided";
  int crop = 320;  ///< pixels of width of a sample; its height is the picture's
  DepthAugmentation augmentation;
};

template <class Visitor, FieldsOf<DepthLearning> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "backend", .help = "depth: guided, or a plugin's path (*.so)", .option = "depth"},
        s.backend);
  visit({.name = "crop", .help = "depth: width of a sample, pixels", .range = {64, Range::kMax}}, s.crop);
  visit({.name = "without_picture",
         .help = "depth: share of samples whose picture is replaced by uniform grey",
         .range = kShare},
        s.augmentation.without_picture);
  visit({.name = "scatter",
         .help = "depth: largest share of a sample's returns that are moved at random, by up to 3 pixels and "
                 "about 5 % in range",
         .range = kShare},
        s.augmentation.scatter);
  visit({.name = "shift",
         .help = "depth: largest common shift of a sample's returns against the picture, pixels",
         .range = {0, 10}},
        s.augmentation.shift);
}

/// What `mirage train depth` is asked for.
struct DepthTrainingOptions : TrainingSchedule, DepthLearning {
  std::filesystem::path data;
  std::filesystem::path start = {};  ///< weights to start from; empty: fresh ones
};

template <class Visitor, FieldsOf<DepthTrainingOptions> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "data", .help = "training set with known depth", .required = true}, s.data);
  visit({.name = "start", .help = "weights to start from", .otherwise = "fresh ones", .decides = false},
        s.start);
  visit_fields(visit, as_base<TrainingSchedule>(s));
  visit_fields(visit, as_base<DepthLearning>(s));
}

/// Hash of what a training reads of those frames: DataSet::hash() of each, and its true depth, instances and
/// point labels where it has them. InputError for a missing file. Uses several threads.
std::string training_frames_hash(const std::filesystem::path& data, std::span<const std::string> ids);

/// What such a training ends with, beside the weights in DepthTrainingOptions::out.
struct DepthTrainingResult {
  std::int64_t steps = 0;
  double seconds = 0, seconds_per_step = 0;
  std::array<double, 3> loss{};   ///< running means: total, depth, presence
  std::filesystem::path weights;  ///< out/BACKEND-depth.weights
};

/// Trains from scratch, or goes on from the checkpoint in `out` (which must be of the same options and
/// frames, or InputError; FieldError for options out of range). What step s sees depends on (seed, s) alone:
/// not on threads, nor on interruptions. A checkpoint is written every checkpoint.steps steps and on Ctrl-C
/// (then Interrupted is thrown).
DepthTrainingResult train_depth(const DepthTrainingOptions& options);

/// A whole frame. InputError where the frame has no true depth, or one of another size.
DepthSample read_depth_frame(const std::filesystem::path& data, const std::string& id);

/// A crop of the frame, changed at random by (seed, index) alone: mirrored; all depths scaled by 0.85–1.15;
/// up to half of the returns hidden, and in some samples rectangles of them (dark cars and glass give none);
/// returns shifted together (calibration) and shaken in range; the picture's exposure, colour, contrast and
/// noise changed, or all of it left out.
DepthSample augmented_crop(const DepthSample& frame, int width, std::uint64_t seed, std::uint64_t index,
                           const DepthAugmentation& augmentation = {});

}  // namespace mirage
