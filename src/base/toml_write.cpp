#include "base/toml_write.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace mirage {
namespace {

using nlohmann::json;

constexpr std::size_t kLineWidth = 110;

/// A basic string: JSON's escapes are TOML's, but that JSON lets DEL stand.
std::string quoted(const std::string& text) {
  std::string all;
  for (const char c : json(text).dump(-1, ' ', false, json::error_handler_t::replace))
    all += c == '\x7f' ? std::string("\\u007F") : std::string(1, c);
  return all;
}

std::string key_text(const std::string& key) {
  const bool bare = !key.empty() && std::all_of(key.begin(), key.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
  });
  return bare ? key : quoted(key);
}

std::string number_text(double value) {
  if (std::isnan(value)) return "nan";
  if (std::isinf(value)) return value > 0 ? "inf" : "-inf";
  return json(value).dump();  // the shortest that reads as the same
}

/// In one line: a table as an inline one.
std::string value_text(const json& value) {
  if (value.is_string()) return quoted(value.get_ref<const std::string&>());
  if (value.is_number_float()) return number_text(value.get<double>());
  if (!value.is_structured()) return value.dump();
  std::vector<std::string> parts;
  for (const auto& [key, entry] : value.items())
    parts.push_back(value.is_object() ? key_text(key) + " = " + value_text(entry) : value_text(entry));
  const std::string all = fmt::format("{}", fmt::join(parts, ", "));
  return value.is_array() ? fmt::format("[{}]", all) : parts.empty() ? "{}" : fmt::format("{{ {} }}", all);
}

/// A list in as many lines as it needs.
std::string list_text(const json& list) {
  const std::string whole = value_text(list);
  if (whole.size() <= kLineWidth) return whole;
  std::string all = "[", line;
  for (const json& entry : list) {
    const std::string next = value_text(entry) + ",";
    if (!line.empty() && line.size() + 1 + next.size() > kLineWidth) {
      all += "\n    " + line;
      line.clear();
    }
    line += (line.empty() ? "" : " ") + next;
  }
  return all + "\n    " + line + "\n]";
}

bool holds_tables(const json& value) {
  return value.is_array() && !value.empty() &&
         std::all_of(value.begin(), value.end(), [](const json& entry) { return entry.is_object(); });
}

/// The table's own values, then the tables within it under their full names.
void write_table(const json& table, const std::string& path, std::string& out) {
  for (const auto& [key, value] : table.items())
    if (!value.is_object() && !holds_tables(value))
      out += key_text(key) + " = " + (value.is_array() ? list_text(value) : value_text(value)) + "\n";
  for (const auto& [key, value] : table.items()) {
    const std::string name = path + key_text(key);
    if (value.is_object()) {
      out += "\n[" + name + "]\n";
      write_table(value, name + ".", out);
    } else if (holds_tables(value)) {
      for (const json& entry : value) {
        out += "\n[[" + name + "]]\n";
        write_table(entry, name + ".", out);
      }
    }
  }
}

}  // namespace

std::string toml_text(const json& object) {
  std::string out;
  write_table(object, "", out);
  return out;
}

}  // namespace mirage
