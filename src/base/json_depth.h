// Bounds on a JSON text, looked at before any reader: readers recurse, and a text of 20 000 "[" would
// overflow the stack; and each of its values takes up to eighty bytes, so that one of "[],[],[]" takes thirty
// times its own.
#pragma once

#include <cstddef>
#include <limits>
#include <string>
#include <string_view>

namespace mirage {

/// Levels of arrays and objects within each other. Ours have 8, exported scenes of other programs below 30.
inline constexpr int kDeepestJson = 128;

/// InputError with `where` as the file and `field` ("" for the whole file) if the text nests deeper. Says
/// nothing about whether it is JSON.
void check_json_depth(std::string_view text, const std::string& where, const std::string& field = "");
/// InputError if the text holds more than `most` values (keys, lists and objects count, too), or more lists
/// and objects than `most_lists`.
void check_json_values(std::string_view text, const std::string& where, std::size_t most,
                       std::size_t most_lists = std::numeric_limits<std::size_t>::max());

}  // namespace mirage
