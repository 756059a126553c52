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

/// A weights file and its parts, read whole and checked before anything in them is believed.
class WeightsFile {
 public:
  /// InputError as read_file's; else std::runtime_error, in words for the user: what parse_tensor_file
  /// refuses, and a part that is missing or of another SHA-256.
  explicit WeightsFile(const std::filesystem::path& file);
  WeightsFile(WeightsFile&&) = default;
  WeightsFile& operator=(WeightsFile&&) = default;
  /// "" for a fact that the file does not state.
  std::string fact(std::string_view key) const;
  bool holds(std::string_view tensor) const { return find(tensor) != nullptr; }
  /// Of the file's own tensors, without those of its parts.
  std::vector<std::string> names() const;
  /// On the CPU, in the type that it is stored in. std::runtime_error if the file has no such tensor of
  /// `sizes`.
  torch::Tensor tensor(std::string_view name, torch::IntArrayRef sizes) const;

 private:
  const StoredTensor* find(std::string_view tensor) const;
  std::vector<std::string> bytes_;  ///< the file, then its parts
  std::vector<TensorFile> files_;   ///< of bytes_
};

/// What a weights file is going to hold.
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

/// The state of an optimiser in a training's checkpoint, without what a training sets at each step. It is
/// read into the memory formats that a fresh one has: sums go on to the same bits.
void add_state(WeightsWriter& writer, torch::optim::AdamW& optimiser);
/// std::runtime_error if the file holds the state of another network's.
void read_state(const WeightsFile& file, torch::optim::AdamW& optimiser);

}  // namespace mirage
