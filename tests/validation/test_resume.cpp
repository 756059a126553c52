// A stopped validation resumes to the same result; and a validation that loses its renderer.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <set>

#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "exchange/gltf.h"
#include "fixture.h"
#include "frames/frame_provenance.h"
#include "plain_reference.h"
#include "scene/data/read_frames.h"
#include "support/each_field.h"
#include "support/files.h"
#include "validation/blender/blender_process.h"
#include "validation/fidelity/validate.h"
#include "validation/tradeoff/subjects.h"

namespace mirage {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

/// A tiny frame with a second camera that sees its car from the left.
Frame with_side(const fs::path& data, const std::string& id) {
  Frame frame = read_frame(data, id);
  const BevBox& car = frame.labels.at(0).box.bev;
  Transform velo_from_turned = Transform::Identity();
  velo_from_turned.linear() = Eigen::AngleAxisd(-M_PI / 2, Vec3d::UnitZ()).toRotationMatrix();
  velo_from_turned.translation() = Vec3d(car.x, car.y + 9, 0);
  frame.others = {{"SIDE", frame.calibration, Lazy<ImageF>([] { return ImageF(248, 75, 3, 0.4f); })}};
  frame.others[0].calibration.camera_from_velo =
      frame.calibration.camera_from_velo * velo_from_turned.inverse();
  return frame;
}

/// A finished run with a random mesh on the tiny frames, for a detector that always finds the same box.
ValidationSettings tiny_validation(const test::TemporaryFolder& folder, Cameras cameras = Cameras::first) {
  test::write_tiny_data(folder / "data", 2);
  if (cameras == Cameras::all)
    for (const char* id : {"000000", "000001"}) write_frame(folder / "data", with_side(folder / "data", id));
  const TexturedMesh mesh = test::random_mesh(3);
  write_adversary(folder / "run/adversary.glb", mesh);
  write_adversary(folder / "run/random.glb", mesh);
  write_file(folder / "weights", "none");
  AttackSettings attack;
  attack.data = folder / "data";
  attack.rooftop = "box";
  attack.cameras = cameras;
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

/// Runs the validation; returns result.json.
json validated(const ValidationSettings& settings, const test::Planted& planted = {}) {
  const fs::path file = settings.out / "result.json";
  write_json(file, to_json(validate(settings, plain(planted))));
  const std::string written = read_file(file);
  write_report(settings);
  EXPECT_TRUE(fs::exists(settings.out / "report.html"));
  EXPECT_EQ(read_file(file), written) << "the report writes the page alone";
  return json::parse(written);
}

/// The value without measured times.
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

  // State after a stop after the first vehicle: no result, and at most a temporary file.
  const fs::path first = settings.out / "hosts/000001_0.json", second = settings.out / "hosts/000000_0.json";
  fs::remove(settings.out / "result.json");
  fs::remove(second);
  const std::string kept = read_file(first);
  const auto time = fs::last_write_time(first);
  const json resumed = validated(settings);
  EXPECT_EQ(timeless(resumed), timeless(whole));
  EXPECT_EQ(read_file(first), kept);
  EXPECT_EQ(fs::last_write_time(first), time) << "a finished vehicle was made again";

  // A damaged file and one with other settings are made again.
  write_file(first, kept.substr(0, kept.size() / 2));
  EXPECT_EQ(timeless(validated(settings)), timeless(whole));
  EXPECT_EQ(timeless(json::parse(read_file(first))), timeless(json::parse(kept)));
  ValidationSettings more = settings;
  more.samples = 3;
  validate(more, plain());
  EXPECT_NE(json::parse(read_file(first)).at("key"), json::parse(kept).at("key"));
}

TEST(Resume, AProgramsVehiclesAreThoseOfItsVersion) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  write_file(folder / "detector.py", R"(
import os
import mirage_serve
import numpy as np

here = os.path.dirname(os.path.abspath(__file__))

def read(name):
    with open(os.path.join(here, name)) as file:
        return file.read()

class Detector:
    version = read("version")

    def __call__(self, image, points, pixel_from_velo):
        return np.float32([[11.4, 0, 3.9, 1.6, 0]]), np.float32([float(read("logit"))])

mirage_serve.serve(Detector())
)");
  settings.detector.detector = fmt::format("exec:/usr/bin/python3 -B {}", (folder / "detector.py").string());
  settings.ladder = 0;
  const auto with = [&](const char* version, const char* logit) {
    write_file(folder / "version", version);
    write_file(folder / "logit", logit);
    validate(settings, plain());
    return fs::last_write_time(settings.out / "hosts/000001_0.json");
  };
  const auto first = with("1", "2");
  EXPECT_EQ(with("1", "3"), first) << "a finished vehicle was made again";
  const auto second = with("2", "3");
  EXPECT_NE(second, first);
  const auto third = with("", "3");
  EXPECT_NE(third, second);
  EXPECT_NE(with("", "3"), third);  // without a version no answer is stored
}

TEST(Resume, TheObjectIsAsTheWorkshopMadeItForBothRenderers) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  const TexturedMesh designed = read_adversary(settings.run / "adversary.glb");
  settings.expect = "shape:0.03,colour,roof,tilt";
  settings.seed = 5;
  const json whole = validated(settings);
  EXPECT_EQ(whole.at("expect"), settings.expect);
  EXPECT_EQ(whole.at("vehicles"), 2);
  for (const json& target : whole.at("targets")) EXPECT_TRUE(target.at("met")) << target;
  // The exported scene has the object that evaluate --expect judges on this vehicle.
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  for (const HostId& id : {HostId{"000000", 0}, HostId{"000001", 0}}) {
    const SampledEnvironment draw(parse_expectation(settings.expect), settings.seed, draw_of(id));
    const Mesh expected = place(draw.built(designed), draw.placement(store.placement(id))).mesh;
    const RenderScene scene = read_scene(settings.out / "scenes" / (host_name(id) + ".glb"));
    double off = 1;
    for (const RenderScene::Thing& thing : scene.things) {
      const auto& vertices = thing.textured.mesh.vertices;
      if (vertices.size() != expected.vertices.size()) continue;
      off = 0;
      for (std::size_t i = 0; i < vertices.size(); ++i)
        off = std::max(off, (vertices[i] - expected.vertices[i]).norm());
    }
    EXPECT_LT(off, 1e-5);
  }
  // Another seed samples another environment: another key. An expectation of the world is refused.
  const std::string vehicle = read_file(settings.out / "hosts/000001_0.json");
  settings.seed = 6;
  validated(settings);
  EXPECT_NE(read_file(settings.out / "hosts/000001_0.json"), vehicle);
  settings.expect = "shape,sun";
  EXPECT_THAT(test::error_text<InputError>([&] { validate(settings, plain()); }),
              testing::HasSubstr("expectation: sun: "));
}

/// Finds the car while all pictures are as recorded, and not if any of them has changed.
class PhotographFinder : public test::StandInDetector {
 public:
  Capabilities capabilities() const override {
    Capabilities can;
    can.reads = {"camera", "SIDE", "lidar"};
    return can;
  }
  std::vector<Detection> forward(const SensorView& view, double threshold, bool) override {
    const bool recorded = view.image->data == view.frame->image.data && view.others.empty();
    const Detection proposal{{11.5, 0, 4, 1.7, 0}, recorded ? kSure : -kSure};
    return proposal.score() > threshold ? std::vector{proposal} : std::vector<Detection>();
  }
  static constexpr double kSure = 2;  // logit: above the least score of a detection, −kSure below it
};

TEST(VehicleValidation, AControlTakesTheObjectOutOfEveryPicture) {
  for (const Cameras cameras : {Cameras::first, Cameras::all}) {
    const test::TemporaryFolder folder;
    const ValidationSettings settings = tiny_validation(folder, cameras);
    for (const char* part : {"hosts", "scenes", "pictures"}) fs::create_directories(settings.out / part);
    const mirage::Run run = read_run(settings.run, settings.trust);
    FrameStore store(run.settings);
    PhotographFinder detector;
    test::PlainReference renderer;
    ValidationContext context{settings, run, run.settings.simulation, store, detector, renderer, {}};
    const VehicleResult vehicle = validate_vehicle(context, {"000000", 0}, false);
    ASSERT_TRUE(vehicle.seen && vehicle.seen->detected && vehicle.seen->conditions);
    for (const ConditionResult& shown : vehicle.seen->conditions->conditions)
      EXPECT_TRUE(shown.outcome.hidden);
    ASSERT_EQ(vehicle.seen->conditions->controls.size(), 3u);
    for (const ControlResult& control : vehicle.seen->conditions->controls) {
      const bool photograph = control.control.control == "photograph";
      EXPECT_EQ(control.outcome.hidden, !photograph) << control.control.control;
      if (photograph) {
        EXPECT_EQ(control.outcome.logit, PhotographFinder::kSure);
      }
    }
  }
}

TEST(Resume, AnEvaluationIsOfTheSameRunAndItsDifferencesAreNamed) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  settings.evaluation = folder / "evaluation";
  settings.provenance->input("run", "this run");  // like the command line
  const auto evaluated = [&](const json& inputs) {
    write_json(settings.evaluation / "result.json",
               {{"fn_asr", 0.5},
                {"provenance", {{"inputs", inputs}, {"detector", "another"}, {"defense", "none"}}}});
  };
  evaluated({{"run", "another run"}});
  EXPECT_THAT(test::error_text<InputError>([&] { validate(settings, plain()); }),
              testing::AllOf(testing::HasSubstr("provenance.inputs.run: is of another run"),
                             testing::HasSubstr("evaluation/result.json")));
  evaluated({{"mesh", "an object"}});
  EXPECT_THAT(test::error_text<InputError>([&] { validate(settings, plain()); }),
              testing::HasSubstr("--mesh"));
  EXPECT_FALSE(fs::exists(settings.out)) << "says so before it starts";
  evaluated({{"run", "this run"}});
  const json result = to_json(validate(settings, plain()));
  ASSERT_EQ(result.at("evaluation_differences").size(), 1u);
  EXPECT_THAT(result.at("evaluation_differences")[0].get<std::string>(),
              testing::StartsWith("detector: another there, "));
}

// Rates of an evaluation under other rules must not stand beside this validation's.
TEST(Resume, TheRulesOfAnEvaluationAreCompared) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  settings.ladder = 0;
  settings.evaluation = folder / "evaluation";
  settings.provenance->input("run", "this run");
  const AttackSettings own = read_run(settings.run, settings.trust).settings;
  json evaluation = {{"fn_asr", 0.5},
                     {"detected_iou", EvaluationSettings().detected_iou},
                     {"score_threshold", EvaluationSettings().score_threshold},
                     {"plane", "bev"},
                     {"placement", text_of(own.placement)},
                     {"placed", to_json(own.placement)},
                     {"simulation", fields_json(own.simulation)},
                     {"provenance",
                      {{"inputs", {{"run", "this run"}}},
                       {"settings", {{"expect", "colour,shape"}, {"sun", "frame"}, {"cameras", "first"}}}}}};
  evaluation["simulation"]["lidar_effects"]["seed"] = 5;  // the seed of noise that is off
  const auto differences = [&] {
    write_json(settings.evaluation / "result.json", evaluation);
    return to_json(validate(settings, plain())).value("evaluation_differences", std::vector<std::string>());
  };
  settings.expect = "shape,colour";
  EXPECT_THAT(differences(), testing::ElementsAre());
  settings.expect = "none";
  evaluation["detected_iou"] = 0.5;
  evaluation["score_threshold"] = 0.1;
  evaluation["plane"] = "3d";
  evaluation["placement"] = "kerb";
  evaluation["placed"]["anchor"] = "right";
  evaluation["provenance"]["settings"]["sun"] = "90,30";
  evaluation["simulation"]["light"] = "visible";
  evaluation["simulation"]["lidar_effects"]["drop_out"] = 0.1;
  EXPECT_THAT(differences(), testing::ElementsAre(
                                 "--iou: 0.5 there, 0.7 here", "--score: 0.1 there, 0.3 here",
                                 "--matching: 3d there, bev here", "--expect: colour,shape there, none here",
                                 "--place: kerb there, roof here", "--sun: 90,30 there, frame here",
                                 "lidar_effects: other values there", "light: visible there, plain here"));
  evaluation = {{"fn_asr", 0.5},
                {"placement", text_of(own.placement)},
                {"placed", to_json(own.placement)},
                {"provenance", {{"inputs", {{"run", "this run"}}}}}};
  evaluation["placed"]["yaw"] = 90;
  EXPECT_THAT(differences(), testing::ElementsAre("--place's file: other values there"));
}

// A run stores its vehicles as label indices; in other label files they are other cars.
TEST(Resume, FramesThatHaveChangedSinceTheAttackAreRefused) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  settings.ladder = 0;
  json run = read_json(settings.run / "run.json");
  const std::vector<std::string> train = {"000000"}, test = {"000001"};
  run[kTrainFrames] = frames_hash(folder / "data", train, Cameras::first);
  run[kTestFrames] = frames_hash(folder / "data", test, Cameras::first);
  write_json(settings.run / "run.json", run);
  EXPECT_EQ(validate(settings, plain()).hosts.size(), 2u);
  const fs::path labels = folder / "data/training/label_2/000000.txt";
  write_file(labels, "Car 0 0 0 10 20 30 40 1.5 1.6 3.9 5 1.7 30 0\n" + read_file(labels));
  EXPECT_THAT(test::error_text<InputError>([&] { validate(settings, plain()); }),
              testing::HasSubstr("frames: have changed since"));
  settings.frames = 1;  // one test frame, which is unchanged
  EXPECT_EQ(validate(settings, plain()).hosts.size(), 1u);
}

/// Replaces the cars of every tiny frame; each next car's picture box begins one pixel further right.
void set_cars(const fs::path& data, const std::vector<BevBox>& cars) {
  for (const char* id : {"000000", "000001"}) {
    Frame frame = read_frame(data, id);
    frame.labels.resize(1);
    for (const BevBox& car : cars) {
      Label label = frame.labels.front();
      label.box.bev = car;
      label.left += static_cast<double>(frame.labels.size());
      frame.labels.push_back(label);
    }
    frame.labels.erase(frame.labels.begin());
    write_frame(data, frame);
  }
}
constexpr BevBox kFound = {10, 1, 4, 2, 0};  // the box that tiny_validation's detector always finds

TEST(Resume, HeldBackVehiclesThatWereLearnedOnInOtherFramesAreCounted) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  set_cars(folder / "data", {kFound});
  settings.ladder = 0;
  settings.sign_off = true;
  const auto pages = [&] {
    return read_file(settings.out / "report.html") + read_file(settings.out / "sign-off.html");
  };
  const json untracked = validated(settings);
  EXPECT_EQ(untracked.at("verdict").at("of"), "held_back");
  EXPECT_EQ(untracked.at("verdict").at("held_back").at("vehicles"), 1);
  EXPECT_EQ(untracked.at("hosts_trained_on"), 0);
  EXPECT_EQ(pages().find("The attack was learned on"), std::string::npos);
  const fs::path tracks = folder / "data/training/track_2";
  write_file(tracks / "000000.txt", "7\n");
  for (const auto& [track, learned] : {std::pair("8\n", 0), std::pair("7\n", 1)}) {
    write_file(tracks / "000001.txt", track);
    EXPECT_EQ(validated(settings).at("hosts_trained_on"), learned);
  }
  EXPECT_NE(pages().find("of these 1 held-back vehicles, in other frames of their drive"), std::string::npos);
  EXPECT_NE(pages().find("id=\"trained-on\""), std::string::npos);
}

TEST(Resume, WhoIsJudgedIsNamedAndShown) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  set_cars(folder / "data", {{20, 4, 3.9, 1.6, 0}, kFound});
  settings.ladder = 0;
  settings.sign_off = true;
  const ImageF recorded = read_srgb(folder / "data/training/image_2/000001.png");
  const auto validated_at = [&](const std::string& place) {
    settings.overrides["placement"] = place;
    settings.out = folder / place;
    EXPECT_EQ(validated(settings).at("placement"), place);
    return read_json(settings.out / "hosts/000001_0.json");
  };
  const auto says = [&](const std::string& text) {
    for (const char* page : {"report.html", "sign-off.html"})
      EXPECT_NE(read_file(settings.out / page).find(text), std::string::npos) << page << ": " << text;
  };
  const json neighbour = validated_at("kerb");
  EXPECT_EQ(neighbour.at("victim"), 1);
  EXPECT_TRUE(neighbour.at("detected"));
  EXPECT_NEAR(neighbour.at("range").get<double>(), std::hypot(kFound.x, kFound.y), 0.02);
  EXPECT_NEAR(neighbour.at("bev").at("host").at(0).get<double>(), kFound.x, 0.02);
  EXPECT_NEAR(neighbour.at("bev").at("host").at(1).get<double>(), kFound.y, 0.02);
  EXPECT_NEAR(neighbour.at("host_rect").at(0).get<double>(), 92, 0.02);  // set_cars'
  EXPECT_EQ(read_srgb(settings.out / "pictures/000001_0_clean.png").data, recorded.data);
  EXPECT_NE(read_file(settings.out / "report.html").find("000001_1 (host 000001_0)"), std::string::npos);
  says(">kerb</data>");

  const json object = validated_at("debris");  // 6 m behind the host
  EXPECT_EQ(object.at("victim"), -1);
  EXPECT_NEAR(object.at("bev").at("host").at(0).get<double>(), 20 - 3.9 / 2 - 6, 0.3);
  EXPECT_NEAR(object.at("bev").at("host").at(1).get<double>(), 4, 0.3);
  EXPECT_NE(read_srgb(settings.out / "pictures/000001_0_clean.png").data, recorded.data)
      << "what counts as clean has a plain object in it";
  EXPECT_NE(read_file(settings.out / "report.html").find("object at 000001_0"), std::string::npos);
  says(">debris</data>");
}

TEST(Resume, APageToSignIsOfTheLastCallAlone) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  settings.sign_off = true;
  validated(settings);
  EXPECT_TRUE(fs::exists(settings.out / "sign-off.html"));
  settings.sign_off = false;
  validated(settings);
  EXPECT_FALSE(fs::exists(settings.out / "sign-off.html"));
}

TEST(Resume, VehiclesWithNothingInViewAreNamedAndNoneOtherIsAFailure) {
  const test::TemporaryFolder folder;
  ValidationSettings settings = tiny_validation(folder);
  EXPECT_EQ(validated(settings).at("unseen"), json::array());
  const fs::path stored = settings.out / "hosts/000001_0.json";
  json vehicle = json::parse(read_file(stored));
  vehicle.erase("matched");  // as of a vehicle whose object no camera shows
  write_json(stored, vehicle);
  const json part = validated(settings);
  EXPECT_EQ(part.at("unseen"), json({"000001_0"}));
  EXPECT_EQ(part.at("vehicles"), 1);
  settings.overrides["placement"] = "world:-20,0,-1.7,0";  // behind the car
  EXPECT_THAT(test::error_text<Failure>([&] { validate(settings, plain()); }),
              testing::HasSubstr("in view on none of 2 vehicles"));
}

TEST(Resume, EachCameraThatSeesTheObjectIsCompared) {
  const test::TemporaryFolder folder;
  const ValidationSettings settings = tiny_validation(folder, Cameras::all);
  const json whole = validated(settings);
  ASSERT_EQ(whole.at("cameras").size(), 2u);
  double pixels = 0;
  std::set<std::string> held;
  for (const json& of : whole.at("cameras")) {
    EXPECT_EQ(of.at("vehicles"), 2) << of;
    EXPECT_LE(of.at("mae"), 1e-3) << of;
    EXPECT_GT(of.at("pixels"), 100) << of;
    pixels += of.at("pixels").get<double>();
  }
  EXPECT_EQ(whole.at("matched").at("pixels"), pixels);
  for (const json& target : whole.at("targets"))
    if (target.contains("camera")) held.insert(target.at("camera"));
  EXPECT_EQ(held, std::set<std::string>({"SIDE", "camera"}));
  EXPECT_NE(read_file(settings.out / "report.html").find("SIDE"), std::string::npos);
  const json vehicle = json::parse(read_file(settings.out / "hosts/000000_0.json"));
  EXPECT_EQ(vehicle.at("cameras")[0].at("camera"), "camera");
  EXPECT_EQ(vehicle.at("full"), vehicle.at("cameras")[0].at("full"));
  EXPECT_NE(vehicle.at("full"), vehicle.at("cameras")[1].at("full"));
  EXPECT_TRUE(fs::exists(settings.out / "pictures/000000_0_cycles_SIDE.png"));
  const json resumed = validated(settings);
  EXPECT_EQ(timeless(resumed), timeless(whole));
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
  ValidationSettings elsewhere = settings;  // a stored vehicle's key does not include planted differences
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

// The inputs of a stored vehicle's result: with any other input it is made again.

namespace {

/// A run on two tiny frames with its own plugin and weights, as validate() completes them.
struct Judged {
  explicit Judged(const fs::path& at) : folder(at) {
    test::write_tiny_data(folder / "data", 2);
    fs::create_directories(folder / "run");
    write_file(folder / "run/adversary.glb", "mesh");
    write_file(folder / "weights", "weights");
    fs::copy_file(MIRAGE_BUILD "/test_plugins/fake_works.so", folder / "fake.so");
    run.settings.data = folder / "data";
    run.settings.rooftop = "box";
    settings.run = folder / "run";
    settings.detector.detector = folder / "fake.so";
    settings.detector.weights = folder / "weights";
    settings.detector.defense = "none";
    settings.detector.precision = kFloat;
    settings.detector.locality = 0;
  }
  std::string key(const std::string& blender = "3.4") const {
    return validation_key(settings, run, "000000",
                          {"blender", "Blender Cycles", blender, renderer_programs()});
  }
  fs::path folder;
  ValidationSettings settings;
  ::mirage::Run run;
};

TEST(ValidationKey, ChangesWithEverySettingThatAResultDependsOn) {
  const test::TemporaryFolder folder;
  const Judged judged(folder.path());
  std::set<std::string> keys = {judged.key()};
  EXPECT_EQ(*keys.begin(), judged.key());
  // Fields of frames, simulation and detector; paths count by their content (below).
  const auto differs = [&](const Judged& other, const char* what, bool matters = true) {
    EXPECT_EQ(keys.insert(other.key()).second, matters) << what;
  };
  int fields = 0;
  const auto change_each = [&](auto part) {
    fields += test::for_each_field(part(judged), [&](auto& changed, const Field& field, auto& value, bool,
                                                     const char*) {
      if (std::is_same_v<std::decay_t<decltype(value)>, fs::path> || std::string(field.name) == "detector")
        return;
      test::change(field, value);
      if constexpr (std::is_same_v<std::decay_t<decltype(value)>, std::string>) {
        if (std::string(field.name) == "depth") value = "ip-basic-bilateral";
        if (std::string(field.name) == "rooftop") value = "shape";
        if (std::string(field.name) == "rig") value = "xenith";
        if (std::string(field.name) == "sensors") value = MIRAGE_BUILD "/plugins/radar.so";
      }
      Judged other = judged;
      part(other) = changed;
      differs(other, field.name, field.matters);
    });
  };
  change_each([](auto& j) -> auto& { return as_base<FrameSource>(j.run.settings); });
  change_each([](auto& j) -> auto& { return j.run.settings.simulation; });
  change_each([](auto& j) -> auto& { return j.settings.detector; });
  EXPECT_GT(fields, 45);
  const auto changed = [&](const char* what, const auto& change) {
    Judged other = judged;
    change(other);
    differs(other, what);
  };
  changed("samples", [](Judged& j) { ++j.settings.samples; });
  changed("noise", [](Judged& j) { j.settings.noise = 0.05; });
  changed("seed", [](Judged& j) { ++j.settings.seed; });
  changed("score", [](Judged& j) { j.settings.evaluation_settings.score_threshold = 0.5; });
  changed("expectation",
          [](Judged& j) { j.settings.evaluation_settings.expectation = parse_expectation("shape"); });
  changed("expectation", [](Judged& j) {
    j.settings.evaluation_settings.expectation = parse_expectation("shape");
    ++j.settings.evaluation_settings.expectation_seed;
  });
  changed("IoU", [](Judged& j) { j.settings.evaluation_settings.detected_iou = 0.5; });
  EXPECT_TRUE(keys.insert(judged.key("3.5")).second) << "Blender";
}

TEST(ValidationKey, ChangesWithTheContentOfEveryInputAndNotWithItsPlace) {
  const test::TemporaryFolder folder;
  const fs::path here = folder / "here", there = folder / "there";
  const Judged judged(here);
  const std::string before = judged.key();
  for (const char* input : {"run/adversary.glb", "weights", "fake.so", "data/training/image_2/000000.png",
                            "data/training/velodyne/000000.bin", "data/training/label_2/000000.txt",
                            "data/training/calib/000000.txt"}) {
    const std::string bytes = read_file(here / input);
    std::string other = bytes;
    if (fs::path(input).extension() == ".bin")
      other[12] ^= 1;  // a return's reflectance
    else if (fs::path(input).extension() == ".png")
      write_srgb(here / input, ImageF(248, 75, 3, 0.31f));
    else
      other += "\n";
    if (fs::path(input).extension() != ".png") write_file(here / input, other);
    EXPECT_NE(judged.key(), before) << input;
    write_file(here / input, bytes);
    EXPECT_EQ(judged.key(), before) << input;
  }
  write_file(here / "data/training/track_2/000000.txt", "4\n");
  EXPECT_NE(judged.key(), before) << "who the vehicle is";
  fs::remove(here / "data/training/track_2/000000.txt");
  write_file(here / "data/training/velodyne/000001.bin", "");
  EXPECT_EQ(judged.key(), before) << "another frame's";
  fs::remove_all(here / "data/training/track_2");
  const Judged moved(there);
  EXPECT_EQ(moved.key(), before);
}

TEST(Tradeoff, EachSettingChangesTheIdentity) {
  const test::TemporaryFolder folder;
  test::expect_identity_follows(TradeoffSettings(), folder.path());
}

TEST(ValidationKey, ChangesWithThePythonThatMakesTheLight) {
  const test::TemporaryFolder folder;
  const Judged judged(folder.path());
  // The worker's imports from the package are among the hashed programs.
  std::set<std::string> names;
  for (const fs::path& file : renderer_programs()) names.insert(file.filename().string());
  for (const char* needed : {"blender_worker.py", "physical_light.py", "cycles_light.py", "scene_import.py",
                             "camera.py", "paint.py"})
    EXPECT_TRUE(names.contains(needed)) << needed;
  const fs::path home = folder / "home";
  for (const fs::path& file : renderer_programs()) {
    const fs::path copy = home / fs::relative(file, MIRAGE_SOURCE);
    fs::create_directories(copy.parent_path());
    write_file(copy, read_file(file));
  }
  fs::create_directory_symlink(MIRAGE_SOURCE "/scenes", home / "scenes");
  ::setenv("MIRAGE_HOME", home.c_str(), 1);
  const std::string before = judged.key();
  std::set<std::string> keys = {before};
  for (const fs::path& file : renderer_programs()) {
    ASSERT_TRUE(file.string().starts_with(home.string())) << "would edit the sources: " << file;
    const std::string text = read_file(file);
    write_file(file, text + "# edited\n");
    EXPECT_TRUE(keys.insert(judged.key()).second) << file;
    write_file(file, text);
  }
  EXPECT_EQ(judged.key(), before);
  ::setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
}

}  // namespace
}  // namespace mirage
