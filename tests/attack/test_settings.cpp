// The list of an attack's settings: each decides the result or does not, comes back from JSON, and is refused
// by its name where no run can use it. A new field is tested as soon as it is listed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "attack/run.h"
#include "base/field_json.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::StartsWith;

/// Every part that can be switched on is, so that its numbers mean something.
AttackSettings everything_on() {
  AttackSettings settings;
  settings.data = "/data";
  settings.until_plateau = 5;
  settings.expectation = parse_expectation("all");
  settings.buildable.on = true;
  settings.simulation.lidar_effects.range_sigma = 0.01;
  settings.simulation.camera_effects.read_sigma = 0.01;
  settings.simulation.lidar_effects.velocity = Vec3d(1, 2, 3);
  return settings;
}

/// Calls `change(field, value, decides, known)` for field number `which`, those of inner structs counted;
/// `known`: the name by which the library speaks of it.
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

/// change(settings of its own, field, value, decides, known) for every field.
template <class Change>
int for_each_field(const Change& change) {
  for (int i = 0;; ++i) {
    AttackSettings settings = everything_on();
    const auto with_settings = [&](const Field& field, auto& value, bool decides, const char* known) {
      change(settings, field, value, decides, known);
    };
    OneField one(i, with_settings);
    visit_fields(one, settings);
    if (!one.found) return i;
  }
}

double other_number(const Range& range, double value) {
  for (const double other : {value + 1, value / 2, value * 2, 0.1})
    if (other != value && range.contains(other)) return other;
  return value;
}

/// Another value that the field can have.
template <class T>
void change(const Field& field, T& value) {
  if constexpr (std::same_as<T, bool>)
    value = !value;
  else if constexpr (HasWords<T>)
    value = value == T() ? static_cast<T>(words_of(value).size() - 1) : T();
  else if constexpr (Number<T>)
    value = static_cast<T>(other_number(field.range, static_cast<double>(value)));
  else if constexpr (NumberVector<T>)
    value[1] = other_number(field.range, value[1]);
  else if constexpr (std::same_as<T, std::filesystem::path>)
    value = "/elsewhere";
  else
    value = std::string(field.name) == "rooftop"     ? "box"
            : std::string(field.name) == "sun"       ? "30,40"
            : std::string(field.name) == "precision" ? "bfloat16"
                                                     : value + "x";
}

TEST(Settings, EachFieldThatDecidesTheResultChangesTheIdentityAndNoOtherDoes) {
  const nlohmann::json before = identity(everything_on());
  int deciding = 0, others = 0;
  const int fields = for_each_field(
      [&](AttackSettings& settings, const Field& field, auto& value, bool decides, const char*) {
        change(field, value);
        EXPECT_EQ(identity(settings) != before, decides) << field.name;
        ++(decides ? deciding : others);
      });
  EXPECT_EQ(deciding + others, fields);
  EXPECT_GT(deciding, 45);
  EXPECT_GE(others, 5);  // iterations, the plateau's steps, when checkpoints are written, memory
}

TEST(Settings, EachFieldComesBackFromJson) {
  const auto back = [](const nlohmann::json& json) {
    AttackSettings settings;
    settings.until_plateau = 5;  // which no file names: it is no part of the result
    read_fields(JsonFields("run.json", json, "restore it"), settings);
    return fields_json(settings);
  };
  for_each_field([&](AttackSettings& settings, const Field& field, auto& value, bool, const char*) {
    change(field, value);
    const nlohmann::json json = fields_json(settings);
    EXPECT_EQ(back(json), json) << field.name;
  });
}

TEST(Settings, EachFieldOutOfItsRangeIsRefusedByItsName) {
  int refused = 0;
  for_each_field([&](AttackSettings& settings, const Field& field, auto& value, bool, const char* known) {
    using T = std::remove_reference_t<decltype(value)>;
    const auto expect_refusal = [&](double wrong) {
      if constexpr (NumberVector<T>)
        value[0] = wrong;
      else if constexpr (Number<T>)
        value = static_cast<T>(wrong);
      EXPECT_THAT(test::error_text<FieldError>([&] { check_fields(settings); }),
                  StartsWith(std::string(known) + ": "))
          << field.name << " " << wrong;
      ++refused;
    };
    if constexpr (Number<T> || NumberVector<T>) {
      const bool fits = !std::integral<T> || (field.range.low > -1e9 && field.range.high < 2e9);
      if (field.range.low > -Range::kMost && std::is_signed_v<T>) expect_refusal(field.range.low - 1);
      if (NumberVector<T> && field.range.low > -Range::kMost) expect_refusal(field.range.low - 1);
      if (field.range.high < Range::kMost && fits) expect_refusal(field.range.high + 1);
      if constexpr (!std::integral<T>) expect_refusal(std::nan(""));
    }
  });
  EXPECT_GT(refused, 60);
}

TEST(Settings, WordsOfNoMeaningAreRefusedWithThoseThereAre) {
  AttackSettings settings;
  settings.sun = "noon";
  EXPECT_THAT(test::error_text<FieldError>([&] { check_fields(settings); }), StartsWith("sun: noon: "));
  EXPECT_THAT(test::error_text<FieldError>([] { parse_word<AttackTarget>("camera", "target"); }),
              testing::StrEq("target: camera: unknown; use both, image, lidar or random"));
  for (const char* word : words_of(AttackParts()))
    EXPECT_STREQ(to_word(parse_word<AttackParts>(word, "")), word);
}

}  // namespace
}  // namespace mirage
