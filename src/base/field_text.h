// The options of a command as a program gives them: by name, in the place of a command line.
#pragma once

#include <charconv>
#include <map>
#include <string>

#include "base/fields.h"

namespace mirage {

/// Texts by name: texel_rate for --texel-rate; a flag's is true or false.
using NamedSettings = std::map<std::string, std::string>;

// Settings set by their names: the texts that options take, put into the fields of a struct (base/fields.h).

/// Of set_field.
class FieldSetter {
 public:
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
      const char *begin = text_.data(), *end = begin + text_.size();
      const auto [stop, error] = std::from_chars(begin, end, value);
      if (error != std::errc() || stop != end)
        throw FieldError(name_, text_, "is not such a number", "use " + field.range.words());
    } else if constexpr (!NumberVector<T>) {
      value = text_;
    }
    FieldCheck()(field, value);
  }
  template <class T>
  void group(const Field&, T& inner) {
    visit_fields(*this, inner);
  }
  template <class T>
  void list(const Field& field, T& inner) {
    if constexpr (HasText<T>) {
      if (name_ != field.name) return;
      found = true;
      set_from_text(text_, inner);
    } else {
      visit_fields(*this, inner);
    }
  }
  bool found = false;

 private:
  const std::string &name_, &text_;
};

/// Sets the field of that name, which must be one. FieldError for a text that it does not take.
template <class S>
void set_field(S& s, const std::string& name, const std::string& text) {
  FieldSetter setter(name, text);
  visit_fields(setter, s);
  if (!setter.found) throw FieldError(name, text, "no such setting", "see the struct's visit_fields");
}

}  // namespace mirage
