// The hosts that `mirage evaluate --pictures` draws, and their data.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>

#include "attack/tiny_world.h"
#include "base/files.h"
#include "base/image.h"
#include "fixture.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "validation/report/pages.h"

namespace mirage {
namespace {

HostOutcome outcome(const char* frame, double left, double clean_score, double distance) {
  HostOutcome host;
  host.id = {frame, 0};
  host.detected = true;
  host.hidden = left <= 0.7;
  host.attacked_iou = left;
  host.clean_score = clean_score;
  host.false_positive = distance > 0;
  host.false_positive_distance = distance;
  return host;
}

TEST(EvaluationPictures, ShowOtherFramesFirstAndTheClearestOnes) {
  std::vector<HostOutcome> hosts = {
      outcome("0", 0.6, 0.9, 0),   // still found, with a poor box
      outcome("1", 0, 0.5, 3),     //
      outcome("1", 0, 0.8, 40),    // hidden, with the highest clean score
      outcome("2", 0.9, 0.9, 20),  // found
      outcome("3", 0, 0.9, 50),    //
  };
  hosts[4].detected = false;  // counts in no share
  const PicturedHosts some = pictured_hosts(hosts, 2);
  EXPECT_THAT(some.hidden, testing::ElementsAre(2, 0));  // a second frame before the same one again
  EXPECT_THAT(some.false_positives, testing::ElementsAre(2, 3));
  const PicturedHosts all = pictured_hosts(hosts, 9);
  EXPECT_THAT(all.hidden, testing::ElementsAre(2, 0, 1));
  EXPECT_THAT(all.false_positives, testing::ElementsAre(2, 3, 1));
  EXPECT_TRUE(pictured_hosts(hosts, 0).hidden.empty());
  EXPECT_TRUE(pictured_hosts({}, 3).false_positives.empty());
}

TEST(EvaluationPictures, AVehicleIsShownByTheCameraThatItsLabelIsIn) {
  const test::TemporaryFolder folder;
  const std::filesystem::path data = folder / "data";
  test::write_tiny_data(data, 1);
  Frame frame = read_frame(data, "000000");  // its car has a label in a second camera, which looks back
  const BevBox& car = frame.labels.at(0).box.bev;
  Transform velo_from_turned = Transform::Identity();
  velo_from_turned.linear() = Eigen::AngleAxisd(-M_PI / 2, Vec3d::UnitZ()).toRotationMatrix();
  velo_from_turned.translation() = Vec3d(car.x, car.y + 9, 0);
  frame.others = {{"SIDE", frame.calibration, Lazy<ImageF>([] { return ImageF(248, 75, 3, 0.6f); })}};
  frame.others[0].calibration.camera_from_velo =
      frame.calibration.camera_from_velo * velo_from_turned.inverse();
  frame.labels[0].camera = 1;
  write_frame(data, frame);

  RunEvaluation evaluation;
  FrameSource source{data, "ip-basic", "box"};
  source.cameras = Cameras::all;
  evaluation.store = std::make_unique<FrameStore>(source);
  evaluation.detectors.push_back(std::make_unique<test::StandInDetector>());
  evaluation.run.adversary = test::random_mesh(3);
  evaluation.learned.hosts = {outcome("000000", 0, 0.9, 0)};
  draw_evaluation_pictures(evaluation, 1, folder / "out");

  const std::filesystem::path drawn = folder / "out/data";
  const ImageF clean = read_srgb(drawn / "000000_0/clean.png"),
               attacked = read_srgb(drawn / "000000_0/attacked.png");
  EXPECT_NEAR(clean.at(0, 0), 0.6, 0.01) << "the first camera's picture";
  EXPECT_NE(clean.data, attacked.data);
  const auto host = read_json(drawn / "pictures.json").at("hosts").at(0);
  EXPECT_EQ(host.at("camera"), "SIDE");
  double u = 0, v = 0;
  for (const auto& pixel : host.at("host").at("pixels"))
    u += pixel.at(0).get<double>() / 8, v += pixel.at(1).get<double>() / 8;
  EXPECT_NEAR(u, 122, 10);  // the camera looks at the car's middle
  EXPECT_GT(v, 0);
  EXPECT_LT(v, 75);
}

TEST(EvaluationPictures, WhoIsJudgedIsNamedAndAPlainObjectIsInItsCleanPicture) {
  const test::TemporaryFolder folder;
  const std::filesystem::path data = folder / "data";
  test::write_tiny_data(data, 1);
  Frame frame = read_frame(data, "000000");
  frame.labels[0].box.bev = {20, 2, 3.9, 1.6, 0};
  frame.labels.push_back(frame.labels[0]);
  frame.labels[1].box.bev = {12, -4, 3.9, 1.6, 0};
  write_frame(data, frame);
  const ImageF recorded = read_srgb(data / "training/image_2/000000.png");
  const auto drawn_at = [&](const char* place, int victim) {
    RunEvaluation evaluation;
    FrameSource source{data, "ip-basic", "box"};
    set_from_text(place, source.placement);
    evaluation.store = std::make_unique<FrameStore>(source);
    evaluation.detectors.push_back(std::make_unique<test::StandInDetector>());
    evaluation.run.adversary = test::random_mesh(3);
    evaluation.target_run.settings.placement = source.placement;
    evaluation.learned.hosts = {outcome("000000", 0, 0.9, 0)};
    evaluation.learned.hosts[0].victim = victim;
    draw_evaluation_pictures(evaluation, 1, folder / place);
    return read_json(folder / place / "data/pictures.json");
  };
  const auto clean = [&](const char* place) {
    return read_srgb(folder / place / "data/000000_0/clean.png").data;
  };
  const auto object = drawn_at("debris", -1);
  EXPECT_EQ(object.at("victim"), "object");
  EXPECT_EQ(object.at("hosts").at(0).at("title"), "object at 000000_0");
  EXPECT_NEAR(object.at("hosts").at(0).at("host").at("x").get<double>(), 20 - 3.9 / 2 - 6, 0.3);
  EXPECT_NE(clean("debris"), recorded.data);
  const auto neighbour = drawn_at("kerb", 1);
  EXPECT_EQ(neighbour.at("victim"), "neighbour");
  EXPECT_EQ(neighbour.at("hosts").at(0).at("title"), "000000_1 (host 000000_0)");
  EXPECT_NEAR(neighbour.at("hosts").at(0).at("host").at("x").get<double>(), 12, 0.02);
  EXPECT_EQ(clean("kerb"), recorded.data);
  const auto host = drawn_at("roof", -1);
  EXPECT_EQ(host.at("hosts").at(0).at("title"), "000000_0");
}

}  // namespace
}  // namespace mirage
