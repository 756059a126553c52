// A bound on how deep a JSON text nests, looked at before any reader: readers recurse, and a text of 20 000
// "[" would overflow the stack.
#pragma once

#include <string>
#include <string_view>

namespace mirage {

/// Levels of arrays and objects within each other. Ours have 8, exported scenes of other programs below 30.
inline constexpr int kDeepestJson = 128;

/// InputError with `where` as the file and `field` ("" for the whole file) if the text nests deeper. Says
/// nothing about whether it is JSON.
void check_json_depth(std::string_view text, const std::string& where, const std::string& field = "");

}  // namespace mirage
