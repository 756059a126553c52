// What is stored of a vehicle reads as the same vehicle, and a damaged file is told by field.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "support/files.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;

VehicleResult whole_vehicle() {
  VehicleResult vehicle;
  vehicle.host = {"000003", 2};
  vehicle.name = "000003_2";
  vehicle.from_box = true;
  vehicle.visible_share = 0.75, vehicle.adversary_points = 31;
  vehicle.losses = {{"full", "ended unexpectedly", 2}};
  vehicle.shown = {{"host_rect", {1, 2, 3, 4}}};
  SeenResult& seen = vehicle.seen.emplace();
  seen.matched.mask_iou = 0.99, seen.matched.rays = 12;
  seen.samples = 64;
  seen.full.mae = 0.1, seen.full.error.unbiased = -0.25, seen.full.error.interval = {-0.5, -1, 0.5};
  seen.range = 9.5, seen.detected = true, seen.clean = {0.8, 0.9};
  seen.raster = {0.1, 0.2, -1.5, true, false}, seen.cycles = {0.9, 0.8, 1.5, false, true};
  seen.arms = ArmsResult{{{{ArmLight::raster, ArmReturns::ideal}, seen.raster}},
                         {{{Channel::image, "noise"}, seen.cycles}}};
  seen.pictures = {{"clean", "pictures/000003_2_clean.png"}};
  LadderResult& ladder = seen.ladder.emplace();
  LightRungResult rung;
  rung.effect = "+clear sky", rung.group = "cycles", rung.base = "matched", rung.seconds = 2;
  rung.change.psnr = HUGE_VAL;  // equal pictures
  rung.to_full.relative = 0.3, rung.outcome = seen.raster;
  ladder.light = {rung};
  ladder.lidar = {{"noise", 7, 0.5, -0.25, 0.125, std::nullopt}};
  ladder.reference = {256, 8, 0.02};
  ladder.features = {{"range", 9.5}};
  return vehicle;
}

TEST(VehicleResult, ReadsAsItWasWritten) {
  const VehicleResult vehicle = whole_vehicle();
  const json stored = json::parse(to_json(vehicle).dump());
  const VehicleResult read = read_vehicle("v.json", stored);
  EXPECT_EQ(to_json(read), to_json(vehicle));
  EXPECT_EQ(read.seen->ladder->light.at(0).change.psnr, HUGE_VAL);
  EXPECT_EQ(read.seen->cycles.fooled(), true);
  EXPECT_FALSE(read.seen->ladder->lidar.at(0).outcome);
  VehicleResult unseen;
  unseen.host = {"000004", 0};
  EXPECT_EQ(to_json(read_vehicle("v.json", to_json(unseen))), to_json(unseen));
  EXPECT_FALSE(read_vehicle("v.json", to_json(unseen)).seen);
}

/// Every field that is missing or of another type is told; or it would be read as 0.
TEST(VehicleResult, EveryFieldIsMissed) {
  const json whole = to_json(whole_vehicle());
  int fields = 0;
  for (const json& place : whole.flatten()) static_cast<void>(place), ++fields;
  int refused = 0, kept = 0;
  const json flat = whole.flatten();
  for (const auto& [pointer, value] : flat.items()) {
    json damaged = whole;
    damaged[json::json_pointer(pointer)] = json::array({"no"});
    try {
      read_vehicle("v.json", damaged);
      ++kept;
      // What the report alone shows, and the roots beside the squares.
      EXPECT_TRUE(pointer.starts_with("/host_rect") || pointer.find("error_") != std::string::npos ||
                  pointer.ends_with("/floor"))
          << pointer;
    } catch (const InputError& error) {
      ++refused;
      EXPECT_THAT(std::string(error.what()), AllOf(HasSubstr("v.json"), HasSubstr("made again"))) << pointer;
    }
  }
  EXPECT_EQ(refused + kept, fields);
  EXPECT_GT(refused, 80);
}

}  // namespace
}  // namespace mirage
