// Prepares TOML text for toml++ and passes its errors on.
#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace mirage {

/// Returns an ASCII text with the same meaning. Non-ASCII letters become escapes in strings (literal strings
/// become basic ones) and '?' in comments; lines keep their numbers. toml++ 3.3 (fixed after 3.4) reaches
/// __builtin_unreachable at such letters (is_non_ascii_horizontal_whitespace, 3019 of them): where TOML
/// refuses them, but also at the head of a line after a line-ending backslash, where TOML allows them.
/// InputError, naming `name` and the line, for bytes that are not UTF-8 and for these letters elsewhere.
std::string toml_in_ascii(std::string_view text, const std::string& name);

// JSON as TOML. Not by toml++'s writer: in 3.3 (Debian 12) it sets no quotes around keys with a tab, a line
// end or a quote, reads strings of several lines within an inline table as other text, and uses the logarithm
// of small numbers in a list as a count of letters, which is undefined below 0.1.

/// An object of tables, lists, texts (UTF-8), numbers and booleans as TOML; read_toml (base/config.h)
/// restores it bit for bit.
std::string toml_text(const nlohmann::json& object);

// TOML files read strictly: every key must be known and present, and errors name file and key.

/// Bytes of the largest TOML file: forty times the longest shipped one. Its parsed keys take fifty times
/// that.
inline constexpr std::uintmax_t kMaxTomlBytes = 1 << 18;
/// The file as JSON. InputError naming file and line when it is not TOML, or larger than kMaxTomlBytes. Dates
/// are read as null.
nlohmann::json read_toml(const std::filesystem::path& path);
/// The same from a text; `name` stands for the file in errors.
nlohmann::json parse_toml(const std::string& text, const std::string& name);

/// A table of a TOML file. Each getter throws InputError, naming file and key, when the key is missing, of
/// another type or out of [low, high].
class ConfigTable {
 public:
  /// The whole file as a table. Errors as read_toml's.
  static ConfigTable read(const std::filesystem::path& path) { return {path.string(), "", read_toml(path)}; }

  /// A table that other code has built: `file` and "KEY." stand for it in errors.
  static ConfigTable of(const std::filesystem::path& file, const std::string& key, nlohmann::json values) {
    return {file.string(), key + ".", std::move(values)};
  }

  /// Whether an optional key is there.
  bool has(const std::string& key) {
    seen_.insert(key);
    return values_.contains(key);
  }
  /// A number in [low, high].
  double number(const std::string& key, double low, double high);
  /// A text, which may be empty.
  std::string text(const std::string& key);
  /// `count` numbers.
  std::vector<double> numbers(const std::string& key, std::size_t count, double low, double high);
  /// Rows of `width` numbers.
  std::vector<std::vector<double>> rows(const std::string& key, std::size_t width, double low, double high);
  /// A table inside this one; its keys are checked by its own check_all_known().
  ConfigTable table(const std::string& key);
  /// Marks a table or value as known because other code reads it.
  void skip(const std::string& key) { seen_.insert(key); }
  /// InputError naming the first key that no getter asked for.
  void check_all_known() const;

 private:
  ConfigTable(std::string file, std::string prefix, nlohmann::json values)
      : file_(std::move(file)), prefix_(std::move(prefix)), values_(std::move(values)) {}
  const nlohmann::json& get(const std::string& key);
  double checked(const nlohmann::json& value, const std::string& key, double low, double high) const;
  [[noreturn]] void fail(const std::string& key, const std::string& problem, const std::string& fix) const;

  std::string file_, prefix_;
  nlohmann::json values_;
  std::set<std::string> seen_;
};

}  // namespace mirage
