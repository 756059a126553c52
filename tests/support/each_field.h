// Every field that a struct lists (base/fields.h), changed one at a time: a new field is tested once it is
// listed.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <set>
#include <string>
#include <utility>

#include "base/fields.h"
#include "base/files.h"
#include "base/provenance.h"

namespace mirage::test {

/// Calls `change(field, value, decides, known)` for field number `which`, counting fields of inner structs.
/// `known`: the name that the library uses in messages.
template <class Change>
class OneField {
 public:
  OneField(int which, const Change& change) : which_(which), change_(change) {}
  template <class T>
  void operator()(const Field& field, T& value) {
    if (at_++ != which_) return;
    found = true;
    change_(field, value, decides_ && field.decides, known_ ? known_ : field.name);
  }
  template <class T>
  void group(const Field& field, T& inner) {
    const bool outer = std::exchange(decides_, decides_ && field.decides);
    visit_fields(*this, inner);
    decides_ = outer;
  }
  template <class T>
  void list(const Field& field, T& inner) {
    if constexpr (HasText<T>) known_ = field.name;
    group(field, inner);
    known_ = nullptr;
  }
  bool found = false;

 private:
  int which_, at_ = 0;
  bool decides_ = true;
  const char* known_ = nullptr;
  const Change& change_;
};

/// Calls change(a copy of `start`, field, value, decides, known) for every field; returns their number.
template <class S, class Change>
int for_each_field(const S& start, const Change& change) {
  for (int i = 0;; ++i) {
    S settings = start;
    const auto with_settings = [&](const Field& field, auto& value, bool decides, const char* known) {
      change(settings, field, value, decides, known);
    };
    OneField one(i, with_settings);
    visit_fields(one, settings);
    if (!one.found) return i;
  }
}

inline double other_number(const Range& range, double value) {
  for (const double other : {value + 1, value / 2, value * 2, 0.1})
    if (other != value && range.contains(other)) return other;
  return value;
}

/// Changes the value to another one that the field can have.
template <class T>
void change(const Field& field, T& value) {
  if constexpr (std::same_as<T, bool>)
    value = !value;
  else if constexpr (HasWords<T>)
    value = value == T() ? static_cast<T>(words_of(value).size() - 1) : T();
  else if constexpr (HasText<T>)
    set_from_text(std::string(field.name) == "gamut" ? "box:0.1,0.8" : "1,2,3,4", value);
  else if constexpr (Number<T>)
    value = static_cast<T>(other_number(field.range, static_cast<double>(value)));
  else if constexpr (NumberVector<T>)
    value[1] = other_number(field.range, value[1]);
  else if constexpr (std::same_as<T, std::filesystem::path>)
    value = "/elsewhere";
  else
    value = std::string(field.name) == "rooftop"     ? "box"
            : std::string(field.name) == "sun"       ? "30,40"
            : std::string(field.name) == "precision" ? (value == "double" ? "float" : "double")
            : std::string(field.name) == "defense"   ? "jpeg:50"
                                                     : value + "x";
}

/// Expects every field to change Provenance's identity, except those that only affect time. A path counts by
/// its file's content, not by its name. `folder`: a folder for such files.
template <class S>
void expect_identity_follows(const S& start, const std::filesystem::path& folder) {
  const auto identity = [](const S& settings) {
    Provenance provenance;
    provenance.add(settings);
    return provenance.identity();
  };
  const std::string before = identity(start);
  std::set<std::string> all = {before};
  const int fields =
      for_each_field(start, [&](S& settings, const Field& field, auto& value, bool, const char*) {
        if constexpr (std::same_as<std::decay_t<decltype(value)>, std::filesystem::path>) {
          value = folder / "file";
          write_file(value, "content");
          const std::string with = identity(settings);
          EXPECT_TRUE(all.insert(with).second) << field.name;
          value = folder / "moved";
          write_file(value, "content");
          EXPECT_EQ(identity(settings), with) << field.name;
          write_file(value, "contend");
          EXPECT_TRUE(all.insert(identity(settings)).second) << field.name;
        } else {
          change(field, value);
          EXPECT_EQ(all.insert(identity(settings)).second, field.matters) << field.name;
        }
      });
  EXPECT_GT(fields, 0);
  EXPECT_EQ(identity(start), before);
}

}  // namespace mirage::test
