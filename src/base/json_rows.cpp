#include "base/json_rows.h"

#include <fmt/format.h>

#include <iterator>

#include "base/error.h"
#include "base/file_characters.h"
#include "base/json_depth.h"

namespace mirage {
namespace {

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

/// What nlohmann's parser reads from; all copies of one are at the same place.
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

json read_json_parts(const fs::path& file, const std::string& fix, const json::parser_callback_t& keep,
                     std::size_t longest) {
  using Event = json::parse_event_t;
  Characters characters(file, fix, longest);
  const auto see = [&](int depth, Event event, json& value) {
    if (depth > kDeepestJson)
      characters.fail(characters.byte(), fmt::format("nested deeper than {} levels", kDeepestJson));
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
  bool within = false, found = false;
  std::string key;  // the file's object's, that is being read
  std::size_t count = 0;
  const char* no_list = list.empty() ? "is no list of rows" : "is no list";
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
    } else if (list.empty() && depth == 0) {
      if (event == Event::array_start) found = within = true;
      if (event == Event::array_end) within = false;
    }
    const bool whole = event == Event::value || event == Event::array_end || event == Event::object_end;
    if (!whole || !within || depth != row_depth) return true;
    visit(count++, value);
    return false;
  };
  [[maybe_unused]] const json beside = read_json_parts(file, fix, see, longest);
  if (!found) fail(list.empty() ? no_list : "is missing");
}

}  // namespace mirage
