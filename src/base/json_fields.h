// Fields of a JSON file that a program wrote and anybody may have edited: each is checked for presence, type
// and range before it is used.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

namespace mirage {

/// An object of the file. Every getter throws InputError, naming file and field, when the field is missing,
/// of another type, not finite or out of [low, high]. What it is given outlives it.
class JsonFields {
 public:
  /// InputError if `json` is not an object. `fix` ends each error.
  JsonFields(std::filesystem::path file, const nlohmann::json& json, std::string fix);

  /// Whether the field is there.
  bool has(const std::string& key) const { return json_.contains(key); }
  /// Whether the field is there and null.
  bool is_null(const std::string& key) const { return has(key) && json_.at(key).is_null(); }
  /// true or false.
  bool truth(const std::string& key) const;
  /// A whole number in [low, high].
  std::int64_t integer(const std::string& key, std::int64_t low, std::int64_t high) const;
  /// A whole number of things, up to `most`.
  int count(const std::string& key, int most = std::numeric_limits<int>::max()) const {
    return static_cast<int>(integer(key, 0, most));
  }
  /// Whole and not negative; the seeds' range.
  std::uint64_t counter(const std::string& key) const;
  /// A finite number in [low, high].
  double number(const std::string& key, double low, double high) const;
  /// A string.
  std::string text(const std::string& key) const;
  /// `count` numbers, or so few as `least`.
  std::vector<double> numbers(const std::string& key, std::size_t count, double low, double high,
                              std::optional<std::size_t> least = {}) const;
  /// A list of any length up to `most`.
  const nlohmann::json& list(const std::string& key, std::size_t most) const;
  /// The names of the fields that are there.
  std::vector<std::string> names() const;
  /// An object within.
  JsonFields object(const std::string& key) const;
  /// An object of this file that `name` leads to, e.g. a list's entry "train[3]".
  JsonFields inner(const std::string& name, const nlohmann::json& json) const;

  /// Throws the InputError that says `problem` of the field.
  [[noreturn]] void fail(const std::string& key, const std::string& problem) const;

 private:
  JsonFields(std::filesystem::path file, std::string prefix, const nlohmann::json& json, std::string fix);
  const nlohmann::json& get(const std::string& key) const;

  std::filesystem::path file_;
  std::string prefix_, fix_;
  const nlohmann::json& json_;
};

}  // namespace mirage
