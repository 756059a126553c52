// A vehicle of a finished drive in `mirage view`.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/adversary.h"
#include "attack/drive.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "support/tiny_drive.h"
#include "validation/view/drive_view.h"
#include "validation/view/view.h"

namespace mirage {
namespace {

using test::error_text;
using testing::HasSubstr;

/// The tiny drive, judged with a pyramid on the car.
class DriveViews : public testing::Test {
 protected:
  static constexpr std::size_t kFrames = 6;
  DriveViews() {
    test::write_tiny_drive(data(), folder_ / "object", kFrames);
    write_file(object(),
               "v -0.4 -0.4 0\nv 0.4 -0.4 0\nv 0.4 0.4 0\nv -0.4 0.4 0\nv 0 0 0.8\n"
               "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 3 2 1\nf 4 3 1\n");
    DriveRequest request;
    request.data = data();
    request.sequences = read_sequences(data());
    request.object = request.random = initial_adversary({});
    request.settings.least_frames = 5;
    request.evaluation.quiet = true;
    request.folder = drive() / "vehicles";
    FrameStore store(data(), read_lidar_model(shipped_file("scenes/rigs/kitti64.toml")));
    DetectorPool detectors;
    detectors.push_back(std::make_unique<test::StandInDetector>());
    result_ = {{"drive", to_json(judge_drive(detectors, store, request))},
               {"object", object().string()},
               {"asked", {{"rooftop", "box"}}},
               {"detector", "stand-in"},
               {"score_threshold", 0.3},
               {"provenance", {{"data", data().string()}, {"seed", 0}, {"settings", {{"between", false}}}}}};
    write_json(drive() / "result.json", result_);
  }
  std::filesystem::path data() const { return folder_ / "data"; }
  std::filesystem::path drive() const { return folder_ / "drive"; }
  std::filesystem::path object() const { return folder_ / "pyramid.obj"; }
  DriveChoice choice() const { return {.drive = drive(), .vehicle = "", .run = {}, .data = {}}; }
  std::string refused(const DriveChoice& asked) {
    return error_text<InputError>([&] { DriveView{asked}; });
  }
  test::TemporaryFolder folder_;
  nlohmann::json result_;
};

TEST_F(DriveViews, ShowsWhatWasJudgedWithTheObjectSimulatedAgain) {
  DriveView view(choice());
  EXPECT_EQ(view.name(), "0000_4");
  EXPECT_EQ(view.object(), "pyramid");
  ASSERT_EQ(view.frames().size(), kFrames);
  const nlohmann::json shown = read_json(drive() / "vehicles/0000_4.json").at("shown");
  for (std::size_t i = 0; i < kFrames; ++i) {
    ViewFrame frame;
    frame.frame = read_frame(data(), view.frames()[i], Cameras::first);
    view.add(frame);
    ASSERT_EQ(frame.attacks.size(), 1u);
    ViewAttack& attack = frame.attacks.front();
    EXPECT_EQ(attack.label, 0);
    EXPECT_FALSE(attack.patches.empty());
    for (const auto& [version, seen] :
         {std::pair("clean", &frame.found), std::pair("attacked", &attack.found)}) {
      EXPECT_TRUE(seen->looked);
      const auto &boxes = shown.at(version).at("boxes").at(i), &tracks = shown.at(version).at("tracks").at(i);
      ASSERT_EQ(seen->found.size(), boxes.size());
      ASSERT_EQ(seen->tracks.size(), tracks.size());
      EXPECT_EQ(tracks.size(), i < 2 ? 0u : 1u);  // the third detection confirms it
      for (std::size_t k = 0; k < boxes.size(); ++k) EXPECT_EQ(seen->found[k].box->bev.x, boxes[k][0]);
      for (std::size_t k = 0; k < tracks.size(); ++k) {
        EXPECT_EQ(seen->tracks[k].identity, tracks[k][0]);
        EXPECT_EQ(seen->tracks[k].box.height, tracks[k][6]);
      }
    }
  }
}

TEST_F(DriveViews, IsOnePage) {
  ViewSettings settings;
  settings.drive = drive();
  settings.page = folder_ / "page.html";
  settings.quiet = true;
  const nlohmann::json told = make_view(settings);
  EXPECT_EQ(told.at("frames"), kFrames);
  EXPECT_EQ(told.at("vehicle"), "0000_4");
  const std::string page = read_file(settings.page);
  EXPECT_THAT(page, HasSubstr("\"gap_s\""));
  EXPECT_THAT(page, HasSubstr("class Drive"));
}

TEST_F(DriveViews, RefusesWhatIsNoDriveAndOtherVehicles) {
  DriveChoice asked = choice();
  asked.vehicle = "0000_5";
  EXPECT_THAT(refused(asked), HasSubstr("did you mean 0000_4"));
  asked.vehicle = "elsewhere_77";
  EXPECT_THAT(refused(asked), HasSubstr("use 0000_4"));
  asked = choice();
  asked.drive = data();
  EXPECT_THAT(refused(asked), HasSubstr("not a finished drive"));
  asked = choice();
  asked.run = folder_ / "gone";
  EXPECT_THAT(refused(asked), HasSubstr("is not there"));
  nlohmann::json vehicle = read_json(drive() / "vehicles/0000_4.json");
  vehicle["shown"]["clean"]["boxes"][1] = {{1, 2}};
  write_json(drive() / "vehicles/0000_4.json", vehicle);
  EXPECT_THAT(refused(choice()), HasSubstr("shown.clean.boxes"));
  vehicle.erase("shown");
  write_json(drive() / "vehicles/0000_4.json", vehicle);
  EXPECT_THAT(refused(choice()), HasSubstr("run the same mirage drive again"));
  EXPECT_THAT(error_text<InputError>([&] { DriveAnimation{folder_ / "film.mp4"}; }), HasSubstr("nor .gif"));
}

TEST_F(DriveViews, LoadsNoCodeThatTheFolderNames) {
  result_["asked"]["depth"] = "exec:touch " + (folder_ / "ran").string();
  write_json(drive() / "result.json", result_);
  EXPECT_THAT(refused(choice()), HasSubstr("--trust-run"));
  result_["asked"].erase("depth");
  result_["asked"]["sensors"] = (folder_ / "sensor.so").string();
  write_json(drive() / "result.json", result_);
  EXPECT_THAT(refused(choice()), HasSubstr("which is code"));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "ran"));
}

}  // namespace
}  // namespace mirage
