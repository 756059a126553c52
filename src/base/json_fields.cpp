#include "base/json_fields.h"

#include <fmt/format.h>

#include <climits>
#include <iterator>

#include "base/error.h"
#include "base/files.h"
#include "base/names.h"

namespace mirage {
namespace {

/// Why the value is not a number in the range; empty if it is.
std::string range_problem(const nlohmann::json& value, double low, double high) {
  if (!value.is_number()) return "not a number";
  const double number = value.get<double>();
  const Range range{low, high};
  return range.contains(number) ? "" : fmt::format("{} is out of range, {}", number, range.words());
}

namespace fs = std::filesystem;
using nlohmann::json;

/// The file's characters, and how many of them a row has.
class Characters {
 public:
  Characters(const fs::path& file, const std::string& fix, std::size_t longest)
      : name_(file.string()), fix_(fix), longest_(longest), from_(file) {}

  bool at_end() const { return from_.at_end(); }
  char current() const { return from_.current(); }
  void next() {
    from_.next();
    if (from_.place() - row_start_ > longest_)
      fail(fmt::format("byte {}", row_start_), fmt::format("a row of more than {} bytes", longest_));
  }
  /// A row ends here.
  void end_row() { row_start_ = from_.place(); }
  [[noreturn]] void fail(const std::string& field, const std::string& problem) const {
    throw InputError(name_, field, problem, fix_);
  }
  std::string byte() const { return fmt::format("byte {}", from_.place()); }

 private:
  std::string name_;
  const std::string& fix_;
  std::size_t longest_;
  std::uintmax_t row_start_ = 0;
  FileCharacters from_;
};

/// The iterator that nlohmann's parser reads from; all copies share one position.
class Reader {
 public:
  using difference_type = std::ptrdiff_t;
  using value_type = char;
  using pointer = const char*;
  using reference = char;
  using iterator_category = std::input_iterator_tag;

  Reader() = default;
  explicit Reader(Characters* from) : from_(from) {}
  char operator*() const { return from_->current(); }
  Reader& operator++() {
    from_->next();
    return *this;
  }
  bool operator!=(const Reader& /*end*/) const { return !from_->at_end(); }
  bool operator==(const Reader& end) const { return !(*this != end); }

 private:
  Characters* from_ = nullptr;
};

}  // namespace

JsonFields::JsonFields(std::filesystem::path file, const nlohmann::json& json, std::string fix,
                       std::string prefix)
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
  return {file_, json, fix_, prefix_ + name + "."};
}

json read_json_parts(const fs::path& file, const std::string& fix, const json::parser_callback_t& keep,
                     std::size_t longest) {
  using Event = json::parse_event_t;
  Characters characters(file, fix, longest);
  const auto see = [&](int depth, Event event, json& value) {
    if (depth > kMaxJsonDepth)
      characters.fail(characters.byte(), fmt::format("nested deeper than {} levels", kMaxJsonDepth));
    const bool kept = keep(depth, event, value);
    if (!kept && event != Event::key) characters.end_row();
    return kept;
  };
  try {
    return json::parse(Reader(&characters), Reader(), see);
  } catch (const json::parse_error& error) {
    characters.fail(fmt::format("byte {}", error.byte), "not valid JSON");
  } catch (const json::out_of_range&) {
    characters.fail("", "holds a number that is out of range");
  }
}

void for_each_json_row(const fs::path& file, const std::string& list, const std::string& fix,
                       const std::function<void(std::size_t, const json&)>& visit, std::size_t longest) {
  using Event = json::parse_event_t;
  const auto fail = [&](const char* problem) { throw InputError(file.string(), list, problem, fix); };
  const int row_depth = list.empty() ? 1 : 2;  // lists and objects that a row is within
  bool found = list.empty(), within = found;
  std::string key;  // the file's object's, that is being read
  std::size_t count = 0;
  const char* no_list = list.empty() ? "is not a list of rows" : "is not a list";
  const auto see = [&](int depth, Event event, json& value) {
    const bool starts = event == Event::array_start || event == Event::object_start;
    if (depth == 0 && starts && (event == Event::array_start) != list.empty()) fail(no_list);
    if (depth == 0 && event == Event::value) fail(no_list);
    if (!list.empty() && depth == 1) {
      if (event == Event::key) key = value.get<std::string>();
      const bool is_list = key == list;
      if (is_list && (event == Event::object_start || event == Event::value)) fail(no_list);
      if (is_list && event == Event::array_start && found) fail("is there twice");
      if (event == Event::array_start && is_list) found = within = true;
      if (event == Event::array_end) within = false;
    }
    const bool whole = event == Event::value || event == Event::array_end || event == Event::object_end;
    if (!whole || !within || depth != row_depth) return true;
    visit(count++, value);
    return false;
  };
  [[maybe_unused]] const json beside = read_json_parts(file, fix, see, longest);
  if (!found) fail("is missing");
}

std::string written_path(const fs::path& path, const char* word) {
  return path.empty() || path == word ? path.string()
                                      : escape_name(fs::absolute(path).lexically_normal().string());
}

std::string written_text(const std::string& text) {
  return escape_name(text);
}

void complete(nlohmann::json& written, const nlohmann::json& lacking) {
  for (const auto& [name, value] : lacking.items())
    if (!written.contains(name))
      written[name] = value;
    else if (value.is_object() && written[name].is_object())
      complete(written[name], value);
    else if (value.is_array() && written[name].is_array())
      for (std::size_t i = written[name].size(); i < value.size(); ++i) written[name].push_back(value[i]);
}

std::string read_text(const JsonFields& json, const char* name) {
  std::string text = unescape_name(json.text(name));
  for (const auto& part : fs::path(text))
    if (part.native().size() > NAME_MAX || text.size() >= PATH_MAX) json.fail(name, "is too long for a path");
  return text;
}

}  // namespace mirage
