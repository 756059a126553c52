#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/attack.h"
#include "attack/attack_step.h"
#include "attack/checkpoint.h"
#include "attack/evaluation.h"
#include "attack/run.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "exchange/gltf.h"
#include "scene/data/read_frames.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::StandInDetector;
using test::TemporaryFolder;

AttackSettings settings_for(const std::filesystem::path& data, const std::filesystem::path& out,
                            int iterations) {
  AttackSettings settings = test::tiny_attack();
  settings.data = data;
  settings.out = out;
  settings.iterations = iterations;
  settings.checkpoint.steps = 1;
  settings.quiet = true;
  return settings;
}

DetectorPool stand_ins() {
  DetectorPool pool;
  for (int i = 0; i < 2; ++i) pool.push_back(std::make_unique<StandInDetector>());
  return pool;
}

TEST(Attack, LowersTheLossAndKeepsTheBox) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const DetectorPool detectors = stand_ins();
  const auto settings = settings_for(folder / "data", folder / "run", 25);
  const AttackResult result = run_attack(settings, detectors);
  EXPECT_EQ(result.iterations, 25);
  EXPECT_EQ(result.vehicles_train + result.vehicles_test, 3);
  const AttackState state = read_checkpoint(
      folder / "run/checkpoint.json", read_json(folder / "run/checkpoint.json").at("identity"), settings);
  ASSERT_EQ(state.losses.size(), 25u);
  EXPECT_LT(state.losses.back().loss(), state.losses.front().loss());
  for (const Vec3d& v : state.adversary.mesh.vertices)
    EXPECT_TRUE((v.cwiseAbs().array() <= settings.limits.half.array() + 1e-12).all());
  for (const Vec3d& t : state.adversary.atlas.texels) EXPECT_TRUE(t.minCoeff() >= 0 && t.maxCoeff() <= 1);
  const mirage::Run run = read_run(folder / "run");
  for (std::size_t i = 0; i < run.adversary.mesh.vertices.size(); ++i)
    EXPECT_EQ(run.adversary.mesh.vertices[i], state.adversary.mesh.vertices[i]);
}

TEST(Attack, ResumesToTheSameBits) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const DetectorPool detectors = stand_ins();
  run_attack(settings_for(folder / "data", folder / "whole", 7), detectors);
  run_attack(settings_for(folder / "data", folder / "parts", 3), detectors);
  run_attack(settings_for(folder / "data", folder / "parts", 7), detectors);
  EXPECT_EQ(read_file(folder / "whole/adversary.glb"), read_file(folder / "parts/adversary.glb"));
  EXPECT_EQ(read_file(folder / "whole/loss.csv"), read_file(folder / "parts/loss.csv"));
}

TEST(Attack, ARunNamesEverySettingAndOneWithoutIsRefused) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const DetectorPool detectors = stand_ins();
  const auto settings = settings_for(folder / "data", folder / "run", 3);
  run_attack(settings, detectors);
  const nlohmann::json run = read_json(folder / "run/run.json");
  EXPECT_EQ(read_run(folder / "run").settings.depth, settings.depth);
  EXPECT_EQ(read_run(folder / "run").settings.rooftop, settings.rooftop);

  // A missing field is refused, not guessed: an earlier program may have used another default.
  const nlohmann::json checkpoint = read_json(folder / "run/checkpoint.json");
  const auto refused = [&](const nlohmann::json::json_pointer& name) {
    nlohmann::json without = run;
    without.at(name.parent_pointer()).erase(name.back());
    write_json(folder / "run/run.json", without);
    EXPECT_THAT(error_text<InputError>([&] { read_run(folder / "run"); }),
                testing::AllOf(testing::HasSubstr(name.back()), testing::HasSubstr("missing")));
    without = checkpoint;
    without.at("identity").at(name.parent_pointer()).erase(name.back());
    write_json(folder / "run/checkpoint.json", without);
    EXPECT_THAT(error_text<InputError>([&] { run_attack(settings, detectors); }),
                testing::HasSubstr((name.parent_pointer().empty() ? name : name.parent_pointer()).back()));
  };
  for (const char* name : {"/depth", "/rooftop", "/sun", "/defense", "/parts", "/simulation/lidar_gradient"})
    refused(nlohmann::json::json_pointer(name));
}

TEST(Attack, APlacementsFileIsPartOfARun) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const DetectorPool detectors = stand_ins();
  const auto file = folder / "rack.toml";
  const std::string rack = read_file(shipped_file("scenes/placements/rear-rack.toml"));
  write_file(file, rack);
  const auto at = [&](const std::filesystem::path& place, const char* out, int iterations) {
    AttackSettings settings = settings_for(folder / "data", folder / out, iterations);
    set_from_text(place.string(), settings.placement);
    settings.min_view = 0;  // behind the car
    return settings;
  };
  const AttackResult whole = run_attack(at("rear-rack", "shipped", 3), detectors);
  const nlohmann::json said = to_json(whole);
  EXPECT_EQ(said.at("placement"), "rear-rack");
  EXPECT_EQ(said.at("placed").at("anchor"), "rear");
  EXPECT_EQ(said.at("left_out").at("no_room"), 0);
  // The volume is the mesh's box.
  const mirage::Run run = read_run(folder / "shipped");
  EXPECT_EQ(run.settings.limits.half, Vec3d(0.4, 0.8, 0.6));
  // A user's file with the same place gives the same mesh and resumes to the same bits; with another place it
  // is refused. run.json stores the place that the run used.
  run_attack(at(file, "own", 1), detectors);
  run_attack(at(file, "own", 3), detectors);
  EXPECT_EQ(read_file(folder / "own/adversary.glb"), read_file(folder / "shipped/adversary.glb"));
  write_file(file, std::string(rack).replace(rack.find("-0.5"), 4, "-0.6"));
  EXPECT_THAT(error_text<InputError>([&] { run_attack(at(file, "own", 3), detectors); }),
              testing::HasSubstr("placed"));
  std::filesystem::remove(file);
  const PlaceChoice kept = read_run(folder / "own").settings.placement;
  EXPECT_EQ(text_of(kept), file.string());
  EXPECT_EQ(content_of(kept), content_of(run.settings.placement));
  nlohmann::json without = read_json(folder / "own/run.json");
  without.erase("placed");
  write_json(folder / "own/run.json", without);
  EXPECT_THAT(error_text<InputError>([&] { read_run(folder / "own"); }), testing::HasSubstr("placed"));
}

TEST(Attack, ASizeOfTheUsersWinsOverThePlacements) {
  AttackSettings settings;
  set_from_text("rear-rack", settings.placement);
  set_from_text("0.8", settings.limits);
  fit_limits(settings);
  EXPECT_EQ(settings.limits.half, kRoofBox);
  settings.limits = {};
  fit_limits(settings);
  EXPECT_EQ(settings.limits.half, settings.placement.volume / 2);
  settings.limits = limits_of_size(0.3);
  fit_limits(settings);
  EXPECT_EQ(settings.limits.half, limits_of_size(0.3).half);
}

TEST(Attack, APhantomThatNothingRewardsIsRefused) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  AttackSettings settings = settings_for(folder / "data", folder / "run", 1);
  set_from_text("road-ahead", settings.placement);
  settings.objective.lambda_fp = 0;
  EXPECT_THAT(error_text<FieldError>([&] { run_attack(settings, stand_ins()); }),
              testing::AllOf(testing::HasSubstr("lambda_fp"), testing::HasSubstr("road-ahead")));
}

TEST(Attack, TheWorstOfDrawsInWhichNothingVariesIsRefused) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  AttackSettings settings = settings_for(folder / "data", folder / "run", 1);
  for (const char* alone : {"worst:4", "none,worst:4"}) {
    set_from_text(alone, settings.expectation);
    EXPECT_THAT(error_text<FieldError>([&] { run_attack(settings, stand_ins()); }),
                testing::HasSubstr("draws in which nothing varies"));
  }
}

TEST(Attack, LidarEffectsArePartOfARun) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const DetectorPool detectors = stand_ins();
  auto settings = settings_for(folder / "data", folder / "run", 1);
  settings.simulation.lidar_effects =
      parse_lidar_effects("noise,drop-out,dark-loss,divergence,motion,albedo", Vec2d(3e-3, 1e-3));
  settings.simulation.lidar_effects.seed = 9;
  run_attack(settings, detectors);
  const LidarEffects read = read_run(folder / "run").settings.simulation.lidar_effects,
                     &asked = settings.simulation.lidar_effects;
  EXPECT_EQ(read.range_sigma, asked.range_sigma);
  EXPECT_EQ(read.drop_out, asked.drop_out);
  EXPECT_EQ(read.signal_floor, asked.signal_floor);
  EXPECT_EQ(read.dark_floor, asked.dark_floor);
  EXPECT_EQ(read.divergence, asked.divergence);
  EXPECT_EQ(read.pulse_length, asked.pulse_length);
  EXPECT_EQ(read.albedo, asked.albedo);
  EXPECT_EQ(read.velocity, asked.velocity);
  EXPECT_EQ(read.yaw_rate, asked.yaw_rate);
  EXPECT_EQ(read.seed, asked.seed);
  // A run with other settings is refused in this folder, and so is a run.json with impossible effects.
  auto ideal = settings_for(folder / "data", folder / "run", 2);
  EXPECT_THAT(error_text<InputError>([&] { run_attack(ideal, detectors); }),
              testing::HasSubstr("simulation"));
  nlohmann::json run = read_json(folder / "run/run.json");
  run["simulation"]["lidar_effects"]["drop_out"] = 1.5;
  write_json(folder / "run/run.json", run);
  EXPECT_THAT(error_text<InputError>([&] { read_run(folder / "run"); }), testing::HasSubstr("drop_out"));
}

TEST(Attack, TargetsGateTheGradientNotTheSensors) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  auto settings = settings_for(folder / "data", folder / "run", 1);
  FrameStore store(settings.data, lidar_of(settings.data));
  const DetectorPool detectors = stand_ins();
  const auto prepared = store.get("000000");
  const auto hosts = find_hosts(store, "000000", detectors[0]->region(), settings.simulation);
  ASSERT_EQ(hosts.size(), 1u);
  const TexturedMesh adversary = initial_adversary();
  const auto step = [&](AttackTarget target) {
    settings.target = target;
    return attack_host(*detectors[0], {*prepared, hosts[0].id, store.placement(hosts[0].id)}, adversary,
                       settings);
  };
  const HostStep both = step(AttackTarget::both), image = step(AttackTarget::image),
                 lidar = step(AttackTarget::lidar);
  EXPECT_EQ(both.hide, image.hide);
  EXPECT_EQ(both.hide, lidar.hide);
  double lidar_texels = 0, lidar_vertices = 0, image_texels = 0;
  for (const Vec3d& d : lidar.gradient.texels) lidar_texels += d.norm();
  for (const Vec3d& d : lidar.gradient.vertices) lidar_vertices += d.norm();
  for (const Vec3d& d : image.gradient.texels) image_texels += d.norm();
  EXPECT_EQ(lidar_texels, 0);
  EXPECT_GT(lidar_vertices, 0);
  EXPECT_GT(image_texels, 0);
}

TEST(Attack, ADetectorInThePictureIsAttackedAndJudgedThere) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  DetectorPool detectors;
  detectors.push_back(std::make_unique<test::PictureStandIn>());
  auto settings = settings_for(folder / "data", folder / "run", 25);
  settings.target = AttackTarget::image;
  EXPECT_EQ(run_attack(settings, detectors).vehicles_train, 2);
  const AttackState state = read_checkpoint(
      folder / "run/checkpoint.json", read_json(folder / "run/checkpoint.json").at("identity"), settings);
  EXPECT_GT(state.losses.front().hide, 0);
  EXPECT_LT(state.losses.back().loss(), state.losses.front().loss());
  const mirage::Run run = read_run(folder / "run");
  FrameStore store(settings.data, lidar_of(settings.data));
  std::vector<HostId> hosts = run.train;
  hosts.insert(hosts.end(), run.test.begin(), run.test.end());
  const Evaluation evaluation =
      evaluate(detectors, store, hosts, run.adversary, settings.simulation, EvaluationSettings());
  EXPECT_EQ(evaluation.rates.vehicles, 3);
  for (const HostOutcome& host : evaluation.hosts) {
    EXPECT_TRUE(host.matching.in_picture());
    EXPECT_EQ(host.clean_iou, 1);
    EXPECT_NEAR(host.range, 11, 3);
  }
  settings.target = AttackTarget::lidar;
  settings.out = folder / "other";
  EXPECT_NE(error_text<InputError>([&] {
              run_attack(settings, detectors);
            }).find("target: lidar: stand-in does not read the LiDAR's returns; use image or both"),
            std::string::npos);
}

TEST(Attack, RandomTargetIsTheBaselineMesh) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  const DetectorPool detectors = stand_ins();
  auto settings = settings_for(folder / "data", folder / "run", 5);
  settings.target = AttackTarget::random;
  run_attack(settings, detectors);
  EXPECT_EQ(read_file(folder / "run/adversary.glb"), read_file(folder / "run/random.glb"));
}

TEST(Attack, PartsLeaveTheOtherAsItStarts) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  const DetectorPool detectors = stand_ins();
  const TexturedMesh start = initial_adversary();
  const auto learned = [&](AttackParts parts) {
    auto settings = settings_for(folder / "data", folder / to_word(parts), 3);
    settings.parts = parts;
    run_attack(settings, detectors);
    return read_run(settings.out).adversary;
  };
  const TexturedMesh shape = learned(AttackParts::shape), texture = learned(AttackParts::texture);
  EXPECT_NE(shape.mesh.vertices, start.mesh.vertices);
  EXPECT_EQ(shape.atlas.texels, start.atlas.texels);
  EXPECT_EQ(texture.mesh.vertices, start.mesh.vertices);
  EXPECT_NE(texture.atlas.texels, start.atlas.texels);
}

TEST(Attack, ExpectedWorldsAndBuildableMeshesResumeToTheSameBits) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const DetectorPool detectors = stand_ins();
  const auto settings = [&](const char* out, int iterations) {
    auto wanted = settings_for(folder / "data", folder / out, iterations);
    wanted.expectation = parse_expectation("all");
    wanted.buildable.on = true;
    wanted.vertex_rate = 0.02;
    return wanted;
  };
  const AttackResult whole = run_attack(settings("whole", 6), detectors);
  run_attack(settings("parts", 2), detectors);
  run_attack(settings("parts", 6), detectors);
  EXPECT_EQ(read_file(folder / "whole/adversary.glb"), read_file(folder / "parts/adversary.glb"));
  EXPECT_EQ(whole.buildable.intersecting_pairs, 0u);
  EXPECT_EQ(whole.buildable.printable, 1.0);
  EXPECT_GE(whole.buildable.min_thickness, 0.01);
  // The random mesh obeys the same rules.
  BuildableSettings rules;
  EXPECT_EQ(buildable_report(read_run(folder / "whole").random, rules).intersecting_pairs, 0u);
  // Other sampled environments make another run, which is refused.
  auto other = settings("whole", 7);
  other.expectation = parse_expectation("sun");
  EXPECT_THAT(error_text<InputError>([&] { run_attack(other, detectors); }),
              testing::HasSubstr("expectation"));
}

TEST(AttackInput, ErrorsNameFileAndField) {
  TemporaryFolder folder;
  const DetectorPool detectors = stand_ins();
  test::write_tiny_data(folder / "data", 2);
  auto settings = settings_for(folder / "data", folder / "run", 1);
  run_attack(settings, detectors);
  settings.batch = 3;
  EXPECT_THAT(error_text<InputError>([&] { run_attack(settings, detectors); }), testing::HasSubstr("batch"));
  settings.batch = 2;
  write_file(folder / "run/checkpoint.json", "{\"identity\": {");
  EXPECT_THAT(error_text<InputError>([&] { run_attack(settings, detectors); }),
              testing::HasSubstr("checkpoint.json: byte"));
  EXPECT_THAT(error_text<InputError>([&] { read_run(folder.path()); }), testing::HasSubstr("run.json"));
  EXPECT_THAT(
      error_text<InputError>([&] { run_attack(settings_for(folder / "none", folder / "r", 1), detectors); }),
      testing::HasSubstr("none"));
}

TEST(AttackInput, LabelsThatCannotCountAreSaid) {
  TemporaryFolder folder;
  const DetectorPool detectors = stand_ins();
  test::write_tiny_data(folder / "data", 2);
  const auto refused = [&] {
    return error_text<InputError>(
        [&] { run_attack(settings_for(folder / "data", folder / "run", 1), detectors); });
  };
  for (const char* frame : {"000000", "000001"}) {
    const auto file = folder / "data/training/label_2" / (std::string(frame) + ".txt");
    write_file(file, "vehicle.foo" + read_file(file).substr(3));
  }
  EXPECT_THAT(refused(), testing::AllOf(testing::HasSubstr("0 of 2"), testing::HasSubstr("2 vehicle.foo")));
  std::filesystem::remove_all(folder / "data/training/label_2");
  EXPECT_THAT(refused(), testing::HasSubstr("none of the 2 frames has any"));
}

// The stand-in finds one car in each frame, at the same place.
TEST(Attack, HostsMayBeWhatTheDetectorFinds) {
  TemporaryFolder folder;
  const DetectorPool detectors = stand_ins();
  test::write_tiny_data(folder / "data", 2);
  auto settings = settings_for(folder / "data", folder / "run", 2);
  settings.hosts_from = HostSource::detections;
  EXPECT_THAT(error_text<InputError>([&] { run_attack(settings, detectors); }),
              testing::HasSubstr("every frame has labels"));
  std::filesystem::remove_all(folder / "data/training/label_2");
  const AttackResult result = run_attack(settings, detectors);
  EXPECT_EQ(result.vehicles_train + result.vehicles_test, 2);
  const mirage::Run run = read_run(folder / "run");
  EXPECT_EQ(run.settings.hosts_from, HostSource::detections);
  const Frame frame = read_frame(run.settings.data, "000000");
  ASSERT_EQ(frame.labels.size(), 1u);
  EXPECT_NEAR(frame.labels[0].box.bev.x, 11.5, 1e-5);
  EXPECT_NEAR(frame.labels[0].box.bottom, -1.73, 0.01);  // the ground's height
  EXPECT_GT(frame.labels[0].right, frame.labels[0].left);
  settings.iterations = 3;
  EXPECT_EQ(run_attack(settings, detectors).iterations, 3);  // resumes: the same labels, the same run
  // A run with another detector is refused, and the finished run keeps its labels.
  const auto file = folder / "run/labelled/label_2/000000.txt";
  const std::string labels = read_file(file);
  write_file(file, labels + labels);  // another detector would give other labels
  settings.weights_hash = "another";
  EXPECT_THAT(error_text<InputError>([&] { run_attack(settings, detectors); }),
              testing::AllOf(testing::HasSubstr("labels.json"), testing::HasSubstr("another --out")));
  EXPECT_EQ(read_file(file), labels + labels);
}

TEST(AttackInput, OptionsThatNoRunCanUse) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  const DetectorPool detectors = stand_ins();
  const auto with = [&](const std::function<void(AttackSettings&)>& change) {
    auto settings = settings_for(folder / "data", folder / "run", 1);
    change(settings);
    return error_text<InputError>([&] { run_attack(settings, detectors); });
  };
  EXPECT_THAT(with([](auto& s) { s.simulation.raster.sigma = 0; }), testing::HasSubstr("sigma: "));
  EXPECT_THAT(with([](auto& s) { s.simulation.raster.sigma = 2; }), testing::HasSubstr("sigma: "));
  EXPECT_THAT(with([](auto& s) { s.limits.half *= 1e9; }), testing::HasSubstr("limits: "));
  EXPECT_THAT(with([](auto& s) { s.batch = 1 << 30; }), testing::HasSubstr("batch: "));
  EXPECT_THAT(with([](auto& s) { s.simulation.raster.gamma = -1; }), testing::HasSubstr("gamma: "));
  EXPECT_THAT(with([](auto& s) { s.vertex_rate = std::nan(""); }), testing::HasSubstr("vertex_rate: "));
  EXPECT_THAT(with([](auto& s) { s.min_view = 2; }), testing::HasSubstr("min_view: "));
  EXPECT_THAT(with([](auto& s) { s.iterations = -5; }), testing::HasSubstr("iterations: "));
}

/// A detector whose gradient is not finite.
class BrokenDetector : public StandInDetector {
 public:
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient gradient = StandInDetector::backward(d_logits);
    for (float& d : gradient.image.data) d = std::nanf("");
    return gradient;
  }
};

TEST(AttackInput, AGradientThatIsNotFiniteLeavesTheCheckpointGood) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  run_attack(settings_for(folder / "data", folder / "run", 2), stand_ins());
  const std::string before = read_file(folder / "run/checkpoint.json"),
                    learned = read_file(folder / "run/adversary.glb");
  DetectorPool broken;
  broken.push_back(std::make_unique<BrokenDetector>());
  EXPECT_THROW(run_attack(settings_for(folder / "data", folder / "run", 4), broken), Failure);
  EXPECT_EQ(read_file(folder / "run/checkpoint.json"), before);
  EXPECT_EQ(read_file(folder / "run/adversary.glb"), learned);  // of the steps before the failure
}

TEST(AttackInput, MoreFramesAreAnotherRun) {
  TemporaryFolder folder;
  const DetectorPool detectors = stand_ins();
  test::write_tiny_data(folder / "data", 2);
  run_attack(settings_for(folder / "data", folder / "run", 1), detectors);
  test::write_tiny_data(folder / "data", 4);  // changes the train/test split
  EXPECT_THAT(error_text<InputError>(
                  [&] { run_attack(settings_for(folder / "data", folder / "run", 2), detectors); }),
              testing::HasSubstr("checkpoint.json: t"));
}

TEST(AttackRoofs, CarsWithReturnsAreFittedAndTheOthersFlagged) {
  TemporaryFolder folder;
  const DetectorPool detectors = stand_ins();
  test::write_tiny_data(folder / "seen", 3, true);
  test::write_tiny_data(folder / "unseen", 3);
  const auto counted = [&](const char* data, const char* out, const std::string& rooftop) {
    auto settings = settings_for(folder / data, folder / out, 2);
    settings.rooftop = rooftop;
    const AttackResult result = run_attack(settings, detectors);
    const mirage::Run run = read_run(folder / out);
    EXPECT_EQ(run.settings.rooftop, rooftop);
    std::vector<HostId> hosts = run.train;
    hosts.insert(hosts.end(), run.test.begin(), run.test.end());
    FrameStore store(run.settings);
    EvaluationSettings quiet;
    quiet.quiet = true;
    const Evaluation evaluation =
        evaluate(detectors, store, hosts, run.adversary, run.settings.simulation, quiet);
    EXPECT_EQ(evaluation.rooftops.fitted, result.rooftops.fitted);
    EXPECT_EQ(to_json(evaluation).at("rooftops"), to_json(result.rooftops));
    EXPECT_EQ(to_json(evaluation).at("outcomes").at(0).at("from_box"), result.rooftops.from_box > 0);
    return std::pair(result.rooftops.fitted, result.rooftops.from_box);
  };
  EXPECT_EQ(counted("seen", "shape", "shape"), std::pair(3, 0));
  EXPECT_EQ(counted("seen", "box", "box"), std::pair(0, 3));
  EXPECT_EQ(counted("unseen", "few", "shape"), std::pair(0, 3));
  FrameStore store(FrameSource{folder / "unseen", "ip-basic", "shape"});
  EXPECT_THAT(store.placement({"000000", 0}).carrier->reason, testing::HasSubstr("fewer than"));
  EXPECT_THAT(error_text<InputError>([&] {
                store.placement({"000000", 7});
              }),
              testing::HasSubstr("000000_7"));
}

TEST(AttackSun, AFolderHoldsARunUnderOneSun) {
  TemporaryFolder folder;
  const DetectorPool detectors = stand_ins();
  test::write_tiny_data(folder / "data", 2, true);
  const auto run = [&](const char* out, const std::string& sun) {
    auto settings = settings_for(folder / "data", folder / out, 1);
    settings.sun = sun;
    run_attack(settings, detectors);
  };
  run("own", "frame");
  run("left", "90,30");
  EXPECT_EQ(read_json(folder / "own/run.json").at("sun"), "frame");
  EXPECT_EQ(read_run(folder / "own").settings.sun, "frame");
  EXPECT_EQ(read_run(folder / "left").settings.sun, "90,30");
  for (const char* other : {"frame", "photo", "90,31"})
    EXPECT_THAT(error_text<InputError>([&] { run("left", other); }), testing::HasSubstr("sun")) << other;
  EXPECT_THAT(error_text<InputError>([&] { run("own", "90,30"); }), testing::HasSubstr("sun"));
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box", "90,30"}),
      own(FrameSource{folder / "data", "ip-basic", "box"});
  const Lighting lit = store.get("000000")->frame.lighting, before = own.get("000000")->frame.lighting;
  EXPECT_NEAR((lit.to_sun_velo - Vec3d(0, std::sqrt(0.75), 0.5)).norm(), 0, 1e-12);
  EXPECT_EQ(lit.sun, before.sun);
}

TEST(AttackRoofs, AFolderHoldsOneFindersRun) {
  TemporaryFolder folder;
  const DetectorPool detectors = stand_ins();
  test::write_tiny_data(folder / "data", 2, true);
  const auto run = [&](const char* out, const std::string& rooftop) {
    auto settings = settings_for(folder / "data", folder / out, 1);
    settings.rooftop = rooftop;
    run_attack(settings, detectors);
  };
  run("shape", "shape");
  run("box", "box");
  EXPECT_THAT(error_text<InputError>([&] { run("shape", "box"); }), testing::HasSubstr("rooftop"));
  EXPECT_THAT(error_text<InputError>([&] { run("box", "shape"); }), testing::HasSubstr("rooftop"));
  EXPECT_THAT(error_text<InputError>([&] { run("new", "cone"); }), testing::StartsWith("rooftop: cone: "));
  EXPECT_EQ(read_json(folder / "box/run.json").at("rooftop"), "box");
}

TEST(AttackThreads, OneAndTwoDetectorsGiveTheSameBits) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3, true);
  DetectorPool one;
  one.push_back(std::make_unique<StandInDetector>());
  run_attack(settings_for(folder / "data", folder / "one", 5), one);
  run_attack(settings_for(folder / "data", folder / "two", 5), stand_ins());
  EXPECT_EQ(read_file(folder / "one/adversary.glb"), read_file(folder / "two/adversary.glb"));
}

TEST(AttackSplit, SevenToThreeByFrameAndBySeed) {
  std::vector<std::string> frames, train, test, train2, test2;
  for (int i = 0; i < 40; ++i) frames.push_back(std::to_string(100 + i));
  split_frames(frames, 1, train, test);
  EXPECT_EQ(train.size(), 28u);
  EXPECT_EQ(test.size(), 12u);
  for (const auto& id : test) EXPECT_THAT(train, testing::Not(testing::Contains(id)));
  split_frames(frames, 1, train2, test2);
  EXPECT_EQ(train, train2);
  split_frames(frames, 2, train2, test2);
  EXPECT_NE(train, train2);
}

TEST(Adam, FirstStepIsTheLearningRate) {
  Adam adam;
  std::vector<Vec3d> x{Vec3d(1, 1, 1)};
  adam.step(x, {Vec3d(3, -0.2, 0)});
  EXPECT_NEAR(x[0].x(), 1 - 1e-3, 1e-8);
  EXPECT_NEAR(x[0].y(), 1 + 1e-3, 1e-8);
  EXPECT_EQ(x[0].z(), 1);
}

}  // namespace
}  // namespace mirage
