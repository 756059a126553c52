// Weights files (tensor_file.h) as LibTorch's tensors.
#pragma once

#include <torch/optim/adamw.h>
#include <torch/types.h>

#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "tensor_file.h"

namespace mirage {

/// A weights file and its parts, read whole and checked before use.
class WeightsFile {
 public:
  /// InputError as read_file's; otherwise std::runtime_error, in words for the user, as parse_tensor_file's,
  /// and for a part that is missing or of another SHA-256.
  explicit WeightsFile(const std::filesystem::path& file);
  WeightsFile(WeightsFile&&) = default;
  WeightsFile& operator=(WeightsFile&&) = default;
  /// "" for a fact that the file does not state.
  std::string fact(std::string_view key) const;
  bool holds(std::string_view tensor) const { return find(tensor) != nullptr; }
  /// Names of the file's own tensors, without those of its parts.
  std::vector<std::string> names() const;
  /// On the CPU, in the type that it is stored in. std::runtime_error if the file has no such tensor of
  /// `sizes`.
  torch::Tensor tensor(std::string_view name, torch::IntArrayRef sizes) const;

 private:
  const StoredTensor* find(std::string_view tensor) const;
  std::vector<std::string> bytes_;  ///< the file, then its parts
  std::vector<TensorFile> files_;   ///< of bytes_
};

/// The content of a weights file to be written.
class WeightsWriter {
 public:
  void state(std::string key, std::string text) { facts_[std::move(key)] = std::move(text); }
  /// float, half, double or std::int64_t.
  void add(std::string name, const torch::Tensor& tensor);
  /// Atomic.
  void write(const std::filesystem::path& file) const;

 private:
  Facts facts_;
  std::map<std::string, torch::Tensor, std::less<>> tensors_;
};

/// Writes an optimiser's state to a training's checkpoint, without the values that a training sets at each
/// step. It is read into the memory formats of a fresh one, so that sums continue bit for bit.
void add_state(WeightsWriter& writer, torch::optim::AdamW& optimiser);
/// std::runtime_error if the file holds the state for another network.
void read_state(const WeightsFile& file, torch::optim::AdamW& optimiser);

}  // namespace mirage
