// Weights are data, but LibTorch's reader of them believes every size that they state and pops stacks that
// they never filled. So their pickles are walked over first; without LibTorch, so that a fuzzer can do that
// quickly.
#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

namespace mirage {

/// Size in bytes of the record of a storage; none where there is no such record.
using StorageSize = std::function<std::optional<std::size_t>(const std::string& key)>;
/// Walks over a pickle (protocol 2) as LibTorch's reader would. std::runtime_error for an instruction that
/// OutputArchive does not write, a stack that runs empty, a name that is neither a module of the file nor
/// what tensors are made with, a tensor that reaches beyond its storage, or a storage that is named twice
/// (OutputArchive recalls it; LibTorch would read it as often as it is named).
void check_pickle(std::string_view bytes, const StorageSize& storage_size);

}  // namespace mirage
