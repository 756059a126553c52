// `mirage evaluate` as a user meets it: another run's hosts, random meshes, pictures, contradictory options.
#include <map>

#include "program.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class Evaluate : public test::Program {
 protected:
  int evaluate(const std::string& options) {
    return mirage("evaluate --run " + at("run") + " --out " + at("e") + " " + options);
  }
  /// Two runs on two frames; with three iterations nothing much is learned.
  void make_runs() {
    ASSERT_EQ(mirage("generate --frames 2 --seed 5 --quiet --out " + at("data")), 0) << said();
    ASSERT_EQ(mirage("attack --quiet --iterations 3 --data " + at("data") + " --out " + at("run")), 0)
        << said();
    ASSERT_EQ(mirage("attack --quiet --detector lidar --target random --data " + at("data") + " --out " +
                     at("other")),
              0)
        << said();
  }
  void check_transfer();
  void check_gate();
  void check_pictures();
  void check_contradictions();
};

void Evaluate::check_transfer() {
  ASSERT_EQ(evaluate("--hosts-of " + at("other") + " --random-meshes 2 --pictures 1"), 0) << said();
  EXPECT_THAT(said(), testing::AllOf(HasSubstr("vanished"), HasSubstr("FN ASR, IoU 0.7"),
                                     HasSubstr("2 × random mesh "), HasSubstr("2 × random mesh of its size"),
                                     HasSubstr("learned mesh minus control, points:")));
  EXPECT_THAT(said(), HasSubstr("range "));
  const auto result = json("e/result.json");
  EXPECT_EQ(result.at("hosts_of"), at("other"));
  EXPECT_EQ(result.at("detector"), "lidar");
  EXPECT_EQ(result.at("reliance").at("reads_picture"), false);
  EXPECT_THAT(said(), HasSubstr("this detector has no picture input, so this says nothing about images"));
  EXPECT_EQ(result.at("random").at("meshes"), 2);
  EXPECT_EQ(result.at("arms").size(), 3u);
  EXPECT_TRUE(result.at("hidden").at("vanished").contains("vehicles"));
  EXPECT_TRUE(result.at("net").contains("vanished"));
  const auto known = json("other/run.json").at("test");
  ASSERT_EQ(result.at("hosts"), known.size());
  for (std::size_t i = 0; i < known.size(); ++i) {
    EXPECT_EQ(result.at("outcomes").at(i).at("frame"), known.at(i).at("frame"));
    EXPECT_EQ(result.at("outcomes").at(i).at("label"), known.at(i).at("label"));
    // The set is generated, so the kind is a body style.
    EXPECT_NE(result.at("outcomes").at(i).at("kind"), "Car");
  }
  const std::size_t shown = result.at("pictures").size();
  for (const auto& name : result.at("pictures"))
    EXPECT_TRUE(fs::exists(folder_ / "e/pictures" / name.get<std::string>())) << name;
  EXPECT_LE(shown, 2u);  // the detector has no image features
  EXPECT_FALSE(result.at("strata").empty());
  EXPECT_TRUE(result.at("false_positives").contains("distance_from_host"));
  // An answer of the user's wins over the other run's.
  ASSERT_EQ(evaluate("--quiet --random-meshes 0 --detector fusion --hosts-of " + at("other")), 0) << said();
  const auto again = json("e/result.json");
  EXPECT_EQ(again.at("detector"), "fusion");
  EXPECT_FALSE(again.contains("random"));
  EXPECT_EQ(again.at("reliance").at("frames"), 2);
  EXPECT_EQ(again.at("clusters").at("by"), "frame");
}

/// mirage audit --gate on the same frames.
void Evaluate::check_gate() {
  const std::string gate =
      "audit --gate --data " + at("data") + " --out " + at("d") + " --claim " + at("claims.json");
  ASSERT_EQ(mirage(gate), 0) << said();
  EXPECT_THAT(said(), HasSubstr("with another frame's"));
  const auto result = json("d/result.json"), &reliance = result.at("reliance");
  EXPECT_EQ(reliance.at("frames"), 2);
  EXPECT_GT(reliance.at("vehicles"), 0);
  EXPECT_TRUE(reliance.contains("ap70_none"));
  EXPECT_LE(reliance.at("drop_low"), reliance.at("drop_high"));
  EXPECT_EQ(result.at("audit").size(), 3u);
  EXPECT_EQ(result.at("audit").at(0).at("drop"), reliance.at("drop"));
  EXPECT_FALSE(exists("d/audit.html"));
  const auto claim = json("claims.json").at("fusion-kitti64");
  EXPECT_EQ(claim.at("drop"), reliance.at("drop"));
  EXPECT_EQ(claim.at("weights_hash"),
            file_hash(fs::path(MIRAGE_BUILD) / "plugins/weights/fusion-kitti64.weights"));
  ASSERT_EQ(mirage("audit --detector lidar --data " + at("data") + " --out " + at("d")), 0) << said();
  EXPECT_THAT(said(), HasSubstr("has no picture"));
  EXPECT_THAT(said(), HasSubstr("points  2 beams"));
  EXPECT_TRUE(exists("d/audit.html"));
}

/// The pictures show the judged object: under --expect the object of the draw.
void Evaluate::check_pictures() {
  const auto sweeps = [&](const std::string& expect) {
    fs::remove_all(folder_ / "e");
    EXPECT_EQ(evaluate("--hosts all --random-meshes 0 --iou 0.85 --pictures 99 --expect " + expect), 0)
        << said();
    EXPECT_THAT(said(), HasSubstr("FN ASR, IoU 0.85"));
    std::map<std::string, std::string> by_host;
    for (const auto& host : fs::directory_iterator(folder_ / "e/pictures/data"))
      if (host.is_directory()) by_host[host.path().filename()] = read_file(host.path() / "points.f32");
    return by_host;
  };
  const auto designed = sweeps("none"), drawn = sweeps("roof,shape:0.2");
  int both = 0;
  for (const auto& [host, points] : designed) {
    if (!drawn.contains(host)) continue;
    ++both;
    EXPECT_NE(drawn.at(host), points) << host;
  }
  EXPECT_GT(both, 0);
}

void Evaluate::check_contradictions() {
  for (const auto& [options, word] : std::vector<std::pair<std::string, std::string>>{
           {"--hosts-of " + at("none"), "run.json"},
           {"--hosts-of " + at("other") + " --data " + at("elsewhere"), "--data"},
           {"--hosts-of " + at("other") + " --hosts train", "--hosts"},
           {"--hosts some", "--hosts"},
           {"--random-meshes -1", "--random-meshes"},
           {"--baseline sphere", "--baseline"},
           {"--iou 70", "--iou: 70 is out of range; use 0 to 1 (70 % is 0.7)"},
           {"--score 30", "--score"},
           {"--pictures -1", "--pictures"}}) {
    EXPECT_EQ(evaluate(options), 2) << options;
    expect_one_line(said(), options);
    EXPECT_THAT(said(), HasSubstr(word));
  }
}

TEST_F(Evaluate, TransfersPoolsRandomMeshesDrawsAndRefusesContradictions) {
  MIRAGE_NEED_FUSION();
  ASSERT_NO_FATAL_FAILURE(make_runs());
  const auto attack = json("run/result.json");
  EXPECT_EQ(attack.at("found_clean").at("vehicles"), attack.at("vehicles_train"));
  EXPECT_GT(attack.at("found_clean").at("found"), 0);
  check_transfer();
  check_gate();
  check_pictures();
  check_contradictions();
}

}  // namespace
}  // namespace mirage
