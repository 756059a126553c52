#include "base/json_rows.h"

#include <fmt/format.h>

#include <iterator>

#include "base/error.h"
#include "base/interrupt.h"
#include "base/json_depth.h"
#include "base/open_file.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// The file's characters in order, a part in memory at a time.
class Characters {
 public:
  Characters(const fs::path& file, const std::string& fix, std::size_t longest)
      : name_(file.string()), fix_(fix), longest_(longest), file_(file) {
    fill();
  }

  bool at_end() const { return size_ == 0; }
  char current() const { return part_[at_]; }
  void next() {
    ++place_;
    if (place_ - row_start_ > longest_)
      fail(fmt::format("byte {}", row_start_), fmt::format("a row of more than {} bytes", longest_));
    if (++at_ == size_) fill();
  }
  /// A row ends here.
  void end_row() { row_start_ = place_; }
  [[noreturn]] void fail(const std::string& field, const std::string& problem) const {
    throw InputError(name_, field, problem, fix_);
  }
  std::string byte() const { return fmt::format("byte {}", place_); }

 private:
  void fill() {
    throw_if_interrupted("what was finished is kept");
    at_ = 0;
    size_ = file_.read(part_, sizeof part_);
  }

  std::string name_;
  const std::string& fix_;
  std::size_t longest_, at_ = 0, size_ = 0;
  std::uintmax_t place_ = 0, row_start_ = 0;
  OpenFile file_;
  char part_[1 << 14];
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

void for_each_json_row(const fs::path& file, const std::string& list, const std::string& fix,
                       const std::function<void(std::size_t, const json&)>& visit, std::size_t longest) {
  using Event = json::parse_event_t;
  Characters characters(file, fix, longest);
  const int row_depth = list.empty() ? 1 : 2;  // lists and objects that a row is within
  bool within = false, found = false;
  std::string key;  // the file's object's, that is being read
  std::size_t count = 0;
  const auto no_list = [&] { characters.fail(list, list.empty() ? "is no list of rows" : "is no list"); };
  const auto see = [&](int depth, Event event, json& value) {
    if (depth > kDeepestJson)
      characters.fail(characters.byte(), fmt::format("nested deeper than {} levels", kDeepestJson));
    const bool starts = event == Event::array_start || event == Event::object_start;
    if (depth == 0 && starts && (event == Event::array_start) != list.empty()) no_list();
    if (depth == 0 && event == Event::value) no_list();
    if (!list.empty() && depth == 1) {
      if (event == Event::key) key = value.get<std::string>();
      const bool is_list = key == list;
      if (is_list && (event == Event::object_start || event == Event::value)) no_list();
      if (is_list && event == Event::array_start && found) characters.fail(list, "is there twice");
      if (event == Event::array_start && is_list) found = within = true;
      if (event == Event::array_end) within = false;
    } else if (list.empty() && depth == 0) {
      if (event == Event::array_start) found = within = true;
      if (event == Event::array_end) within = false;
    }
    const bool whole = event == Event::value || event == Event::array_end || event == Event::object_end;
    if (!whole || !within || depth != row_depth) return true;
    visit(count++, value);
    characters.end_row();
    return false;
  };
  try {
    [[maybe_unused]] const json beside = json::parse(Reader(&characters), Reader(), see);
  } catch (const json::parse_error& error) {
    characters.fail(fmt::format("byte {}", error.byte), "not valid JSON");
  } catch (const json::out_of_range&) {
    characters.fail("", "holds a number that is out of range");
  }
  if (!found) characters.fail(list, list.empty() ? "is no list of rows" : "is missing");
}

}  // namespace mirage
