// Every error of a plugin gives one clear line.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <fstream>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/sizes.h"
#include "detection/average_precision.h"
#include "detection/detector.h"
#include "detection/detector_settings.h"
#include "scene/frame_source.h"
#include "support/files.h"

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

// A plugin that returns boxes below the threshold is judged like one that keeps to it.
TEST(Loader, AnswersUnderTheThresholdAreDropped) {
  Scene scene;
  const auto version3 = load_detector(fake("works"));
  const double score = Detection({10, 1, 4, 2, 0}, 3).score();
  EXPECT_EQ(version3->forward(scene.view(), std::nextafter(score, 0), true).size(), 1u);
  EXPECT_TRUE(version3->forward(scene.view(), score, true).empty());
  EXPECT_EQ(version3->backward({}).image.data[0], 0);
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

/// The inputs of a plugin of version 4 that reads "camera", "lidar" and "back".
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
    all.others = {back};
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
  ASSERT_EQ(found.size(), 1u);  // the pedestrian is not among the classes
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

TEST(Loader, Version4IsAskedForGradientsOfWhatIsOverTheThreshold) {
  DetectorOptions options = named();
  options.classes = kEveryClass;
  const auto detector = load_detector(options);
  NamedScene scene;
  scene.points[0].x = 5;  // the car's logit is then 5.25, after the pedestrian's 4
  const double pedestrian = Detection({5, 0, 1, 1, 0}, 4).score();
  const auto found = detector->forward(scene.view(), pedestrian, true);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].logit, 5.25);
  EXPECT_EQ(detector->backward(std::vector<double>{0.5}).points[0][0], 0.5f);
  EXPECT_EQ(detector->forward(scene.view(), std::nextafter(pedestrian, 0), true).size(), 2u);
  EXPECT_EQ(detector->backward(std::vector<double>{0.25, 0.5}).points[0][0], 0.5f);
}

TEST(Loader, OfSeveralClassesThoseThatAreSoughtAreLookedAt) {
  DetectorOptions options = named();
  NamedScene scene;
  const auto found = [&](const std::string& classes) {
    options.classes = classes;
    const auto detector = load_detector(options);
    std::vector<std::string> names;
    for (const Detection& one : detector->forward(scene.view(), 0.1, true))
      names.push_back(detector->capabilities().types.at(as_size(one.type)));
    return names;
  };
  EXPECT_EQ(found("Car"), std::vector<std::string>{"Car"});
  EXPECT_EQ(found("Pedestrian"), std::vector<std::string>{"Pedestrian"});
  EXPECT_EQ(found("Car,human.pedestrian.child"), (std::vector<std::string>{"Pedestrian", "Car"}));
  EXPECT_EQ(found("Van,Truck"), std::vector<std::string>{"Car"});  // its name for vehicles
  // The gradient goes to the returned answer.
  options.classes = "Pedestrian";
  const auto detector = load_detector(options);
  detector->forward(scene.view(), 0.1, true);
  EXPECT_EQ(detector->backward(std::vector<double>{0.5}).points[0][0], 0);
}

TEST(Loader, WhatADetectorHasNoWordForIsAskedByAnother) {
  using Words = std::vector<std::string>;
  EXPECT_EQ(answering_types({"Car"}, {"Car"}), Words{"Car"});
  EXPECT_EQ(answering_types({"Car"}, {"Pedestrian"}), Words{"Car"});  // by a network of one class
  EXPECT_EQ(answering_types({"Car", "Misc"}, {"Pedestrian"}), Words{"Misc"});
  EXPECT_EQ(answering_types({"Car", "Misc"}, {"Truck", "Car"}), Words{"Car"});
  EXPECT_EQ(answering_types({"Car", "Misc"}, {"Misc", "Car"}), (Words{"Misc", "Car"}));
  EXPECT_EQ(answering_types({"Pedestrian"}, {"Car"}), Words{});
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
  ASSERT_EQ(gradient.others.at("back").size(), scene.behind.data.size());
  EXPECT_EQ(gradient.others.at("back")[0], 0.5f);
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

// A frame with several cameras gives the recorded pictures of the cameras that the detector names, and reads
// no others.
TEST(Loader, ACameraOfTheFrameIsReadByItsName) {
  const auto detector = load_detector(named());
  NamedScene scene;
  Frame frame;
  const auto camera = [&](const char* name, std::function<ImageF()> read) {
    Calibration where;
    where.camera_from_velo = scene.back.sensor_from_ego;
    frame.others.push_back({name, where, Lazy<ImageF>(std::move(read))});
  };
  camera("aside", []() -> ImageF { throw std::logic_error("nobody reads it"); });
  camera("back", [&] { return scene.behind; });
  SensorView view = scene.Scene::view();
  view.frame = &frame;
  const Detection recorded = detector->forward(view, 0.1, true).at(0);
  EXPECT_TRUE(detector->backward(std::vector<double>{0.5}).others.empty());  // none is in the view
  const Detection shown = detector->forward(scene.view(), 0.1, false).at(0);
  EXPECT_EQ(recorded.logit, shown.logit);
  EXPECT_EQ(recorded.velocity, shown.velocity);
  EXPECT_EQ(recorded.camera, 2);
  // A picture in the view replaces the recorded one.
  ImageF attacked = scene.behind;
  attacked.data[0] = 0.75f;
  scene.back.image = &attacked;
  SensorView both = scene.view();
  both.frame = &frame;
  EXPECT_EQ(detector->forward(both, 0.1, false).at(0).logit, recorded.logit + 0.5);
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

TEST(Loader, ACeilingIsOverTheRoadBelowTheUnitThatRecordedTheData) {
  const test::TemporaryFolder folder;
  const std::string shipped = shipped_file("scenes/rigs/kitti64.toml").string();
  std::string tall = read_file(shipped);
  tall.replace(tall.find("height = 1.73"), 13, "height = 2.60");
  write_file(folder / "rig.toml", tall);
  write_file(folder / "dataset.json", R"({"rig": "tall"})");
  DetectorOptions options = fake("works");
  options.defense = "ceiling:1.6";
  FrameSource source;
  source.data = folder.path();
  const DetectorOptions own = for_data(options, source);
  EXPECT_EQ(unit_height_of(own), 2.6);
  EXPECT_NO_THROW(load_detector(own));
  source.rig = shipped;
  EXPECT_EQ(unit_height_of(for_data(options, source)), 1.73);
  source.rig = (folder / "rig.toml").string();
  write_file(folder / "dataset.json", R"({"rig": "kitti64"})");
  EXPECT_EQ(unit_height_of(for_data(options, source)), 2.6);
}

TEST(Loader, MissingPlugin) {
  DetectorOptions options;
  options.detector = "/nowhere/plugin.so";
  EXPECT_THAT(load_error(options), HasSubstr("/nowhere/plugin.so: no such detector plugin"));
}

TEST(Loader, UnknownName) {
  DetectorOptions options;
  options.detector = "pointpillars";
  EXPECT_THAT(load_error(options), HasSubstr("pointpillars: unknown; use clusters, lidar, camera"));
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

/// The user's own plugin, in its own folder.
DetectorOptions copied_to(const test::TemporaryFolder& folder) {
  DetectorOptions options;
  options.detector = folder / "fake_works.so";
  std::filesystem::copy_file(fake("works").detector, options.detector);
  return options;
}

TEST(Loader, APluginWithoutWeightsNeedsNone) {
  const test::TemporaryFolder folder;
  DetectorOptions options = copied_to(folder);
  EXPECT_EQ(weights_file(options), "");
  EXPECT_EQ(weights_hash(options), file_hash(options.detector));
  Scene scene;
  EXPECT_EQ(load_detector(options)->forward(scene.view(), 0.1, false).size(), 1u);
  options.start = true;
  EXPECT_THAT(load_error(options), HasSubstr("weights: the training starts from some, and "));
  options.start = false;
  write_file(folder / "weights/fake_works-kitti64.weights", "its own");
  EXPECT_EQ(weights_file(options), folder / "weights/fake_works-kitti64.weights");
}

TEST(Loader, MissingWeights) {
  const test::TemporaryFolder folder;
  DetectorOptions options = copied_to(folder);
  write_file(folder / "weights/fake_works-other.weights", "of another rig");
  EXPECT_THAT(load_error(options), HasSubstr("no shipped weights of fake_works for the rig kitti64"));
  options.rig = "xenith";
  EXPECT_THAT(load_error(options), HasSubstr("fake_works-xenith.weights"));
  EXPECT_THAT(load_error(options), HasSubstr("--weights"));
  options.weights = "real";
  EXPECT_THAT(load_error(options), HasSubstr("fake_works-xenith-real.weights"));
  EXPECT_THAT(load_error(options), HasSubstr("fine-tuned on real frames"));
  options.defense = "adversarial";
  EXPECT_THAT(load_error(options), HasSubstr("give one of the two"));
  options.defense = "real";  // the family alone is no defence
  EXPECT_THAT(load_error(options), HasSubstr("is not a defence"));
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

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

std::string refusal(const std::string& text) {
  return test::error_text<FieldError>([&] { read_defense(text); });
}

TEST(DefenseWords, WeightsAndWhatStandsAround) {
  for (const char* none : {"", "none"}) {
    EXPECT_EQ(read_defense(none).weights, "");
    EXPECT_THAT(read_defense(none).around, IsEmpty());
  }
  EXPECT_EQ(read_defense("roof-objects").weights, "roof-objects");
  EXPECT_THAT(read_defense("roof-objects").around, IsEmpty());
  EXPECT_THAT(read_defense("shadows").around, ElementsAre("shadows"));
  const Defense all = read_defense("shadows+adversarial+jpeg:50+consistency");
  EXPECT_EQ(all.weights, "adversarial");
  EXPECT_THAT(all.around, ElementsAre("shadows", "jpeg:50", "consistency"));
  EXPECT_TRUE(all.has(kShadows));
  EXPECT_TRUE(all.has(kConsistency));
  EXPECT_FALSE(read_defense("adversarial").has(kShadows));
  const Defense trained = read_defense("ceiling+shadows");
  EXPECT_EQ(trained.weights, "ceiling");
  EXPECT_THAT(trained.around, ElementsAre(kTrainedCeiling, "shadows"));
  EXPECT_EQ(read_defense("ceiling:1.4").weights, "");
}

TEST(DefenseWords, WhatIsNone) {
  for (const char* wrong :
       {"+", "shadows+", "+adversarial", "none+shadows", "Shadows", "../weights", "shadows adversarial"})
    EXPECT_THAT(refusal(wrong), HasSubstr("is not a defence")) << wrong;
  EXPECT_THAT(refusal("adversarial+denoising"), HasSubstr("two sets of weights, adversarial and denoising"));
  EXPECT_THAT(refusal("shadows+adversarial+shadows"), HasSubstr("names shadows twice"));
  EXPECT_THAT(refusal("shadows+jpeg:0"), HasSubstr("use jpeg:1 to jpeg:100"));
  for (const char* wrong :
       {"ceiling:", "ceiling:0", "ceiling:-1", "ceiling:1.6m", "ceiling:nan", "ceiling:11"})
    EXPECT_THAT(refusal(wrong), HasSubstr("use metres, such as ceiling:1.6")) << wrong;
  EXPECT_EQ(ceiling_height("ceiling:1.6"), 1.6);
  EXPECT_EQ(ceiling_height("shadows"), 0);
}

}  // namespace

// Comparisons of boxes, against cases worked out by hand.

namespace {

ObjectBoxes boxes(double x, double y, double bottom, const PictureBox& picture = {}) {
  return {Box3{{x, y, 4, 2, 0}, bottom, 2}, picture};
}

TEST(Matching, OverlapIsThatOfItsKind) {
  const ObjectBoxes a = boxes(10, 0, 0, {0, 0, 100, 50}), b = boxes(12, 0, 1, {50, 0, 150, 50});
  EXPECT_NEAR(kFromAbove.overlap(a, b), 1.0 / 3, 1e-12);
  EXPECT_NEAR(kInSpace.overlap(a, b), 4.0 / 28, 1e-12);
  EXPECT_NEAR(kInPicture.overlap(a, b), 1.0 / 3, 1e-12);
  EXPECT_NEAR(kByCentre.overlap(a, b), 0.5, 1e-12);  // 2 m
  EXPECT_EQ(kByCentre.overlap(a, boxes(14, 0, 0)), 0);
  EXPECT_EQ(kByCentre.overlap(a, boxes(30, 0, 0)), 0);
  EXPECT_DOUBLE_EQ(kFromAbove.distance(a, b), 2);
  EXPECT_DOUBLE_EQ(kInPicture.distance(a, b), 50);
  EXPECT_DOUBLE_EQ(kFromAbove.area(a), 8);
  EXPECT_DOUBLE_EQ(kInPicture.area(a), 5000);
  EXPECT_NEAR(kFromAbove.intersection(a, b), 4, 1e-12);
  EXPECT_NEAR(kInPicture.intersection(a, b), 2500, 1e-9);
}

TEST(Matching, BoxesOfTwoCamerasNeverMeet) {
  ObjectBoxes a = boxes(10, 0, 0, {0, 0, 100, 50}), b = a;
  b.camera = 2;
  EXPECT_EQ(kInPicture.overlap(a, b), 0);
  EXPECT_EQ(kInPicture.intersection(a, b), 0);
  EXPECT_DOUBLE_EQ(kFromAbove.overlap(a, b), 1);
}

TEST(Matching, NamesItselfAsTheOptionHasIt) {
  EXPECT_EQ(kFromAbove.name(), "bev");
  EXPECT_EQ(kInSpace.name(), "3d");
  EXPECT_EQ(kInPicture.name(), "picture");
  EXPECT_EQ(kByCentre.name(), "centre");
  EXPECT_EQ(std::string(words_of(MatchBy())[0]), "own");
}

TEST(Matching, DecidesWhatIsSuppressedAndWhatIsAHit) {
  Detection low({10, 0, 4, 2, 0}, 3), high = low;
  low.box.height = high.box.height = 1.5;
  high.box.bottom = 2, high.logit = 2;  // one above the other
  EXPECT_EQ(suppress({low, high}, kFromAbove).size(), 1u);
  EXPECT_EQ(suppress({low, high}, kInSpace).size(), 2u);
  Detection other = low;
  other.type = 1;
  EXPECT_EQ(suppress({low, other}, kFromAbove).size(), 2u);  // of another class
  Detection flat = low;
  flat.box.height = 0;
  EXPECT_THROW(suppress({flat}, kInSpace), InputError);

  // Turned by 90°: IoU 1/3 from above, with the same centre.
  const Detection turned({10, 0, 2, 4, 0}, 3);
  TruthBoxes truth;
  truth.boxes = {BevBox{10, 0, 4, 2, 0}};
  const auto ap = [&](Matching matching) {
    return average_precision(std::vector{ScoredFrame{{turned}, truth, 0, matching}}, 0.5).average_precision;
  };
  EXPECT_EQ(ap(kFromAbove), 0);
  EXPECT_DOUBLE_EQ(ap(kByCentre), 1);
}

}  // namespace
}  // namespace mirage
