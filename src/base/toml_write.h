// JSON as TOML. Not by toml++'s writer: in 3.3 (Debian 12) it sets no quotes around keys with a tab, a line
// end or a quote, reads strings of several lines within an inline table as other text, and takes the
// logarithm of small numbers in a list for a count of letters, which is undefined below 0.1.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace mirage {

/// An object of tables, lists, texts (UTF-8), numbers and booleans as TOML; read_toml (base/config.h) gives
/// it back, bit by bit.
std::string toml_text(const nlohmann::json& object);

}  // namespace mirage
