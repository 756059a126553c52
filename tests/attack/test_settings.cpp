// The list of an attack's settings. Each one decides the result or does not, round-trips through JSON, and is
// refused by name where no run can use it. A new field is tested once it is listed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "attack/checkpoint.h"
#include "attack/run.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "detection/training.h"
#include "frames/frame_provenance.h"
#include "scene/depth/learned_depth.h"
#include "support/each_field.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::StartsWith;

/// Every optional part is on, so that its numbers have an effect.
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

using test::change;

/// Calls change(settings of its own, field, value, decides, known) for every field.
template <class Change>
int for_each_field(const Change& change) {
  return test::for_each_field(everything_on(), change);
}

TEST(Settings, EachFieldThatDecidesTheResultChangesTheIdentityAndNoOtherDoes) {
  const nlohmann::json before = identity(everything_on()).json;
  int deciding = 0, others = 0;
  const int fields = for_each_field(
      [&](AttackSettings& settings, const Field& field, auto& value, bool decides, const char*) {
        change(field, value);
        EXPECT_EQ(identity(settings).json != before, decides) << field.name;
        ++(decides ? deciding : others);
      });
  EXPECT_EQ(deciding + others, fields);
  EXPECT_GT(deciding, 45);
  EXPECT_GE(others, 5);  // iterations, the plateau's steps, when checkpoints are written, memory
}

TEST(Settings, EachFieldComesBackFromJson) {
  const auto back = [](const nlohmann::json& file) {
    AttackSettings settings;
    settings.until_plateau = 5;  // no file has it: it is not part of the result
    read_fields(JsonFields("run.json", file, "restore it"), settings);
    return fields_json(settings);
  };
  for_each_field([&](AttackSettings& settings, const Field& field, auto& value, bool, const char*) {
    change(field, value);
    const nlohmann::json written = fields_json(settings);
    EXPECT_EQ(back(written), written) << field.name;
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
      if (field.range.low > -Range::kMax && std::is_signed_v<T>) expect_refusal(field.range.low - 1);
      if (NumberVector<T> && field.range.low > -Range::kMax) expect_refusal(field.range.low - 1);
      if (field.range.high < Range::kMax && fits) expect_refusal(field.range.high + 1);
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

TEST(Settings, EachFieldChangesTheIdentityOfWhatIsMadeOfIt) {
  const test::TemporaryFolder folder;
  test::expect_identity_follows(everything_on(), folder.path());
  test::expect_identity_follows(TrainingOptions(), folder.path());
  test::expect_identity_follows(DepthTrainingOptions(), folder.path());
}

TEST(Settings, EachFieldIsInTheFileAtItsDefaultToo) {
  const nlohmann::json whole = fields_json(AttackSettings());
  const nlohmann::json on = fields_json(everything_on());
  for (const auto& [key, value] : on.items()) EXPECT_TRUE(whole.contains(key)) << key;
  for (const auto& [key, value] : on.at("simulation").items())
    EXPECT_TRUE(whole.at("simulation").contains(key)) << key;
  AttackSettings free;
  free.buildable.on = false;
  EXPECT_TRUE(fields_json(free).at("buildable").is_null());
}

/// A run.json of an earlier program, which left out fields at their default.
nlohmann::json as_of_an_earlier_program(nlohmann::json run) {
  const nlohmann::json lacking = lacking_json<AttackSettings>();
  for (const auto& [key, value] : lacking.items())
    if (key != "simulation") run.erase(key);
  for (const auto& [key, value] : lacking.at("simulation").items()) run.at("simulation").erase(key);
  run.erase("rooftop_model_hash");
  return run;
}

TEST(Settings, WhatAnEarlierFileLeftOutIsWhatItMeantThen) {
  const nlohmann::json lacking = lacking_json<AttackSettings>();
  EXPECT_EQ(lacking.at("fp_top_k"), 0);
  EXPECT_EQ(lacking.at("attack"), "plain");
  EXPECT_EQ(lacking.at("simulation").at("light"), "plain");
  EXPECT_GE(lacking.size() + lacking.at("simulation").size(), 20u);
  AttackSettings settings;
  settings.objective.fp_top_k = 7;  // whatever the reader's default is
  settings.simulation.light = LightModel::fine;
  settings.placement.in = PlaceChoice::In::world;
  settings.buildable.on = true;
  settings.simulation.camera_effects.shot = 0.1;
  read_fields(JsonFields("run.json", as_of_an_earlier_program(fields_json(AttackSettings())), "restore it"),
              settings);
  EXPECT_EQ(settings.objective.fp_top_k, 0);
  EXPECT_EQ(settings.simulation.light, LightModel::plain);
  EXPECT_EQ(text_of(settings.placement), "roof");
  EXPECT_FALSE(settings.buildable.on);
  EXPECT_FALSE(settings.simulation.camera_effects.any());
}

TEST(Settings, AListThatGrewIsReadAsItWas) {
  AttackSettings settings;
  settings.expectation = parse_expectation("all");
  nlohmann::json run = fields_json(settings);
  auto& list = run.at("expectation");
  const std::size_t whole = list.size();
  list.erase(list.begin() + 7, list.end());
  AttackSettings read;
  read.expectation.shape = 0.1;  // whatever the reader's default is
  read_fields(JsonFields("run.json", run, "restore it"), read);
  EXPECT_EQ(read.expectation.range_noise, settings.expectation.range_noise);
  EXPECT_EQ(read.expectation.shape, 0);
  complete(run, lacking_json<AttackSettings>());
  EXPECT_EQ(list.size(), whole);
  EXPECT_EQ(list.back(), 0);
  list.erase(list.begin() + 6, list.end());  // shorter than any program wrote
  EXPECT_THAT(
      test::error_text<InputError>([&] { read_fields(JsonFields("run.json", run, "restore it"), read); }),
      testing::HasSubstr("expectation: not a list of 12 numbers"));
}

TEST(Settings, ARunOfAnEarlierProgramGoesOnWithTheSameSettingsAndNoOthers) {
  AttackSettings settings;
  settings.data = "/data";
  settings.rooftop = "box";
  settings.buildable.on = false;
  settings.objective.fp_top_k = 0;
  const nlohmann::json written = as_of_an_earlier_program(identity(settings).json);
  check_identity("checkpoint.json", written, identity(settings));
  settings.simulation.light = LightModel::visible;
  EXPECT_THAT(
      test::error_text<InputError>([&] { check_identity("checkpoint.json", written, identity(settings)); }),
      StartsWith("checkpoint.json: simulation: "));
}

TEST(Settings, ARunGoesOnWithTheUsersPluginsAsTheyWere) {
  const test::TemporaryFolder folder;
  AttackSettings settings;
  settings.data = "/data";
  settings.rooftop = "box";
  settings.detector.detector = folder / "detector.so";
  settings.depth = folder / "depth.so";
  settings.sensors = "radar," + (folder / "sonar.so").string();
  const std::vector<std::pair<std::string, std::string>> keys = {
      {"detector.so", "plugin_hash"},
      {"depth.so", "depth_hash"},
      {"weights/depth-depth.weights", "depth_hash"},
      {"sonar.so", "sensors_hash"}};
  for (const auto& [name, key] : keys) write_file(folder / name, "before");
  const nlohmann::json written = identity(settings).json;
  for (const auto& [name, key] : keys) {
    write_file(folder / name, "rebuilt");
    EXPECT_THAT(
        test::error_text<InputError>([&] { check_identity("checkpoint.json", written, identity(settings)); }),
        StartsWith("checkpoint.json: " + key + ": the run in this folder has another value"));
    nlohmann::json earlier = written;  // of a program that did not store them
    earlier.erase(key);
    check_identity("checkpoint.json", earlier, identity(settings));
    write_file(folder / name, "before");
  }
  check_identity("checkpoint.json", written, identity(settings));
  const nlohmann::json shipped = identity(everything_on()).json;
  for (const auto& [name, key] : keys) EXPECT_FALSE(shipped.contains(key)) << key;
}

TEST(Settings, AnswersOfAPluginWithoutWeightsAreKeptUnderItsContent) {
  const test::TemporaryFolder folder;
  DetectorOptions options;
  options.detector = folder / "detector.so";
  write_file(options.detector, "before");
  const std::string before = detector_identity(options);
  EXPECT_NE(before, "");
  EXPECT_EQ(detector_identity(options), before);
  write_file(options.detector, "rebuilt");
  EXPECT_NE(detector_identity(options), before);
}

TEST(Settings, ASettingThatIsGoneIsIgnoredByReadersAndRefusedByWhatGoesOn) {
  AttackSettings settings;
  settings.rooftop = "box";
  nlohmann::json written = identity(settings).json;
  written["objective"] = "gap";
  AttackSettings read;
  read_fields(JsonFields("run.json", written, "restore it"), read);
  EXPECT_EQ(fields_json(read), fields_json(settings));
  EXPECT_THAT(
      test::error_text<InputError>([&] { check_identity("checkpoint.json", written, identity(settings)); }),
      StartsWith("checkpoint.json: objective: the run in this folder has this setting, and yours does not"));
}

}  // namespace
}  // namespace mirage
