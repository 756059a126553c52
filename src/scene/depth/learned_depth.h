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

/// Which back-end.
struct DepthOptions {
  /// ip-basic, with -multiscale, -bilateral and -extrapolated appended in this order for its variants; guided
  /// (plugins/guided.so beside the program); or a plugin's path (*.so).
  std::string backend = "ip-basic";
  std::filesystem::path weights = {};  ///< of a learned one; empty: the shipped ones
  bool fresh = false;                  ///< freshly initialised weights, drawn from the seed
  std::uint64_t seed = 0;
  int threads = 0;  ///< of a training step; 0: thread_count()
};

/// A picture, its returns and what is really there: H×W, m; 0 nothing (sky), negative not known.
struct DepthSample {
  ImageF image, sparse, truth;
};

class LearnedDepth : public DepthCompletion {
 public:
  /// total, depth and presence loss of one optimiser step on the samples' mean.
  virtual std::array<float, 3> train_step(std::span<const DepthSample> samples, double learning_rate) = 0;
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
std::unique_ptr<LearnedDepth> load_learned_depth(const DepthOptions& options);

}  // namespace mirage
