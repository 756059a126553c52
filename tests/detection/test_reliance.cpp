// The gate: planted detectors that use, ignore or barely use their picture. The claim of each shipped
// detector with a camera, against a measurement.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/files.h"
#include "detection/detect.h"
#include "detection/reliance.h"
#include "generator/dataset.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "support/planted.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using test::Eyes;
using test::kPlaces;
using test::Planted;
using test::planted_frame;
using test::write_planted;
using testing::HasSubstr;

Reliance measured(Planted detector, const fs::path& data) {
  Detector* const only[] = {&detector};
  return measure_reliance(only, data, list_frames(data));
}

TEST(Reliance, TellsPlantedDetectorsApart) {
  test::TemporaryFolder folder;
  write_planted(folder.path());
  const Reliance sees = measured(Planted(Eyes::sees), folder.path());
  EXPECT_EQ(sees.frames, kPlaces);
  EXPECT_EQ(sees.vehicles, kPlaces);
  EXPECT_DOUBLE_EQ(sees.ap70, 1);
  EXPECT_EQ(sees.ap70_swapped, 0);
  EXPECT_LT(sees.ap70_black, 0.1);  // black means the place of the darkest frame's car
  EXPECT_EQ(sees.ap70_none, 0);
  EXPECT_DOUBLE_EQ(sees.drop.value, 1);
  EXPECT_GT(sees.drop.low, 0.5);
  EXPECT_NEAR(sees.mean_delta_logit, 3 - std::log(1e-4 / (1 - 1e-4)), 1e-9);  // from 3 to the floor
  EXPECT_TRUE(sees.uses_picture());
  EXPECT_EQ(picture_note(sees), "");

  const Reliance ignores = measured(Planted(Eyes::ignores), folder.path());
  EXPECT_EQ(ignores.ap70, ignores.ap70_swapped);
  EXPECT_EQ(ignores.ap70_none, ignores.ap70);
  EXPECT_EQ(ignores.mean_delta_logit, 0);
  EXPECT_FALSE(ignores.uses_picture());
  EXPECT_THAT(picture_note(ignores),
              HasSubstr("does not use its picture, so this says nothing about images"));
}

TEST(Reliance, AGlanceIsNotEnough) {
  test::TemporaryFolder folder;
  write_planted(folder.path());
  const Reliance glances = measured(Planted(Eyes::glances), folder.path());
  EXPECT_NEAR(glances.mean_delta_logit, 0.15, 0.01);  // half of the range of brightness
  EXPECT_FALSE(glances.uses_picture());
  EXPECT_TRUE(glances.ignores_picture());
  Reliance steady = glances;  // logits that move without a drop, and a drop with hardly moved logits
  steady.mean_delta_logit = 1;
  EXPECT_FALSE(steady.uses_picture());
  steady.drop = {0.1, 0.02, 0.2};
  EXPECT_TRUE(steady.uses_picture());
  steady.mean_delta_logit = 0.4;
  EXPECT_FALSE(steady.uses_picture());
}

TEST(Reliance, SaysWhatItCannotMeasure) {
  test::TemporaryFolder folder;
  write_planted(folder.path());
  EXPECT_FALSE(measured(Planted(Eyes::needs_a_picture), folder.path()).ap70_none);
  const Reliance none = measured(Planted(Eyes::ignores, "lidar"), folder.path());
  EXPECT_FALSE(none.reads_picture);
  EXPECT_EQ(none.frames, 0);  // nothing was run
  EXPECT_THAT(picture_note(none), HasSubstr("has no picture"));
  // Two cars: AP falls from 1 to 0, but two frames are too few to tell.
  test::TemporaryFolder pair;
  for (const int k : {0, 6}) write_frame(pair.path(), planted_frame(k));
  const Reliance few = measured(Planted(Eyes::sees), pair.path());
  EXPECT_DOUBLE_EQ(few.drop.value, 1);
  EXPECT_FALSE(few.uses_picture());
  EXPECT_FALSE(few.ignores_picture());
  EXPECT_THAT(picture_note(few), HasSubstr("cannot be told from 2 cars in 2 frames"));
  EXPECT_EQ(to_json(reliance_from_json({"result.json", to_json(few), ""})), to_json(few));
  test::TemporaryFolder single;
  write_frame(single.path(), planted_frame(0));
  const Reliance alone = measured(Planted(Eyes::sees), single.path());
  EXPECT_EQ(alone.left_out, 1);
  EXPECT_FALSE(alone.uses_picture());
  EXPECT_THAT(picture_note(alone), HasSubstr("cannot be measured"));
}

TEST(Reliance, PicturesAreExchangedAmongFramesOfOneSize) {
  test::TemporaryFolder folder;
  std::vector<std::string> ids;
  for (int k = 0; k < 6; ++k) {
    const Frame frame = planted_frame(k, k == 5 ? 64 : k % 2 == 0 ? 48 : 50);
    write_frame(folder.path(), frame);
    ids.push_back(frame.id);
  }
  const auto pairs = pair_pictures(folder.path(), ids);  // a c e are of one size, b d of another, f is alone
  ASSERT_EQ(pairs.size(), 5u);
  EXPECT_EQ(pairs[0].frame, ids[0]);
  EXPECT_EQ(pairs[0].other, ids[2]);
  EXPECT_EQ(pairs[1].other, ids[3]);
  EXPECT_EQ(pairs[2].other, ids[4]);
  EXPECT_EQ(pairs[3].other, ids[1]);
  EXPECT_EQ(pairs[4].other, ids[0]);
}

TEST(Reliance, SurvivesItsJson) {
  test::TemporaryFolder folder;
  write_planted(folder.path());
  for (const Eyes eyes : {Eyes::sees, Eyes::needs_a_picture, Eyes::glances}) {
    const nlohmann::json json = to_json(measured(Planted(eyes), folder.path()));
    EXPECT_EQ(to_json(reliance_from_json({"file", json, ""})), json);
    EXPECT_EQ(json.contains("ap70_none"), eyes != Eyes::needs_a_picture);
  }
  const nlohmann::json none = to_json(measured(Planted(Eyes::ignores, "lidar"), folder.path()));
  EXPECT_EQ(none.size(), 3u);
  EXPECT_EQ(to_json(reliance_from_json({"file", none, ""})), none);
}

TEST(Reliance, ADamagedOneIsNamedByFileAndField) {
  Reliance whole;
  whole.ap70_none = 0.25;
  const nlohmann::json good = to_json(whole);
  const auto usage_error = [](const nlohmann::json& bad) {
    return test::error_text<InputError>([&] {
      reliance_from_json({"a/result.json", bad, "measure it again"});
    });
  };
  const auto complaint = [&](const char* key, const nlohmann::json& value) {
    nlohmann::json bad = good;
    bad[key] = value;
    return usage_error(bad);
  };
  EXPECT_THAT(complaint("ap70", "x"), HasSubstr("a/result.json: ap70"));
  EXPECT_THAT(complaint("ap70_none", nullptr), HasSubstr("ap70_none"));
  EXPECT_THAT(complaint("drop_low", -2), HasSubstr("drop_low"));
  EXPECT_THAT(complaint("mean_delta_logit", -1), HasSubstr("mean_delta_logit"));
  EXPECT_THAT(complaint("vehicles", 0.5), HasSubstr("vehicles"));
  EXPECT_THAT(complaint("clusters", nlohmann::json::object({{"by", "frame"}})), HasSubstr("clusters.count"));
  for (const auto& [key, value] : good.items()) {
    if (key == "uses_picture" || key == "note") continue;           // follow
    if (key == "ap70_none" || key == "delta_logit_high") continue;  // may be missing
    nlohmann::json bad = good;
    bad.erase(key);
    EXPECT_THAT(usage_error(bad), HasSubstr(fmt::format("a/result.json: {}: missing", key)));
  }
}

#ifdef MIRAGE_HAS_FUSION

/// A few generated frames of the rig, stored beside the build.
fs::path generated(const std::string& rig) {
  const fs::path data =
      fs::path(MIRAGE_BUILD) / "test_reliance" / (rig + "-" + std::to_string(kGeneratorVersion));
  generate_dataset(read_rig(fs::path(MIRAGE_SOURCE) / "scenes" / "rigs" / (rig + ".toml")), 77, 0, 4, data,
                   [](std::size_t) {});
  return data;
}

// weights/reliance.json holds the results of `mirage audit --gate --claim` on a whole data set; weights that
// it does not name claim nothing. Four frames are too few for the interval. A detector that claims to use its
// picture must still lose AP with another frame's picture, and its cars' logits must move.
TEST(Reliance, ShippedDetectorsSeeWhatTheyClaim) {
  const fs::path weights = fs::path(MIRAGE_SOURCE) / "plugins" / "detectors" / "fusion" / "weights";
  const nlohmann::json claims = read_json(weights / "reliance.json");
  int cameras = 0;
  for (const auto& entry : fs::directory_iterator(weights)) {
    if (entry.path().extension() != ".weights") continue;
    const std::string stem = entry.path().stem().string();
    const std::size_t dash = stem.find('-'), end = stem.find('-', dash + 1);
    DetectorOptions options;
    options.detector = stem.substr(0, dash);
    options.rig = stem.substr(dash + 1, end - dash - 1);
    options.weights = entry.path();
    if (end != std::string::npos && stem.substr(end + 1) == kCeiling) options.defense = kTrainedCeiling;
    const auto detector = load_detector(options);
    if (!detector->capabilities().reads_image) continue;
    ++cameras;
    const nlohmann::json claim = claims.value(stem, nlohmann::json({{"uses_picture", false}}));
    if (claims.contains(stem)) {
      EXPECT_EQ(claim.at("weights_hash"), file_hash(entry.path()))
          << stem << ": other weights than those that were measured; run mirage audit --gate --claim";
    }
    const fs::path data = generated(options.rig);
    Detector* const only[] = {detector.get()};
    const Reliance here = measure_reliance(only, data, list_frames(data));
    EXPECT_GT(here.vehicles, 10) << stem;
    if (claim.at("uses_picture").get<bool>()) {
      EXPECT_GE(here.mean_delta_logit, kMinDeltaLogit) << stem << ": " << describe(here);
      EXPECT_GT(here.drop.value, 0) << stem << ": " << describe(here);
    } else {
      EXPECT_FALSE(here.uses_picture())
          << stem << " sees and does not claim it; run mirage audit --gate --claim: " << describe(here);
    }
  }
  EXPECT_GT(cameras, 0);
}

#endif

}  // namespace
}  // namespace mirage
