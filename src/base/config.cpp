#include "base/config.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <cmath>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/toml_text.h"
#include "base/words.h"

namespace mirage {
namespace {

nlohmann::json to_json(const toml::node& node) {
  if (const auto* table = node.as_table()) {
    nlohmann::json object = nlohmann::json::object();
    for (const auto& [key, value] : *table) object[std::string(key.str())] = to_json(value);
    return object;
  }
  if (const auto* array = node.as_array()) {
    nlohmann::json list = nlohmann::json::array();
    for (const auto& value : *array) list.push_back(to_json(value));
    return list;
  }
  if (const auto* text = node.as_string()) return text->get();
  if (const auto* whole = node.as_integer()) return whole->get();
  if (const auto* real = node.as_floating_point()) return real->get();
  if (const auto* truth = node.as_boolean()) return truth->get();
  return nullptr;
}

}  // namespace

nlohmann::json read_toml(const std::filesystem::path& path) {
  return parse_toml(read_text(path, kLargestToml), path.string());
}

nlohmann::json parse_toml(const std::string& text, const std::string& name) {
  try {
    return to_json(toml::parse(toml_in_ascii(text, name), name));
  } catch (const toml::parse_error& error) {
    refuse_toml(name, error.source().begin.line, std::string(error.description()));
  }
}

void ConfigTable::fail(const std::string& key, const std::string& problem, const std::string& fix) const {
  throw InputError(file_, prefix_ + key, problem, fix);
}

const nlohmann::json& ConfigTable::get(const std::string& key) {
  seen_.insert(key);
  const auto value = values_.find(key);
  if (value == values_.end()) fail(key, "missing key", "add it (the shipped files show how)");
  return *value;
}

double ConfigTable::checked(const nlohmann::json& value, const std::string& key, double low,
                            double high) const {
  const std::string fix = "use " + Range{low, high}.words();
  if (!value.is_number()) fail(key, "not a number", fix);
  const double number = value.get<double>();
  if (!(number >= low && number <= high)) fail(key, fmt::format("{} is out of range", number), fix);
  return number;
}

double ConfigTable::number(const std::string& key, double low, double high) {
  return checked(get(key), key, low, high);
}

std::string ConfigTable::text(const std::string& key) {
  const auto& value = get(key);
  if (!value.is_string()) fail(key, "not a text", "write it in quotes");
  return value.get<std::string>();
}

std::vector<double> ConfigTable::numbers(const std::string& key, std::size_t count, double low, double high) {
  const auto& value = get(key);
  if (!value.is_array() || (count != 0 && value.size() != count))
    fail(key, fmt::format("not a list of {}numbers", count ? std::to_string(count) + " " : ""),
         "write it as [a, b, …]");
  std::vector<double> result;
  for (std::size_t i = 0; i < value.size(); ++i)
    result.push_back(checked(value[i], fmt::format("{}[{}]", key, i), low, high));
  return result;
}

std::vector<std::vector<double>> ConfigTable::rows(const std::string& key, std::size_t width, double low,
                                                   double high) {
  const auto& value = get(key);
  if (!value.is_array() || value.empty()) fail(key, "not a list of rows", "write it as [[…], […], …]");
  std::vector<std::vector<double>> result;
  for (std::size_t r = 0; r < value.size(); ++r) {
    const std::string name = fmt::format("{}[{}]", key, r);
    if (!value[r].is_array() || value[r].size() != width)
      fail(name, fmt::format("not a row of {} numbers", width), "complete the row");
    auto& row = result.emplace_back();
    for (std::size_t i = 0; i < width; ++i)
      row.push_back(checked(value[r][i], fmt::format("{}[{}]", name, i), low, high));
  }
  return result;
}

ConfigTable ConfigTable::table(const std::string& key) {
  const auto& value = get(key);
  if (!value.is_object()) fail(key, "not a table", "write it as [" + prefix_ + key + "]");
  return {file_, prefix_ + key + ".", value};
}

void ConfigTable::check_all_known() const {
  for (const auto& [key, value] : values_.items())
    if (!seen_.contains(key))
      fail(key, "unknown key", use_one_of(key, {seen_.begin(), seen_.end()}) + ", or remove it");
}

}  // namespace mirage
