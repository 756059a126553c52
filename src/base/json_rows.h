// Large JSON files, a row at a time: what a file of any size takes of memory is what its longest row takes.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

namespace mirage {

/// Bytes of the longest row, and of whatever else stands between two rows; the values of a row take up to
/// thirty times its bytes.
inline constexpr std::size_t kLongestRow = std::size_t{1} << 20;

/// The file's JSON without what `keep` refuses, of which one value is in memory at a time; the rest of the
/// file, and each of those values, is of `longest` bytes at most. InputError naming file and byte when it is
/// not JSON, nests too deep (json_depth.h) or has longer parts, ended by `fix`; and as OpenFile. Interrupted
/// if a signal comes. Exceptions of `keep` pass.
nlohmann::json read_json_parts(const std::filesystem::path& file, const std::string& fix,
                               const nlohmann::json::parser_callback_t& keep,
                               std::size_t longest = kLongestRow);

/// visit(i, row) for each element of the file's list, in its order: of the file itself (`list` is ""), or of
/// the field of that name of the file's object. What stands beside the list is checked to be JSON and
/// forgotten. InputError as read_json_parts (the rows before have been visited by then), and when there is no
/// such list. Exceptions of `visit` pass.
void for_each_json_row(const std::filesystem::path& file, const std::string& list, const std::string& fix,
                       const std::function<void(std::size_t, const nlohmann::json&)>& visit,
                       std::size_t longest = kLongestRow);

}  // namespace mirage
