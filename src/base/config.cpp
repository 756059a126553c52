#include "base/config.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/names.h"
#include "base/sizes.h"

namespace mirage {
namespace {

// Not toml11: Debian 12's 3.7.1 reads past the end of an unclosed literal string, overflows the stack where
// lists are nested some thousand deep, and takes an integer of more than 64 bits for the largest of 64.

bool is_ascii(std::string_view text) {
  return std::all_of(text.begin(), text.end(), [](unsigned char c) { return c < 0x80; });
}

/// Throws the InputError of a syntax error.
[[noreturn]] void refuse_toml(const std::string& name, std::size_t line, const std::string& problem) {
  throw InputError(name, fmt::format("line {}", line), problem, "mend the TOML syntax");
}

/// Walks over the text by TOML's rules for strings and comments alone; text that breaks any other rule stays
/// for the parser to refuse.
class AsciiWriter {
 public:
  AsciiWriter(std::string_view text, const std::string& name) : text_(text), name_(name) {}

  std::string write() {
    at_ = byte_order_mark(text_, name_);
    while (at_ < text_.size()) {
      const char c = text_[at_];
      if (c == '#')
        comment();
      else if (c == '"' || c == '\'')
        string(c);
      else if (is_beyond(c))
        refuse(fmt::format("U+{:04X} outside of strings and comments", character()));
      else
        copy(1);
    }
    return std::move(out_);
  }

 private:
  static bool is_beyond(char c) { return static_cast<unsigned char>(c) >= 0x80; }

  [[noreturn]] void refuse(const std::string& problem) const {
    const auto line = 1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(at_), '\n');
    refuse_toml(name_, as_size(line), problem);
  }

  void copy(std::size_t count) {
    out_ += text_.substr(at_, count);
    at_ += std::min(count, text_.size() - at_);
  }
  /// Reads the non-ASCII character here and moves past it.
  std::uint32_t character() {
    const auto [bytes, point] = first_character(text_.substr(at_));
    if (bytes == 0) refuse("holds bytes that are not UTF-8");
    at_ += bytes;
    return point;
  }
  void escape() {
    const std::uint32_t point = character();
    out_ += point < 0x10000 ? fmt::format("\\u{:04X}", point) : fmt::format("\\U{:08X}", point);
  }

  void comment() {
    while (at_ < text_.size() && text_[at_] != '\n') {
      if (is_beyond(text_[at_]))
        static_cast<void>(character()), out_ += '?';
      else
        copy(1);
    }
  }

  /// Number of quotes here, up to `most`.
  std::size_t quotes(char quote, std::size_t most) const {
    const std::string_view rest = text_.substr(at_, most);
    return std::min(rest.find_first_not_of(quote), rest.size());
  }

  /// Copies a string from its first quote to its last, or to where it breaks off. All strings become basic
  /// ones, because only basic strings have escapes.
  void string(char quote) {
    const std::size_t opening = quotes(quote, 3), fence = opening == 3 ? 3 : 1;
    put_quotes(fence);
    while (at_ < text_.size()) {
      const char c = text_[at_];
      // Before a fence of three there may be two quotes that belong to the string.
      if (c == quote) {
        const std::size_t count = fence == 1 ? 1 : quotes(quote, 5);
        if (count < fence) {
          copy(count);
          continue;
        }
        copy(count - fence);
        return put_quotes(fence);
      } else if (c == '\n' && fence == 1) {
        return;
      } else if (is_beyond(c)) {
        escape();
      } else if (quote == '"' && c == '\\') {
        if (at_ + 1 < text_.size() && is_beyond(text_[at_ + 1]))
          refuse("a backslash before a letter that needs none");
        copy(2);
      } else if (c == '"' || c == '\\') {  // of a literal string
        out_ += '\\';
        copy(1);
      } else {
        copy(1);
      }
    }
  }
  void put_quotes(std::size_t count) {
    out_.append(count, '"');
    at_ += count;
  }

  std::string_view text_;
  const std::string& name_;
  std::string out_;
  std::size_t at_ = 0;
};

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

std::string toml_in_ascii(std::string_view text, const std::string& name) {
  return is_ascii(text) ? std::string(text) : AsciiWriter(text, name).write();
}

std::string toml_text(const json& object) {
  std::string out;
  write_table(object, "", out);
  return out;
}

nlohmann::json read_toml(const std::filesystem::path& path) {
  return parse_toml(read_text(path, kMaxTomlBytes), path.string());
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
  if (!value.is_array() || value.size() != count)
    fail(key, fmt::format("not a list of {} numbers", count), "write it as [a, b, …]");
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
