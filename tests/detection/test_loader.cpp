// Every way a plugin can be wrong gives one clear line.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "base/error.h"
#include "detection/detector.h"

namespace mirage {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

DetectorOptions fake(const std::string& kind) {
  DetectorOptions options;
  options.detector = std::string(MIRAGE_BUILD) + "/test_plugins/fake_" + kind + ".so";
  options.fresh = true;
  return options;
}

template <class Error, class Work>
std::string message_of(const Work& work) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), Not(HasSubstr("\n")));
    return error.what();
  } catch (const std::exception& error) {
    ADD_FAILURE() << "another kind of error: " << error.what();
  }
  return "";
}

std::string load_error(const DetectorOptions& options) {
  return message_of<InputError>([&] { load_detector(options); });
}

struct Scene {
  ImageF image{8, 4, 3};
  std::vector<LidarPoint> points{{1, 0, 0, 0}};
  Calibration calibration;
  SensorView view() { return {&image, points, &calibration}; }
};

TEST(Loader, RunsAPluginThatWorks) {
  const auto detector = load_detector(fake("works"));
  Scene scene;
  scene.image = ImageF(64, 48, 3);
  EXPECT_EQ(detector->region()[1], 50);
  const auto proposals = detector->forward(scene.view(), 0.1, true);
  ASSERT_EQ(proposals.size(), 1u);
  EXPECT_EQ(proposals[0].logit, 3);
  EXPECT_EQ(proposals[0].picture.right, 50);
  const Capabilities can = detector->capabilities();
  EXPECT_TRUE(can.reads_image && can.finds_bev && can.finds_picture);
  EXPECT_FALSE(can.reads_points);
  const std::vector<double> d = {0.5};
  const SensorGradient gradient = detector->backward(d);
  EXPECT_EQ(gradient.image.data[0], 0.5f);
  EXPECT_EQ(gradient.points[0][0], 1.0f);
}

TEST(Loader, BoxesEndAtThePicturesBorder) {
  const auto detector = load_detector(fake("works"));
  Scene scene;
  scene.image = ImageF(41, 40, 3);
  const PictureBox box = detector->forward(scene.view(), 0.1, false).at(0).picture;
  EXPECT_EQ(box.left, 20);
  EXPECT_EQ(box.top, 30);
  EXPECT_EQ(box.right, 40);
  EXPECT_EQ(box.bottom, 39);
}

TEST(Loader, HandsThePicturesTruthOn) {
  const auto detector = load_detector(fake("works"));
  Scene scene;
  const std::vector<std::uint8_t> mask(32, 1);
  std::vector<TrainingSample> samples(3);
  for (TrainingSample& sample : samples) sample.input = scene.view();
  TrainingLoss loss = detector->train_step(samples, 1e-3);
  EXPECT_EQ(loss.total, 0);
  EXPECT_EQ(loss.box, -1);  // no mask
  samples[2].picture_boxes = {{1, 2, 3, 4}, {5, 6, 7, 8}};
  samples[2].picture_ignore = {{1, 2, 3, 4}};
  samples[2].vehicle_mask = mask;
  samples[2].picture_key = 41;
  loss = detector->train_step(samples, 1e-3);
  EXPECT_EQ(loss.total, 21);
  EXPECT_EQ(loss.score, 8);
  EXPECT_EQ(loss.box, 42);
}

/// What a plugin of version 4 that reads "camera", "lidar" and "back" is shown.
struct NamedScene : Scene {
  ImageF behind{64, 8, 3};
  SensorData back;
  NamedScene() {
    behind.data[0] = 0.25f;
    back.name = "back", back.image = &behind;
    back.sensor_from_ego.translation() = Vec3d(2, 0, 0);
  }
  SensorView view() {
    SensorView all = Scene::view();
    all.others = {&back, 1};
    return all;
  }
};

DetectorOptions named() {
  DetectorOptions options;
  options.detector = std::string(MIRAGE_BUILD) + "/test_plugins/named.so";
  options.fresh = true;
  return options;
}

TEST(Loader, Version4ReadsSensorsByNameAndAnswersIn3d) {
  const auto detector = load_detector(named());
  NamedScene scene;
  const auto found = detector->forward(scene.view(), 0.1, true);
  ASSERT_EQ(found.size(), 1u);  // the pedestrian is none of the classes looked for
  const Detection& car = found[0];
  EXPECT_EQ(car.box.bev.x, -13);  // three sensors
  EXPECT_DOUBLE_EQ(car.box.bottom, -1.75);
  EXPECT_DOUBLE_EQ(car.box.height, 1.5);
  EXPECT_EQ(car.logit, 1.25);  // of the camera behind and the first return
  EXPECT_EQ(car.identity, 7);
  EXPECT_EQ(car.velocity->x(), 2);  // where that camera stands
  EXPECT_EQ(car.camera, 2);
  EXPECT_EQ(car.picture.right, 63);  // ends at that picture's border
  const Capabilities can = detector->capabilities();
  EXPECT_TRUE(can.finds_heights && can.remembers && can.has_gradients && can.knows_presence);
  EXPECT_EQ(can.types, std::vector<std::string>{"Car"});
  EXPECT_EQ(detector->region()[0], -50);
}

TEST(Loader, Version4GivesGradientsByTheSameNames) {
  const auto detector = load_detector(named());
  NamedScene scene;
  SensorView view = scene.view();
  const std::vector<LidarPoint> places{{3, 0, 0, 0}};
  view.watched = places;
  detector->forward(view, 0.1, true);
  const SensorGradient gradient = detector->backward(std::vector<double>{0.5});
  EXPECT_EQ(gradient.image.data[0], 0);
  EXPECT_EQ(gradient.points[0][0], 0.5f);
  ASSERT_EQ(gradient.others.size(), 1u);
  ASSERT_EQ(gradient.others[0].size(), scene.behind.data.size());
  EXPECT_EQ(gradient.others[0][0], 0.5f);
  EXPECT_EQ(gradient.presence, std::vector<float>{1.5f});
}

TEST(Loader, Version4StartsAnewWhereAFrameDoesNotContinue) {
  const auto detector = load_detector(named());
  NamedScene scene;
  SensorView view = scene.view();
  const auto frames = [&] { return detector->forward(view, 0.1, false).at(0).box.bev.y; };
  EXPECT_EQ(frames(), 1);
  view.continues = true;
  EXPECT_EQ(frames(), 2);
  view.continues = false;
  EXPECT_EQ(frames(), 1);
}

TEST(Loader, Version4LearnsFromBoxesInSpaceAndInThePicture) {
  const auto detector = load_detector(named());
  NamedScene scene;
  TrainingSample sample;
  sample.input = scene.view();
  sample.boxes = {{10, 0, 4.5, 2, 0}};
  sample.picture_ignore = {{5, 6, 7, 8}};
  const TrainingLoss loss = detector->train_step({&sample, 1}, 1e-3);
  EXPECT_EQ(loss.total, 2);
  EXPECT_EQ(loss.score, 4.5);
  EXPECT_EQ(loss.box, 7);
  EXPECT_EQ(detector->weights_version(), 1u);
}

TEST(Loader, ASensorThatTheFrameLacksIsNamed) {
  const auto detector = load_detector(named());
  Scene scene;
  EXPECT_THAT(message_of<InputError>([&] { detector->forward(scene.view(), 0.1, false); }),
              HasSubstr("named.so: back: the frame has no such sensor"));
}

TEST(Loader, AWayOfComparingThatItsBoxesLackIsRefused) {
  DetectorOptions options = fake("works");
  options.matching = MatchBy::space;
  EXPECT_THAT(message_of<FieldError>([&] { load_detector(options); }),
              HasSubstr("finds no heights of its boxes"));
  options.matching = MatchBy::centre;
  EXPECT_EQ(load_detector(options)->capabilities().matching().name(), "centre");
  options = named();
  options.matching = MatchBy::space;
  EXPECT_EQ(load_detector(options)->capabilities().matching().name(), "3d");
}

TEST(Loader, MissingPlugin) {
  DetectorOptions options;
  options.detector = "/nowhere/plugin.so";
  EXPECT_THAT(load_error(options), HasSubstr("/nowhere/plugin.so: no such detector plugin"));
}

TEST(Loader, UnknownName) {
  DetectorOptions options;
  options.detector = "pointpillars";
  EXPECT_THAT(load_error(options), HasSubstr("pointpillars: unknown; use lidar, camera"));
}

TEST(Loader, NotALibrary) {
  const std::string path = ::testing::TempDir() + "mirage_text_" + std::to_string(getpid()) + ".so";
  std::ofstream(path) << "this is text";
  DetectorOptions options;
  options.detector = path;
  options.fresh = true;
  EXPECT_THAT(load_error(options), HasSubstr("not a loadable plugin"));
  std::remove(path.c_str());
}

TEST(Loader, NoEntryPoint) {
  EXPECT_THAT(load_error(fake("no_entry")), HasSubstr("lacks this entry point"));
}

TEST(Loader, WrongAbi) {
  EXPECT_THAT(load_error(fake("wrong_abi")), HasSubstr("abi_version: is 999, this program speaks 4 and 3"));
}

TEST(Loader, PluginThatRefuses) {
  EXPECT_THAT(load_error(fake("refuses")), HasSubstr("these weights are for another network"));
}

TEST(Loader, PluginThatThrowsInCreate) {
  EXPECT_THAT(message_of<Failure>([] { load_detector(fake("throws_in_create")); }),
              HasSubstr("create threw an exception (thrown on purpose)"));
}

TEST(Loader, PluginThatThrowsOrFailsLater) {
  Scene scene;
  const auto run = [&](const char* kind) {
    const auto detector = load_detector(fake(kind));
    return message_of<Failure>([&] { detector->forward(scene.view(), 0.1, false); });
  };
  EXPECT_THAT(run("throws_in_run"), HasSubstr("forward threw an exception (thrown on purpose)"));
  EXPECT_THAT(run("fails_in_run"), HasSubstr("forward failed (out of luck)"));
  const auto detector = load_detector(fake("not_finite"));
  EXPECT_THAT(message_of<InputError>([&] { detector->forward(scene.view(), 0.1, false); }),
              AllOf(HasSubstr("fake_not_finite.so: box 0 of 1: "), HasSubstr("not finite")));
}

TEST(Loader, MissingWeights) {
  DetectorOptions options = fake("works");
  options.fresh = false;
  EXPECT_THAT(load_error(options), HasSubstr("no shipped weights of fake_works for the rig kitti64"));
  options.rig = "xenith";
  EXPECT_THAT(load_error(options), HasSubstr("fake_works-xenith.weights"));
  EXPECT_THAT(load_error(options), HasSubstr("--weights"));
  options.weights = "real";
  EXPECT_THAT(load_error(options), HasSubstr("fake_works-xenith-real.weights"));
  EXPECT_THAT(load_error(options), HasSubstr("fine-tuned on real frames"));
  options.defense = "adversarial";
  EXPECT_THAT(load_error(options), HasSubstr("give one of the two"));
  options.defense = "real";  // the family is no defence
  EXPECT_THAT(load_error(options), HasSubstr("is no defence"));
  options.defense = "none";
  options.weights = "/nowhere/my.weights";
  EXPECT_THAT(load_error(options), HasSubstr("/nowhere/my.weights: no such weights file"));
}

TEST(Loader, MissingWeightsOfABranch) {
  DetectorOptions options = fake("works");
  options.camera = "/nowhere/camera.weights";
  EXPECT_THAT(load_error(options),
              HasSubstr("/nowhere/camera.weights: no such weights file; check --camera"));
  options.camera.clear();
  options.lidar = "/nowhere/lidar.weights";
  EXPECT_THAT(load_error(options), HasSubstr("check --lidar"));
}

}  // namespace
}  // namespace mirage
