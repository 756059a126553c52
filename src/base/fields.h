// Settings, each declared once. A struct lists its fields beside its definition, nested ones included:
//
//     template <class Visitor, FieldsOf<Shape> S>
//     void visit_fields(Visitor& visit, S& s) {
//       visit({.name = "width", .help = "of the mesh, m", .range = {0.1, 10}}, s.width);
//       visit_fields(visit, s.limits);                    // its fields are among this struct's
//       visit.group({.name = "simulation"}, s.simulation);  // its fields are an object of their own
//       visit.list({.name = "expectation"}, s.expectation);  // its numbers are one list
//     }
//
// Visitors use this list for JSON output, JSON input and a run's identity (base/json_fields.h), for range
// checks (check_fields), for setting a field by name (set_field), and for command-line options
// (cli/field_options.h). Results list their fields for JSON alone. These may be lists, maps, structs and
// optional structs: visit.among("score", s.outcome).
//
// A field is a number, bool, text, path, vector, enum, or a struct that is written as one text. An enum has
// one table of words, found beside it: constexpr auto words_of(Target) { return std::to_array<const
// char*>({"both", "image"}); } in the enumerators' order. A struct that is written as one text has two
// functions: set_from_text(text, value), which throws FieldError, and text_of(value). A nested struct may
// have them too.
#pragma once

#include <concepts>
#include <cstddef>
#include <filesystem>
#include <limits>
#include <map>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "base/error.h"
#include "base/names.h"
#include "base/sizes.h"
#include "base/types.h"

namespace mirage {

/// A setting with an unusable value. The library names the field; the command line names its option.
class FieldError : public InputError {
 public:
  /// `name`: the field's; `value_text`: its value; `wrong`: the problem; `mend`: the fix.
  FieldError(std::string name, std::string value_text, std::string wrong, std::string mend)
      : InputError(name, value_text, wrong, mend),
        field(std::move(name)),
        value(std::move(value_text)),
        problem(std::move(wrong)),
        fix(std::move(mend)) {}
  std::string field, value, problem, fix;
};

/// A closed range; NaN lies in no range.
struct Range {
  static constexpr double kMax = std::numeric_limits<double>::max();  ///< largest finite number
  double low = -kMax, high = kMax;
  /// Whether the value lies in the range.
  bool contains(double value) const { return value >= low && value <= high; }
  /// "a number", "0 or more", "1 to 65536", …
  std::string words() const;
};
/// Above 0.
inline constexpr Range kPositive{std::numeric_limits<double>::denorm_min(), Range::kMax};
/// A share of a whole.
inline constexpr Range kShare{0, 1};
/// 0 or more.
inline constexpr Range kNotNegative{0, Range::kMax};
/// A count that cannot be 0.
inline constexpr Range kFromOne{1, Range::kMax};

/// The description of a field.
struct Field {
  const char* name = "";         ///< in files and errors; the option is --name, with dashes
  const char* help = "";         ///< of the option
  const char* otherwise = "";    ///< the default in words, if the value does not show it
  Range range = {};              ///< of a number, or of each component of a vector
  const char* option = nullptr;  ///< the option's name if it differs; "": no option
  bool required = false;         ///< the option must be given
  bool decides = true;           ///< part of the run's identity: a run resumes only with the same value
  bool matters = true;           ///< false: affects time and memory alone, never a result
  /// The value, as text, of the field in files of earlier programs, which left it out. For a list or group,
  /// "" means that all of it is off. Null: the field may not be missing.
  const char* lacking = nullptr;
  const char* word = "";                        ///< a path's value that is a word and no path
  bool endless = false;                         ///< of a number: null in a file is infinite
  bool plain = false;                           ///< of a text: stored unescaped
  void (*check)(const std::string&) = nullptr;  ///< of a text: throws FieldError

  /// The option's name; "": no option.
  std::string option_name() const;
};

/// S is T, or T that is const.
template <class S, class T>
concept FieldsOf = std::same_as<std::remove_const_t<S>, T>;

/// `s` as its base class, which has its own list of fields: visit_fields(visit, as_base<FrameSource>(s)).
template <class Base, class S>
auto& as_base(S& s) {
  return static_cast<std::conditional_t<std::is_const_v<S>, const Base, Base>&>(s);
}

/// Fields that need no description but their names: name, value, name, value, …
template <class Visitor, class T, class... Rest>
void visit_named(Visitor& visit, const char* name, T& value, Rest&... rest) {
  visit({.name = name}, value);
  if constexpr (sizeof...(rest) > 0) visit_named(visit, rest...);
}

template <class T>
concept HasWords = std::is_enum_v<T> && requires(T value) {
  words_of(value);
};
template <class T>
concept HasText = requires(const std::string& text, T& value) {
  set_from_text(text, value);
  { text_of(value) } -> std::convertible_to<std::string>;
};
template <class T>
concept Number = std::is_arithmetic_v<T> && !std::same_as<T, bool>;
template <class T>
concept NumberVector = std::same_as<T, Vec2d> || std::same_as<T, Vec3d>;

/// The value's word.
template <HasWords E>
const char* to_word(E value) {
  return words_of(value)[as_size(value)];
}

/// The index of `word` in `words`. FieldError naming all words if it is not one of them.
std::size_t place_of(const std::string& word, const std::string& field, const char* const* words,
                     std::size_t count);

/// The enumerator that `word` names. FieldError as place_of.
template <HasWords E>
E parse_word(const std::string& word, const std::string& field) {
  const auto words = words_of(E());
  return static_cast<E>(place_of(word, field, words.data(), words.size()));
}

/// The comma-separated words; an empty text has none.
std::vector<std::string> listed_words(const std::string& text);

/// The text as a number. FieldError if it is not a number.
double parse_number(const std::string& text, const std::string& field);

/// FieldError if the field's range does not hold the value.
void check_number(const Field& field, double value);

/// A list's numbers in order, each as a pointer with its Field.
template <class T>
class NumbersOf {
 public:
  template <class Value>
  void operator()(const Field& field, Value& value) {
    if constexpr (NumberVector<std::remove_const_t<Value>>)
      for (int i = 0; i < value.size(); ++i) numbers.emplace_back(&value[i], field);
    else if constexpr (std::same_as<std::remove_const_t<Value>, double>)
      numbers.emplace_back(&value, field);
  }
  std::vector<std::pair<T*, Field>> numbers;
};
/// The numbers of a struct that is one list: double fields and elements of vectors, with their Field.
template <class S>
auto numbers_of(S& s) {
  NumbersOf<std::conditional_t<std::is_const_v<S>, const double, double>> all;
  visit_fields(all, s);
  return all.numbers;
}

/// The visitor of check_fields.
class FieldCheck {
 public:
  template <class T>
  void operator()(const Field& field, const T& value) {
    if constexpr (Number<T>)
      check_number(field, static_cast<double>(value));
    else if constexpr (NumberVector<T>)
      for (int i = 0; i < value.size(); ++i) check_number(field, value[i]);
    else if constexpr (std::same_as<T, std::string>)
      if (field.check) field.check(value);
  }
  template <class T>
  void group(const Field&, const T& inner) {
    visit_fields(*this, inner);
  }
  template <class T>
  void list(const Field& field, const T& inner) {
    for (auto& [number, own] : numbers_of(inner)) {
      if constexpr (HasText<T>) own.name = field.name;  // its numbers are set together
      check_number(own, *number);
    }
  }
};

/// FieldError for the first field that is out of its range or fails its own check.
template <class S>
void check_fields(const S& s) {
  FieldCheck check;
  visit_fields(check, s);
}

/// A command's options as programs pass them: texel_rate for --texel-rate; a flag's value is true or false.
using NamedSettings = std::map<std::string, std::string>;

/// A base of visitors (class Own : public FlatFields<Own>) that treat a nested struct's fields as the
/// struct's own, and a list that a text sets as one field.
template <class Own>
class FlatFields {
 public:
  template <class T>
  void group(const Field&, T& inner) {
    visit_fields(static_cast<Own&>(*this), inner);
  }
  template <class T>
  void list(const Field& field, T& inner) {
    if constexpr (HasText<std::remove_const_t<T>>)
      static_cast<Own&> (*this)(field, inner);
    else
      visit_fields(static_cast<Own&>(*this), inner);
  }
};

/// The visitor of set_field.
class FieldSetter : public FlatFields<FieldSetter> {
 public:
  /// Sets the field `name` by `text`; both outlive this.
  FieldSetter(const std::string& name, const std::string& text) : name_(name), text_(text) {}
  template <class T>
  void operator()(const Field& field, T& value) {
    if (name_ != field.name) return;
    found = true;
    if constexpr (HasWords<T>) {
      value = parse_word<T>(text_, name_);
    } else if constexpr (HasText<T>) {
      set_from_text(text_, value);
    } else if constexpr (std::same_as<T, bool>) {
      value = text_ == "true";
    } else if constexpr (Number<T>) {
      const auto number = try_parse_number<T>(text_);
      if (!number) throw FieldError(name_, text_, "is not such a number", "use " + field.range.words());
      value = *number;
    } else if constexpr (!NumberVector<T>) {
      value = text_;
    }
    FieldCheck()(field, value);
  }
  bool found = false;

 private:
  const std::string &name_, &text_;
};

/// Sets the field `name` from a text. FieldError for an unknown name or a text that the field does not take.
template <class S>
void set_field(S& s, const std::string& name, const std::string& text) {
  FieldSetter setter(name, text);
  visit_fields(setter, s);
  if (!setter.found) throw FieldError(name, text, "no such setting", "see the struct's visit_fields");
}

// Words that name one thing of several (a command, an option, a rig, a defence …), and the message for an
// unknown word: the likely choices, and all choices.

/// The fewest insertions, deletions, replacements and swaps of neighbouring letters that turn one word into
/// the other: the Damerau–Levenshtein distance (optimal string alignment; Damerau, CACM 1964). Capitals count
/// as small letters, '_' as '-'.
int edit_distance(std::string_view a, std::string_view b);

/// The `choices` that `word` may have meant, nearest first: at most a third of the letters is wrong, or one
/// word begins with the other.
std::vector<std::string> closest_words(std::string_view word, const std::vector<std::string>& choices);

/// "did you mean b? use b, a, c or FORMS", with likely choices first; "use a, b, c or FORMS" if none is
/// likely. `forms`: other permitted forms; may be empty.
std::string use_one_of(std::string_view word, const std::vector<std::string>& choices,
                       const std::string& forms = "");

/// The error for a field's word that is not among `choices`.
FieldError unknown_word(const std::string& field, const std::string& word,
                        const std::vector<std::string>& choices, const std::string& forms = "");

/// Names of the files that ship in a folder such as "scenes/rigs", without their extension, sorted; empty
/// without that folder.
std::vector<std::string> shipped_names(const std::string& folder, const std::string& extension);

/// The shipped file of that name. FieldError of `field`, naming all choices, for an unknown name; InputError
/// as shipped_file() (base/files.h) if the folder is missing.
std::filesystem::path shipped_choice(const std::string& folder, const std::string& extension,
                                     const std::string& word, const std::string& field,
                                     const std::string& forms = "");

}  // namespace mirage
