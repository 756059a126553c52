// Learned depth completion, loaded from a plugin (depth_abi.h), and the one way to get any back-end by name.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

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

}  // namespace mirage
