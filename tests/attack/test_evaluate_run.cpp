// `mirage evaluate` without the program: the hosts that it judges, and the controls beside the run's mesh.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <tuple>
#include <utility>

#include "attack/attack.h"
#include "attack/evaluate_run.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "exchange/gltf.h"
#include "frames/frame_provenance.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;

/// A finished run with a random mesh on a tiny data set, for a detector that always finds the same box.
std::filesystem::path tiny_run(const TemporaryFolder& folder, const std::string& name, const char* data,
                               std::vector<HostId> train, std::vector<HostId> test, std::uint64_t seed = 3) {
  const TexturedMesh mesh = random_adversary(seed);
  write_adversary(folder / name / "adversary.glb", mesh);
  write_adversary(folder / name / "random.glb", mesh);
  write_file(folder / name / "weights", "none");
  AttackSettings settings;
  settings.data = folder / data;
  settings.rooftop = "box";
  settings.detector.detector = MIRAGE_BUILD "/test_plugins/fake_works.so";
  settings.detector.weights = folder / name / "weights";
  settings.target = AttackTarget::random;
  settings.seed = seed;
  test::write_run_json(folder / name, settings, train, test);
  return folder / name;
}

EvaluationRequest request_for(const std::filesystem::path& run) {
  EvaluationRequest request;
  request.run = run;
  request.trust = TrustRun::yes;  // its detector is a plugin
  request.settings.quiet = true;
  return request;
}

std::vector<std::string> names(const std::vector<HostId>& hosts) {
  std::vector<std::string> list;
  for (const HostId& id : hosts) list.push_back(host_name(id));
  return list;
}

TEST(EvaluateRun, AnotherRunsHostsAreThatRunsTestHostsExactly) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "one", 2);
  test::write_tiny_data(folder / "two", 4, true);  // with other sweeps
  EvaluationRequest request = request_for(tiny_run(folder, "a", "one", {{"000000", 0}}, {{"000001", 0}}));
  request.hosts_of = tiny_run(folder, "b", "two", {{"000000", 0}}, {{"000001", 0}, {"000003", 0}}, 4);
  request.random_meshes = 0;
  const RunEvaluation judged = evaluate_run(request);
  EXPECT_THAT(names(judged.hosts), testing::ElementsAre("000001_0", "000003_0"));
  EXPECT_EQ(judged.target_run.settings.data, folder / "two");
  EXPECT_EQ(judged.detector.weights, folder / "b/weights");
  EXPECT_EQ(judged.trained_on, 0);  // frames have the same names, but the data sets differ
  EXPECT_TRUE(judged.baselines.empty());
  const auto json = to_json(judged);
  EXPECT_EQ(json.at("hosts_of"), (folder / "b").string());
  EXPECT_EQ(json.at("run"), (folder / "a").string());
  EXPECT_FALSE(json.contains("random"));
  EXPECT_EQ(json.at("hosts"), 2);
  // The mesh is run a's: the result equals a's own evaluation on that data set.
  EvaluationRequest direct = request_for(folder / "a");
  direct.overrides["data"] = folder / "two";
  const RunEvaluation all = evaluate_run(direct);
  ASSERT_EQ(all.hosts.size(), 4u);
  EXPECT_EQ(to_json(all).at("outcomes").at(3), json.at("outcomes").at(1));
  EXPECT_FALSE(to_json(all).contains("hosts_of"));
  EXPECT_EQ(to_json(all).at("random").at("meshes"), 1);

  // The same data set, with a host in a frame that the adversary was trained on.
  request.run = tiny_run(folder, "c", "two", {{"000003", 0}}, {{"000001", 0}});
  EXPECT_EQ(evaluate_run(request).trained_on, 1);
}

// A data set at another path may be a copy of the run's, or have more frames.
TEST(EvaluateRun, FramesThatTheRunLearnedOnAreKnownAtAnotherPlace) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "one", 2);
  test::write_tiny_data(folder / "more", 4);
  EvaluationRequest request = request_for(tiny_run(folder, "a", "one", {{"000000", 0}}, {{"000001", 0}}));
  request.random_meshes = 0;
  request.overrides["data"] = folder / "more";
  const RunEvaluation unseen = evaluate_run(request);
  EXPECT_THAT(names(unseen.hosts), testing::ElementsAre("000001_0", "000002_0", "000003_0"));
  EXPECT_EQ(unseen.trained_on, 0);
  request.hosts = "all";
  EXPECT_EQ(evaluate_run(request).hosts.size(), 4u);
  EXPECT_EQ(evaluate_run(request).trained_on, 1);
  request.hosts = "train";
  EXPECT_THAT(error_text<InputError>([&] { evaluate_run(request); }), testing::StartsWith("hosts: train: "));
  // Frames are recognised under any name.
  test::write_tiny_data(folder / "renamed", 1);
  for (const auto& [kind, end] : {std::pair("velodyne", ".bin"), std::pair("image_2", ".png"),
                                  std::pair("calib", ".txt"), std::pair("label_2", ".txt")}) {
    const auto part = folder / "renamed" / "training" / kind;
    std::filesystem::rename(part / (std::string("000000") + end), part / (std::string("000100") + end));
  }
  EXPECT_THAT(frames_learned_on(read_run(folder / "a", TrustRun::yes), folder / "renamed"),
              testing::ElementsAre("000100"));
  // For a run whose own data are gone, this is unknown.
  std::filesystem::remove_all(folder / "one");
  EXPECT_TRUE(frames_learned_on(read_run(folder / "a", TrustRun::yes), folder / "more").empty());
  test::write_tiny_data(folder / "copy", 1);
  std::filesystem::copy(folder / "copy", folder / "one", std::filesystem::copy_options::recursive);
  request.hosts.clear();
  request.overrides["data"] = folder / "copy";
  EXPECT_THAT(error_text<InputError>([&] { evaluate_run(request); }),
              testing::HasSubstr("only frames that the run was learned on"));
  request.overrides = {{"classes", "Van"}};
  EXPECT_THAT(error_text<InputError>([&] { evaluate_run(request); }), testing::StartsWith("classes: Van: "));
  request.overrides = {{"min_view", "0.9"}};
  EXPECT_THAT(error_text<InputError>([&] { evaluate_run(request); }), testing::StartsWith("min_view: 0.9: "));
}

// A run stores its vehicles as label indices; in other label files they are other cars.
TEST(EvaluateRun, FramesThatHaveChangedSinceTheAttackAreRefused) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "one", 3);
  EvaluationRequest request = request_for(tiny_run(folder, "a", "one", {{"000000", 0}}, {{"000001", 0}}));
  request.random_meshes = 0;
  nlohmann::json run = read_json(folder / "a" / "run.json");
  const std::vector<std::string> test = {"000001"};
  run[kTestFrames] = frames_hash(folder / "one", test, Cameras::first);
  write_json(folder / "a" / "run.json", run);
  EXPECT_EQ(evaluate_run(request).hosts.size(), 1u);
  const auto labels = folder / "one/training/label_2/000001.txt";
  const std::string before = read_file(labels);
  write_file(labels, "Car 0 0 0 10 20 30 40 1.5 1.6 3.9 5 1.7 30 0\n" + before);
  EXPECT_THAT(error_text<InputError>([&] { evaluate_run(request); }),
              testing::AllOf(testing::HasSubstr("one"), testing::HasSubstr("have changed since")));
  write_file(labels, before);
  write_file(folder / "one/training/label_2/000002.txt", "");  // none of its frames
  EXPECT_EQ(evaluate_run(request).hosts.size(), 1u);
}

// Each command checks the frames of the split that it uses.
TEST(EvaluateRun, FramesAreUnchangedOfTheSplitThatIsAskedFor) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "one", 2);
  for (const char* id : {"000000", "000001"}) {  // the same labels in a frame with a second camera
    Frame frame = read_frame(folder / "one", id);
    frame.others = {{"SIDE", frame.calibration, Lazy<ImageF>([] { return ImageF(248, 75, 3, 0.4f); })}};
    write_frame(folder / "one", frame);
  }
  const std::vector<std::string> train = {"000000"}, test = {"000001"};
  const auto hashes = [&](Cameras cameras) {
    return std::pair(frames_hash(folder / "one", train, cameras), frames_hash(folder / "one", test, cameras));
  };
  ASSERT_NE(hashes(Cameras::first), hashes(Cameras::all));
  mirage::Run run = read_run(tiny_run(folder, "a", "one", {{"000000", 0}}, {{"000001", 0}}), TrustRun::yes);
  EXPECT_NO_THROW(require_unchanged(run, run.test)) << "nothing is known of runs of before";
  for (const Cameras chosen : {Cameras::first, Cameras::all}) {
    std::tie(run.train_frames, run.test_frames) = hashes(chosen);
    for (const Cameras asked : {Cameras::first, Cameras::all}) {
      run.settings.cameras = asked;
      EXPECT_NO_THROW(require_unchanged(run, run.train));
      EXPECT_NO_THROW(require_unchanged(run, run.test));
    }
  }
  const auto labels = folder / "one/training/label_2/000001.txt";
  write_file(labels, "Car 0 0 0 10 20 30 40 1.5 1.6 3.9 5 1.7 30 0\n" + read_file(labels));
  EXPECT_NO_THROW(require_unchanged(run, run.train));
  EXPECT_THAT(error_text<InputError>([&] { require_unchanged(run, run.test); }),
              testing::HasSubstr("frames: have changed since"));
}

TEST(EvaluateRun, AVehicleThatWasLearnedOnInAnotherFrameIsNoUnseenOne) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "one", 3);
  for (const char* id : {"000000", "000001", "000002"})
    write_file(folder / "one/training/track_2" / (std::string(id) + ".txt"),
               std::string(id) == "000002" ? "8\n" : "7\n");
  EvaluationRequest request =
      request_for(tiny_run(folder, "a", "one", {{"000000", 0}}, {{"000001", 0}, {"000002", 0}}));
  request.random_meshes = 0;
  EXPECT_EQ(evaluate_run(request).trained_on, 1);
  const mirage::Run run = read_run(folder / "a", TrustRun::yes);
  const FrameSource& source = run.settings;
  std::vector<HostId> all = run.test;
  all.insert(all.end(), run.train.begin(), run.train.end());
  EXPECT_THAT(names(hosts_learned_on(run, source, all, frames_learned_on(run, source.data))),
              testing::ElementsAre("000001_0", "000000_0"));
  EXPECT_THAT(names(hosts_learned_on(run, source, all, {})), testing::ElementsAre("000001_0", "000000_0"));
}

TEST(EvaluateRun, OptionsThatContradictAnotherRunsHosts) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "one", 2);
  test::write_tiny_data(folder / "two", 2);
  EvaluationRequest good = request_for(tiny_run(folder, "a", "one", {{"000000", 0}}, {{"000001", 0}}));
  good.hosts_of = tiny_run(folder, "b", "two", {{"000000", 0}}, {{"000001", 0}});
  const auto error = [&](const std::function<void(EvaluationRequest&)>& change) {
    EvaluationRequest request = good;
    change(request);
    return error_text<InputError>([&] { evaluate_run(request); });
  };
  EXPECT_THAT(error([&](auto& r) { r.overrides["data"] = folder / "one"; }),
              testing::AllOf(testing::StartsWith("data: "), testing::HasSubstr("--hosts-of")));
  EXPECT_THAT(error([](auto& r) { r.hosts = "train"; }),
              testing::AllOf(testing::StartsWith("hosts: train: "), testing::HasSubstr("--hosts-of")));
  EXPECT_THAT(error([&](auto& r) { r.hosts_of = folder / "none"; }), testing::HasSubstr("run.json"));
  EXPECT_THAT(error([](auto& r) { r.random_meshes = -1; }), testing::StartsWith("random_meshes: -1: "));
  EXPECT_THAT(error([](auto& r) { r.hosts_of.clear(), r.hosts = "some"; }),
              testing::StartsWith("hosts: some: "));
  good.overrides["data"] = folder / "two";  // the same path
  good.hosts = "test";
  EXPECT_EQ(evaluate_run(good).hosts.size(), 1u);
}

TEST(EvaluateRun, RandomMeshesAreThoseOfTheRunsSeeds) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  AttackSettings attack;
  attack.data = folder / "data";
  attack.out = folder / "run";
  attack.iterations = 1;
  attack.quiet = true;
  attack.seed = 5;
  attack.limits.half = Vec3d(0.4, 0.4, 0.25);
  DetectorPool detectors;
  detectors.push_back(std::make_unique<test::StandInDetector>());
  for (const bool buildable : {false, true}) {
    attack.out = folder / (buildable ? "buildable" : "free");
    attack.buildable.on = buildable;
    run_attack(attack, detectors);
    const mirage::Run run = read_run(attack.out);
    EXPECT_EQ(run.settings.seed, 5u);
    EXPECT_EQ(run.settings.limits.half, attack.limits.half);
    const auto meshes = baseline_meshes(run, Baseline::start, 3);
    ASSERT_EQ(meshes.size(), 3u);
    const auto same = [](const TexturedMesh& a, const TexturedMesh& b) {
      return a.mesh.vertices == b.mesh.vertices && a.atlas.texels == b.atlas.texels;
    };
    EXPECT_TRUE(same(meshes[0], random_baseline(5, run.settings.limits, run.settings.buildable)));
    EXPECT_TRUE(same(meshes[2], random_baseline(7, run.settings.limits, run.settings.buildable)));
    EXPECT_FALSE(same(meshes[1], meshes[2]));
    for (const Vec3d& v : meshes[2].mesh.vertices) EXPECT_LE(v.cwiseAbs().z(), 0.25);
    if (buildable) {
      EXPECT_EQ(buildable_report(meshes[1], run.settings.buildable).printable, 1.0);
    }
  }
}

TEST(EvaluateRun, PooledMeshesAreTheirMeans) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  EvaluationRequest request = request_for(tiny_run(folder, "a", "data", {{"000000", 0}}, {{"000001", 0}}));
  request.hosts = "all";
  request.random_meshes = 2;
  const auto json = to_json(evaluate_run(request));
  EXPECT_EQ(json.at("random").at("meshes"), 2);
  EXPECT_EQ(json.at("random").at("hosts"), 2);
  EXPECT_EQ(json.at("random").at("vehicles"), json.at("vehicles"));
  EXPECT_EQ(json.at("random").at("outcomes").size(), 4u);
  EXPECT_EQ(json.at("sized").at("meshes"), 2);
}

TEST(EvaluateRun, AGrownBoxIsReportedBesideTheLabelledOne) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  EvaluationRequest request = request_for(tiny_run(folder, "a", "data", {{"000000", 0}}, {{"000001", 0}}));
  EXPECT_FALSE(to_json(evaluate_run(request)).contains("grown"));
  request.overrides["placement"] = "rear-rack";
  const RunEvaluation evaluation = evaluate_run(request);
  EXPECT_EQ(evaluation.learned.against_grown.size(), 1u);
  const auto json = to_json(evaluation);
  EXPECT_EQ(json.at("placement"), "rear-rack");
  EXPECT_EQ(json.at("placed").at("box"), "grown");
  EXPECT_EQ(json.at("grown").at("vehicles"), json.at("vehicles"));
  EXPECT_NE(json.at("grown").at("outcomes").at(0).at("attacked_iou"),
            json.at("outcomes").at(0).at("attacked_iou"));  // for the same box
  EXPECT_EQ(json.at("grown").at("outcomes").at(0).at("clean_iou"), json.at("outcomes").at(0).at("clean_iou"));
  const auto& arms = json.at("arms");
  ASSERT_EQ(arms.size(), 3u);
  for (const auto& arm : arms) EXPECT_TRUE(arm.at("grown").contains("fn_asr")) << arm.at("name");
  EXPECT_TRUE(arms.at(1).at("grown").contains("net"));

  // Hosts without that place are left out.
  request.overrides["placement"] = "kerb";
  EXPECT_THAT(error_text<InputError>([&] { evaluate_run(request); }),
              testing::HasSubstr("no other vehicle is within 12 m"));
}

TEST(EvaluateRun, ArmsAndNetAreListed) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  EvaluationRequest request = request_for(tiny_run(folder, "a", "data", {{"000000", 0}}, {{"000001", 0}}));
  request.baseline = "all";
  const RunEvaluation judged = evaluate_run(request);
  const auto json = to_json(judged);
  std::vector<std::string> names;
  for (const auto& arm : json.at("arms")) {
    names.push_back(arm.at("name"));
    EXPECT_TRUE(arm.at("hidden").at("vanished").contains("vehicles"));
    EXPECT_TRUE(arm.at("asr").contains("low"));  // for false negatives and false positives, too
    EXPECT_TRUE(arm.at("net").at("distance2m").contains("low"));
  }
  EXPECT_THAT(names, testing::ElementsAre("learned", "start", "sized", "ellipsoid", "cuboid"));
  EXPECT_EQ(json.at("net"), json.at("arms").at(2).at("net"));
  EXPECT_EQ(json.at("arms").at(0).at("net"), json.at("net"));
  for (std::size_t c = 0; c < 3; ++c)  // the extents of the learned mesh
    EXPECT_DOUBLE_EQ(json.at("arms").at(2).at("extents_m").at(c),
                     json.at("arms").at(0).at("extents_m").at(c));
  EXPECT_DOUBLE_EQ(json.at("arms").at(4).at("extents_m").at(0), 1.6);
  request.baseline = "sized";
  const auto alone = to_json(evaluate_run(request));
  EXPECT_FALSE(alone.contains("random"));
  EXPECT_EQ(alone.at("arms").size(), 2u);
  request.random_meshes = 0;
  const auto none = to_json(evaluate_run(request));
  EXPECT_FALSE(none.contains("net"));
  EXPECT_EQ(none.at("arms").size(), 1u);
  request.baseline = "sphere";
  EXPECT_THAT(error_text<InputError>([&] { evaluate_run(request); }),
              testing::StartsWith("baseline: sphere: "));
}

TEST(EvaluateRun, ObjectsNeedNoRun) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 4);
  write_file(folder / "weights", "none");
  write_adversary(folder / "a.glb", random_adversary(3));
  write_adversary(folder / "b.glb", random_adversary(4));
  EvaluationRequest request;
  request.settings.quiet = true;
  request.meshes = {folder / "a.glb", folder / "b.glb"};
  request.overrides = {{"data", folder / "data"}, {"rooftop", "box"}};
  request.detector.detector = MIRAGE_BUILD "/test_plugins/fake_works.so";
  request.detector.weights = folder / "weights";
  const RunEvaluation both = evaluate_run(request);
  ASSERT_EQ(both.each.size(), 2u);
  EXPECT_EQ(both.each[1].name, (folder / "b.glb").string());
  EXPECT_EQ(both.hosts.size(), 4u);
  EXPECT_EQ(both.trained_on, 0);
  const auto json = to_json(both);
  EXPECT_FALSE(json.contains("run"));
  EXPECT_EQ(json.at("meshes").size(), 2u);
  EXPECT_EQ(json.at("arms").at(1).at("name"), both.each[1].name);
  EXPECT_TRUE(json.at("arms").at(0).at("bound").contains("at_most"));
  // One of these meshes alone, judged as a run's adversary on the same vehicles.
  request.meshes = {folder / "b.glb"};
  request.baseline = "sized";
  const RunEvaluation alone = evaluate_run(request);
  EXPECT_EQ(alone.baselines.size(), 1u);
  EvaluationRequest of_run = request_for(
      tiny_run(folder, "run", "data", {{"000000", 0}}, {{"000001", 0}, {"000002", 0}, {"000003", 0}}, 4));
  of_run.hosts = "all";
  of_run.baseline = "none";
  const auto expected = to_json(evaluate_run(of_run)).at("outcomes");
  EXPECT_EQ(to_json(alone).at("outcomes"), expected);
  EXPECT_EQ(to_json(both.each[1].evaluation).at("outcomes"), expected);
}

TEST(EvaluateRun, ObjectsThatAreAskedForWrongly) {
  EvaluationRequest good;
  good.meshes = {"a.glb"};
  good.overrides = {{"data", "data"}};
  const auto error = [&](const std::function<void(EvaluationRequest&)>& change) {
    EvaluationRequest request = good;
    change(request);
    return error_text<InputError>([&] { evaluate_run(request); });
  };
  EXPECT_THAT(error([](auto& r) { r.meshes.clear(); }), testing::HasSubstr("--mesh"));
  EXPECT_THAT(error([](auto& r) { r.run = "run"; }), testing::StartsWith("run: run: "));
  EXPECT_THAT(error([](auto& r) { r.overrides.clear(); }), testing::StartsWith("data: "));
  EXPECT_THAT(error([](auto& r) { r.hosts = "train"; }), testing::StartsWith("hosts: train: "));
  EXPECT_THAT(error([](auto& r) { r.baseline = "start"; }), testing::StartsWith("baseline: start: "));
  EXPECT_THAT(error([](auto& r) { r.meshes.push_back("b.glb"), r.baseline = "sized"; }),
              testing::StartsWith("baseline: sized: "));
  EXPECT_THAT(error([](auto&) {}), testing::HasSubstr("a.glb"));
}

}  // namespace
}  // namespace mirage
