// Options of the command line, made from a struct's list of fields (base/fields.h).
#pragma once

#include <CLI/CLI.hpp>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "base/fields.h"

namespace mirage::cli {

/// Records the option that sets a field, if their names differ.
void name_option(const Field& field);
/// The option of `app` that sets the field; the field's own name where there is none.
std::string option_of(const CLI::App& app, const std::string& field);
/// An option's help with its default in words, `otherwise`, if that is not empty.
std::string with_default(const std::string& help, const std::string& otherwise);
/// Refuses values out of the range on the command line.
CLI::Validator within(const Range& range);
/// Refuses every other word.
CLI::Validator one_of(const std::vector<std::string>& words);
/// Refuses non-numbers for every option that takes a number: CLI11 would say "could not convert", and read -1
/// as the largest unsigned number. Call it when the command has all its options.
void check_numbers(CLI::App& app);
/// The first part of an option's type, "TEXT" or "INT", and what within() or one_of() added to it.
struct OptionType {
  std::string name, limits;
};
OptionType type_of(const CLI::Option& option);

/// An error of CLI11: the option ("--size"; may be empty), the problem and the fix.
struct UsageError {
  std::string option, problem, fix;
};
UsageError usage_error(const CLI::ParseError& error, const CLI::App& app);

/// The visitor of add_fields.
class FieldOptions : public FlatFields<FieldOptions> {
 public:
  FieldOptions(CLI::App& to, std::set<std::string> without, std::string elsewhere = "")
      : app(to), skip(std::move(without)), otherwise(std::move(elsewhere)) {}
  template <class T>
  void operator()(const Field& field, T& value) {
    const std::string name = field.option_name();
    if (name.empty() || skip.contains(field.name)) return;
    name_option(field);
    if constexpr (std::same_as<T, bool>) {
      const bool set = field.option == nullptr;  // an option of another name says the opposite of the field
      app.add_flag_function(
          "--" + name, [&value, set](std::int64_t times) { value = (times > 0) == set; },
          with_default(field.help, field.otherwise));
    } else if constexpr (HasWords<T>) {
      std::string words;
      for (const char* word : words_of(value)) words += (words.empty() ? "{" : ",") + std::string(word);
      by_text(field, value, to_word(value), [field](const std::string& text, T& set) {
        set = parse_word<T>(text, field.name);
      })->type_name(words + "}");
    } else if constexpr (HasText<T>) {
      by_text(field, value, text_of(value),
              [](const std::string& text, T& set) { set_from_text(text, set); });
    } else if constexpr (!NumberVector<T>) {
      CLI::Option* option = app.add_option("--" + name, value)->required(field.required);
      if constexpr (Number<T>) option->check(within(field.range));
      if constexpr (!std::same_as<T, std::filesystem::path>) option->capture_default_str();
      describe(field, option);
    }
  }

 private:
  template <class T, class Set>
  CLI::Option* by_text(const Field& field, T& value, const std::string& initial, const Set& set) {
    return describe(field, app.add_option_function<std::string>(
                                  "--" + field.option_name(),
                                  [&value, set](const std::string& text) { set(text, value); })
                               ->default_str(initial));
  }
  CLI::Option* describe(const Field& field, CLI::Option* option) {
    const bool from_elsewhere = !otherwise.empty() && field.matters;
    if (from_elsewhere) option->default_str("");
    return option->description(with_default(field.help, from_elsewhere ? otherwise : field.otherwise));
  }
  CLI::App& app;
  std::set<std::string> skip;
  std::string otherwise;
};

/// Adds an option for each field that has one, except those to skip; `s` must outlive the command.
/// `otherwise`: the source of the default values, if not `s`, of all fields that affect results.
template <class S>
void add_fields(CLI::App& app, S& s, std::set<std::string> skip = {}, std::string otherwise = "") {
  FieldOptions options(app, std::move(skip), std::move(otherwise));
  visit_fields(options, s);
}

/// The visitor of add_overrides.
class OverrideOptions : public FlatFields<OverrideOptions> {
 public:
  template <class T>
  void operator()(const Field& field, const T&) {
    const std::string name = field.option_name();
    if (name.empty() || (!only.empty() && !only.contains(field.name))) return;
    name_option(field);
    app.add_option_function<std::string>(
        "--" + name, [to = &overrides, key = field.name](const std::string& text) { (*to)[key] = text; },
        with_default(field.help, otherwise));
  }
  CLI::App& app;
  std::map<std::string, std::string>& overrides;  ///< by field (attack/run.h, Overrides)
  std::set<std::string> only;
  std::string otherwise;
};

/// Adds options that override values of S's fields (only those in `only`, if it is not empty). Their help
/// names `otherwise` as the default's source; `overrides` must outlive the command.
template <class S>
void add_overrides(CLI::App& app, std::map<std::string, std::string>& overrides,
                   std::set<std::string> only = {}, std::string otherwise = "the run's") {
  OverrideOptions options{{}, app, overrides, std::move(only), std::move(otherwise)};
  const S fields;
  visit_fields(options, fields);
}

// --config FILE.toml: keys are the command's option names without the dashes; the command line wins. Users
// share these files like data sets, so they hold settings and no code.

/// Arguments with the file's keys turned into options, where the command line doesn't give them already.
/// InputError naming file and key for: an unreadable file, a syntax error, an unknown key, and a value that
/// would run code (a plugin, weights that may be a TorchScript model, trust in a run's code).
std::vector<std::string> apply_config(const std::vector<std::string>& arguments, const CLI::App& command);

// Runs commands on named settings: for Python (plugins/python) and for commands that run others.

/// Separates the entries of a list in a NamedSettings' text: the "unit separator", in no path or word.
inline constexpr char kListSeparator = '\x1f';

/// Arguments such as "--texel-rate=0.01": one for each setting, or for each entry of a list if the option
/// takes several. InputError, naming `where` and the known names, for an unknown name.
std::vector<std::string> arguments_of(const NamedSettings& settings, const CLI::App& command,
                                      const std::string& where);

/// Sets the variables of the command's options. InputError naming `where` for a refused value.
void parse_settings(CLI::App& command, const NamedSettings& settings, const std::string& where);

/// Runs a command as the command line does, OUT/result.json included, and returns its content. `where` names
/// the call in its errors. Throws what the command throws.
nlohmann::json run_command(const std::string& command, const NamedSettings& settings,
                           const std::string& where);

}  // namespace mirage::cli
