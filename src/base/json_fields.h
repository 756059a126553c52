// Fields of a JSON file that a program wrote and anybody may have edited: each is checked for presence, type
// and range before it is used.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/fields.h"
#include "base/sizes.h"

namespace mirage {

/// An object of the file. Every getter throws InputError, naming file and field, when the field is missing,
/// of another type, not finite or out of [low, high]. Its arguments must outlive it.
class JsonFields {
 public:
  /// InputError if `json` is not an object. `fix` ends each error; `prefix` leads the fields' names in it.
  JsonFields(std::filesystem::path file, const nlohmann::json& json, std::string fix,
             std::string prefix = "");

  /// Whether the field is there.
  bool has(const std::string& key) const { return json_.contains(key); }
  /// Whether the field is there and null.
  bool is_null(const std::string& key) const { return has(key) && json_.at(key).is_null(); }
  /// A field that is true or false.
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
  /// `count` numbers, or as few as `least`.
  std::vector<double> numbers(const std::string& key, std::size_t count, double low, double high,
                              std::optional<std::size_t> least = {}) const;
  /// A list of any length up to `most`.
  const nlohmann::json& list(const std::string& key, std::size_t most) const;
  /// The names of the fields that are there.
  std::vector<std::string> names() const;
  /// The object in that field.
  JsonFields object(const std::string& key) const;
  /// An object of this file that `name` leads to, e.g. a list's entry "train[3]".
  JsonFields inner(const std::string& name, const nlohmann::json& json) const;

  /// Throws the InputError that says `problem` of the field.
  [[noreturn]] void fail(const std::string& key, const std::string& problem) const;

 private:
  const nlohmann::json& get(const std::string& key) const;

  std::filesystem::path file_;
  std::string prefix_, fix_;
  const nlohmann::json& json_;
};

// Large JSON files, read row by row: a file of any size takes only the memory of its longest row.

/// Bytes of the longest row, and of any text between rows; a row's values take up to thirty times its bytes.
inline constexpr std::size_t kMaxRowBytes = std::size_t{1} << 20;

/// The file's JSON without the values that `keep` refuses; only one of them is in memory at a time. Each of
/// them, and the rest of the file, has at most `longest` bytes. InputError naming file and byte when it is
/// not JSON, nests too deep (files.h) or has longer parts, ended by `fix`; and as OpenFile. Interrupted if a
/// signal comes. Exceptions of `keep` propagate.
nlohmann::json read_json_parts(const std::filesystem::path& file, const std::string& fix,
                               const nlohmann::json::parser_callback_t& keep,
                               std::size_t longest = kMaxRowBytes);

/// Calls visit(i, row) for each element, in order, of the file's list (`list` is "") or of the field `list`
/// of its object. Everything else is checked to be JSON and dropped. InputError as read_json_parts (the rows
/// before have been visited by then), and when there is no such list. Exceptions of `visit` propagate too.
void for_each_json_row(const std::filesystem::path& file, const std::string& list, const std::string& fix,
                       const std::function<void(std::size_t, const nlohmann::json&)>& visit,
                       std::size_t longest = kMaxRowBytes);

// Settings as JSON, by their list of fields (base/fields.h): out, in, and the part of them that decides a
// result.

/// A path as files hold it: absolute, escaped (base/names.h); `word` and an empty path stay unchanged.
std::string written_path(const std::filesystem::path& path, const char* word);
/// A text as files hold it: escaped, since it may be a file's name.
std::string written_text(const std::string& text);
/// The original text of a written_text. InputError if it is longer than a path can be.
std::string read_text(const JsonFields& json, const char* name);

/// The JSON of a value in a file: an enum's word, a struct's text or fields, a list's or a map's entries;
/// null for an infinite number and for an empty optional.
template <class T>
nlohmann::json value_json(const Field& field, const T& value, bool whole);

/// The visitor of fields_json.
class JsonWriter {
 public:
  /// `whole`: also fields outside of the run's identity.
  explicit JsonWriter(bool whole = false) : whole_(whole) {}
  template <class T>
  void operator()(const Field& field, const T& value) {
    if (whole_ || field.decides) json[field.name] = value_json(field, value, whole_);
  }
  template <class T>
  void group(const Field& field, const T& inner) {
    (*this)(field, inner);
  }
  /// Writes an optional struct's fields among its owner's; `sign` is a field that it always has.
  template <class T>
  void among(const char* /*sign*/, const std::optional<T>& value) {
    if (value) visit_fields(*this, *value);
  }
  /// A value derived from the fields, for the file's readers.
  template <class T>
  void derived(const char* name, const T& value) {
    json[name] = value;
  }
  /// Writes null if the list's owner is off.
  template <class T>
  void list(const Field& field, const T& inner) {
    if (!whole_ && !field.decides) return;
    auto& out = json[field.name] = nullptr;
    if constexpr (requires { inner.on; })
      if (!inner.on) return;
    out = nlohmann::json::array();
    for (const auto& [number, own] : numbers_of(inner)) out.push_back(*number);
  }
  nlohmann::json json = nlohmann::json::object();

 private:
  bool whole_;
};

template <class T>
concept HasFields = requires(JsonWriter& writer, const T& value) {
  visit_fields(writer, value);
};
/// Whether the type is a std::vector.
template <class T>
inline constexpr bool kIsList = false;
template <class T>
inline constexpr bool kIsList<std::vector<T>> = true;
/// Whether the type is a std::optional.
template <class T>
inline constexpr bool kIsOptional = false;
template <class T>
inline constexpr bool kIsOptional<std::optional<T>> = true;
/// Whether the type is a std::map from texts.
template <class T>
inline constexpr bool kIsMap = false;
template <class T>
inline constexpr bool kIsMap<std::map<std::string, T>> = true;

template <class T>
nlohmann::json value_json(const Field& field, const T& value, bool whole) {
  if constexpr (HasWords<T>) {
    return to_word(value);
  } else if constexpr (HasText<T>) {
    return text_of(value);
  } else if constexpr (NumberVector<T>) {
    return std::vector<double>(value.data(), value.data() + value.size());
  } else if constexpr (std::same_as<T, std::filesystem::path>) {
    return written_path(value, field.word);
  } else if constexpr (std::same_as<T, std::string>) {
    return field.plain ? value : written_text(value);
  } else if constexpr (kIsOptional<T>) {
    return value ? value_json(field, *value, whole) : nlohmann::json();
  } else if constexpr (kIsList<T>) {
    auto list = nlohmann::json::array();
    for (const auto& entry : value) list.push_back(value_json(field, entry, whole));
    return list;
  } else if constexpr (kIsMap<T>) {
    auto map = nlohmann::json::object();
    for (const auto& [name, entry] : value) map[name] = value_json(field, entry, whole);
    return map;
  } else if constexpr (HasFields<T>) {
    JsonWriter within(whole);
    visit_fields(within, value);
    return std::move(within.json);
  } else {
    if constexpr (std::floating_point<T>)
      if (std::isinf(value)) return nullptr;
    return value;
  }
}

/// The JSON list of write(entry).
template <class List, class Write>
nlohmann::json list_json(const List& list, const Write& write) {
  auto array = nlohmann::json::array();
  for (const auto& entry : list) array.push_back(write(entry));
  return array;
}
/// The JSON list of to_json(entry).
template <class List>
nlohmann::json list_json(const List& list) {
  return list_json(list, [](const auto& entry) { return to_json(entry); });
}

/// The fields that decide the result, by name.
template <class S>
nlohmann::json fields_json(const S& s) {
  JsonWriter writer;
  visit_fields(writer, s);
  return std::move(writer.json);
}

/// The value that null in a file stands for: an empty one, or one that is switched off.
template <class T>
T off() {
  T value;
  if constexpr (requires { value.on; }) value.on = false;
  return value;
}

/// Sets the value of Field::lacking.
template <class T>
void set_lacking(const Field& field, T& value) {
  if constexpr (std::same_as<T, bool>)
    value = std::string(field.lacking) == "true";
  else if constexpr (HasWords<T>)
    value = parse_word<T>(field.lacking, field.name);
  else if constexpr (HasText<T>)
    *field.lacking ? set_from_text(field.lacking, value) : void(value = off<T>());
  else if constexpr (Number<T>)
    value = static_cast<T>(parse_number(field.lacking, field.name));
  else if constexpr (std::same_as<T, std::string> || std::same_as<T, std::filesystem::path>)
    value = field.lacking;
  else
    value = off<T>();
}

/// The visitor of lacking_json.
class LackingFields {
 public:
  template <class T>
  void operator()(const Field& field, T& value) {
    if (!field.lacking) return;
    set_lacking(field, value);
    writer(field, value);
  }
  template <class T>
  void group(const Field& field, T& inner) {
    if (field.lacking) return writer.group(field, inner = off<T>());
    LackingFields within;
    visit_fields(within, inner);
    if (!within.writer.json.empty()) writer.json[field.name] = std::move(within.writer.json);
  }
  template <class T>
  void list(const Field& field, T& inner) {
    if (field.lacking) writer.list(field, inner = off<T>());
  }
  JsonWriter writer;
};

/// The values of the fields that an earlier program's fields_json() left out.
template <class S>
nlohmann::json lacking_json() {
  S s;
  LackingFields fields;
  visit_fields(fields, s);
  return std::move(fields.writer.json);
}
/// Adds the values of `lacking` to the JSON of an earlier program.
void complete(nlohmann::json& written, const nlohmann::json& lacking);

/// The identity of a run, which must match for the run to resume.
struct RunIdentity {
  /// `own`: fields_json() of the settings, with the other deciding inputs; `left_out`: their lacking_json().
  RunIdentity(nlohmann::json own, nlohmann::json left_out = nlohmann::json::object())
      : json(std::move(own)), lacking(std::move(left_out)) {}
  nlohmann::json json;
  nlohmann::json lacking;  ///< lacking_json() of its settings
};

/// How many numbers end a list in files of earlier programs, for S::read_former to read.
template <class S>
constexpr std::size_t former_numbers() {
  if constexpr (requires { S::kFormerNumbers; })
    return S::kFormerNumbers;
  else
    return 0;
}

/// Most entries of a list in a file.
inline constexpr std::size_t kMaxListed = 100'000'000;

/// The visitor of read_fields.
class JsonReader {
 public:
  /// Reads from the object `from`, which outlives this.
  explicit JsonReader(const JsonFields& from) : json(from) {}
  template <class T>
  void operator()(const Field& field, T& value) {
    if (!field.decides) return;
    if (lacks(field)) return set_lacking(field, value);
    const std::string name = field.name;
    const auto [low, high] = std::pair(field.range.low, field.range.high);
    if constexpr (std::same_as<T, bool>) {
      value = json.truth(name);
    } else if constexpr (std::same_as<T, std::uint64_t>) {
      value = json.counter(name);
      named(name, [&] { check_number(field, static_cast<double>(value)); });
    } else if constexpr (std::integral<T>) {
      using Limits = std::numeric_limits<T>;
      value = static_cast<T>(json.integer(
          name, static_cast<std::int64_t>(std::max({low, static_cast<double>(Limits::min()), -9e18})),
          static_cast<std::int64_t>(std::min({high, static_cast<double>(Limits::max()), 9e18}))));
    } else if constexpr (Number<T>) {
      value = field.endless && json.is_null(name) ? std::numeric_limits<T>::infinity()
                                                  : static_cast<T>(json.number(name, low, high));
    } else if constexpr (NumberVector<T>) {
      value = T(json.numbers(name, as_size(value.size()), low, high).data());
    } else if constexpr (kIsList<T>) {
      value.clear();
      for (const nlohmann::json& entry : json.list(name, kMaxListed)) {
        const JsonFields inner = json.inner(entry_of(name, value.size()), entry);
        JsonReader within(inner);
        visit_fields(within, value.emplace_back());
      }
    } else if constexpr (kIsMap<T>) {
      value.clear();
      const JsonFields inner = json.object(name);
      JsonReader within(inner);
      for (const std::string& key : inner.names()) {
        Field entry = field;
        entry.name = key.c_str();
        within(entry, value[key]);
      }
    } else if constexpr (HasFields<T>) {
      group(field, value);
    } else {
      const std::string text = field.plain ? json.text(name) : read_text(json, field.name);
      named(name, [&] {
        if constexpr (HasWords<T>)
          value = parse_word<T>(text, field.name);
        else if constexpr (HasText<T>)
          set_from_text(text, value);
        else
          value = text;
        if constexpr (std::same_as<T, std::string>)
          if (field.check) field.check(text);
      });
    }
  }
  /// Reads the struct if the object has `sign`; otherwise resets it.
  template <class T>
  void among(const char* sign, std::optional<T>& value) {
    value.reset();
    if (json.has(sign)) visit_fields(*this, value.emplace());
  }
  /// Reads nothing: a derived value is not a setting.
  template <class T>
  void derived(const char* /*name*/, const T& /*value*/) {}
  template <class T>
  void group(const Field& field, T& inner) {
    if (!field.decides) return;
    if (lacks(field)) return set_lacking(field, inner);
    const JsonFields object = json.object(field.name);
    JsonReader within(object);
    visit_fields(within, inner);
  }
  /// A list in the file switches its owner on; null switches it off.
  template <class T>
  void list(const Field& field, T& inner) {
    if (!field.decides) return;
    if (lacks(field)) return set_lacking(field, inner);
    if constexpr (requires { inner.on; })
      if (json.is_null(field.name)) {
        inner.on = false;
        return;
      }
    const auto numbers = numbers_of(inner);
    std::size_t least = numbers.size();  // an earlier program's list is shorter
    while (least > 0 && numbers[least - 1].second.lacking) --least;
    constexpr std::size_t kFormer = former_numbers<T>();
    std::size_t most = numbers.size();
    if constexpr (kFormer > 0)
      if (json.list(field.name, kMaxListed).size() > most) least = most += kFormer;
    auto read = json.numbers(field.name, most, -Range::kMax, Range::kMax, least);
    if constexpr (kFormer > 0)
      if (read.size() > numbers.size()) {
        named(field.name, [&] { inner.read_former(std::span(read).subspan(numbers.size())); });
        read.resize(numbers.size());
      }
    for (std::size_t i = read.size(); i < numbers.size(); ++i)
      set_lacking(numbers[i].second, *numbers[i].first);
    for (std::size_t i = 0; i < read.size(); ++i)
      named(entry_of(field.name, i), [&] { check_number(numbers[i].second, *numbers[i].first = read[i]); });
    if constexpr (requires { inner.on; }) inner.on = true;
  }

 private:
  bool lacks(const Field& field) const { return field.lacking && !json.has(field.name); }
  static std::string entry_of(const std::string& list, std::size_t place) {
    return list + "[" + std::to_string(place) + "]";
  }
  /// Runs `read` and turns its FieldError into an error of the file's field.
  template <class Read>
  void named(const std::string& name, const Read& read) const {
    try {
      read();
    } catch (const FieldError& error) {
      json.fail(name, error.value + ": " + error.problem + ", " + error.fix);
    }
  }
  const JsonFields& json;
};

/// Reads what fields_json() wrote. InputError naming file and field if one is missing or out of range.
template <class S>
void read_fields(const JsonFields& json, S& s) {
  JsonReader reader(json);
  visit_fields(reader, s);
}

}  // namespace mirage
