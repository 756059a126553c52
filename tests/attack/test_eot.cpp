// The false-positive loss over the largest background logits.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <set>

#include "attack/attack.h"
#include "attack/attack_step.h"
#include "attack/eot.h"
#include "attack/evaluation.h"
#include "attack/objective.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/random.h"
#include "base/sizes.h"
#include "frames/hosts.h"
#include "support/files.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

const BevBox kCarrier{10, 0, 4, 2, 0};

Detection at(double x, double y, double logit) {
  return {{x, y, 4, 2, 0}, logit};
}

ObjectiveSettings top(int k, double lambda = 1) {
  ObjectiveSettings settings;
  settings.fp_top_k = k;
  settings.lambda_fp = lambda;
  return settings;
}

TEST(TopBackground, TakesTheLargestLogitsWhateverTheirScore) {
  const std::vector<ObjectBoxes> labels{kCarrier, BevBox{31, 0, 4, 2, 0}};
  const std::vector<Detection> proposals{at(10, 0, 2),      // the host
                                         at(30, 0, 5),      // another label
                                         at(50, 10, -6),    // background at 0.2 %
                                         at(50, -10, -4),   // … at 2 %
                                         at(20, 15, -9),    //
                                         at(40, -15, -4)};  // as large as the fourth, and later
  const HostTruth truth(kCarrier, labels);
  const auto one = objective(proposals, truth, top(1, 0.5));
  EXPECT_NEAR(one.false_positive, -0.5 * softplus(-4), 1e-15);
  EXPECT_LT(one.d_logits[3], 0);
  EXPECT_EQ(one.d_logits[5], 0);
  const auto three = objective(proposals, truth, top(3));
  EXPECT_NEAR(three.false_positive, -2 * softplus(-4) - softplus(-6), 1e-15);
  EXPECT_EQ(three.d_logits[4], 0);
  EXPECT_EQ(three.d_logits[1], 0);
  const auto all = objective(proposals, truth, top(100));
  EXPECT_NEAR(all.false_positive, three.false_positive - softplus(-9), 1e-15);
  EXPECT_EQ(all.hide, objective(proposals, truth, top(0)).hide);     // hiding is as it was
  EXPECT_EQ(objective(proposals, truth, top(0)).false_positive, 0);  // none over the default threshold
  EXPECT_EQ(objective({}, truth, top(5)).false_positive, 0);
}

TEST(TopBackground, LeavesOutWhatIsSeenInTheCleanFrame) {
  const std::vector<Detection> proposals{at(50, 10, 1), at(52, 10.5, 0.5), at(20, 15, -3)};
  const std::vector<Detection> clean{at(51, 10, 2)};  // an unlabelled car
  const HostTruth truth(kCarrier, {kCarrier});
  const auto value = objective(proposals, truth, top(2), clean);
  EXPECT_EQ(value.d_logits[0], 0);
  EXPECT_EQ(value.d_logits[1], 0);
  EXPECT_NEAR(value.false_positive, -softplus(-3), 1e-15);
}

/// A camera that looks along x, a host, and a DontCare region of the picture.
Frame frame_with_region(const PictureBox& region) {
  Frame frame;
  frame.calibration.camera = {700, 700, 600, 180, 1200, 370};
  Eigen::Matrix3d axes;
  axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  frame.calibration.camera_from_velo.linear() = axes;
  Label host, unknown;
  host.type = "Car";
  host.box = {kCarrier, -1.7, 1.5};
  unknown.type = "DontCare";
  unknown.left = region.left, unknown.top = region.top;
  unknown.right = region.right, unknown.bottom = region.bottom;
  frame.labels = {host, unknown};
  return frame;
}

TEST(TopBackground, LeavesOutDontCareRegionsSeenFromAbove) {
  // A car's box at 40 m, 10 m to the left, stands around column 600 − 700 · 10 / 40 = 425.
  const Frame frame = frame_with_region({380, 170, 470, 220});
  const HostTruth truth(frame, frame.labels[0], kFromAbove);
  EXPECT_TRUE(truth.in_dont_care(at(40, 10, 0)));
  EXPECT_FALSE(truth.in_dont_care(at(40, -10, 0)));
  EXPECT_FALSE(truth.in_dont_care(at(40, 13, 0)));   // outside the region
  EXPECT_FALSE(truth.in_dont_care(at(-40, 10, 0)));  // behind the camera
  EXPECT_EQ(truth.label_iou(at(40, 10, 0)), 0);      // the evaluation's rule does not change
  const std::vector<Detection> proposals{at(40, 10, 3), at(40, -10, -2)};
  EXPECT_NEAR(objective(proposals, truth, top(1)).false_positive, -softplus(-2), 1e-15);
}

TEST(TopBackground, GradientInLogits) {
  RandomStream random(3, "top background");
  for (int round = 0; round < 5; ++round) {
    std::vector<Detection> proposals;
    std::vector<double> logits;
    for (int i = 0; i < 40; ++i) {  // logit gaps that keep the top set under a step
      logits.push_back(0.4 * i - 10);
      std::swap(logits.back(), logits[as_size(random.below(i + 1))]);
    }
    for (const double logit : logits)
      proposals.push_back(at(random.uniform(0, 70), random.uniform(-30, 30), logit));
    const HostTruth truth(kCarrier, {kCarrier, BevBox{40, 5, 4, 2, 1}});
    const std::vector<Detection> clean{at(20, 10, 1)};
    const auto f = [&](const std::vector<double>& x) {
      for (std::size_t i = 0; i < x.size(); ++i) proposals[i].logit = x[i];
      const auto value = objective(proposals, truth, top(8, 0.7), clean);
      return value.hide + value.false_positive;
    };
    const auto gradient = objective(proposals, truth, top(8, 0.7), clean).d_logits;
    EXPECT_EQ(std::count_if(gradient.begin(), gradient.end(), [](double d) { return d < 0; }), 8);
    test::check_gradient(f, logits, gradient, 1e-5, 1e-8);
  }
}

/// Finds the host and an unlabelled car in every frame, with background proposals beside it; counts its
/// passes.
class UnlabelledCar : public test::StandInDetector {
 public:
  int clean_passes = 0;
  std::vector<double> asked;
  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    StandInDetector::forward(input, score_threshold, keep_graph);
    clean_passes += !keep_graph;
    asked.push_back(score_threshold);
    std::vector<Detection> found;
    for (const Detection& one :
         {at(30, 10, 2), at(30.5, 10, 1.5), at(20, -12, -5), Detection{test::tiny_car(0), 1}})
      if (one.score() > score_threshold) found.push_back(one);
    return found;
  }
};

TEST(TopBackground, AnAttackLooksAtEachCleanFrameOnce) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  DetectorPool detectors;
  auto owned = std::make_unique<UnlabelledCar>();
  UnlabelledCar& detector = *owned;
  detectors.push_back(std::move(owned));
  AttackSettings settings = test::tiny_attack();
  settings.data = folder / "data";
  settings.out = folder / "run";
  settings.iterations = 6;
  settings.rooftop = "box";
  settings.quiet = true;
  settings.objective.lambda_fp = 1;
  settings.objective.fp_top_k = 3;
  run_attack(settings, detectors);
  EXPECT_EQ(detector.clean_passes, 2);  // two training frames
  EXPECT_EQ(std::count(detector.asked.begin(), detector.asked.end(), 0.0),
            12);  // every proposal, in 6 steps of 2 hosts
  // Of the three proposals beside the host one is no clean detection; the loss is its loss alone.
  const AttackState state = read_checkpoint(
      settings.out / "checkpoint.json", read_json(settings.out / "checkpoint.json").at("identity"), settings);
  EXPECT_NEAR(state.losses.front().false_positive, -softplus(-5), 1e-12);
  EXPECT_EQ(read_json(settings.out / "run.json").at("fp_top_k"), 3);
  settings.objective.fp_top_k = 0;  // another rule makes another run
  EXPECT_THAT(test::error_text<InputError>([&] { run_attack(settings, detectors); }),
              testing::HasSubstr("fp_top_k"));
}

using ::testing::HasSubstr;

TEST(EotSettings, WordsSwitchWhatVaries) {
  EXPECT_FALSE(parse_expectation("none").any());
  EXPECT_FALSE(parse_expectation("").any());
  const EotSettings some = parse_expectation("sun,noise");
  EXPECT_GT(some.sun, 0);
  EXPECT_GT(some.image_noise, 0);
  EXPECT_GT(some.range_noise, 0);
  EXPECT_EQ(some.roof_shift, 0);
  EXPECT_EQ(some.exposure, 0);
  const EotSettings all = parse_expectation("all");
  for (const double spread : {all.roof_shift, all.roof_yaw, all.tilt, all.shape, all.colour, all.sun,
                              all.light, all.exposure, all.image_noise, all.range_noise})
    EXPECT_GT(spread, 0);
  EXPECT_EQ(parse_expectation("shape:0.02").shape, 0.02);
  for (const char* wrong :
       {"shape:", "shape:x", "shape:-1", "shape:0", "shape:1", "shape:nan", "shape:0.01 m"})
    EXPECT_THAT(test::error_text<InputError>([&] { parse_expectation(wrong); }), HasSubstr("shape:0.01"))
        << wrong;
  EXPECT_THAT(test::error_text<InputError>([] { parse_expectation("roof,moon"); }),
              AllOf(HasSubstr("expectation: "), HasSubstr("moon")));
}

TEST(EotSettings, AListThatContradictsItselfIsRefusedAndItsOptionNamed) {
  for (const char* wrong : {"none,all", "roof,none", "shape:0.02,shape:0.03", "shape,shape:0.02",
                            "worst:2,roof,worst:4", "sun,sun", "all,all"})
    try {
      parse_expectation(wrong);
      ADD_FAILURE() << wrong;
    } catch (const FieldError& error) {  // the command line shows the field's option
      EXPECT_EQ(error.field, "expectation") << wrong;
      EXPECT_EQ(error.value, wrong);
    }
  for (const char* wrong : {"shape:0", "worst:1", "paints:1"})
    EXPECT_THROW(parse_expectation(wrong), FieldError) << wrong;
  EXPECT_THROW(require_judged(parse_expectation("roof,worst:4")), FieldError);
  EXPECT_THROW(require_built(parse_expectation("sun")), FieldError);
  EXPECT_EQ(parse_expectation("shape:0.02,all").shape, 0.02);  // in any order
  EXPECT_EQ(parse_expectation("all,shape:0.02").shape, 0.02);
}

TEST(EotSettings, TheWorstOfDrawsIsOfSomeThatVary) {
  const EotSettings e = parse_expectation("worst:4,shape:0.02");
  EXPECT_EQ(e.draws(), 4);
  EXPECT_EQ(e.shape, 0.02);
  EXPECT_EQ(parse_expectation("all").draws(), 1);
  for (const char* wrong : {"worst:1", "worst:65", "worst:2.5", "worst:x", "worst:"})
    EXPECT_THAT(test::error_text<InputError>([&] { parse_expectation(std::string("roof,") + wrong); }),
                HasSubstr("use 2 to 64, as in worst:4"))
        << wrong;
  EXPECT_THAT(test::error_text<InputError>([&] { require_judged(e); }), HasSubstr("mirage attack alone"));
  // No world's number occurs twice, and none equals that of an attack without draws or of its validation
  // (from 2^62 on).
  std::set<std::uint64_t> numbers;
  std::size_t all = 0;
  for (const std::uint64_t base : {std::uint64_t{0}, std::uint64_t{1} << 62})
    for (std::uint64_t step = 0; step < 50; ++step) {
      numbers.insert(base + step);
      for (int k = 0; k < 64; ++k) numbers.insert(candidate_draw(base + step, k));
      all += 65;
    }
  EXPECT_EQ(numbers.size(), all);
}

TEST(EotSettings, WhatIsValidatedIsTheBuiltObjectInTheRecordedWorld) {
  for (const char* good : {"none", "shape:0.02,colour", "roof,tilt"}) require_built(parse_expectation(good));
  for (const char* wrong : {"sun", "light", "exposure", "noise"})
    EXPECT_THAT(test::error_text<InputError>(
                    [&] { require_built(parse_expectation(std::string("shape,") + wrong)); }),
                AllOf(HasSubstr(wrong), HasSubstr("use some of shape, colour, paints, roof and tilt")));
  EXPECT_THAT(test::error_text<InputError>([&] { require_built(parse_expectation("shape,worst:2")); }),
              HasSubstr("worst:2"));
}

TEST(EotSettings, DrawsHaveTheStatedSpreadAndDependOnTheirIndexAlone) {
  const EotSettings e = parse_expectation("all");
  Placement known;
  known.velo_from_adversary = Eigen::Translation3d(10, 2, -0.2) * Eigen::AngleAxisd(0.7, Vec3d::UnitZ());
  double along = 0, up = 0, yaw = 0;
  constexpr int kDraws = 4000;
  for (int i = 0; i < kDraws; ++i) {
    const Placement drawn = SampledEnvironment(e, 5, static_cast<std::uint64_t>(i)).placement(known);
    const Transform off = known.velo_from_adversary.inverse() * drawn.velo_from_adversary;
    along += std::pow(off.translation().x(), 2) / kDraws;
    up += std::pow(off.translation().z(), 2) / kDraws;
    yaw += std::pow(std::atan2(off(1, 0), off(0, 0)), 2) / kDraws;
  }
  // Standard errors of a spread from 4000 draws: 1.1 %.
  EXPECT_NEAR(std::sqrt(along) / e.roof_shift, 1, 0.05);
  EXPECT_NEAR(std::sqrt(up) / (e.roof_shift / 5), 1, 0.05);
  EXPECT_NEAR(std::sqrt(yaw) / e.roof_yaw, 1, 0.05);
  const Placement one = SampledEnvironment(e, 5, 17).placement(known),
                  same = SampledEnvironment(e, 5, 17).placement(known);
  EXPECT_EQ(one.velo_from_adversary.matrix(), same.velo_from_adversary.matrix());
}

TEST(EotSettings, TheBuiltObjectIsOffByTheStatedDistanceAndCast) {
  const TexturedMesh designed = random_adversary(1);
  const EotSettings e = parse_expectation("shape:0.02,colour");
  double squares = 0, logs = 0;
  constexpr int kDraws = 400;
  for (int i = 0; i < kDraws; ++i) {
    const TexturedMesh built = SampledEnvironment(e, 5, static_cast<std::uint64_t>(i)).built(designed);
    for (std::size_t v = 0; v < built.mesh.vertices.size(); ++v)
      squares += (built.mesh.vertices[v] - designed.mesh.vertices[v]).squaredNorm() /
                 static_cast<double>(built.mesh.vertices.size()) / kDraws;
    const auto dark =
        std::ranges::min_element(designed.atlas.texels, {}, [](const Vec3d& t) { return t.maxCoeff(); });
    const auto at = as_size(dark - designed.atlas.texels.begin());
    logs += std::pow(std::log(built.atlas.texels[at].x() / designed.atlas.texels[at].x()), 2) / kDraws;
    EXPECT_LE(built.atlas.texels[at].maxCoeff(), 1);
  }
  EXPECT_NEAR(std::sqrt(squares), 0.02, 2e-4);
  EXPECT_NEAR(std::sqrt(logs), e.colour, 0.1 * e.colour);
  const TexturedMesh same = SampledEnvironment(parse_expectation("roof,sun"), 5, 3).built(designed);
  EXPECT_EQ(same.mesh.vertices, designed.mesh.vertices);
  EXPECT_EQ(same.atlas.texels, designed.atlas.texels);
}

TEST(EotSettings, TheGradientOfTheBuiltObjectReachesItsDesign) {
  TexturedMesh designed = random_adversary(2);
  designed.mesh.vertices.resize(8);
  designed.atlas.texels.resize(12);
  designed.atlas.texels[0] = Vec3d(0, 1, 0.999);  // black, and values that clip under any cast over 1
  RandomStream random(4, "weights");
  std::vector<double> x = test::flat(designed.mesh.vertices), w;
  const std::vector<double> texels = test::flat(designed.atlas.texels);
  x.insert(x.end(), texels.begin(), texels.end());
  for (std::size_t i = 0; i < x.size(); ++i) w.push_back(random.normal());
  long clipped = 0;
  for (std::uint64_t number = 0; number < 6; ++number) {
    const SampledEnvironment draw(
        parse_expectation(number % 2 ? "shape:0.02,colour" : "shape:0.02,colour,paints:24"), 7, number);
    const auto built = [&](const std::vector<double>& at) {
      TexturedMesh mesh = designed;
      std::size_t i = 0;
      for (auto* points : {&mesh.mesh.vertices, &mesh.atlas.texels})
        for (Vec3d& point : *points)
          for (double& value : point) value = at[i++];
      return draw.built(mesh);
    };
    const auto f = [&](const std::vector<double>& at) {
      const TexturedMesh mesh = built(at);
      double sum = 0;
      std::size_t i = 0;
      for (const auto* points : {&mesh.mesh.vertices, &mesh.atlas.texels})
        for (const double value : test::flat(*points)) sum += w[i++] * value * value;
      return sum;
    };
    const TexturedMesh mesh = built(x);
    AdversaryGradient gradient;
    std::size_t i = 0;
    for (const auto& [points, to] :
         {std::pair(&mesh.mesh.vertices, &gradient.vertices), {&mesh.atlas.texels, &gradient.texels}})
      for (const Vec3d& point : *points) {
        to->push_back(2 * Vec3d(w[i], w[i + 1], w[i + 2]).cwiseProduct(point));
        i += 3;
      }
    draw.built_vjp(designed, gradient);
    std::vector<double> d = test::flat(gradient.vertices);
    for (const double value : test::flat(gradient.texels)) d.push_back(value);
    for (const Vec3d& texel : mesh.atlas.texels) clipped += (texel.array() == 1).count();
    test::check_gradient(f, x, d, 1e-6, 1e-6, 1e-3);
  }
  EXPECT_GT(clipped, 0);
}

TEST(EotSettings, AnObjectOfFewPaintsIsNearTheDesign) {
  const TexturedMesh designed = random_adversary(1);
  const std::vector<Vec3d>& before = designed.atlas.texels;
  const SampledEnvironment draw(parse_expectation("paints:24"), 5, 1);
  const std::vector<Vec3d> painted = draw.built(designed).atlas.texels;
  std::set<std::array<double, 3>> paints;
  Vec3d sum = Vec3d::Zero();
  double squares = 0, spread = 0;
  const Vec3d mean =
      std::accumulate(before.begin(), before.end(), Vec3d(0, 0, 0)) / static_cast<double>(before.size());
  for (std::size_t i = 0; i < painted.size(); ++i) {
    paints.insert({painted[i].x(), painted[i].y(), painted[i].z()});
    sum += painted[i] - before[i];
    squares += (painted[i] - before[i]).squaredNorm();
    spread += (mean - before[i]).squaredNorm();
  }
  EXPECT_GE(paints.size(), 20u);
  EXPECT_LE(paints.size(), 24u);
  EXPECT_LT(sum.norm(), 1e-8);
  EXPECT_LT(squares, spread / 4);
  EXPECT_EQ(draw.built(designed).atlas.texels, painted);
  EXPECT_EQ(SampledEnvironment(draw.expectation(), 9, 4).built(designed).atlas.texels,
            painted);  // the same paints in every draw
}

TEST(EotSettings, EveryObjectOnAVehicleMeetsTheSameDraw) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  AttackSettings settings = test::tiny_attack();
  settings.data = folder / "data";
  settings.rooftop = "box";
  FrameStore store(settings);
  const std::vector<HostId> hosts = {{"000000", 0}, {"000001", 0}};
  DetectorPool detectors;
  detectors.push_back(std::make_unique<test::StandInDetector>());
  EvaluationSettings how;
  how.score_threshold = 0;
  how.quiet = true;
  const TexturedMesh mesh = random_adversary(1);
  const std::vector<TexturedMesh> twice = {mesh, mesh};
  const auto scores = [&](const char* words, std::uint64_t seed) {
    how.expectation = parse_expectation(words);
    how.expectation_seed = seed;
    const CleanDetections clean = clean_detections(detectors, store, hosts, how);
    std::vector<double> found;
    for (const HostOutcome& host :
         evaluate(detectors, store, hosts, clean, twice, settings.simulation, how).hosts)
      found.push_back(host.attacked_score);
    EXPECT_EQ(found.size(), 4u);
    EXPECT_EQ(found[0], found[2]) << words;
    EXPECT_EQ(found[1], found[3]) << words;
    return found;
  };
  const std::vector<double> recorded = scores("none", 1);
  for (const char* words : {"roof", "tilt", "shape:0.05", "colour", "noise", "exposure"}) {
    EXPECT_NE(scores(words, 1), recorded) << words;
    EXPECT_EQ(scores(words, 1), scores(words, 1)) << words;
    EXPECT_NE(scores(words, 2), scores(words, 1)) << words;
  }
}

TEST(EotSettings, AnswersOfAnotherLightAreNotTakenFromTheCache) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1);
  AttackSettings settings = test::tiny_attack();
  settings.data = folder / "data";
  settings.rooftop = "box";
  DetectorPool detectors;
  detectors.push_back(std::make_unique<test::StandInDetector>());
  EvaluationSettings how;
  how.score_threshold = 0;
  how.quiet = true;
  how.detector_identity = "stand-in";
  how.expectation = parse_expectation("light,sun");  // fields of the simulation's and of the frame's settings
  const TexturedMesh mesh = random_adversary(1);
  setenv("MIRAGE_CACHE", (folder / "cache").c_str(), 1);
  FrameStore store(settings);
  const auto score = [&](LightModel light) {
    SimulationSettings simulation = settings.simulation;
    simulation.light = light;
    return evaluate(detectors, store, {{"000000", 0}}, mesh, simulation, how).hosts.at(0).attacked_score;
  };
  const double plain = score(LightModel::plain), visible = score(LightModel::visible);
  setenv("MIRAGE_CACHE", "off", 1);
  EXPECT_NE(plain, visible);
}

TEST(EotSettings, LightTurnsBrightensAndStaysAboveTheGround) {
  PreparedFrame known;
  known.frame.image = ImageF(4, 3, 3, 0.6f);
  known.frame.lighting.to_sun_velo = Vec3d(0.9, 0, 0.15).normalized();
  const EotSettings e = parse_expectation("sun,light,exposure");
  double angle = 0;
  for (int i = 0; i < 200; ++i) {
    const PreparedFrame drawn = SampledEnvironment(e, 9, static_cast<std::uint64_t>(i)).frame(known);
    const Lighting& light = drawn.frame.lighting;
    EXPECT_NEAR(light.to_sun_velo.norm(), 1, 1e-12);
    EXPECT_GE(std::asin(light.to_sun_velo.z()), 3 * std::numbers::pi / 180 - 1e-9);
    EXPECT_GT(light.sun.minCoeff(), 0);
    angle += std::acos(std::min(1.0, light.to_sun_velo.dot(known.frame.lighting.to_sun_velo))) / 200;
    // Exposure scales photograph and light alike; white clips.
    const double exposure = drawn.frame.image.data[0] / 0.6;
    EXPECT_GT(exposure, 0.2);
    EXPECT_LE(drawn.frame.image.data[0], 1.0f);
  }
  EXPECT_GT(angle, 0.1);
  EXPECT_EQ(SampledEnvironment(parse_expectation("roof"), 9, 1).frame(known).frame.image.data,
            known.frame.image.data);
}

TEST(EotSettings, CameraNoiseHasNoGradientWhereItClips) {
  const SampledEnvironment draw(parse_expectation("noise"), 2, 3);
  constexpr int kWidth = 16, kHeight = 12;
  ImageF noise(kWidth, kHeight, 3, 0.5f);  // far from both ends, so that noise does not clip
  draw.add_noise(noise);
  RandomStream random(4, "weights");
  std::vector<double> x, w;
  for (std::size_t i = 0; i < noise.data.size(); ++i) {
    double value = i % 2 ? 0.004 : 0.996;
    const double noisy = value + noise.data[i] - 0.5;
    if (std::min(std::abs(noisy), std::abs(1 - noisy)) < 1e-3) value = 0.5;  // no difference across a clip
    x.push_back(value);
    w.push_back(random.normal());
  }
  const auto noisy_of = [&](const std::vector<double>& at) {
    ImageF image(kWidth, kHeight, 3);
    for (std::size_t i = 0; i < at.size(); ++i) image.data[i] = static_cast<float>(at[i]);
    draw.add_noise(image);
    return image;
  };
  const auto f = [&](const std::vector<double>& at) {
    const ImageF image = noisy_of(at);
    double sum = 0;
    for (std::size_t i = 0; i < at.size(); ++i) sum += w[i] * static_cast<double>(image.data[i]);
    return sum;
  };
  const ImageF noisy = noisy_of(x);
  ImageF gradient(kWidth, kHeight, 3);
  for (std::size_t i = 0; i < w.size(); ++i) gradient.data[i] = static_cast<float>(w[i]);
  draw.noise_vjp(noisy, gradient);
  const std::vector<double> d(gradient.data.begin(), gradient.data.end());
  EXPECT_GT(std::ranges::count(d, 0.0), 100);
  EXPECT_LT(std::ranges::count(d, 0.0), std::ssize(d) / 2);
  // Pixels are single precision: 6e-8 near 1, over a difference of 1e-3.
  test::check_gradient(f, x, d, 5e-4, 1e-3, 1);
  ImageF none;
  draw.noise_vjp(noisy, none);  // for a detector that reads no picture
  EXPECT_TRUE(none.empty());
  ImageF whole(kWidth, kHeight, 3, 1);
  SampledEnvironment(parse_expectation("roof"), 2, 3).noise_vjp(noisy, whole);
  EXPECT_EQ(std::ranges::count(whole.data, 1.0f), std::ssize(d));
}

TEST(EotSettings, CameraNoiseStaysInRange) {
  ImageF image(60, 40, 3, 0.5f);
  SampledEnvironment(parse_expectation("noise"), 2, 3).add_noise(image);
  double sum = 0, squares = 0;
  for (const float value : image.data) {
    ASSERT_TRUE(value >= 0 && value <= 1);
    sum += value - 0.5;
    squares += (value - 0.5) * (value - 0.5);
  }
  const double n = static_cast<double>(image.data.size());
  EXPECT_NEAR(sum / n, 0, 5e-4);
  EXPECT_NEAR(std::sqrt(squares / n), 0.01, 4e-4);
}

}  // namespace
}  // namespace mirage
