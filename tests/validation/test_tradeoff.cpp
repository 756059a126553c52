// The speed–accuracy study: fronts and the rule on made-up points, and a whole study of a tiny scene.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "attack/adversary.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "exchange/gltf.h"
#include "fixture.h"
#include "generator/generator.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"
#include "support/files.h"
#include "support/small_rig.h"
#include "validation/reference/reference_renderer.h"
#include "validation/tradeoff/points.h"
#include "validation/tradeoff/tradeoff.h"

namespace mirage {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::StartsWith;

TradeoffPoint point(const std::string& label, double ms, double image, double cosine) {
  TradeoffPoint p;
  p.group = "camera", p.axis = "grid", p.label = label;
  p.ms = ms;
  p.errors = {{"image_levels", image}, {"gradient_cosine", cosine}, {"gradient", 1 - cosine}};
  return p;
}

TEST(TradeoffPoints, TheFrontHoldsWhatNothingBeatsInBoth) {
  std::vector<TradeoffPoint> points = {point("fast", 1, 9, 0.9),   point("beaten", 2, 9.5, 0.9),
                                       point("middle", 3, 4, 0.9), point("equal", 3, 4, 0.9),
                                       point("slower", 4, 4, 0.9), point("best", 5, 1, 0.9)};
  points.push_back(point("other group", 0.1, 0, 1));
  points.back().group = "lidar";
  points.push_back(point("without the error", 0.1, 0, 1));
  points.back().errors.erase("image_levels");
  mark_front(points, "camera", "image_levels");
  std::vector<std::string> front;
  for (const TradeoffPoint& p : points)
    if (!p.front.empty()) front.push_back(p.label);
  EXPECT_THAT(front, ElementsAre("fast", "middle", "equal", "best"));
}

TEST(TradeoffPoints, TheRuleForDraftAndExact) {
  const TradeoffPoint standard = point("default", 2, 4, 0.8);
  const double slowest = 2 * kExactTimeRatio;
  const std::vector<TradeoffPoint> points = {
      point("image too far off", 0.1, 4 * kDraftImageErrorRatio + 0.1, 0.9),
      point("gradient too far off", 0.2, 4, 0.8 - kDraftGradientError - 0.01),
      point("as fast as draft", 0.5, 4, 0.8 - kDraftGradientError + 1e-9),
      point("draft", 0.5 * kEqualTimeRatio, 4 * kDraftImageErrorRatio, 0.79),
      point("slower than draft", 0.5 * kEqualTimeRatio + 0.01, 4, 0.9),
      standard,
      point("least error", 5, 1, 0.7),
      point("exact", slowest, kExactImage, 0.85),
      point("coarser", 3, kExactImage + 0.1, 0.95),
      point("too slow", slowest + 1, 0.5, 0.99)};
  const auto advice = recommend(points, standard);
  ASSERT_EQ(advice.size(), 3u);
  EXPECT_EQ(advice[0].point->label, "draft");
  EXPECT_EQ(advice[1].point, &standard);
  EXPECT_EQ(advice[2].point->label, "exact");
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(advice[i].name, qualities()[i].name);
    EXPECT_FALSE(advice[i].rule.empty());
  }
}

TradeoffSettings tiny(const std::filesystem::path& data, const std::filesystem::path& out) {
  TradeoffSettings settings;
  if (!data.empty()) settings.overrides["data"] = data;
  settings.out = out;
  settings.overrides["rooftop"] = "box";
  settings.hosts = 1;
  settings.frames = 1;
  settings.repeats = 1;
  settings.reference_samples = 8;
  settings.sharp_samples = 2;
  settings.directions = 4;
  settings.depth_frames = 1;
  settings.detector_hosts = 0;
  settings.quiet = true;
  return settings;
}

TEST(Tradeoff, TheRoofThatIsAskedForStandsBeforeTheRuns) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1, true);
  for (const char* mesh : {"adversary.glb", "random.glb"})
    write_adversary(folder / "run" / mesh, test::random_mesh(3));
  AttackSettings attack;
  attack.data = folder / "data";
  attack.min_view = 0;
  test::write_run_json(folder / "run", attack, {}, {{"000000", 0}});
  TradeoffSettings settings = tiny({}, folder / "out");
  settings.run = folder / "run";
  settings.grid = false;
  settings.depth_frames = 0;
  EXPECT_EQ(to_json(tradeoff(settings)).at("rooftop"), "box");
  settings.overrides.erase("rooftop");
  EXPECT_EQ(to_json(tradeoff(settings)).at("rooftop"), "shape");
}

TEST(Tradeoff, AStudyOfATinyScene) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1, true);
  const TradeoffResult result = tradeoff(tiny(folder / "data", folder / "out"));
  EXPECT_EQ(result.hosts.size(), 1u);
  const nlohmann::json whole = to_json(result);
  EXPECT_EQ(whole.at("vehicles"), 1);
  // Written before the plots are drawn from it.
  nlohmann::json file = read_json(folder / "out/tradeoff.json");
  EXPECT_FALSE(file.contains("plots") || file.contains("page"));
  file["plots"] = whole.at("plots");
  if (whole.contains("page")) file["page"] = whole.at("page");
  EXPECT_EQ(file, whole);

  const auto find = [&](const std::string& group, const std::string& axis, const std::string& label) {
    for (const TradeoffPoint& p : result.points)
      if (p.group == group && p.axis == axis && p.label == label) return p;
    ADD_FAILURE() << "no point " << group << ", " << axis << ", " << label;
    return TradeoffPoint();
  };
  const auto error = [](const TradeoffPoint& p, const char* name) { return p.errors.at(name); };
  for (const TradeoffPoint& p : result.points) {
    EXPECT_GT(p.ms, 0) << p.label;
    EXPECT_GT(p.ratio, 0) << p.label;
    for (const auto& [name, value] : p.errors) EXPECT_TRUE(std::isfinite(value)) << p.label << ' ' << name;
    EXPECT_EQ(p.drawing.has_value(), p.group == "camera") << p.label;
  }
  const auto draft = find("camera", "quality", "draft"), standard = find("camera", "quality", "default"),
             exact = find("camera", "quality", "exact");
  EXPECT_LE(error(exact, "image_levels"), error(standard, "image_levels"));
  EXPECT_LE(error(standard, "image_levels"), error(draft, "image_levels"));
  EXPECT_LE(error(find("camera", "samples", "8×8 samples"), "image_levels"),
            error(find("camera", "samples", "1×1 samples"), "image_levels"));
  EXPECT_LE(error(find("camera", "sigma", "σ 5e-07"), "image_levels"),
            error(find("camera", "sigma", "σ 0.0001"), "image_levels"));
  EXPECT_LE(error(standard, "image_levels"),
            error(find("camera", "image_scale", "1/4 size"), "image_levels"));
  // The same definition in two arithmetics.
  const auto in_float = find("camera", "arithmetic", "float, vectorised"),
             in_double = find("camera", "arithmetic", "double, plain loop");
  EXPECT_NEAR(error(in_float, "image_mae"), error(in_double, "image_mae"), 1e-4);
  EXPECT_NEAR(error(in_float, "double_cosine"), error(in_double, "double_cosine"), 1e-3);
  // Soft edges have a gradient that hard edges lack.
  EXPECT_GT(error(standard, "gradient_cosine"),
            error(find("camera", "edges", "hard, 2×2 samples"), "gradient_cosine"));

  EXPECT_LE(error(find("lidar", "arithmetic", "Embree's face, range in double"), "range_error_m"), 1e-6);
  EXPECT_EQ(error(find("lidar", "rays", "every ray"), "disagreements"), 0);
  EXPECT_LE(error(find("lidar", "rays", "every ray"), "range_error_m"),
            error(find("lidar", "rays", "every 8th ray"), "range_error_m"));

  // Along a front, error falls as time grows.
  for (const char* name : {"image_levels", "gradient"}) {
    std::vector<std::pair<double, double>> front;
    for (const TradeoffPoint& p : result.points)
      for (const std::string& on : p.front)
        if (p.group == "camera" && on == name) front.push_back({p.ms, error(p, name)});
    ASSERT_FALSE(front.empty());
    std::sort(front.begin(), front.end());
    for (std::size_t i = 1; i < front.size(); ++i) EXPECT_LE(front[i].second, front[i - 1].second);
  }
  const auto advice = result.recommended();
  ASSERT_EQ(advice.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(advice[i].name, qualities()[i].name);
    EXPECT_EQ(advice[i].shipped->drawing->supersampling, qualities()[i].supersampling);
    const auto& written = whole.at("recommended").at(i);
    EXPECT_EQ(written.at("name"), qualities()[i].name);
    EXPECT_EQ(written.at("shipped").at("settings").at("supersampling"), qualities()[i].supersampling);
    EXPECT_EQ(written.contains("settings"), advice[i].point != nullptr);
  }
  ASSERT_TRUE(result.plots);
  for (const std::string& plot : *result.plots) EXPECT_TRUE(std::filesystem::exists(folder / "out" / plot));
  if (!result.page.empty()) {
    const std::string page = read_file(result.page);
    EXPECT_THAT(page, HasSubstr("<svg"));
    EXPECT_THAT(page, HasSubstr("--quality exact"));
  }
}

#ifdef MIRAGE_HAS_FUSION
TEST(Tradeoff, TheDetectorsPassesAreJudgedByThatInDouble) {
  const Rig rig = test::small_rig();
  const PreparedFrame prepared = prepare(generate_frame(rig, 3, 0), rig.lidar);
  std::vector<StepHost> hosts;
  for (std::size_t i = 0; i < prepared.frame.labels.size() && hosts.empty(); ++i)
    if (const Label& label = prepared.frame.labels[i]; label.type == "Car" && label.box.bev.x > 5)
      hosts.push_back({prepared,
                       {prepared.frame.id, static_cast<int>(i)},
                       on_roof(BoxRoofFinder().find(prepared.frame, label))});
  ASSERT_FALSE(hosts.empty());
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  DetectorOptions options;
  options.detector = "lidar";
  std::map<std::string, TradeoffPoint> points;
  for (TradeoffPoint& p : detector_points(options, hosts, random_adversary(3), 1))
    points.try_emplace(p.label, std::move(p));
  ASSERT_TRUE(points.contains("what the object changes") && points.contains("the whole frame"));
  const auto cosine = [&](const char* label) { return points.at(label).errors.at("gradient_cosine"); };
  EXPECT_GT(cosine("the whole frame"), 0.99) << "float against double";
  EXPECT_GT(cosine("what the object changes"), 0.99) << "exact but for rounding";
  EXPECT_LT(cosine("1 m"), cosine("what the object changes") - 1e-6) << "leaves things out, which is seen";
  for (const auto& [label, p] : points) EXPECT_GT(p.ms, 0) << label;
}
#endif

TEST(Tradeoff, AttacksOfEqualTimeAreJudgedByOne) {
  const test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3, true);
  for (const std::string& id : list_frames(folder / "data")) {  // the car is where the plugin finds one
    Frame frame = read_frame(folder / "data", id);
    frame.labels.at(0).box.bev = {10, 1, 4, 2, 0};
    write_frame(folder / "data", frame);
  }
  write_file(folder / "weights", "none");
  TradeoffSettings settings = tiny(folder / "data", folder / "out");
  settings.source.data = folder / "data";
  settings.source.rooftop = "box";
  settings.detector.detector = MIRAGE_BUILD "/test_plugins/fake_works.so";
  settings.detector.weights = folder / "weights";
  settings.attack_seconds = 0.05;
  write_file(settings.out / "attack_whole_passes/old.txt", "of an earlier study");
  write_file(settings.out / "scratch/notes.txt", "the user's own");
  const auto rows = attack_study(settings);
  ASSERT_GE(rows.size(), 5u);
  EXPECT_TRUE(std::filesystem::exists(settings.out / "attack_whole_passes/adversary.glb"));
  EXPECT_FALSE(std::filesystem::exists(settings.out / "attack_whole_passes/old.txt"));
  EXPECT_TRUE(std::filesystem::exists(settings.out / "scratch/notes.txt"));
  EXPECT_FALSE(std::filesystem::exists(settings.out / kScratchFolder));
  // A study that fails leaves the earlier result.
  write_file(settings.out / kScratchFolder, "in the way");
  EXPECT_ANY_THROW(attack_study(settings));
  EXPECT_TRUE(std::filesystem::exists(settings.out / "attack_quality_draft/adversary.glb"));
  for (const TimedAttack& row : rows) {
    EXPECT_GE(row.iterations, 1) << row.name;
    EXPECT_GE(row.asr.value, 0) << row.name;
    const nlohmann::json written = to_json(row);
    for (const char* key : {"name", "quality", "precision", "locality", "clean_memory_mb", "seconds",
                            "iterations", "loss", "vehicles", "asr", "fn_asr", "fp_asr"})
      EXPECT_TRUE(written.contains(key)) << key;
    EXPECT_EQ(written.at("asr_interval").size(), 2u);
  }
}

TEST(Tradeoff, NumbersOutOfRangeAreNamed) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1);
  const auto complaint = [&](const auto& change) {
    TradeoffSettings settings = tiny(folder / "data", folder / "out");
    change(settings);
    return test::error_text<InputError>([&] { tradeoff(settings); });
  };
  EXPECT_THAT(complaint([](auto& s) { s.hosts = 0; }), StartsWith("hosts: "));
  EXPECT_THAT(complaint([](auto& s) { s.detector_hosts = -1; }), StartsWith("detector_hosts: "));
  EXPECT_THAT(complaint([](auto& s) { s.repeats = 0; }), StartsWith("repeats: "));
  EXPECT_THAT(complaint([](auto& s) { s.reference_samples = 64; }), StartsWith("reference_samples: "));
  EXPECT_THAT(complaint([](auto& s) { s.directions = 1; }), StartsWith("directions: "));
  EXPECT_THAT(complaint([](auto& s) { s.attack_seconds = -1; }), StartsWith("attack_seconds: "));
  EXPECT_THAT(complaint([](auto& s) { s.attack_seconds = std::nan(""); }), StartsWith("attack_seconds: "));
  EXPECT_THAT(complaint([](auto& s) { s.overrides.erase("data"); }), StartsWith("data: "));
  EXPECT_THAT(complaint([&](auto& s) { s.overrides["data"] = (folder / "none").string(); }),
              HasSubstr("none"));
}

}  // namespace
}  // namespace mirage
