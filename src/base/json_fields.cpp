#include "base/json_fields.h"

#include <fmt/format.h>

#include "base/error.h"
#include "base/fields.h"

namespace mirage {
namespace {

/// The number, or why it is none within the range.
std::string range_problem(const nlohmann::json& value, double low, double high) {
  if (!value.is_number()) return "not a number";
  const double number = value.get<double>();
  const Range range{low, high};
  return range.contains(number) ? "" : fmt::format("{} is out of range, {}", number, range.words());
}

}  // namespace

JsonFields::JsonFields(std::filesystem::path file, const nlohmann::json& json, std::string fix)
    : JsonFields(std::move(file), "", json, std::move(fix)) {}

JsonFields::JsonFields(std::filesystem::path file, std::string prefix, const nlohmann::json& json,
                       std::string fix)
    : file_(std::move(file)), prefix_(std::move(prefix)), fix_(std::move(fix)), json_(json) {
  if (json.is_object()) return;
  std::string name = prefix_;
  if (!name.empty()) name.pop_back();  // the dot
  throw InputError(file_.string(), name, "not a JSON object", fix_);
}

void JsonFields::fail(const std::string& key, const std::string& problem) const {
  throw InputError(file_.string(), prefix_ + key, problem, fix_);
}

const nlohmann::json& JsonFields::get(const std::string& key) const {
  const auto value = json_.find(key);
  if (value == json_.end()) fail(key, "missing");
  return *value;
}

bool JsonFields::truth(const std::string& key) const {
  const auto& value = get(key);
  if (!value.is_boolean()) fail(key, "not true or false");
  return value.get<bool>();
}

std::int64_t JsonFields::integer(const std::string& key, std::int64_t low, std::int64_t high) const {
  const auto& value = get(key);
  if (!value.is_number_integer()) fail(key, "not a whole number");
  const bool huge = value.is_number_unsigned() && value.get<std::uint64_t>() > INT64_MAX;
  if (huge || value.get<std::int64_t>() < low || value.get<std::int64_t>() > high)
    fail(key, fmt::format("{} is out of range, {} to {}", value.dump(), low, high));
  return value.get<std::int64_t>();
}

std::uint64_t JsonFields::counter(const std::string& key) const {
  const auto& value = get(key);
  if (!value.is_number_unsigned()) fail(key, "not a whole number from 0");
  return value.get<std::uint64_t>();
}

double JsonFields::number(const std::string& key, double low, double high) const {
  const auto& value = get(key);
  if (const std::string problem = range_problem(value, low, high); !problem.empty()) fail(key, problem);
  return value.get<double>();
}

std::string JsonFields::text(const std::string& key) const {
  const auto& value = get(key);
  if (!value.is_string()) fail(key, "not a text");
  return value.get<std::string>();
}

std::vector<double> JsonFields::numbers(const std::string& key, std::size_t count, double low, double high,
                                        std::optional<std::size_t> least) const {
  const auto& value = get(key);
  if (!value.is_array() || value.size() > count || value.size() < least.value_or(count))
    fail(key, fmt::format("not a list of {} numbers", count));
  std::vector<double> numbers(value.size());
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    if (const std::string problem = range_problem(value[i], low, high); !problem.empty())
      fail(fmt::format("{}[{}]", key, i), problem);
    numbers[i] = value[i].get<double>();
  }
  return numbers;
}

const nlohmann::json& JsonFields::list(const std::string& key, std::size_t most) const {
  const auto& value = get(key);
  if (!value.is_array()) fail(key, "not a list");
  if (value.size() > most) fail(key, fmt::format("has {} entries, at most {} are read", value.size(), most));
  return value;
}

std::vector<std::string> JsonFields::names() const {
  std::vector<std::string> names;
  for (const auto& [name, value] : json_.items()) names.push_back(name);
  return names;
}

JsonFields JsonFields::object(const std::string& key) const {
  return inner(key, get(key));
}

JsonFields JsonFields::inner(const std::string& name, const nlohmann::json& json) const {
  return {file_, prefix_ + name + ".", json, fix_};
}

}  // namespace mirage
