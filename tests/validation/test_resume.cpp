// A validation that was stopped goes on where it was, to the same result; and one whose renderer is lost.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "attack/tiny_world.h"
#include "base/error.h"
#include "exchange/gltf.h"
#include "fixture.h"
#include "plain_reference.h"
#include "support/files.h"
#include "validation/fidelity/validate.h"

namespace mirage {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

/// A finished run of a random mesh on the tiny frames, for a detector that always finds the same box.
ValidationSettings tiny_validation(const test::TemporaryFolder& folder) {
  test::write_tiny_data(folder / "data", 2);
  const TexturedMesh mesh = test::random_mesh(3);
  write_adversary(folder / "run/adversary.glb", mesh);
  write_adversary(folder / "run/random.glb", mesh);
  write_file(folder / "weights", "none");
  AttackSettings attack;
  attack.data = folder / "data";
  attack.rooftop = "box";
  attack.detector.detector = MIRAGE_BUILD "/test_plugins/fake_works.so";
  attack.detector.weights = folder / "weights";
  attack.target = AttackTarget::random;
  test::write_run_json(folder / "run", attack, {{"000000", 0}}, {{"000001", 0}});
  ValidationSettings settings;
  settings.run = folder / "run";
  settings.trust = TrustRun::yes;  // its detector is a plugin
  settings.out = folder / "out";
  settings.frames = 2;
  settings.samples = 2;
  settings.ladder = 1;
  settings.quiet = true;
  return settings;
}

/// Starts a plain loop in place of Blender.
StartReference plain(const test::Planted& planted = {}) {
  return [planted](const fs::path&) { return std::make_unique<test::PlainReference>(planted); };
}

/// result.json of the validation.
json validated(const ValidationSettings& settings, const test::Planted& planted = {}) {
  const fs::path file = settings.out / "result.json";
  write_json(file, to_json(validate(settings, plain(planted))));
  const std::string written = read_file(file);
  write_report(settings);
  EXPECT_TRUE(fs::exists(settings.out / "report.html"));
  EXPECT_EQ(read_file(file), written) << "the report writes the page alone";
  return json::parse(written);
}

/// Without what a clock says.
json timeless(json value) {
  if (value.is_object()) {
    for (const char* key : {"seconds", "report"}) value.erase(key);
    for (auto& [key, part] : value.items()) part = timeless(part);
  } else if (value.is_array()) {
    for (json& part : value) part = timeless(part);
  }
  return value;
}

TEST(Resume, AStoppedValidationEndsAtTheSameResult) {
  const test::TemporaryFolder folder;
  const ValidationSettings settings = tiny_validation(folder);
  const json whole = validated(settings);
  ASSERT_EQ(whole.at("vehicles"), 2);
  EXPECT_EQ(whole.at("reference"),
            json({{"name", "a plain loop"}, {"version", "1"}, {"losses", json::array()}}));
  EXPECT_EQ(whole.at("failed"), json::array());
  EXPECT_FALSE(whole.at("ladder").empty());
  EXPECT_TRUE(fs::exists(settings.out / "result.json"));

  // What a stop after the first vehicle leaves: no result, and a temporary file at most.
  const fs::path first = settings.out / "hosts/000001_0.json", second = settings.out / "hosts/000000_0.json";
  fs::remove(settings.out / "result.json");
  fs::remove(second);
  const std::string kept = read_file(first);
  const auto time = fs::last_write_time(first);
  const json resumed = validated(settings);
  EXPECT_EQ(timeless(resumed), timeless(whole));
  EXPECT_EQ(read_file(first), kept);
  EXPECT_EQ(fs::last_write_time(first), time) << "a finished vehicle was made again";

  // A damaged file and one of other settings are made again.
  write_file(first, kept.substr(0, kept.size() / 2));
  EXPECT_EQ(timeless(validated(settings)), timeless(whole));
  EXPECT_EQ(timeless(json::parse(read_file(first))), timeless(json::parse(kept)));
  ValidationSettings more = settings;
  more.samples = 3;
  validate(more, plain());
  EXPECT_NE(json::parse(read_file(first)).at("key"), json::parse(kept).at("key"));
}

TEST(Resume, AVehicleThatTheRendererIsLostOnIsGivenUpAndMadeByTheNextCall) {
  const test::TemporaryFolder folder;
  const ValidationSettings settings = tiny_validation(folder);
  const json part = validated(settings, {.lost_frame = "000001"});
  EXPECT_EQ(part.at("vehicles"), 1);
  ASSERT_EQ(part.at("failed").size(), 1u);
  EXPECT_EQ(part.at("failed")[0].at("name"), "000001_0");
  const fs::path kept = settings.out / "hosts/000000_0.json";
  const auto time = fs::last_write_time(kept);
  EXPECT_EQ(validated(settings).at("vehicles"), 2);
  EXPECT_EQ(fs::last_write_time(kept), time);
  fs::remove_all(settings.out);
  EXPECT_THAT(test::error_text<Failure>([&] { validate(settings, plain({.lost_frame = "0000"})); }),
              testing::HasSubstr("a plain loop: was lost on every vehicle"));
}

TEST(Resume, APlantedDifferenceIsInTheResult) {
  const test::TemporaryFolder folder;
  const ValidationSettings settings = tiny_validation(folder);
  ValidationSettings elsewhere = settings;  // a stored vehicle's key does not name what is planted
  elsewhere.out = folder / "elsewhere";
  const json same = to_json(validate(settings, plain())),
             bright = to_json(validate(elsewhere, plain({.gain = 1.25})));
  const auto met = [](const json& result, const char* place) {
    for (const json& target : result.at("targets"))
      if (target.at("place") == place) return target.at("met").get<bool>();
    return false;
  };
  EXPECT_TRUE(met(same, "matched.hit_disagreements") && met(bright, "matched.hit_disagreements"));
  EXPECT_FALSE(met(bright, "matched.mae"));
  EXPECT_THAT(bright.at("headline").get<std::string>(), testing::HasSubstr("matched light misses a target"));
  EXPECT_GT(bright.at("matched").at("mae"), 10 * same.at("matched").at("mae").get<double>());
}

}  // namespace
}  // namespace mirage
