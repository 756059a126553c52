// LibTorch archives that are data. LibTorch stores tensors as it stores TorchScript modules, and loading one
// compiles the classes in it and calls their __setstate__: a weights file from a stranger would be a program.
// So the classes are read first; what declares more than fields is not loaded.
#pragma once

#include <torch/serialize/input-archive.h>

#include <string>

namespace mirage {

/// The archive, read whole before anything in it is believed. Throws std::runtime_error, in words for the
/// user, where the file is no such archive or holds code.
torch::serialize::InputArchive open_data_archive(const std::string& file, const torch::Device& device);

}  // namespace mirage
