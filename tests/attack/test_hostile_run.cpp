// Run folders from other people: code that they name is not executed, and their values are checked.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

#include "attack/attack.h"
#include "attack/checkpoint.h"
#include "attack/run.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "support/files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

DetectorPool stand_in() {
  DetectorPool pool;
  pool.push_back(std::make_unique<test::StandInDetector>());
  return pool;
}

AttackSettings settings_for(const fs::path& data, const fs::path& out, int iterations) {
  AttackSettings settings = test::tiny_attack();
  settings.data = data;
  settings.out = out;
  settings.iterations = iterations;
  settings.quiet = true;
  return settings;
}

/// One finished run of three steps, made once, and the content of its files.
class HostileRun : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    world_ = new TemporaryFolder;
    test::write_tiny_data(*world_ / "data", 2);
    run_attack(settings_for(*world_ / "data", *world_ / "run", 3), stand_in());
  }
  static void TearDownTestSuite() {
    delete world_;
    world_ = nullptr;
  }
  void SetUp() override { fs::copy(*world_ / "run", run(), fs::copy_options::recursive); }

  fs::path run() const { return folder_ / "run"; }
  fs::path data() const { return *world_ / "data"; }
  json said() const { return read_json(run() / "run.json"); }
  json checkpoint() const { return read_json(run() / "checkpoint.json"); }

  /// read_run's error for a run.json in which `value` replaces the value at `place`.
  std::string complaint(const char* place, const json& value) const {
    json changed = read_json(*world_ / "run/run.json");
    changed[json::json_pointer(place)] = value;
    write_json(run() / "run.json", changed);
    return error_text<InputError>([&] { read_run(run()); });
  }
  std::string resume_complaint(const char* place, const json& value) const {
    json changed = read_json(*world_ / "run/checkpoint.json");
    changed[json::json_pointer(place)] = value;
    write_json(run() / "checkpoint.json", changed);
    auto settings = settings_for(data(), run(), 5);
    return error_text<InputError>([&] { run_attack(settings, stand_in()); });
  }

  TemporaryFolder folder_;
  static TemporaryFolder* world_;
};

TemporaryFolder* HostileRun::world_ = nullptr;

TEST_F(HostileRun, CodeThatItNamesIsRefusedWithTheFileThatItWouldBe) {
  json changed = said();
  changed["detector"] = "/tmp/evil/detector.so";
  changed["depth"] = "evil-depth.so";
  changed["sensors"] = "radar,evil-sonar.so";
  changed["weights"] = "/tmp/evil/weights";
  write_json(run() / "run.json", changed);
  mirage::Run other = read_run(run());  // reading it runs no code
  EXPECT_EQ(other.settings.detector.detector, "");
  EXPECT_EQ(other.settings.depth, "");
  EXPECT_EQ(other.settings.detector.weights, "");
  DetectorOptions options;
  options.detector = options.defense = "";
  EXPECT_THAT(error_text<InputError>([&] { use_detector_of(other, options); }),
              AllOf(HasSubstr("run.json: detector"), HasSubstr("/tmp/evil/detector.so"),
                    HasSubstr("--detector"), HasSubstr("--trust-run")));
  EXPECT_THAT(error_text<InputError>([&] { override_settings(other, {}, 0); }),
              AllOf(HasSubstr("run.json: depth"), HasSubstr((fs::current_path() / "evil-depth.so").string()),
                    HasSubstr("--depth"), HasSubstr("--trust-run")));
  mirage::Run guided = other;
  EXPECT_EQ(guided.settings.sensors, "");
  EXPECT_THAT(error_text<InputError>([&] {
                override_settings(guided, {{"depth", "guided"}}, 0);
              }),
              AllOf(HasSubstr("run.json: sensors"), HasSubstr("evil-sonar.so"), HasSubstr("--sensors")));
  override_settings(guided, {{"depth", "guided"}, {"sensors", ""}}, 0);
  EXPECT_EQ(guided.settings.depth, "guided");

  options.detector = "/tmp/evil/detector.so";  // the user's own choice, but without the run's weights
  EXPECT_THAT(error_text<InputError>([&] { use_detector_of(other, options); }),
              AllOf(HasSubstr("run.json: weights"), HasSubstr("/tmp/evil/weights")));
  options.detector = "lidar";
  use_detector_of(other, options);
  EXPECT_EQ(options.weights, "");

  mirage::Run trusted = read_run(run(), TrustRun::yes);
  options.detector = options.defense = "";
  use_detector_of(trusted, options);
  EXPECT_EQ(options.detector, "/tmp/evil/detector.so");
  EXPECT_EQ(options.weights, "/tmp/evil/weights");
  override_settings(trusted, {}, 0);
  EXPECT_EQ(trusted.settings.depth, "evil-depth.so");
}

TEST_F(HostileRun, ItsDetectorComputesAsItWasAttackedUnlessAskedOtherwise) {
  mirage::Run other = read_run(run());
  other.settings.detector.detector = "fusion";
  other.settings.detector.precision = kDouble;
  other.settings.detector.locality = 4;
  DetectorOptions options = detector_of_the_run();
  use_detector_of(other, options);
  EXPECT_EQ(options.precision, kDouble);
  EXPECT_EQ(options.locality, 4);
  options = detector_of_the_run();
  options.precision = kFloat;
  options.locality = 0;
  use_detector_of(other, options);
  EXPECT_EQ(options.precision, kFloat);
  EXPECT_EQ(options.locality, 0);
  options = detector_of_the_run();
  options.detector = "lidar";  // another detector uses the default precision and locality
  use_detector_of(other, options);
  EXPECT_EQ(options.precision, kFloat);
  EXPECT_EQ(options.locality, 0);
}

TEST_F(HostileRun, ATorchScriptModelIsCodeAndOwnWeightsAreData) {
  json changed = said();
  changed["detector"] = "torchscript";
  changed["weights"] = "/tmp/model.pt";
  write_json(run() / "run.json", changed);
  DetectorOptions options;
  options.detector = options.defense = "";
  EXPECT_THAT(error_text<InputError>([&] { use_detector_of(read_run(run()), options); }),
              AllOf(HasSubstr("TorchScript"), HasSubstr("/tmp/model.pt"), HasSubstr("--weights")));
  options.weights = "/home/me/model.pt";
  options.detector = options.defense = "";
  use_detector_of(read_run(run()), options);
  EXPECT_EQ(options.detector, "torchscript");
  EXPECT_EQ(options.weights, "/home/me/model.pt");
  changed["detector"] = "late";
  write_json(run() / "run.json", changed);
  options = {};
  options.detector = options.defense = "";
  use_detector_of(read_run(run()), options);
  EXPECT_EQ(options.weights, "/tmp/model.pt");
}

TEST_F(HostileRun, EachFieldIsCheckedAndNamed) {
  const json host = {{"frame", "000000"}, {"label", 0}};
  for (const auto& [place, value, words] : std::vector<std::tuple<const char*, json, const char*>>{
           {"/detector", "yolo", "run.json: detector"},
           {"/detector", 7, "run.json: detector: not a text"},
           {"/depth", "deep", "run.json: depth"},
           {"/weights", json::array(), "run.json: weights"},
           {"/data", nullptr, "run.json: data"},
           {"/target", "camera", "run.json: target"},
           {"/sun", "noon", "run.json: sun"},
           {"/train", json::object(), "run.json: train"},
           {"/test/0", 5, "run.json: test[0]: not a JSON object"},
           {"/test/0/frame", "../../../etc/cron.d/x", "run.json: test[0].frame: holds a separator"},
           {"/test/0/frame", "..", "run.json: test[0].frame"},
           {"/test/0/frame", "", "run.json: test[0].frame"},
           {"/test/0/frame", "a\\x2fb", "run.json: test[0].frame: holds a separator"},
           {"/test/0/frame", std::string(300, 'x'), "run.json: test[0].frame"},
           {"/test/0/label", -1, "run.json: test[0].label: -1 is out of range"},
           {"/test/0/label", 1e12, "run.json: test[0].label"},
           {"/test/0/label", 1000000000000, "run.json: test[0].label"},
           {"/min_view", 1e308, "run.json: min_view"},
           {"/min_view", nullptr, "run.json: min_view"},
           {"/seed", -1, "run.json: seed"},
           {"/seed", 0.5, "run.json: seed"},
           {"/limits", {1, 2}, "run.json: limits"},
           {"/limits/1", -0.8, "run.json: limits[1]"},
           {"/limits/2", 1e300, "run.json: limits[2]"},
           {"/buildable", {0.01, 0.5, 0.1}, "run.json: buildable"},
           {"/simulation", 1, "run.json: simulation: not a JSON object"},
           {"/simulation/sigma", 0, "run.json: simulation.sigma"},
           {"/simulation/sigma", 1e9, "run.json: simulation.sigma"},
           {"/simulation/gamma", -1, "run.json: simulation.gamma"},
           {"/simulation/epsilon", "x", "run.json: simulation.epsilon"},
           {"/simulation/dist_eps", 0.7, "run.json: simulation.dist_eps"},
           {"/simulation/supersampling", 1000000, "run.json: simulation.supersampling"},
           {"/simulation/supersampling", 2.5, "run.json: simulation.supersampling"},
           {"/simulation/grazing_cosine", 0, "run.json: simulation.grazing_cosine"},
           {"/simulation/occlusion_margin", 1e300, "run.json: simulation.occlusion_margin"},
           {"/simulation/lidar_reflectivity", -1, "run.json: simulation.lidar_reflectivity"},
           {"/simulation/light", "moon", "run.json: simulation.light"},
           {"/simulation/double", "yes", "run.json: simulation.double"}})
    EXPECT_THAT(complaint(place, value), HasSubstr(words)) << place << " " << value;
  for (const char* text : {"[]", "null", "3", "\"run\"", "{}", "", "{\"data\"", "{\"data\": 1e999}"}) {
    write_file(run() / "run.json", text);
    EXPECT_THAT(error_text<InputError>([&] { read_run(run()); }), HasSubstr("run.json")) << text;
  }
}

TEST_F(HostileRun, ACheckpointIsCheckedLikeAnyInput) {
  const auto losses = checkpoint().at("losses");
  for (const auto& [place, value, words] : std::vector<std::tuple<const char*, json, const char*>>{
           {"/iteration", -1, "checkpoint.json: iteration"},
           {"/iteration", 1e308, "checkpoint.json: iteration"},
           {"/iteration", 1000000000000, "checkpoint.json: iteration"},
           {"/iteration", 999999999, "checkpoint.json: "},  // fewer losses than steps
           {"/iteration", 2.5, "checkpoint.json: iteration"},
           {"/iteration", 0, "checkpoint.json: "},
           {"/iteration", UINT64_MAX, "checkpoint.json: iteration"},
           {"/vertices/0", 1e308, "checkpoint.json: vertices[0]"},
           {"/vertices/5", nullptr, "checkpoint.json: vertices[5]: not a number"},
           {"/vertices/5", 0.9, "checkpoint.json: vertices"},
           {"/vertices", {1, 2, 3}, "checkpoint.json: vertices"},
           {"/texels/7", -0.1, "checkpoint.json: texels"},
           {"/texels", "grey", "checkpoint.json: texels"},
           {"/adam_vertices", nullptr, "checkpoint.json: adam_vertices"},
           {"/adam_vertices/step_count", -3, "checkpoint.json: adam_vertices.step_count"},
           {"/adam_vertices/step_count", 4, "checkpoint.json: adam_vertices.step_count"},
           {"/adam_vertices/first", {0.5}, "checkpoint.json: adam_vertices.first"},
           {"/adam_texels/second/0", -1, "checkpoint.json: adam_texels.second[0]"},
           {"/losses", {1, 2}, "checkpoint.json: losses"},
           {"/losses/0", "low", "checkpoint.json: losses[0]"},
           {"/hidden", {1}, "checkpoint.json: hidden"},
           {"/hidden/0", 1e300, "checkpoint.json: hidden[0]"},
           {"/identity", 1, "checkpoint.json: identity"},
           {"/identity/seed", "x", "checkpoint.json: seed"},
           {"/identity/more", 1, "checkpoint.json: more"}})
    EXPECT_THAT(resume_complaint(place, value), HasSubstr(words)) << place << " " << value;
  for (const char* text : {"[]", "{}", "null", ""}) {
    write_file(run() / "checkpoint.json", text);
    EXPECT_THAT(error_text<InputError>([&] { run_attack(settings_for(data(), run(), 5), stand_in()); }),
                HasSubstr("checkpoint.json"))
        << text;
  }
}

// A resumed run stops here while it learns: the earlier result stays valid.
TEST_F(HostileRun, AFinishedResultStaysUntilTheNextOneIsThere) {
  class Stopping : public test::StandInDetector {
   public:
    SensorGradient backward(std::span<const double>) override { throw Failure("detector", "gone", "none"); }
  };
  DetectorPool pool;
  pool.push_back(std::make_unique<Stopping>());
  write_json(run() / "result.json", {{"iterations", 3}});
  const std::string before = read_file(run() / "adversary.glb");
  EXPECT_THROW(run_attack(settings_for(data(), run(), 9), pool), Failure);
  EXPECT_EQ(read_file(run() / "adversary.glb"), before);
  EXPECT_EQ(read_json(run() / "result.json").at("iterations"), 3);
  EXPECT_NO_THROW(read_run(run()));
  run_attack(settings_for(data(), run(), 9), stand_in());
  EXPECT_NE(read_file(run() / "adversary.glb"), before);
}

// Frame names of arbitrary bytes: learned on, resumed, read back and named in messages.
TEST(NamesInRuns, AnyBytesMakeARunThatComesBack) {
  TemporaryFolder folder;
  const fs::path data = folder / "d\xff\\x41";
  test::write_tiny_data(data, 2);
  for (const char* part : {"image_2", "velodyne", "calib", "label_2", "lighting"})
    for (const auto& entry : fs::directory_iterator(data / "training" / part)) {
      const std::string name = entry.path().filename().string();
      if (name.starts_with("000001"))
        fs::rename(entry.path(), entry.path().parent_path() / ("\xe8\\x\x1b" + name.substr(6)));
    }
  auto settings = settings_for(data, folder / "run", 2);
  run_attack(settings, stand_in());
  settings.iterations = 4;
  run_attack(settings, stand_in());  // the same run
  const mirage::Run run = read_run(folder / "run");
  EXPECT_EQ(run.settings.data, data);
  std::vector<std::string> frames;
  for (const auto* split : {&run.train, &run.test})
    for (const HostId& id : *split) frames.push_back(id.frame);
  EXPECT_THAT(frames, testing::UnorderedElementsAre("000000", "\xe8\\x\x1b"));
  EXPECT_EQ(host_name({"\xe8\\x\x1b", 0}), "\\xe8\\\\x\\x1b_0");
}

TEST(Checkpoints, ComeByTimeToo) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  class Dying : public test::StandInDetector {
   public:
    SensorGradient backward(std::span<const double> d) override {
      if (++steps_ > 4) throw Failure("detector", "gone", "none");
      return StandInDetector::backward(d);
    }
    int steps_ = 0;
  };
  auto settings = settings_for(folder / "data", folder / "run", 9);
  settings.batch = 1;
  settings.checkpoint.steps = 1000;
  settings.checkpoint.seconds = 1e-9;
  DetectorPool pool;
  pool.push_back(std::make_unique<Dying>());
  EXPECT_THROW(run_attack(settings, pool), Failure);
  EXPECT_EQ(read_json(folder / "run/checkpoint.json").at("iteration"), 4);
  settings.checkpoint.steps = 0;
  EXPECT_THAT(error_text<InputError>([&] { run_attack(settings, stand_in()); }),
              HasSubstr("checkpoint_every: "));
}

}  // namespace
}  // namespace mirage
