// JSON files that a command keeps for its next run, under a key of what they are made of.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <type_traits>

#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"

namespace mirage {

/// How a damaged one is mended.
inline constexpr const char* kKeptAgain = "delete the file";

/// What read(fields) makes of the file, an std::optional; none where it is missing or has another `key`, and
/// where it is damaged, which is told.
template <class Read>
std::invoke_result_t<Read, const JsonFields&> read_kept(const std::filesystem::path& file,
                                                        const std::string& key, const Read& read) {
  if (file.empty() || !std::filesystem::exists(file)) return std::nullopt;
  try {
    const nlohmann::json stored = read_json(file);
    const JsonFields fields(file, stored, kKeptAgain);
    if (fields.text("key") != key) return std::nullopt;
    return read(fields);
  } catch (const InputError& damaged) {
    spdlog::warn("{}", damaged.what());
    return std::nullopt;
  }
}

}  // namespace mirage
