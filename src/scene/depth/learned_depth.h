// Learned depth completion from a plugin (depth_abi.h), and the loader of any back-end by name.
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

/// The default back-end.
inline constexpr const char* kDefaultDepth = "ip-basic";

/// The choice of a back-end.
struct DepthOptions {
  /// ip-basic, with -multiscale, -bilateral and -extrapolated appended in this order for its variants; guided
  /// (plugins/guided.so beside the program); or a plugin's path (*.so).
  std::string backend = kDefaultDepth;
  std::filesystem::path weights = {};  ///< of a learned back-end; empty: the shipped ones
  bool fresh = false;                  ///< freshly initialised weights, drawn from the seed
  std::uint64_t seed = 0;
  int threads = 0;  ///< of a training step; 0: thread_count()
};

/// A picture, its returns and the true depth: H×W, m; truth 0: nothing (sky), negative: not known.
struct DepthSample {
  ImageF image, sparse, truth;
};

/// A completion with weights, from a plugin.
class LearnedDepth : public DepthCompletion {
 public:
  /// One optimiser step on the samples' mean loss; returns total, depth and presence loss.
  virtual std::array<float, 3> train_step(std::span<const DepthSample> samples, double learning_rate) = 0;
  /// Writes weights, and the optimiser's state if asked. Failure if the file can't be written.
  virtual void save(const std::filesystem::path& file, bool with_optimiser) = 0;
};

/// InputError, one line: an unknown name, a missing, unloadable or wrong-version plugin, missing or unfit
/// weights. The object's complete() reports pixels that are not finite (InputError) and skips such returns; a
/// plugin that fails, throws or returns a depth that is not finite causes Failure.
std::unique_ptr<DepthCompletion> load_depth_completion(const DepthOptions& options);
/// Identity of a back-end, on which its answers depend besides the input: name, or plugin and weights by
/// content, and the threads that a plugin may use. InputError as load_depth_completion's.
std::string depth_identity(const DepthOptions& options);
/// Whether a word names a shipped back-end; other names are paths of plugins, which run code.
bool is_shipped_depth(const std::string& backend);
/// For training: a completion that has weights. Errors as load_depth_completion's.
std::unique_ptr<LearnedDepth> load_learned_depth(const DepthOptions& options);

// Training learned depth completion on generated frames with known depth (mirage generate --depth).

/// How strongly training perturbs picture and returns (see augmented_crop).
struct DepthAugmentation {
  double without_picture = 0;  ///< share of samples with a uniform grey picture
  /// Largest share of a sample's returns that are displaced: by up to 3 pixels across, 2 up or down, and 5 %
  /// in range. Recorded sweeps have strays at foliage, edges and moving objects; generated ones have few.
  double scatter = 0;
  int shift = 1;  ///< pixels by which all returns may be off the picture
};

/// The options of a training of depth completion besides those of every training.
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

/// The options of `mirage train depth`.
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

/// Hash of the data that a training reads from those frames: DataSet::hash() of each, with its true depth,
/// instances and point labels if any. InputError for a missing file. Uses several threads.
std::string training_frames_hash(const std::filesystem::path& data, std::span<const std::string> ids);

/// The result of a training, besides the weights in DepthTrainingOptions::out.
struct DepthTrainingResult {
  std::int64_t steps = 0;
  double seconds = 0, seconds_per_step = 0;
  std::array<double, 3> loss{};   ///< running means: total, depth, presence
  std::filesystem::path weights;  ///< out/BACKEND-depth.weights
};

/// Trains from scratch, or resumes from the checkpoint in `out`. InputError if that has other options or
/// frames; FieldError for options out of range. The input of step s depends on (seed, s) only, not on threads
/// or interruptions. A checkpoint is written every checkpoint.steps steps and on Ctrl-C (then Interrupted is
/// thrown).
DepthTrainingResult train_depth(const DepthTrainingOptions& options);

/// Reads a whole frame. InputError if its true depth is missing or has another size.
DepthSample read_depth_frame(const std::filesystem::path& data, const std::string& id);

/// A crop of the frame, changed at random by (seed, index) alone: mirrored; all depths scaled by 0.85–1.15;
/// up to half of the returns hidden, and in some samples rectangles of them (dark cars and glass give none);
/// returns shifted together (calibration) and shaken in range; the picture's exposure, colour, contrast and
/// noise changed, or all of it left out.
DepthSample augmented_crop(const DepthSample& frame, int width, std::uint64_t seed, std::uint64_t index,
                           const DepthAugmentation& augmentation = {});

}  // namespace mirage
