// Weights files: which network they hold, and how they are read and written.
#pragma once

#include <torch/torch.h>

#include <string>
#include <string_view>

#include "network.h"
#include "weights_file.h"

namespace mirage::fusion {

/// "lidar", "camera", "painted", "fusion", "late" or "refined".
std::string name_of(const Parts& parts);
/// Of a fresh network of that name; std::runtime_error if there is none.
Parts parts_named(const std::string& name);

/// std::runtime_error, one line, if it is not a readable file of this program.
WeightsFile open_weights(const std::string& file);
bool is_weights_file(const std::string& file);
/// Which network a file holds.
Parts parts_of(const WeightsFile& file);
/// Whether a fact that is a list of words has this one.
bool has_word(const WeightsFile& file, std::string_view key, std::string_view word);
/// The file's network into those parts of `network` that it has. New channels of a layer's input stay as
/// they are. std::runtime_error if shapes differ.
void copy_network(const std::string& file, NetworkImpl& network);

/// A file with this network.
WeightsWriter begin_weights(const NetworkImpl& network);

}  // namespace mirage::fusion
