// Attacks that stop at a plateau, and attacks that learn the size alone.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "attack/attack.h"
#include "attack/attack_hosts.h"
#include "attack/attack_step.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/random.h"
#include "support/files.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

using test::error_text;

AttackSettings plateau_settings(const test::TemporaryFolder& folder, const char* out, int iterations,
                                int until) {
  AttackSettings settings = test::tiny_attack();
  settings.data = folder / "data";
  settings.out = folder / out;
  settings.iterations = iterations;
  settings.until_plateau = until;
  settings.validation_every = 2;
  settings.rooftop = "box";
  settings.quiet = true;
  return settings;
}

template <class Kind>
DetectorPool pool_of() {
  DetectorPool pool;
  pool.push_back(std::make_unique<Kind>());
  return pool;
}

TEST(Plateau, EndsWhereTheBestIsOldEnough) {
  HeldOutRecord record;
  EXPECT_FALSE(record.plateau(1));
  const TexturedMesh mesh = initial_adversary();
  const double values[] = {5, 3, 4, 3, 2.5, 2.6, 2.7};
  const bool ends[] = {false, false, false, true, false, false, true};  // after 20 steps without a better one
  for (int i = 0; i < 7; ++i) {
    record.add(10 * i, values[i], mesh);
    EXPECT_EQ(record.plateau(20), ends[i]) << i;
  }
  EXPECT_EQ(record.best_iteration, 40);
  EXPECT_EQ(record.best, 2.5);
}

TEST(Plateau, WholeFramesAreHeldOutBySeed) {
  std::vector<Host> train;
  for (int frame = 0; frame < 50; ++frame)
    for (int label = 0; label < 3; ++label) train.push_back({{std::to_string(100 + frame), label}, {}});
  const ValidationPart part = split_validation(train, 1);
  EXPECT_EQ(part.learn.size() + part.held_out.size(), train.size());
  EXPECT_EQ(part.held_out.size(), 18u);  // six frames of three hosts: at least 16 are needed
  std::set<std::string> learn, held;
  for (const Host& host : part.learn) learn.insert(host.id.frame);
  for (const Host& host : part.held_out) held.insert(host.id.frame);
  for (const std::string& frame : held) EXPECT_FALSE(learn.contains(frame));
  const auto names = [](const std::vector<Host>& hosts) {
    std::string all;
    for (const Host& host : hosts) all += host_name(host.id) + " ";
    return all;
  };
  EXPECT_EQ(names(split_validation(train, 1).held_out), names(part.held_out));
  EXPECT_NE(names(split_validation(train, 2).held_out), names(part.held_out));
  const std::vector<Host> few(train.begin(), train.begin() + 30);  // ten frames: a fifth is two
  EXPECT_EQ(split_validation(few, 1).held_out.size(), 6u);
  const std::vector<Host> two(train.begin() + 2, train.begin() + 4);
  EXPECT_EQ(split_validation(two, 1).held_out.size(), 1u);
  EXPECT_THAT(error_text<InputError>([&] { split_validation({train[0]}, 1); }),
              testing::StartsWith("until_plateau: 1 training frame: "));
}

/// Gives the same answer for any object, so that nothing can improve.
class Unmoved : public test::StandInDetector {
 public:
  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    StandInDetector::forward(input, score_threshold, keep_graph);
    return {{{11.5, 0, 4, 1.7, 0}, 1.5}};
  }
  SensorGradient backward(std::span<const double>) override { return StandInDetector::backward({{0.0}}); }
};

TEST(Plateau, APlantedOneEndsTheAttack) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 4);
  const DetectorPool detectors = pool_of<Unmoved>();
  auto settings = plateau_settings(folder, "run", 100, 6);
  settings.objective.lambda_laplacian = 0;
  const AttackResult result = run_attack(settings, detectors);
  EXPECT_EQ(result.iterations, 6);
  ASSERT_TRUE(result.plateau);
  EXPECT_TRUE(result.plateau->stopped);
  EXPECT_EQ(result.plateau->best_iteration, 0);
  EXPECT_EQ(result.plateau->values.size(), 4u);              // after 0, 2, 4 and 6 steps
  EXPECT_EQ(run_attack(settings, detectors).iterations, 6);  // it does not go on
  settings.until_plateau = 8;                                // more patience prolongs it
  EXPECT_EQ(run_attack(settings, detectors).iterations, 8);
  // Without the option, no hosts are held out.
  const AttackResult plain = run_attack(plateau_settings(folder, "plain", 2, 0), detectors);
  EXPECT_FALSE(plain.plateau);
  EXPECT_TRUE(to_json(plain).at("plateau").is_null());
  EXPECT_FALSE(read_json(folder / "plain/run.json").contains("validation"));
  const auto run = read_json(folder / "run/run.json");
  EXPECT_EQ(run.at("validation").size(), 1u);
  EXPECT_EQ(run.at("train").size(), 3u);  // all three chose the mesh, so none of them may judge it
}

/// More certain with every step: the mesh of the first step stays the best.
class Hardening : public test::StandInDetector {
 public:
  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    auto found = StandInDetector::forward(input, score_threshold, keep_graph);
    for (Detection& one : found) one.logit += 0.5 * std::max(0, steps_ - 4);
    return found;
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    ++steps_;
    return StandInDetector::backward(d_logits);
  }

 private:
  int steps_ = 0;
};

TEST(Plateau, TheBestMeshIsKeptAndNotTheLast) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 4);
  const DetectorPool detectors = pool_of<Hardening>();
  auto settings = plateau_settings(folder, "run", 11, 100);
  settings.batch = 1;
  settings.texel_rate = 0.1;
  const AttackResult result = run_attack(settings, detectors);
  ASSERT_TRUE(result.plateau);
  EXPECT_FALSE(result.plateau->stopped);
  const long best = result.plateau->kept_iteration;
  EXPECT_GT(best, 0);
  EXPECT_LT(best, 11);
  const std::vector<double>& values = result.plateau->values;
  EXPECT_EQ(result.plateau->best, *std::min_element(values.begin(), values.end()));
  const auto checkpoint = read_json(folder / "run/checkpoint.json");
  const AttackState state = read_checkpoint(folder / "run/checkpoint.json", checkpoint.at("identity"),
                                            plateau_settings(folder, "run", 11, 50));
  const mirage::Run run = read_run(folder / "run");
  EXPECT_EQ(run.adversary.mesh.vertices, state.held_out.mesh.mesh.vertices);
  EXPECT_EQ(run.adversary.atlas.texels, state.held_out.mesh.atlas.texels);
  EXPECT_NE(run.adversary.atlas.texels, state.adversary.atlas.texels);
}

TEST(Plateau, ResumesToTheSameBits) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 4);
  const DetectorPool detectors = pool_of<test::StandInDetector>();
  for (const char* expect : {"none", "all"}) {
    const auto run = [&](const std::string& out, int iterations) {
      auto settings = plateau_settings(folder, out.c_str(), iterations, 50);
      settings.expectation = parse_expectation(expect);
      settings.checkpoint.steps = 1;
      return to_json(run_attack(settings, detectors)).at("plateau");
    };
    const std::string whole = std::string("whole-") + expect, parts = std::string("parts-") + expect;
    const auto told = run(whole, 9);
    for (const int until : {1, 4, 5, 9, 9}) run(parts, until);
    EXPECT_EQ(run(parts, 9), told);
    EXPECT_EQ(read_file(folder / parts / "checkpoint.json"), read_file(folder / whole / "checkpoint.json"));
    EXPECT_EQ(read_file(folder / parts / "adversary.glb"), read_file(folder / whole / "adversary.glb"));
    EXPECT_EQ(told.at("values").size(), 5u);
  }
  // On two detectors at once, too.
  DetectorPool two = pool_of<test::StandInDetector>();
  two.push_back(std::make_unique<test::StandInDetector>());
  run_attack(plateau_settings(folder, "two", 9, 50), two);
  EXPECT_EQ(read_file(folder / "two/adversary.glb"), read_file(folder / "whole-none/adversary.glb"));
}

TEST(Plateau, ADamagedRecordIsRefused) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const DetectorPool detectors = pool_of<test::StandInDetector>();
  run_attack(plateau_settings(folder, "run", 4, 50), detectors);
  const auto file = folder / "run/checkpoint.json";
  const auto good = read_json(file);
  const auto with = [&](const char* key, const nlohmann::json& value) {
    auto bad = good;
    bad["held_out"][key] = value;
    write_json(file, bad);
    return error_text<InputError>(
        [&] { read_checkpoint(file, good.at("identity"), plateau_settings(folder, "run", 4, 50)); });
  };
  EXPECT_THAT(with("iterations", {0, 4, 2}), testing::HasSubstr("held_out.iterations"));
  EXPECT_THAT(with("iterations", {0, 2, 7}), testing::HasSubstr("held_out.iterations"));
  EXPECT_THAT(with("iterations", nlohmann::json::array()), testing::HasSubstr("held_out.iterations"));
  EXPECT_THAT(with("values", {1, 2}), testing::HasSubstr("held_out.values"));
  EXPECT_THAT(with("best_iteration", 1), testing::HasSubstr("held_out.best_iteration"));
  EXPECT_THAT(with("vertices", {1, 2, 3}), testing::HasSubstr("held_out.vertices"));
  EXPECT_THAT(
      error_text<InputError>([&] { run_attack(plateau_settings(folder, "other", 1, -1), detectors); }),
      testing::HasSubstr("until_plateau: -1"));
  auto settings = plateau_settings(folder, "other", 1, 5);
  settings.validation_every = 0;
  EXPECT_THAT(error_text<InputError>([&] { run_attack(settings, detectors); }),
              testing::HasSubstr("validation_every: 0"));
}

TEST(SizeAlone, TheStartFillsABoxOfHalfLengthsOne) {
  const TexturedMesh unit = initial_adversary({Vec3d::Ones()}, 1);
  EXPECT_EQ(half_lengths(unit.mesh), Vec3d(1, 1, 1));
  EXPECT_EQ(half_lengths(initial_adversary().mesh), Vec3d(0.75 * 0.8, 0.75 * 0.8, 0.75 * 0.5));
}

TEST(SizeAlone, GradientOfTheHalfLengths) {
  const auto unit = initial_adversary({Vec3d::Ones()}, 1).mesh.vertices;
  RandomStream random(5, "size alone");
  std::vector<Vec3d> slope;
  for (std::size_t i = 0; i < unit.size(); ++i)
    slope.push_back({random.normal(), random.normal(), random.normal()});
  const auto f = [&](const std::vector<double>& half) {  // smooth, not linear, and different for each vertex
    double sum = 0;
    for (std::size_t i = 0; i < unit.size(); ++i)
      sum += std::sin(slope[i].dot(unit[i].cwiseProduct(Vec3d(half[0], half[1], half[2]))));
    return sum;
  };
  for (const Vec3d& half : {Vec3d(0.6, 0.5, 0.3), Vec3d(1e-3, 2, 0.7), Vec3d(0, 0, 0)}) {
    std::vector<Vec3d> d_vertices;
    for (std::size_t i = 0; i < unit.size(); ++i)
      d_vertices.push_back(std::cos(slope[i].dot(unit[i].cwiseProduct(half))) * slope[i]);
    const Vec3d gradient = half_length_gradient(unit, d_vertices);
    test::check_gradient(f, {half.x(), half.y(), half.z()}, {gradient.x(), gradient.y(), gradient.z()}, 1e-6,
                         1e-7);
  }
}

TEST(SizeAlone, OnlyThreeNumbersAreLearned) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const DetectorPool detectors = pool_of<test::StandInDetector>();
  const auto run = [&](const char* out, int iterations) {
    auto settings = plateau_settings(folder, out, iterations, 0);
    settings.parts = AttackParts::size;
    settings.vertex_rate = 0.02;
    run_attack(settings, detectors);
    return read_run(settings.out).adversary;
  };
  const TexturedMesh learned = run("whole", 12), start = initial_adversary();
  const auto unit = initial_adversary({Vec3d::Ones()}, 1).mesh.vertices;
  const Vec3d half = half_lengths(learned.mesh);
  EXPECT_GT((half - half_lengths(start.mesh)).norm(), 0.01);
  EXPECT_TRUE((half.array() <= Vec3d(0.8, 0.8, 0.5).array()).all());
  for (std::size_t i = 0; i < unit.size(); ++i)
    EXPECT_EQ(learned.mesh.vertices[i], unit[i].cwiseProduct(half));
  EXPECT_EQ(learned.atlas.texels, start.atlas.texels);
  const auto losses = read_json(folder / "whole/checkpoint.json").at("losses").get<std::vector<double>>();
  EXPECT_LT(losses[losses.size() - 3], losses[0]);
  run("parts", 5);
  run("parts", 12);
  EXPECT_EQ(read_file(folder / "parts/adversary.glb"), read_file(folder / "whole/adversary.glb"));
  auto buildable = plateau_settings(folder, "b", 1, 0);
  buildable.parts = AttackParts::size;
  buildable.buildable.on = true;
  EXPECT_THAT(error_text<InputError>([&] { run_attack(buildable, detectors); }),
              testing::HasSubstr("parts: size"));
}

/// Reads the picture alone. Returns appear and vanish with size, and no gradient shows that.
class PictureReader : public test::StandInDetector {
 public:
  std::vector<Detection> forward(const SensorView& input, double threshold, bool keep) override {
    return StandInDetector::forward({input.image, {}, input.calibration}, threshold, keep);
  }
};

/// Half lengths → ellipsoid → picture → logit → loss.
TEST(SizeAlone, TheWholeChainAgainstDifferences) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  AttackSettings settings = test::tiny_attack();
  settings.simulation.reference = true;  // in double
  PictureReader detector;
  settings.target = AttackTarget::image;
  const HostId id = find_hosts(store, "000000", detector.region(), settings.simulation).at(0).id;
  const auto prepared = store.get("000000");
  const StepHost host{*prepared, id, store.placement(id)};
  const auto unit = initial_adversary({Vec3d::Ones()}, 1).mesh.vertices;
  const auto mesh = [&](const Vec3d& half) {
    TexturedMesh made = initial_adversary();
    for (std::size_t i = 0; i < unit.size(); ++i) made.mesh.vertices[i] = unit[i].cwiseProduct(half);
    return made;
  };
  const Vec3d start = half_lengths(initial_adversary().mesh);
  const HostStep step = attack_host(detector, host, mesh(start), settings);
  const Vec3d exact = half_length_gradient(unit, step.gradient.vertices);
  ASSERT_GT(exact.norm(), 0);
  for (int c = 0; c < 3; ++c) {
    const double h = 2e-4;
    const auto loss = [&](double shift) {
      Vec3d half = start;
      half[c] += shift;
      return attack_host(detector, host, mesh(half), settings, false).hide;
    };
    const double numeric = (loss(h) - loss(-h)) / (2 * h);
    EXPECT_NEAR(exact[c], numeric, 0.02 * exact.norm()) << c;
    std::printf("d loss / d half[%d]: %.5f, differences %.5f\n", c, exact[c], numeric);
  }
}

}  // namespace
}  // namespace mirage
