// What a result is made of, in one form: the program, all settings, and every input, weights and plugins
// included, by content. Its hash is the identity under which results are kept on disk; every result.json
// carries it.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "base/fields.h"
#include "base/json_fields.h"

namespace mirage {

/// Tells programs apart whose results may differ: hashes of the running executable, of the plugin beside it
/// that decodes pictures ("" without one), and of what the processor can do (libraries choose their
/// instructions by it). Shared libraries of the system are not in it, nor is the commit: the same program
/// built from another commit is the same. Plugins that a setting names are inputs.
std::string program_identity();
/// The same of another executable.
std::string program_identity(const std::filesystem::path& file);
/// "0.1.0".
std::string program_version();
/// What stands in `mirage.commit` beside the program, which every build writes (packaging/commit.cmake):
/// "ea8efec", or "ea8efec-dirty" of sources that were changed since. "" for sources without their history.
std::string program_commit();

/// Collects what a result is made of. What is added twice under one name is what was added last.
class Provenance {
 public:
  /// All fields of `s` by their list (base/fields.h), those at their default too, but for paths: what a path
  /// leads to counts by content, a file's here, a folder's where it is read (input()). Nor those that matter
  /// to time alone.
  template <class S>
  void add(const S& s);
  /// A setting that is in no list.
  void set(const std::string& name, nlohmann::json value) { settings_[name] = std::move(value); }
  /// What is read, by a hash of its content.
  void input(const std::string& name, const std::string& hash) { inputs_[name] = hash; }
  /// The file's content. InputError as file_hash.
  void file(const std::string& name, const std::filesystem::path& path);
  /// That input's hash; "" without one.
  std::string input(const std::string& name) const { return inputs_.value(name, ""); }
  /// What a reader wants to know and no result depends on: names and paths of inputs, date, command.
  void record(const std::string& name, nlohmann::json value) { records_[name] = std::move(value); }

  /// {program, inputs, settings}; keys are sorted.
  nlohmann::json provenance() const;
  /// Hash of provenance().
  std::string identity() const;
  /// Of result.json (src/README.md): provenance(), version, commit, identity, and what was told.
  nlohmann::json json() const;

 private:
  friend class ProvenanceFields;
  nlohmann::json settings_ = nlohmann::json::object(), inputs_ = settings_, records_ = settings_;
};

/// Of Provenance::add.
class ProvenanceFields {
 public:
  /// Adds to `to`, which outlives this.
  explicit ProvenanceFields(Provenance& to) : to_(to) {}
  template <class T>
  void operator()(const Field& field, const T& value) {
    to_.settings_.erase(field.name);  // of an option of that name (cli/dispatch.cpp)
    if constexpr (HasText<T>) to_.settings_.erase(field.option_name());  // one of its spellings
    if (!field.matters) return;
    if constexpr (std::same_as<T, std::filesystem::path>) {
      if (value == field.word)
        to_.set(field.name, value.string());
      else if (std::filesystem::is_regular_file(value))
        to_.file(field.name, value);
    } else {
      JsonWriter writer(true);
      writer(field, value);
      to_.settings_.update(writer.json);
    }
  }
  template <class T>
  void group(const Field& field, const T& inner) {
    Provenance within;
    within.add(inner);
    to_.set(field.name, std::move(within.settings_));
    for (const auto& [name, hash] : within.inputs_.items()) to_.inputs_[name] = hash;
  }
  template <class T>
  void list(const Field& field, const T& inner) {
    JsonWriter writer(true);
    writer.list(field, inner);
    to_.settings_.update(writer.json);
  }

 private:
  Provenance& to_;
};

template <class S>
void Provenance::add(const S& s) {
  ProvenanceFields fields(*this);
  visit_fields(fields, s);
}

}  // namespace mirage
