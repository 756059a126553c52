// The program as a user meets it: exit codes, one-line errors, and the files that remain after a failure.
#include <fmt/format.h>
#include <signal.h>
#include <sys/mount.h>

#include <chrono>
#include <cmath>
#include <sstream>
#include <thread>
#include <vector>

#include "base/image.h"
#include "program.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

using Words = std::vector<std::string>;

class CommandLine : public test::Program {
 protected:
  void generate(const std::string& options, const std::string& to = "data") const {
    ASSERT_EQ(run("generate --quiet " + options + " --out " + at(to)).code, 0);
  }
};

TEST_F(CommandLine, AConfigSetsOptionsAndAnUnknownKeyIsAnError) {
  const std::string generate = "generate --config " + at("run.toml") + " --out " + at("d");
  write_file(folder_ / "run.toml", "frames = 1\nrig = \"no-such-rig\"\n");
  EXPECT_THAT(refused(generate), HasSubstr("no-such-rig"));
  write_file(folder_ / "run.toml", "frames = 1\nfarmes = 2\n");
  EXPECT_THAT(refused(generate), HasSubstr("run.toml: farmes"));
}

TEST_F(CommandLine, AWordThatIsNoneIsAskedAboutAndAllThatThereIsIsNamed) {
  write_file(folder_ / "c.toml", "min_veiw = 0.5\n");
  write_file(folder_ / "quality.toml", "quality = \"best\"\n");
  write_file(folder_ / "place.toml",
             read_file(fs::path(MIRAGE_SOURCE) / "scenes/placements/roof.toml") + "anchr = \"rear\"\n");
  const Words qualities = {"--quality", "best", "draft", "default", "exact"};
  for (const auto& [arguments, words] : std::vector<std::pair<std::string, Words>>{
           {"fly", {"fly: no such command"}},
           {"atack", {"atack: no such command", "did you mean attack?", "reproduce"}},
           {"--hepl", {"no such option", "did you mean --help?"}},
           {"", {"command: is missing", "attack"}},
           {"generate --no-such-option", {"generate: --no-such-option: no such option"}},
           {"attack --data d --iteratons 5",
            {"attack: --iteratons: no such option", "did you mean --iterations?", "--until-plateau"}},
           {"attack --data d --iteratons=5", {"did you mean --iterations?"}},
           {"train --stepz 5 --data d", {"did you mean --steps?"}},
           {"train detektor --data d", {"detektor is unknown", "did you mean detector?"}},
           {"attack --data d --config " + at("c.toml"),
            {"c.toml: min_veiw: unknown key", "did you mean min-view?", "texel-rate"}},
           {"attack --data d --light visibel", {"--light", "did you mean visible?"}},
           {"attack --data d --target imag", {"--target", "did you mean image?"}},
           {"attack --data d --precision flaot", {"did you mean float?", "bfloat16"}},
           {"attack --data d --expect roof,son", {"son: unknown", "did you mean sun?"}},
           {"attack --data d --renderer cycle", {"did you mean cycles?"}},
           {"generate --rig kitti", {"--rig: kitti", "did you mean kitti64?", "nuscenes", "xenith"}},
           {"generate --lidar hdl64", {"--lidar: hdl64", "hdl32e", "vlp16", "vls128"}},
           {"simulate --data d --frame 0 --mesh m.glb --place rear-rak",
            {"--place: rear-rak", "did you mean rear-rack?", "roof", "kerb", "X,Y,Z,YAW"}},
           {"attack --data d --place " + at("place.toml"), {"place.toml: anchr: unknown key", "anchor"}},
           {"attack --data d --place " + at("no.toml"), {"no.toml", "no such file"}},
           {"generate --look amercian", {"did you mean american?"}},
           {"defend --data d --method denoisng", {"did you mean denoising?", "adversarial"}},
           {"reproduce tabel1", {"tabel1: no such table or figure", "did you mean table1?"}},
           {"render --scene s.glb --renderer sotf", {"did you mean soft?"}},
           {"attack --data d --quality best", qualities},
           {"attack --data d --config " + at("quality.toml"), qualities},
           {"simulate --data d --frame 0 --mesh m.glb --quality best", qualities},
           {"evaluate --run r --quality best", qualities},
           {"validate --run r --quality best", qualities},
           {"demo --quality best", qualities}}) {
    const std::string line = refused(arguments);
    for (const char* not_said : {"…", "MIRAGE_HOME"}) EXPECT_THAT(line, Not(HasSubstr(not_said)));
    for (const std::string& word : words) EXPECT_THAT(line, HasSubstr(word)) << arguments;
  }
}

TEST_F(CommandLine, AValueOutOfItsRangeIsToldTheRange) {
  write_file(folder_ / "c.toml", "seed = -1\n");
  std::string path = at("p");
  while (path.size() < 4200) path += "/" + std::string(100, 'p');
  for (const auto& [arguments, said] : std::vector<std::pair<std::string, std::string>>{
           {"export --run r --frames -1", "--frames: -1 is out of range; use at least 0"},
           {"reproduce table1 --quick --kitti64 " + at("none") + " --out " + at("tables"), at("none")},
           {"reproduce --judge-frames -1", "--judge-frames: -1 is out of range; use at least 0"},
           {"detect --data d --frames -1", "--frames"},
           {"generate --frames many", "--frames: many is not a valid number"},
           {"generate --threads 2000", "--threads: 2000 is out of range; use 0 to 1024"},
           {"generate --threads -1", "--threads"},
           {"attack --data d --iterations ten",
            "--iterations: ten is not a valid number; use a whole number, 0 to 1000000000"},
           {"attack --data d --iterations 1.5", "--iterations: 1.5 is not a valid number"},
           {"attack --data d --iterations", "--iterations: needs a value; Adam steps"},
           {"attack --data d --vertex-rate 0", "--vertex-rate: 0 is out of range; use above 0"},
           {"attack --data d --vertex-rate nan", "--vertex-rate: nan is out of range"},
           {"attack --data d --size 0", "--size"},
           {"attack --data d --size nan", "--size"},
           {"attack --data d --sigma 5", "--sigma"},
           {"detect --data d --check 0", "--check: 0 is out of range; use 1 to 1000"},
           {"export --run r --bed 20,0.3,0.3", "--bed: 20 is out of range; use 0.05 to 10"},
           {"export --run r --bed 0.2,0.3,0.3", "--bed requires --kit"},
           {"export --run r --sheet A3", "--sheet requires --kit"},
           {"export --run r --cameras first", "--cameras"},
           {"validate --run r --budget-of score", "--budget-of requires --budget"},
           {"validate --run r --budget-confidence 0.95", "--budget-confidence requires --budget"},
           {"view d --detector lidar", "--detector requires --run"},
           {"view --run r --no-detector --detector lidar", "--no-detector"},
           {"view --run r --no-detector --weights w", "--no-detector"},
           {"view --run r --no-detector --defense ceiling", "--no-detector"},
           {"view --drive d --place roof", "--drive excludes --place"},
           {"view --drive d --cameras all", "--drive excludes --cameras"},
           {"view --drive d --depth guided", "--drive excludes --depth"},
           {"view --drive d --rig kitti64", "--drive excludes --rig"},
           {"attack --data d --gamma 1e9", "--gamma"},
           {"attack --data d --checkpoint-every 0", "--checkpoint-every"},
           {"attack --data d --checkpoint-seconds -1", "--checkpoint-seconds"},
           {"attack", "mirage: attack: --data: is missing; give it: "},
           {"generate --seed -1", "--seed: -1 is"},
           {"generate --seed 1e3", "--seed"},
           {"generate --seed 18446744073709551616", "--seed"},
           {"generate --seed 99999999999999999999999", "--seed"},
           {"generate --config " + at("c.toml"), "seed"},
           {"simulate --data d --frame 1 --mesh m --sigma 1e9", "--sigma"},
           {"render --scene s.glb --sigma 1e300", "--sigma"},
           {"render --scene s.glb --sigma 1e-300", "--sigma"},
           {"render --scene s.glb --sigma nan", "--sigma"},
           {"render --scene s.glb --gamma 1e300", "--gamma"},
           {"render --scene s.glb --color nan nan nan", "--color"},
           {"render --scene s.glb --color 0,0,2", "--color"},
           {"fit --data d --label-noise 1e300", "--label-noise"},
           {"fit --data d --label-noise nan", "--label-noise"},
           {"tradeoff --data d --hosts 0", "--hosts"},
           {"tradeoff --data d --repeats -1", "--repeats"},
           {"tradeoff --data d --reference-samples 99", "--reference-samples"},
           {"generate --out " + path, "--out"},
           {"export --run " + std::string(256, 'n'), "--run"},
           {"attack --data " + path, "--data"}})
    EXPECT_THAT(refused(arguments), HasSubstr(said)) << arguments;
}

TEST_F(CommandLine, AReproductionWithAFailedStepEndsWithOne) {
  write_file(folder_ / "tables/runs/kitti64-lidar-lidar", "no folder");
  const Outcome outcome = run("reproduce table1 --quick --quiet --only kitti64-lidar-lidar --kitti64 " +
                              frames_ + " --out " + at("tables"));
  EXPECT_EQ(outcome.code, 1);
  EXPECT_THAT(outcome.err, HasSubstr("steps failed; runs/kitti64-lidar-lidar: "));
  EXPECT_EQ(json("tables/result.json").at("steps").at("runs/kitti64-lidar-lidar").at("status"), "failed");
}

TEST_F(CommandLine, HelpIsNarrowGroupedAndWithAnExampleThatHolds) {
  const auto help_of = [&](const std::string& command) {
    const Outcome outcome = run(command + " --help");
    EXPECT_EQ(outcome.code, 0) << command;
    return outcome.out;
  };
  const std::string whole = help_of("");
  std::istringstream list(run("--completion commands").out);
  int commands = 0;
  for (std::string line; std::getline(list, line); ++commands) {
    const std::string command = line.substr(0, line.find('\t')), help = help_of(command);
    EXPECT_THAT(whole, HasSubstr("\n  " + command + " "));
    const auto example = help.find("Example:\n  mirage " + command);
    EXPECT_NE(example, help.npos) << command;
    EXPECT_THAT(help, Not(HasSubstr("79769313"))) << command;
    std::istringstream lines(help), words(help.substr(std::min(example, help.size())));
    for (std::string text; std::getline(lines, text);)
      EXPECT_LE(std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xc0) != 0x80; }), 100)
          << text;
    for (std::string word; words >> word && word != "Completed";)
      if (word.starts_with("--")) {
        EXPECT_THAT(help, HasSubstr("  " + word)) << command;
      }
  }
  EXPECT_GE(commands, 23);
  const std::string attack = help_of("attack");
  for (const char* text : {"\nData:\n", "\nDetector:\n", "\nLearning:\n", "\nRun:\n",
                           "(0 to 1000000000; default 200)", "(required)"})
    EXPECT_THAT(attack, HasSubstr(text));
  EXPECT_THAT(help_of("generate"),
              AllOf(HasSubstr("kitti64, nuscenes, nuscenes6, xenith"), HasSubstr("hdl32e, vlp16")));
  EXPECT_THAT(whole, HasSubstr("--completion bash"));
}

TEST_F(CommandLine, BashCompletesWordsOfOptions) {
  const auto completed = [&](const std::string& line) {
    EXPECT_EQ(shell("bash -c 'source <(" + command("--completion bash") + "); COMP_WORDS=(" + line +
                    "); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _mirage; echo \" ${COMPREPLY[@]} \"'"),
              0);
    return said();
  };
  EXPECT_THAT(completed("mirage att"), HasSubstr(" attack "));
  EXPECT_THAT(completed("mirage attack --targ"), HasSubstr(" --target "));
  EXPECT_THAT(completed("mirage attack --target i"), HasSubstr(" image "));
  EXPECT_THAT(completed("mirage generate --rig k"), HasSubstr(" kitti64 "));
  EXPECT_THAT(completed("mirage attack --defense adv"), HasSubstr(" adversarial "));
  EXPECT_THAT(completed("mirage attack --lidar-effects u"), HasSubstr(" unit "));
  EXPECT_THAT(completed("mirage --comp"), HasSubstr(" --completion "));
  const Outcome zsh = run("--completion zsh");
  EXPECT_EQ(zsh.code, 0);
  EXPECT_THAT(zsh.out, HasSubstr("bashcompinit"));
}

TEST_F(CommandLine, AResultSaysWhatItIsMadeOfWhereverThatLies) {
  const auto provenance = [&](const std::string& data, const std::string& more = "") {
    const Outcome outcome =
        run("depth --quiet --data " + at(data) + " --frames 1 --backends ip-basic --out " + at("o") + more);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    return json("o/result.json").at("provenance");
  };
  generate("--frames 2");
  const auto first = provenance("data");
  for (const char* key : {"program", "version", "commit", "date", "command", "seed", "settings", "inputs",
                          "identity", "data", "data_hash", "frames"})
    EXPECT_TRUE(first.contains(key)) << key;
  EXPECT_THAT(first.at("command").get<std::string>(), testing::StartsWith("mirage depth --quiet --data "));
  EXPECT_EQ(first.at("frames"), 1);
  // Another path, other threads and a frame that is not used do not change the identity.
  fs::rename(folder_ / "data", folder_ / "moved");
  write_file(folder_ / "moved/training/label_2/000001.txt", "");
  EXPECT_EQ(provenance("moved", " --threads 1").at("identity"), first.at("identity"));
  EXPECT_NE(provenance("moved", " --hide 0.3").at("identity"), first.at("identity"));
  const std::string sweep = "moved/training/velodyne/000000.bin";
  std::string bytes = text(sweep);
  bytes[12] ^= 1;
  write_file(folder_ / sweep, bytes);
  EXPECT_NE(provenance("moved").at("identity"), first.at("identity"));
}

TEST_F(CommandLine, WhatCannotBeIsOneLine) {
  generate("--frames 1");
  fs::create_directories(folder_ / "empty/training/velodyne");
  const std::string data = " --data " + at("data"), none = " --data " + at("none"),
                    simulate = "simulate --frame 000000 --mesh m.glb" + data;
  std::vector<std::pair<std::string, std::string>> rows = {
      {"tradeoff", "--data"},
      {"tradeoff" + none, "none"},
      {"tradeoff --run " + at("none"), "run.json"},
      {"tradeoff --rooftop thatched" + data, "thatched"},
      {"defend --method armour" + data, "use adversarial, denoising, depth-gate"},
      {"defend --method denoising --detector lidar" + data, "sees the picture"},
      {"defend --attacked 2" + data, "--attacked"},
      {"defend --method depth-gate --attacked 0.2" + data, "--attacked: decides nothing with the method"},
      {"defend --method roof-objects --vertex-rate 0.1" + data, "--vertex-rate: decides nothing"},
      {"defend --detector camera" + data, "--detector: camera: finds boxes in the picture alone"},
      {"train --detector lidar --joint" + data, "--joint: has no effect on the detector lidar"},
      {"defend --weights " + at("none.weights") + data, "none.weights"},
      {"detect --defense jpeg:0" + data, "jpeg:1 to jpeg:100"},
      {"detect --defense stone-wall" + data, "with the defence stone-wall"},
      {"detect --defense adversariel" + data, "did you mean adversarial? use"},
      {"detect --defense jpeg" + data, "did you mean jpeg:QUALITY? use"},
      {"detect --detector /no/such/plugin.so" + data, "/no/such/plugin.so"},
      {"detect --detector clusters --precision double" + data,
       "--precision: double: has no effect on the detector clusters"},
      {"detect --locality 3" + data, "--locality: 3: has no effect here"},
      {"audit --locality 3" + data, "--locality: 3: has no effect here"},
      {"attack" + none, "none"},
      {"detect" + none, "none"},
      {"attack --data " + at("empty"), "empty"},
      {"detect --data " + at("empty"), "empty"}};
  for (const char* sun : {"noon", "30,120", "49,8.4,2011-09-26T23:30:00Z,0"})
    for (const std::string& command : {simulate, "attack" + data})
      rows.push_back({command + " --sun " + sun, "--sun: " + std::string(sun)});
  for (const auto& [arguments, said] : rows)
    EXPECT_THAT(refused(arguments + " --out " + at("o")), HasSubstr(said)) << arguments;
  EXPECT_THAT(refused("generate --frames 1 --out /proc/nowhere", 1), HasSubstr("/proc/nowhere"));
}

TEST_F(CommandLine, DepthIsGeneratedScoredAndAskedForByTraining) {
  const std::string data = " --data " + at("data");
  generate("--frames 1");
  refused("train depth --depth " MIRAGE_BUILD "/none.so --out " + at("t") + data);
  generate("--frames 1 --depth");
  const Outcome scored = run("depth --backends ip-basic,ip-basic-bilateral --out " + at("d") + data);
  EXPECT_EQ(scored.code, 0) << scored.err;
  const auto result = json("d/result.json");
  ASSERT_EQ(result.at("backends").size(), 2u);
  EXPECT_GT(result.at("backends")[0].at("common").at("rmse_mm"), 100);
  EXPECT_GT(result.at("backends")[0].at("roof").at("pixels"), 0);
  const Outcome hidden = run("depth --hide 0.2 --backends ip-basic --out " + at("h") + data);
  EXPECT_EQ(hidden.code, 0) << hidden.err;
  EXPECT_EQ(json("h/result.json").at("hidden"), 0.2);
  EXPECT_THAT(refused("depth --backends magic --out " + at("u") + data), HasSubstr("magic"));
}

TEST_F(CommandLine, SimulateStandsOnTheFittedRoofOrTheBoxsAndSaysWhich) {
  const std::string data = " --data " + at("data");
  generate("--frames 1");
  ASSERT_EQ(run("fit --mesh-format glb --out " + at("f") + data).code, 0);
  std::string fit;
  for (const auto& file : fs::recursive_directory_iterator(folder_ / "f"))
    if (file.path().extension() == ".glb") fit = file.path();
  ASSERT_NE(fit, "");
  const std::string vehicle = fit.substr(fit.rfind('_') + 1, fit.rfind('.') - fit.rfind('_') - 1);
  write_file(  // a tetrahedron of a metre
      folder_ / "object.obj",
      "\xef\xbb\xbfv -0.5 -0.5 0\nv 0.5 -0.5 0\nv 0 0.5 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n");
  const std::string simulate =
      "simulate --frame 000000 --mesh " + at("object.obj") + " --out " + at("s") + data + " --vehicle ";
  const auto simulated = [&](const std::string& more) {
    const Outcome outcome = run(simulate + vehicle + more);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    return std::pair(json("s/result.json").at("rooftop"), text("s/image.png") + text("s/sweep.bin"));
  };
  const auto [fitted, one] = simulated(" --threads 1");
  EXPECT_EQ(fitted.at("from_box"), false);
  EXPECT_NE(fitted.at("over_box_m"), 0);
  const auto [again, two] = simulated(" --threads 2 --rooftop shape");
  EXPECT_EQ(fitted, again);
  EXPECT_EQ(one, two);
  const auto [noisy, three] = simulated(" --lidar-effects unit");
  EXPECT_EQ(noisy, fitted);
  EXPECT_NE(three, one);
  EXPECT_EQ(simulated(" --lidar-effects unit").second, three);
  EXPECT_EQ(simulated(" --lidar-effects ideal").second, one);
  // The frame is generated: its sweep has noise and drop-out, of thin rays.
  const auto as_recorded = simulated(" --lidar-effects as-recorded").second;
  EXPECT_EQ(as_recorded, simulated(" --lidar-effects noise,drop-out").second);
  EXPECT_NE(as_recorded, three);
  EXPECT_GT(json("s/result.json").at("simulation").at("lidar_effects").at("drop_out"), 0);
  const auto by_box = simulated(" --rooftop box").first;
  EXPECT_EQ(by_box.at("from_box"), true);
  EXPECT_NEAR(by_box.at("over_box_m").get<double>(), 0, 1e-9);
  EXPECT_NE(by_box.at("velo"), fitted.at("velo"));
  // The mask's levels are shares, and the depth is the object's. Files of an earlier simulation of another
  // vehicle are removed.
  const auto result = json("s/result.json");
  const ImageF mask = read_srgb(folder_ / "s/mask.png"), depth = read_exr(folder_ / "s/depth.exr");
  int covered = 0, on_object = 0;
  const double there = by_box.at("velo").at(0);
  for (int v = 0; v < mask.height; ++v)
    for (int u = 0; u < mask.width; ++u)
      if (std::lround(255 * srgb_from_linear(mask.at(u, v))) > 127)
        ++covered, on_object += std::abs(depth.at(u, v) - there) < 1.5;
  EXPECT_EQ(covered, result.at("adversary_pixels"));
  EXPECT_GT(on_object, 0.9 * covered);  // rays through some of the outline's pixels miss it
  auto earlier = result;
  earlier["cameras"]["CAM_LEFT"] = nullptr;
  write_json(folder_ / "s/result.json", earlier);
  for (const char* left : {"s/image-CAM_LEFT.png", "s/mask-CAM_LEFT.png", "s/depth-CAM_LEFT.exr"})
    write_file(folder_ / left, "of another vehicle");
  simulated("");
  for (const char* left : {"s/image-CAM_LEFT.png", "s/mask-CAM_LEFT.png", "s/depth-CAM_LEFT.exr"})
    EXPECT_FALSE(exists(left)) << left;
  // The frame's own sun, and one of another direction.
  const auto to_sun = [&] { return json("s/result.json").at("sun").at("to_sun_velo"); };
  EXPECT_EQ(simulated(" --sun frame").second, one);
  EXPECT_EQ(to_sun(), json("data/training/lighting/000000.json").at("to_sun_velo"));
  simulated(" --sun photo");
  EXPECT_NE(simulated(" --sun=-120,30").second, one);
  EXPECT_NEAR(to_sun().at(2).get<double>(), 0.5, 1e-9);
  EXPECT_THAT(refused(simulate + vehicle + " --rooftop cone"), HasSubstr("--rooftop: cone"));
  // Invalid hosts, and frames without labels.
  EXPECT_THAT(refused("fit --types Golem --out " + at("f") + data),
              AllOf(HasSubstr("--types"), HasSubstr("Golem"), HasSubstr("Car")));
  const std::string labels = "data/training/label_2/000000.txt", rows = text(labels);
  write_file(folder_ / labels, "Pedestrian" + rows.substr(rows.find(' ')));
  EXPECT_THAT(refused(simulate + "0"), AllOf(HasSubstr("--vehicle: 0"), HasSubstr("a Pedestrian there")));
  fs::remove(folder_ / labels);
  EXPECT_THAT(refused(simulate + "0"), HasSubstr("has no labels"));
  EXPECT_THAT(refused("fit --out " + at("f") + data), HasSubstr("labels"));
  EXPECT_EQ(run("view " + at("data") + " --out " + at("page.html")).code, 0);
  EXPECT_THAT(refused("attack --data " + at("data/training") + " --out " + at("a")),
              HasSubstr("give its parent"));
}

TEST_F(CommandLine, AFullDiskKeepsWhatWasFinished) {
  const fs::path disk = folder_ / "disk";
  fs::create_directories(disk);
  if (mount("tmpfs", disk.c_str(), "tmpfs", 0, "size=2500k") != 0)
    GTEST_SKIP() << "a small file system cannot be mounted here (root is needed)";
  EXPECT_THAT(refused("generate --frames 20 --quiet --out " + at("disk"), 1), HasSubstr(disk.string()));
  int whole = 0;
  for (const auto& file : fs::recursive_directory_iterator(disk)) whole += file.path().extension() == ".bin";
  EXPECT_GE(whole, 1);
  for (const auto& file : fs::recursive_directory_iterator(disk))
    EXPECT_THAT(file.path().string(), Not(HasSubstr(".tmp"))) << "a half-written file was left";
  umount(disk.c_str());
}

TEST_F(CommandLine, CtrlCKeepsFinishedFramesAndTheNextRunGoesOn) {
  const std::string arguments = "generate --frames 3 --seed 4 --quiet --out " + at("d"),
                    first = "d/training/velodyne/000000.bin";
  const pid_t child = start(arguments);
  for (int i = 0; i < 12'000 && !exists(first); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  ASSERT_TRUE(exists(first));
  kill(child, SIGINT);
  const Outcome stopped = finish(child);
  EXPECT_EQ(stopped.code, 1);
  expect_one_line(stopped.err, arguments);
  EXPECT_THAT(stopped.err, HasSubstr("interrupted"));
  const std::string before = text(first);
  const Outcome outcome = run(arguments);
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_EQ(text(first), before);
  EXPECT_TRUE(exists("d/training/label_2/000002.txt"));
  EXPECT_TRUE(exists("d/result.json"));
}

/// With Cycles' pictures the gradient uses exact areas and visible light, unless the user chooses otherwise.
TEST_F(CommandLine, AnAttackUnderCyclesGoesThroughExactAreasAndVisibleLight) {
  MIRAGE_NEED_FUSION();
  generate("--frames 2 --seed 5");
  const auto simulation = [&](const std::string& out, const std::string& more) {
    const Outcome outcome =
        run("attack --quiet --iterations 1 --batch 1 --renderer cycles --cycles-samples 1 --data " +
            at("data") + " --out " + at(out) + more);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    return json(out + "/run.json").at("simulation");
  };
  const auto by_itself = simulation("a", ""), asked = simulation("b", " --light plain --sigma 1e-6");
  EXPECT_EQ(by_itself.value("light", "plain"), "visible");
  EXPECT_TRUE(by_itself.value("exact_coverage", false));
  EXPECT_EQ(asked.value("light", "plain"), "plain");
  EXPECT_FALSE(asked.value("exact_coverage", false));
}

/// All commands up to Blender with the shipped detector, including an attack that is interrupted.
TEST_F(CommandLine, AttackSurvivesCtrlCAndTheChainGoesOn) {
  MIRAGE_NEED_FUSION();
  generate("--frames 2 --seed 5");
  const std::string attacked = " --run " + at("run");
  const auto attack = [&](int iterations) {
    return fmt::format("attack --data {} --iterations {} --out {}", at("data"), iterations, at("run"));
  };
  const pid_t child = start(attack(2000) + " --quiet");
  const std::string checkpoint = "run/checkpoint.json";
  for (int i = 0; i < 12'000 && !exists(checkpoint); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  ASSERT_TRUE(exists(checkpoint));
  kill(child, SIGINT);
  const Outcome stopped = finish(child);
  EXPECT_EQ(stopped.code, 1);
  EXPECT_THAT(stopped.err, HasSubstr("interrupted after"));
  const int reached = json(checkpoint).at("iteration");
  EXPECT_GE(reached, 10);

  refused("evaluate --out " + at("e") + attacked);  // an unfinished run
  ASSERT_EQ(run(attack(reached + 1) + " --quiet").code, 0);
  EXPECT_EQ(json("run/result.json").at("iterations"), reached + 1);

  // A finished attack has nothing left to do, and says so.
  Outcome outcome = run(attack(1));
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, HasSubstr(fmt::format("already done: {0} of {0} iterations", reached + 1)));
  EXPECT_THAT(outcome.out, Not(HasSubstr("seconds an iteration")));
  EXPECT_THAT(outcome.err, Not(HasSubstr("resuming")));
  EXPECT_EQ(json("run/result.json").at("provenance").at("settings").at("iterations"), reached + 1);

  // A run on fitted roofs does not resume with boxes, nor with another sun.
  EXPECT_THAT(refused(attack(reached + 2) + " --quiet --rooftop box"), HasSubstr("rooftop"));
  EXPECT_THAT(refused(attack(reached + 2) + " --quiet --sun 90,30"), HasSubstr("sun"));

  outcome = run("evaluate --hosts all --quiet --out " + at("e") + attacked);
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const auto result = json("e/result.json"), split = json("run/run.json");
  EXPECT_EQ(result.at("rooftops"), json("run/result.json").at("rooftops"));
  EXPECT_GT(result.at("rooftops").at("fitted"), 0);
  EXPECT_EQ(result.at("sun"), "frame");
  EXPECT_EQ(result.at("depth"), "ip-basic");
  EXPECT_EQ(result.at("rooftop"), "shape");
  EXPECT_EQ(split.at("sun"), "frame");
  for (const char* key : {"vehicles", "fn_asr", "fp_asr", "asr", "recall_iou"})
    EXPECT_TRUE(result.contains(key)) << key;
  const auto exported = [&](const std::string& out, int frames) {
    outcome = run(fmt::format("export --frames {} --out {}{}", frames, at(out), attacked));
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    return json(out + "/result.json");
  };
  const auto one = exported("g", 1);
  EXPECT_EQ(one.at("rooftops").at("fitted").get<int>() + one.at("rooftops").at("from_box").get<int>(),
            one.at("scenes"));
  EXPECT_EQ(text("g/adversary.glb"), text("run/adversary.glb"));
  // By default all test vehicles and no others; the number of training vehicles is printed and stored.
  const auto held_back = exported("h", 0), everything = exported("i", 9);
  EXPECT_EQ(held_back.at("scenes"), split.at("test").size());
  EXPECT_EQ(held_back.at("learned_on"), 0);
  EXPECT_EQ(everything.at("scenes"), split.at("test").size() + split.at("train").size());
  EXPECT_EQ(everything.at("learned_on"), split.at("train").size());
  EXPECT_THAT(outcome.out, HasSubstr(fmt::format("({} of vehicles learned on)", split.at("train").size())));
  // Files of an earlier export that this one does not write are removed; other files stay.
  write_file(folder_ / "i/own.obj", "the user's");
  auto listed = everything;
  listed["files"].push_back("../run/adversary.glb");  // not a name of the export
  write_json(folder_ / "i/result.json", listed);
  const auto fewer = exported("i", 1);
  EXPECT_LT(fewer.at("files").size(), everything.at("files").size());
  for (const auto& file : everything.at("files")) {
    const auto& names = fewer.at("files");
    EXPECT_EQ(exists("i/" + file.get<std::string>()),
              std::find(names.begin(), names.end(), file) != names.end())
        << file;
  }
  EXPECT_TRUE(exists("i/own.obj") && exists("run/adversary.glb"));

  // The quality's values, except where a config file or the command line sets them.
  write_file(folder_ / "quality.toml", "quality = \"draft\"\ngamma = 0.02\n");
  const std::string simulate = "simulate --frame 000000 --rooftop box --data " + at("data") + " --mesh " +
                               at("run/adversary.glb") + " --out " + at("s");
  outcome = run(simulate + " --supersampling 3 --config " + at("quality.toml"));
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const auto simulated = json("s/result.json").at("simulation");
  EXPECT_EQ(simulated.at("gamma"), 0.02);
  EXPECT_EQ(simulated.at("supersampling"), 3);
  EXPECT_NE(simulated.at("sigma"), result.at("simulation").at("sigma"));
  ASSERT_EQ(run(simulate + " --quality exact").code, 0);
  EXPECT_EQ(json("s/result.json").at("simulation").at("exact_coverage"), true);
  EXPECT_THAT(refused(simulate + " --quality exact --sigma 1e-6"), HasSubstr("--sigma"));
}

#ifdef MIRAGE_HAS_TORCHSCRIPT
TEST_F(CommandLine, AModelFromPyTorchIsRunAndScored) {
  ASSERT_EQ(shell(MIRAGE_BUILD "/test_plugins/torchscript_models " + folder_.path().string()), 0);
  generate("--frames 1");
  const auto detect = [&](const std::string& model) {
    return "detect --data " + at("data") + " --detector torchscript --weights " + at(model) + " --out " +
           at("o");
  };
  const Outcome outcome = run(detect("works.pt"));
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, AllOf(HasSubstr("AP by Mirage's rules"), HasSubstr("AP 0.7 (95 %)"),
                                 HasSubstr("AP by KITTI's kit, bev, IoU 0.7 (0.5):"), HasSubstr("moderate")));
  const auto result = json("o/result.json");
  EXPECT_EQ(result.at("detector"), "torchscript");
  EXPECT_EQ(result.at("kitti_ap").at("iou"), 0.7);
  for (const char* level : {"easy", "moderate", "hard"})
    EXPECT_TRUE(result.at("kitti_ap").at("bev").contains(level)) << level;
  for (const char* key : {"frames", "vehicles", "ap50", "ap70", "recall50"})
    EXPECT_TRUE(result.at(key).is_number()) << key;
  for (const char* key : {"0_20_m", "20_40_m", "40_70_m", "0_40_m", "easy", "moderate", "hard"}) {
    const auto part = result.at("strata").at(key);
    for (const char* figure : {"ap50", "ap70", "recall50", "recall70"})  // null without vehicles
      EXPECT_TRUE(part.at("vehicles") > 0 ? part.at(figure).is_number() : part.at(figure).is_null()) << key;
  }
  EXPECT_TRUE(exists("o/precision_recall.json"));
  for (const auto& plot : result.at("plots")) EXPECT_TRUE(exists("o/" + plot.get<std::string>()));
  EXPECT_EQ(result.at("plane"), "bev");
  const Outcome seen = run(detect("picture.pt"));
  ASSERT_EQ(seen.code, 0) << seen.err;
  EXPECT_EQ(json("o/result.json").at("plane"), "picture");
  EXPECT_THAT(json("o/precision_recall.json").at("title"), HasSubstr("boxes in the picture"));
  EXPECT_TRUE(json("o/result.json").at("kitti_ap").contains("image"));
  const auto found = json("o/detections.json").at("frames").at(0).at("detections");
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found.at(0).at("right").get<double>() - found.at(1).at("right").get<double>(),
            found.at(0).at("left") == 2 ? -30 : 30);
  EXPECT_THAT(refused("attack --target lidar --detector torchscript --data " + at("data") + " --weights " +
                      at("picture.pt") + " --out " + at("a")),
              HasSubstr("--target"));
  for (const char* model :
       {"one_tensor.pt", "not_finite.pt", "detached.pt", "negative_sides.pt", "missing.pt"})
    EXPECT_THAT(refused(detect(model)), HasSubstr(model));
}
#endif

}  // namespace
}  // namespace mirage
