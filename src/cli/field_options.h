// Options of the command line, made of a struct's list of fields (base/fields.h).
#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "base/fields.h"

namespace mirage::cli {

/// Remembers under which option a field is set, where its name is another.
void name_option(const Field& field);
/// The option of `app` that sets the field; the field's own name where there is none.
std::string option_of(const CLI::App& app, const std::string& field);
/// Refuses, on the command line, what is out of the range.
CLI::Validator within(const Range& range);

/// Of add_fields.
class FieldOptions {
 public:
  explicit FieldOptions(CLI::App& to) : app(to) {}
  template <class T>
  void operator()(const Field& field, T& value) {
    const std::string name = field.option_name();
    if (name.empty()) return;
    name_option(field);
    if constexpr (std::same_as<T, bool>) {
      app.add_flag("--" + name, value, field.help);
    } else if constexpr (HasWords<T>) {
      std::string words;
      for (const char* word : words_of(value)) words += (words.empty() ? "{" : ",") + std::string(word);
      by_text(field, value, to_word(value), [field](const std::string& text, T& set) {
        set = parse_word<T>(text, field.name);
      })->type_name(words + "}");
    } else if constexpr (!NumberVector<T>) {
      CLI::Option* option = app.add_option("--" + name, value, field.help)->required(field.required);
      if constexpr (Number<T>) option->check(within(field.range));
      if constexpr (!std::same_as<T, std::filesystem::path>) option->capture_default_str();
    }
  }
  template <class T>
  void group(const Field&, T& inner) {
    visit_fields(*this, inner);
  }
  /// A struct that a text sets is one option; else its fields are.
  template <class T>
  void list(const Field& field, T& inner) {
    if constexpr (HasText<T>) {
      name_option(field);
      by_text(field, inner, text_of(inner),
              [](const std::string& text, T& set) { set_from_text(text, set); });
    } else {
      visit_fields(*this, inner);
    }
  }

 private:
  template <class T, class Set>
  CLI::Option* by_text(const Field& field, T& value, const std::string& otherwise, const Set& set) {
    return app
        .add_option_function<std::string>(
            "--" + field.option_name(), [&value, set](const std::string& text) { set(text, value); },
            field.help)
        ->default_str(otherwise);
  }
  CLI::App& app;
};

/// An option for each field that has one; `s` lives as long as the command.
template <class S>
void add_fields(CLI::App& app, S& s) {
  FieldOptions options(app);
  visit_fields(options, s);
}

}  // namespace mirage::cli
