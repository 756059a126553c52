// The provenance of a result: the program, all settings, and every input by content, weights and plugins
// included. Its hash is the identity under which results are stored; every result.json holds it.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "base/fields.h"
#include "base/json_fields.h"

namespace mirage {

/// Tells apart programs whose results may differ, by hashes of the running executable, of the plugin beside
/// it that decodes pictures ("" without one), and of the processor's features (libraries choose instructions
/// by them). It leaves out the system's shared libraries and the commit: the same program built from another
/// commit is the same. Plugins that a setting names are inputs.
std::string program_identity();
/// The same of another executable.
std::string program_identity(const std::filesystem::path& file);
/// "0.1.0".
std::string program_version();
/// The text in `mirage.commit` beside the program, which every build writes (packaging/commit.cmake):
/// "ea8efec", or "ea8efec-dirty" for sources changed since. "" for sources without git.
std::string program_commit();

/// Collects the provenance of a result. Of two values added under one name the last one counts.
class Provenance {
 public:
  /// Adds all fields of `s` by their list (base/fields.h), defaults included, except those that affect time
  /// alone. Paths count by content: a file here, a folder where it is read (input()).
  template <class S>
  void add(const S& s);
  /// A setting that is in no list.
  void set(const std::string& name, nlohmann::json value) { settings_[name] = std::move(value); }
  /// Adds an input by a hash of its content.
  void input(const std::string& name, const std::string& hash) { inputs_[name] = hash; }
  /// Adds a file as an input by its content. InputError as file_hash.
  void file(const std::string& name, const std::filesystem::path& path);
  /// That input's hash; "" without one.
  std::string input(const std::string& name) const { return inputs_.value(name, ""); }
  /// Adds information for readers that no result depends on: names and paths of inputs, date, command.
  void record(const std::string& name, nlohmann::json value) { records_[name] = std::move(value); }

  /// {program, inputs, settings}; keys are sorted.
  nlohmann::json provenance() const;
  /// Hash of provenance().
  std::string identity() const;
  /// The object in result.json (src/README.md): provenance(), version, commit, identity, and the records.
  nlohmann::json json() const;

 private:
  friend class ProvenanceFields;
  nlohmann::json settings_ = nlohmann::json::object(), inputs_ = settings_, records_ = settings_;
};

/// The visitor of Provenance::add.
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
