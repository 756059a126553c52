// Weights files: which network they hold, and how they are read and written.
#pragma once

#include <string>

#include "network.h"
#include "torch_headers.h"

namespace mirage::fusion {

/// CUDA where LibTorch has it, else the CPU.
torch::Device best_device();

/// "lidar", "camera", "painted", "fusion", "late" or "refined".
std::string name_of(const Parts& parts);
/// Of a fresh network of that name; std::runtime_error if there is none.
Parts parts_named(const std::string& name);

/// std::runtime_error, one line, if it is not a readable file of this program.
torch::serialize::InputArchive open_weights(const std::string& file);
bool is_weights_file(const std::string& file);
/// Which network an open file holds.
Parts parts_of(torch::serialize::InputArchive& archive);
/// The file's network into those parts of `network` that it has. New channels of a layer's input stay as
/// they are. std::runtime_error if shapes differ or a weight is not finite.
void copy_network(const std::string& file, NetworkImpl& network);

/// An archive that says which network is going to be in it.
torch::serialize::OutputArchive begin_weights(const Parts& parts);
void write_weights(torch::serialize::OutputArchive& archive, const std::string& file);

}  // namespace mirage::fusion
