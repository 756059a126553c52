// The program as a user meets it: exit codes, one-line errors, and what survives when something goes wrong.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

#include "base/files.h"
#include "support/files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

const std::string kProgram = std::string(MIRAGE_BUILD) + "/mirage";

struct Outcome {
  int code = -1;
  std::string out, err;
};

/// Starts the program with its output in files under `folder`.
pid_t start(const TemporaryFolder& folder, const std::vector<std::string>& arguments,
            const std::vector<std::pair<std::string, std::string>>& environment = {}) {
  const pid_t child = fork();
  if (child != 0) return child;
  for (const auto& [name, value] : environment) setenv(name.c_str(), value.c_str(), 1);
  if (!freopen((folder / "out.txt").c_str(), "w", stdout)) _exit(99);
  if (!freopen((folder / "err.txt").c_str(), "w", stderr)) _exit(99);
  std::vector<char*> argv{const_cast<char*>(kProgram.c_str())};
  for (const std::string& a : arguments) argv.push_back(const_cast<char*>(a.c_str()));
  argv.push_back(nullptr);
  execv(kProgram.c_str(), argv.data());
  _exit(98);
}

Outcome finish(const TemporaryFolder& folder, pid_t child) {
  int status = 0;
  waitpid(child, &status, 0);
  return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), read_file(folder / "out.txt"),
          read_file(folder / "err.txt")};
}

Outcome run(const TemporaryFolder& folder, const std::vector<std::string>& arguments,
            const std::vector<std::pair<std::string, std::string>>& environment = {}) {
  return finish(folder, start(folder, arguments, environment));
}

/// One line on standard error that starts with "mirage: ".
void expect_one_line(const std::string& err) {
  EXPECT_THAT(err, testing::StartsWith("mirage: "));
  EXPECT_EQ(std::count(err.begin(), err.end(), '\n'), 1) << err;
}

TEST(CommandLine, HelpNamesEveryCommand) {
  TemporaryFolder folder;
  const Outcome outcome = run(folder, {"--help"});
  EXPECT_EQ(outcome.code, 0);
  for (const char* command :
       {"demo", "generate", "simulate", "train", "detect", "attack", "evaluate", "export", "validate",
        "tradeoff", "depth", "reproduce", "defend", "certify", "view", "rig", "drive"})
    EXPECT_THAT(outcome.out, HasSubstr(command));
}

TEST(CommandLine, WrongArgumentsExitWithTwo) {
  TemporaryFolder folder;
  for (const auto& arguments :
       std::vector<std::vector<std::string>>{{"fly"},
                                             {},
                                             {"attack"},
                                             {"generate", "--frames", "many"},
                                             {"generate", "--no-such-option"},
                                             {"generate", "--look", "lunar", "--out", folder / "d"},
                                             {"reproduce", "table9", "--out", folder / "d"}}) {
    const Outcome outcome = run(folder, arguments);
    EXPECT_EQ(outcome.code, 2);
    expect_one_line(outcome.err);
  }
}

TEST(CommandLine, AConfigSetsOptionsAndAnUnknownKeyIsAnError) {
  TemporaryFolder folder;
  const fs::path config = folder / "run.toml";
  std::ofstream(config) << "frames = 1\nrig = \"no-such-rig\"\n";
  Outcome outcome = run(folder, {"generate", "--config", config, "--out", folder / "d"});
  EXPECT_EQ(outcome.code, 2);
  EXPECT_THAT(outcome.err, HasSubstr("no-such-rig"));
  std::ofstream(config) << "frames = 1\nfarmes = 2\n";
  outcome = run(folder, {"generate", "--config", config, "--out", folder / "d"});
  EXPECT_EQ(outcome.code, 2);
  expect_one_line(outcome.err);
  EXPECT_THAT(outcome.err, HasSubstr("run.toml: farmes"));
}

TEST(CommandLine, AWordThatIsNoneIsAskedAboutAndAllThatThereIsIsNamed) {
  TemporaryFolder folder;
  std::ofstream(folder / "c.toml") << "min_veiw = 0.5\n";
  std::ofstream(folder / "rig.toml") << "lidar = \"hdl32\"\n";
  using Words = std::vector<std::string>;
  for (const auto& [arguments, words] : std::vector<std::pair<Words, Words>>{
           {{"atack"}, {"atack: no such command", "did you mean attack?", "reproduce"}},
           {{"--hepl"}, {"no such option", "did you mean --help?"}},
           {{}, {"command: is missing", "attack"}},
           {{"attack", "--data", "d", "--iteratons", "5"},
            {"attack: --iteratons: no such option", "did you mean --iterations?", "--until-plateau"}},
           {{"attack", "--data", "d", "--iteratons=5"}, {"did you mean --iterations?"}},
           {{"train", "--stepz", "5", "--data", "d"}, {"did you mean --steps?"}},
           {{"train", "detektor", "--data", "d"}, {"detektor is unknown", "did you mean detector?"}},
           {{"attack", "--data", "d", "--config", folder / "c.toml"},
            {"c.toml: min_veiw: unknown key", "did you mean min-view?", "texel-rate"}},
           {{"attack", "--data", "d", "--light", "visibel"}, {"--light", "did you mean visible?"}},
           {{"attack", "--data", "d", "--target", "imag"}, {"--target", "did you mean image?"}},
           {{"attack", "--data", "d", "--precision", "flaot"}, {"did you mean float?", "bfloat16"}},
           {{"attack", "--data", "d", "--expect", "roof,son"}, {"son: unknown", "did you mean sun?"}},
           {{"attack", "--data", "d", "--renderer", "cycle"}, {"did you mean cycles?"}},
           {{"generate", "--rig", "kitti"}, {"--rig: kitti", "did you mean kitti64?", "nuscenes", "xenith"}},
           {{"generate", "--lidar", "hdl64"}, {"--lidar: hdl64", "hdl32e", "vlp16", "vls128"}},
           {{"generate", "--look", "amercian"}, {"did you mean american?"}},
           {{"defend", "--data", "d", "--method", "denoisng"}, {"did you mean denoising?", "adversarial"}},
           {{"reproduce", "tabel1"}, {"tabel1: no such table or figure", "did you mean table1?"}},
           {{"render", "--scene", "s.glb", "--renderer", "sotf"}, {"did you mean soft?"}}}) {
    const Outcome outcome = run(folder, arguments);
    EXPECT_EQ(outcome.code, 2);
    expect_one_line(outcome.err);
    EXPECT_THAT(outcome.err, testing::Not(HasSubstr("…")));
    EXPECT_THAT(outcome.err, testing::Not(HasSubstr("MIRAGE_HOME")));
    for (const std::string& word : words) EXPECT_THAT(outcome.err, HasSubstr(word));
  }
}

TEST(CommandLine, AValueOutOfItsRangeIsToldTheRange) {
  TemporaryFolder folder;
  using Words = std::vector<std::string>;
  for (const auto& [arguments, line] : std::vector<std::pair<Words, std::string>>{
           {{"export", "--run", "r", "--frames", "-1"}, "--frames: -1 is out of range; use at least 0"},
           {{"reproduce", "--judge-frames", "-1"}, "--judge-frames: -1 is out of range; use at least 0"},
           {{"generate", "--threads", "2000"}, "--threads: 2000 is out of range; use 0 to 1024"},
           {{"attack", "--data", "d", "--iterations", "ten"},
            "--iterations: ten is no such number; use a whole number, 0 to 1000000000"},
           {{"attack", "--data", "d", "--vertex-rate", "0"}, "--vertex-rate: 0 is out of range; use above 0"},
           {{"attack", "--data", "d", "--vertex-rate", "nan"}, "--vertex-rate: nan is out of range"},
           {{"attack", "--data", "d", "--iterations", "1.5"}, "--iterations: 1.5 is no such number"},
           {{"generate", "--seed", "-1"}, "--seed: -1 is"},
           {{"attack", "--data", "d", "--iterations"}, "--iterations: needs a value; Adam steps"},
           {{"attack"}, "mirage: attack: --data: is missing; give it: "}}) {
    const Outcome outcome = run(folder, arguments);
    EXPECT_EQ(outcome.code, 2) << line;
    expect_one_line(outcome.err);
    EXPECT_THAT(outcome.err, HasSubstr(line));
  }
}

TEST(CommandLine, HelpIsNarrowGroupedAndWithAnExampleThatHolds) {
  TemporaryFolder folder;
  const auto help_of = [&](const std::string& command) {
    const Outcome outcome = run(folder, {command, "--help"});
    EXPECT_EQ(outcome.code, 0) << command;
    return outcome.out;
  };
  std::istringstream list(run(folder, {"--completion", "commands"}).out);
  int commands = 0;
  for (std::string line; std::getline(list, line); ++commands) {
    const std::string command = line.substr(0, line.find('\t')), help = help_of(command);
    const auto example = help.find("Example:\n  mirage " + command);
    EXPECT_NE(example, help.npos) << command;
    EXPECT_THAT(help, testing::Not(HasSubstr("79769313"))) << command;
    std::istringstream lines(help), words(help.substr(std::min(example, help.size())));
    for (std::string text; std::getline(lines, text);)
      EXPECT_LE(std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xc0) != 0x80; }), 100)
          << text;
    for (std::string word; words >> word && word != "Completed";)
      if (word.starts_with("--")) {
        EXPECT_THAT(help, HasSubstr("  " + word)) << command;
      }
  }
  EXPECT_GE(commands, 17);
  const std::string attack = help_of("attack");
  for (const char* text : {"\nData:\n", "\nDetector:\n", "\nLearning:\n", "\nRun:\n",
                           "(0 to 1000000000; default 200)", "(required)"})
    EXPECT_THAT(attack, HasSubstr(text));
  EXPECT_THAT(help_of("generate"),
              AllOf(HasSubstr("kitti64, nuscenes, nuscenes6, xenith"), HasSubstr("hdl32e, vlp16")));
  EXPECT_THAT(run(folder, {"--help"}).out, HasSubstr("--completion bash"));
}

TEST(CommandLine, BashCompletesWordsOfOptions) {
  TemporaryFolder folder;
  const auto completed = [&](const std::string& line) {
    const std::string script =
        "source <(" + kProgram + " --completion bash); COMP_WORDS=(" + line +
        "); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _mirage; echo \" ${COMPREPLY[@]} \" > " +
        (folder / "words.txt").string();
    EXPECT_EQ(std::system(("bash -c '" + script + "'").c_str()), 0);
    return read_file(folder / "words.txt");
  };
  EXPECT_THAT(completed("mirage att"), HasSubstr(" attack "));
  EXPECT_THAT(completed("mirage attack --targ"), HasSubstr(" --target "));
  EXPECT_THAT(completed("mirage attack --target i"), HasSubstr(" image "));
  EXPECT_THAT(completed("mirage generate --rig k"), HasSubstr(" kitti64 "));
  EXPECT_THAT(completed("mirage attack --defense adv"), HasSubstr(" adversarial "));
  EXPECT_THAT(completed("mirage attack --lidar-effects u"), HasSubstr(" unit "));
  EXPECT_THAT(completed("mirage --comp"), HasSubstr(" --completion "));
  const Outcome zsh = run(folder, {"--completion", "zsh"});
  EXPECT_EQ(zsh.code, 0);
  EXPECT_THAT(zsh.out, HasSubstr("bashcompinit"));
}

TEST(CommandLine, AQualityIsOneOfThree) {
  TemporaryFolder folder;
  std::ofstream(folder / "run.toml") << "quality = \"best\"\n";
  for (const auto& arguments : std::vector<std::vector<std::string>>{
           {"attack", "--data", folder.path(), "--quality", "best"},
           {"attack", "--data", folder.path(), "--config", folder / "run.toml"},
           {"simulate", "--data", folder.path(), "--frame", "0", "--mesh", "m.glb", "--quality", "best"},
           {"evaluate", "--run", folder.path(), "--quality", "best"},
           {"validate", "--run", folder.path(), "--quality", "best"},
           {"demo", "--quality", "best"}}) {
    const Outcome outcome = run(folder, arguments);
    EXPECT_EQ(outcome.code, 2) << arguments[0];
    expect_one_line(outcome.err);
    for (const char* word : {"--quality", "best", "draft", "default", "exact"})
      EXPECT_THAT(outcome.err, HasSubstr(word)) << arguments[0];
  }
}

TEST(CommandLine, AResultSaysWhatItIsMadeOfWhereverThatLies) {
  TemporaryFolder folder;
  const auto made_of = [&](const fs::path& data, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"depth", "--data", data, "--frames", "1", "--backends", "ip-basic"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    arguments.insert(arguments.end(), {"--out", folder / "o", "--quiet"});
    const Outcome outcome = run(folder, arguments);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    return read_json(folder / "o/result.json").at("provenance");
  };
  const fs::path data = folder / "data";
  ASSERT_EQ(run(folder, {"generate", "--frames", "2", "--out", data, "--quiet"}).code, 0);
  const auto first = made_of(data);
  for (const char* key : {"program", "version", "commit", "date", "command", "seed", "settings", "inputs",
                          "identity", "data", "data_hash", "frames"})
    EXPECT_TRUE(first.contains(key)) << key;
  EXPECT_THAT(first.at("command").get<std::string>(), testing::StartsWith("mirage depth --data "));
  EXPECT_EQ(first.at("frames"), 1);
  // Another place, other threads and the frame that is not looked at are nothing to it.
  fs::rename(data, folder / "moved");
  write_file(folder / "moved/training/label_2/000001.txt", "");
  EXPECT_EQ(made_of(folder / "moved", {"--threads", "1"}).at("identity"), first.at("identity"));
  EXPECT_NE(made_of(folder / "moved", {"--hide", "0.3"}).at("identity"), first.at("identity"));
  const fs::path sweep = folder / "moved/training/velodyne/000000.bin";
  std::string bytes = read_file(sweep);
  bytes[12] ^= 1;
  write_file(sweep, bytes);
  EXPECT_NE(made_of(folder / "moved").at("identity"), first.at("identity"));
}

TEST(CommandLine, ASunThatIsNoneIsOneLine) {
  TemporaryFolder folder;
  ASSERT_EQ(run(folder, {"generate", "--frames", "1", "--out", folder / "data", "--quiet"}).code, 0);
  for (const char* sun : {"noon", "30,120", "49,8.4,2011-09-26T23:30:00Z,0"})
    for (const auto& command : std::vector<std::vector<std::string>>{
             {"simulate", "--data", folder / "data", "--frame", "000000", "--mesh", "m.glb"},
             {"attack", "--data", folder / "data", "--out", folder / "run"}}) {
      auto arguments = command;
      arguments.insert(arguments.end(), {"--sun", sun});
      const Outcome outcome = run(folder, arguments);
      EXPECT_EQ(outcome.code, 2) << arguments[0];
      expect_one_line(outcome.err);
      for (const char* word : {"--sun", sun}) EXPECT_THAT(outcome.err, HasSubstr(word)) << arguments[0];
    }
}

TEST(CommandLine, ATradeoffThatCannotBeMadeIsOneLine) {
  TemporaryFolder folder;
  for (const auto& [arguments, word] : std::vector<std::pair<std::vector<std::string>, std::string>>{
           {{}, "--data"},
           {{"--data", folder / "none"}, "none"},
           {{"--run", folder / "none"}, "run.json"},
           {{"--data", folder.path(), "--hosts", "0"}, "--hosts"},
           {{"--data", folder.path(), "--repeats", "-1"}, "--repeats"},
           {{"--data", folder.path(), "--reference-samples", "99"}, "--reference-samples"},
           {{"--data", folder.path(), "--rooftop", "thatched"}, "thatched"}}) {
    std::vector<std::string> all{"tradeoff", "--out", folder / "o"};
    all.insert(all.end(), arguments.begin(), arguments.end());
    const Outcome outcome = run(folder, all);
    EXPECT_EQ(outcome.code, 2) << word;
    expect_one_line(outcome.err);
    EXPECT_THAT(outcome.err, HasSubstr(word));
  }
}

TEST(CommandLine, AnAttackOrADefenceThatCannotBeIsOneLine) {
  TemporaryFolder folder;
  ASSERT_EQ(run(folder, {"generate", "--frames", "1", "--out", folder / "data", "--quiet"}).code, 0);
  const std::string data = folder / "data", out = folder / "out";
  using Case = std::pair<std::vector<std::string>, std::string>;
  for (const auto& [arguments, word] : std::vector<Case>{
           {{"defend", "--data", data, "--method", "armour"}, "use adversarial, denoising, depth-gate"},
           {{"defend", "--data", data, "--method", "denoising", "--detector", "lidar"}, "sees the picture"},
           {{"defend", "--data", data, "--attacked", "2"}, "--attacked"},
           {{"defend", "--data", data, "--weights", folder / "none.weights"}, "none.weights"},
           {{"attack", "--data", data, "--size", "0"}, "--size"},
           {{"attack", "--data", data, "--size", "nan"}, "--size"},
           {{"detect", "--data", data, "--defense", "jpeg:0"}, "jpeg:1 to jpeg:100"},
           {{"detect", "--data", data, "--defense", "stone-wall"}, "with the defence stone-wall"},
           {{"detect", "--data", data, "--defense", "adversariel"}, "did you mean adversarial? use"},
           {{"detect", "--data", data, "--defense", "jpeg"}, "did you mean jpeg:QUALITY? use"}}) {
    auto all = arguments;
    all.insert(all.end(), {"--out", out});
    const Outcome outcome = run(folder, all);
    EXPECT_EQ(outcome.code, 2) << arguments[0] << ' ' << word;
    expect_one_line(outcome.err);
    EXPECT_THAT(outcome.err, HasSubstr(word));
  }
}

TEST(CommandLine, MissingAndEmptyDataSets) {
  TemporaryFolder folder;
  fs::create_directories(folder / "empty/training/velodyne");
  for (const char* data : {"none", "empty"})
    for (const char* command : {"attack", "detect"}) {
      const Outcome outcome = run(folder, {command, "--data", folder / data, "--out", folder / "o"});
      EXPECT_EQ(outcome.code, 2) << command << ' ' << data << ' ' << outcome.err;
      expect_one_line(outcome.err);
      EXPECT_THAT(outcome.err, HasSubstr(data));
    }
}

TEST(CommandLine, AMissingPluginIsNamed) {
  TemporaryFolder folder;
  const Outcome outcome = run(
      folder, {"detect", "--data", folder.path(), "--detector", "/no/such/plugin.so", "--out", folder / "o"});
  EXPECT_EQ(outcome.code, 2);
  expect_one_line(outcome.err);
  EXPECT_THAT(outcome.err, HasSubstr("/no/such/plugin.so"));
}

TEST(CommandLine, DepthIsGeneratedScoredAndAskedForByTraining) {
  TemporaryFolder folder;
  const std::string data = folder / "data";
  ASSERT_EQ(run(folder, {"generate", "--frames", "1", "--out", data, "--quiet"}).code, 0);
  const Outcome untold = run(
      folder, {"train", "depth", "--data", data, "--depth", MIRAGE_BUILD "/none.so", "--out", folder / "t"});
  EXPECT_EQ(untold.code, 2);
  expect_one_line(untold.err);
  ASSERT_EQ(run(folder, {"generate", "--frames", "1", "--depth", "--out", data, "--quiet"}).code, 0);
  const Outcome scored = run(
      folder, {"depth", "--data", data, "--backends", "ip-basic,ip-basic-bilateral", "--out", folder / "d"});
  EXPECT_EQ(scored.code, 0) << scored.err;
  const auto result = read_json(folder / "d/result.json");
  ASSERT_EQ(result.at("backends").size(), 2u);
  EXPECT_GT(result.at("backends")[0].at("common").at("rmse_mm"), 100);
  EXPECT_GT(result.at("backends")[0].at("roof").at("pixels"), 0);
  const Outcome hidden = run(
      folder, {"depth", "--data", data, "--hide", "0.2", "--backends", "ip-basic", "--out", folder / "h"});
  EXPECT_EQ(hidden.code, 0) << hidden.err;
  EXPECT_EQ(read_json(folder / "h/result.json").at("hidden"), 0.2);
  const Outcome unknown =
      run(folder, {"depth", "--data", data, "--backends", "magic", "--out", folder / "u"});
  EXPECT_EQ(unknown.code, 2);
  expect_one_line(unknown.err);
  EXPECT_THAT(unknown.err, HasSubstr("magic"));
}

TEST(CommandLine, SimulateStandsOnTheFittedRoofOrTheBoxsAndSaysWhich) {
  TemporaryFolder folder;
  const std::string data = folder / "data";
  ASSERT_EQ(run(folder, {"generate", "--frames", "1", "--out", data, "--quiet"}).code, 0);
  ASSERT_EQ(run(folder, {"fit", "--data", data, "--mesh-format", "glb", "--out", folder / "f"}).code, 0);
  const auto fits = read_json(folder / "f/result.json");
  std::string fit;
  for (const auto& file : fs::recursive_directory_iterator(folder / "f"))
    if (file.path().extension() == ".glb") fit = file.path();
  ASSERT_NE(fit, "");
  const int vehicle = std::stoi(fit.substr(fit.rfind('_') + 1));
  const std::string mesh = folder / "object.obj";  // a tetrahedron of a metre
  write_file(
      mesh,
      "\xef\xbb\xbfv -0.5 -0.5 0\nv 0.5 -0.5 0\nv 0 0.5 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n");
  const auto simulated = [&](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {
        "simulate", "--data", data,    "--frame",   "000000", "--vehicle", std::to_string(vehicle),
        "--mesh",   mesh,     "--out", folder / "s"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const Outcome outcome = run(folder, arguments);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    auto result = read_json(folder / "s/result.json");
    return std::pair(result.at("rooftop"),
                     read_file(folder / "s/image.png") + read_file(folder / "s/sweep.bin"));
  };
  const auto [fitted, one] = simulated({"--threads", "1"});
  EXPECT_EQ(fitted.at("from_box"), false);
  EXPECT_NE(fitted.at("over_box_m"), 0);
  const auto [again, two] = simulated({"--threads", "2", "--rooftop", "shape"});
  EXPECT_EQ(fitted, again);
  EXPECT_EQ(one, two);
  const auto [noisy, three] = simulated({"--lidar-effects", "unit"});
  EXPECT_EQ(noisy, fitted);
  EXPECT_NE(three, one);
  EXPECT_EQ(simulated({"--lidar-effects", "unit"}).second, three);
  EXPECT_EQ(simulated({"--lidar-effects", "ideal"}).second, one);
  // The frame is generated: its sweep has noise and drop-out, of thin rays.
  const auto as_recorded = simulated({"--lidar-effects", "as-recorded"}).second;
  EXPECT_EQ(as_recorded, simulated({"--lidar-effects", "noise,drop-out"}).second);
  EXPECT_NE(as_recorded, three);
  const auto by_box = simulated({"--rooftop", "box"}).first;
  EXPECT_EQ(by_box.at("from_box"), true);
  EXPECT_NEAR(by_box.at("over_box_m").get<double>(), 0, 1e-9);
  EXPECT_NE(by_box.at("velo"), fitted.at("velo"));
  // The frame's own sun, and one of another direction.
  const auto to_sun = [&] { return read_json(folder / "s/result.json").at("sun").at("to_sun_velo"); };
  const auto frames_sun = simulated({"--sun", "frame"}).second;
  EXPECT_EQ(frames_sun, one);
  EXPECT_EQ(to_sun(), read_json(folder / "data/training/lighting/000000.json").at("to_sun_velo"));
  simulated({"--sun", "photo"});
  EXPECT_NE(simulated({"--sun", "-120,30"}).second, one);
  EXPECT_NEAR(to_sun().at(2).get<double>(), 0.5, 1e-9);
  const Outcome unknown = run(folder, {"simulate", "--data", data, "--frame", "000000", "--mesh", mesh,
                                       "--rooftop", "cone", "--out", folder / "s"});
  EXPECT_EQ(unknown.code, 2);
  expect_one_line(unknown.err);
  EXPECT_THAT(unknown.err, HasSubstr("--rooftop: cone"));
  // Hosts that are none, and frames that nobody has labelled.
  const auto refused = [&](const std::vector<std::string>& arguments) {
    const Outcome outcome = run(folder, arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.err;
    expect_one_line(outcome.err);
    return outcome.err;
  };
  const std::vector<std::string> simulate = {"simulate", "--data", data, "--frame", "000000",    "--vehicle",
                                             "0",        "--mesh", mesh, "--out",   folder / "s"};
  EXPECT_THAT(refused({"fit", "--data", data, "--types", "Golem", "--out", folder / "f"}),
              testing::AllOf(HasSubstr("--types"), HasSubstr("Golem"), HasSubstr("Car")));
  const auto labels = folder / "data/training/label_2/000000.txt";
  const std::string rows = read_file(labels);
  write_file(labels, "Pedestrian" + rows.substr(rows.find(' ')));
  EXPECT_THAT(refused(simulate), testing::AllOf(HasSubstr("--vehicle: 0"), HasSubstr("a Pedestrian there")));
  fs::remove(labels);
  EXPECT_THAT(refused(simulate), HasSubstr("has no labels"));
  EXPECT_THAT(refused({"fit", "--data", data, "--out", folder / "f"}), HasSubstr("labels"));
  EXPECT_EQ(run(folder, {"view", data, "--out", folder / "page.html"}).code, 0);
  EXPECT_THAT(refused({"attack", "--data", folder / "data/training", "--out", folder / "a"}),
              HasSubstr("give its parent"));
}

TEST(CommandLine, AnOutputFolderThatCannotBeWritten) {
  TemporaryFolder folder;
  const Outcome outcome = run(folder, {"generate", "--frames", "1", "--out", "/proc/nowhere"});
  EXPECT_EQ(outcome.code, 1);
  expect_one_line(outcome.err);
  EXPECT_THAT(outcome.err, HasSubstr("/proc/nowhere"));
}

TEST(CommandLine, AFullDiskKeepsWhatWasFinished) {
  TemporaryFolder folder;
  const fs::path disk = folder / "disk";
  fs::create_directories(disk);
  if (mount("tmpfs", disk.c_str(), "tmpfs", 0, "size=2500k") != 0)
    GTEST_SKIP() << "a small file system cannot be mounted here (root is needed)";
  const Outcome outcome = run(folder, {"generate", "--frames", "20", "--out", disk, "--quiet"});
  EXPECT_EQ(outcome.code, 1);
  expect_one_line(outcome.err);
  EXPECT_THAT(outcome.err, HasSubstr(disk.string()));
  int whole = 0;
  for (const auto& file : fs::recursive_directory_iterator(disk)) whole += file.path().extension() == ".bin";
  EXPECT_GE(whole, 1);
  for (const auto& file : fs::recursive_directory_iterator(disk))
    EXPECT_THAT(file.path().string(), testing::Not(HasSubstr(".tmp"))) << "a half-written file was left";
  umount(disk.c_str());
}

TEST(CommandLine, CtrlCKeepsFinishedFramesAndTheNextRunGoesOn) {
  TemporaryFolder folder;
  const std::vector<std::string> arguments{"generate", "--frames", "3",          "--seed",
                                           "4",        "--out",    folder / "d", "--quiet"};
  const pid_t child = start(folder, arguments);
  const fs::path first = folder / "d/training/velodyne/000000.bin";
  for (int i = 0; i < 1200 && !fs::exists(first); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  ASSERT_TRUE(fs::exists(first));
  kill(child, SIGINT);
  const Outcome stopped = finish(folder, child);
  EXPECT_EQ(stopped.code, 1);
  expect_one_line(stopped.err);
  EXPECT_THAT(stopped.err, HasSubstr("interrupted"));
  const std::string before = read_file(first);
  const Outcome outcome = run(folder, arguments);
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_EQ(read_file(first), before);
  EXPECT_TRUE(fs::exists(folder / "d/training/label_2/000002.txt"));
  EXPECT_TRUE(fs::exists(folder / "d/result.json"));
}

/// Beside Cycles' pictures the gradient is that of pictures like them, unless the user asks for another.
TEST(CommandLine, AnAttackUnderCyclesGoesThroughExactAreasAndVisibleLight) {
  if (!fs::exists(fs::path(MIRAGE_BUILD) / "plugins/fusion.so"))
    GTEST_SKIP() << "the fusion plugin was not built (MIRAGE_DETECTORS)";
  TemporaryFolder folder;
  const std::string data = folder / "data";
  ASSERT_EQ(run(folder, {"generate", "--frames", "2", "--seed", "5", "--out", data, "--quiet"}).code, 0);
  const auto simulation = [&](const std::string& out, const std::vector<std::string>& more) {
    std::vector<std::string> words = {"attack",           "--data", data,      "--iterations", "1",
                                      "--batch",          "1",      "--quiet", "--renderer",   "cycles",
                                      "--cycles-samples", "1",      "--out",   folder / out};
    words.insert(words.end(), more.begin(), more.end());
    const Outcome outcome = run(folder, words);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    return read_json(folder / (out + "/run.json")).at("simulation");
  };
  const auto by_itself = simulation("a", {}),
             asked = simulation("b", {"--light", "plain", "--sigma", "1e-6"});
  EXPECT_EQ(by_itself.value("light", "plain"), "visible");
  EXPECT_TRUE(by_itself.value("exact_coverage", false));
  EXPECT_EQ(asked.value("light", "plain"), "plain");
  EXPECT_FALSE(asked.value("exact_coverage", false));
}

/// The chain up to Blender, with the shipped detector, and an attack that is stopped in the middle.
TEST(CommandLine, AttackSurvivesCtrlCAndTheChainGoesOn) {
  if (!fs::exists(fs::path(MIRAGE_BUILD) / "plugins/fusion.so"))
    GTEST_SKIP() << "the fusion plugin was not built (MIRAGE_DETECTORS)";
  TemporaryFolder folder;
  const std::string data = folder / "data", attacked = folder / "run";
  ASSERT_EQ(run(folder, {"generate", "--frames", "2", "--seed", "5", "--out", data, "--quiet"}).code, 0);
  const auto attack = [&](const char* iterations) {
    return std::vector<std::string>{"attack",   "--data", data,     "--iterations",
                                    iterations, "--out",  attacked, "--quiet"};
  };
  const pid_t child = start(folder, attack("2000"));
  const fs::path checkpoint = folder / "run/checkpoint.json";
  for (int i = 0; i < 2400 && !fs::exists(checkpoint); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  ASSERT_TRUE(fs::exists(checkpoint));
  kill(child, SIGINT);
  const Outcome stopped = finish(folder, child);
  EXPECT_EQ(stopped.code, 1);
  EXPECT_THAT(stopped.err, HasSubstr("interrupted after"));
  const int reached = read_json(checkpoint).at("iteration");
  EXPECT_GE(reached, 10);

  Outcome outcome = run(folder, {"evaluate", "--run", attacked, "--out", folder / "e"});
  EXPECT_EQ(outcome.code, 2) << "an unfinished run was evaluated";
  expect_one_line(outcome.err);
  ASSERT_EQ(run(folder, attack(std::to_string(reached + 1).c_str())).code, 0);
  EXPECT_EQ(read_json(folder / "run/result.json").at("iterations"), reached + 1);

  // Finished: nothing is left to do, and it says so.
  auto finished = attack("1");
  finished.pop_back();  // --quiet
  outcome = run(folder, finished);
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, HasSubstr(fmt::format("already done: {0} of {0} iterations", reached + 1)));
  EXPECT_THAT(outcome.out, testing::Not(HasSubstr("seconds an iteration")));
  EXPECT_THAT(outcome.err, testing::Not(HasSubstr("resuming")));

  auto by_box = attack(std::to_string(reached + 2).c_str());
  by_box.insert(by_box.end(), {"--rooftop", "box"});
  outcome = run(folder, by_box);
  EXPECT_EQ(outcome.code, 2) << "a run on fitted roofs went on with boxes";
  expect_one_line(outcome.err);
  EXPECT_THAT(outcome.err, HasSubstr("rooftop"));

  auto other_sun = attack(std::to_string(reached + 2).c_str());
  other_sun.insert(other_sun.end(), {"--sun", "90,30"});
  outcome = run(folder, other_sun);
  EXPECT_EQ(outcome.code, 2) << "a run under the frames' sun went on under another";
  expect_one_line(outcome.err);
  EXPECT_THAT(outcome.err, HasSubstr("sun"));

  outcome = run(folder, {"evaluate", "--run", attacked, "--hosts", "all", "--out", folder / "e", "--quiet"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const auto result = read_json(folder / "e/result.json");
  EXPECT_EQ(result.at("rooftops"), read_json(folder / "run/result.json").at("rooftops"));
  EXPECT_GT(result.at("rooftops").at("fitted"), 0);
  EXPECT_EQ(result.at("sun"), "frame");
  EXPECT_EQ(result.at("depth"), "ip-basic");
  EXPECT_EQ(result.at("rooftop"), "shape");
  EXPECT_EQ(read_json(folder / "run/run.json").at("sun"), "frame");
  for (const char* key : {"vehicles", "fn_asr", "fp_asr", "asr", "recall_iou"})
    EXPECT_TRUE(result.contains(key)) << key;
  ASSERT_EQ(
      run(folder, {"export", "--run", attacked, "--frames", "1", "--out", folder / "g", "--quiet"}).code, 0);
  EXPECT_TRUE(fs::exists(folder / "g/adversary.glb"));
  const auto exported = read_json(folder / "g/result.json");
  EXPECT_EQ(
      exported.at("rooftops").at("fitted").get<int>() + exported.at("rooftops").at("from_box").get<int>(),
      exported.at("scenes"));
  EXPECT_EQ(read_file(folder / "g/adversary.glb"), read_file(folder / "run/adversary.glb"));
  // All test vehicles by default, and no others; which were learned on is counted and written.
  const auto split = read_json(folder / "run/run.json");
  ASSERT_EQ(
      run(folder, {"export", "--run", attacked, "--frames", "0", "--out", folder / "h", "--quiet"}).code, 0);
  const auto held_back = read_json(folder / "h/result.json");
  EXPECT_EQ(held_back.at("scenes"), split.at("test").size());
  EXPECT_EQ(held_back.at("learned_on"), 0);
  outcome = run(folder, {"export", "--run", attacked, "--frames", "9", "--out", folder / "i"});
  const auto everything = read_json(folder / "i/result.json");
  EXPECT_EQ(everything.at("scenes"), split.at("test").size() + split.at("train").size());
  EXPECT_EQ(everything.at("learned_on"), split.at("train").size());
  EXPECT_THAT(outcome.out, HasSubstr(fmt::format("({} of vehicles learned on)", split.at("train").size())));

  // The quality's values, but for what a config file or the command line gives.
  std::ofstream(folder / "quality.toml") << "quality = \"draft\"\ngamma = 0.02\n";
  outcome = run(folder, {"simulate", "--data", data, "--frame", "000000", "--mesh",
                         folder / "run/adversary.glb", "--rooftop", "box", "--config",
                         folder / "quality.toml", "--supersampling", "3", "--out", folder / "s"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const auto simulated = read_json(folder / "s/result.json").at("simulation");
  EXPECT_EQ(simulated.at("gamma"), 0.02);
  EXPECT_EQ(simulated.at("supersampling"), 3);
  EXPECT_NE(simulated.at("sigma"), result.at("simulation").at("sigma"));
  const std::vector<std::string> exactly = {
      "simulate",  "--data", data,        "--frame", "000000", "--mesh",    folder / "run/adversary.glb",
      "--rooftop", "box",    "--quality", "exact",   "--out",  folder / "e"};
  ASSERT_EQ(run(folder, exactly).code, 0);
  EXPECT_EQ(read_json(folder / "e/result.json").at("simulation").at("exact_coverage"), true);
  auto mixed = exactly;
  mixed.insert(mixed.end(), {"--sigma", "1e-6"});
  outcome = run(folder, mixed);
  EXPECT_EQ(outcome.code, 2);
  EXPECT_THAT(outcome.err, HasSubstr("--sigma"));
}

#ifdef MIRAGE_HAS_TORCHSCRIPT
TEST(CommandLine, AModelFromPyTorchIsRunAndScored) {
  TemporaryFolder folder;
  ASSERT_EQ(std::system((MIRAGE_BUILD "/test_plugins/torchscript_models " + folder.path().string()).c_str()),
            0);
  const std::string data = folder / "data";
  ASSERT_EQ(run(folder, {"generate", "--frames", "1", "--out", data, "--quiet"}).code, 0);
  const auto detect = [&](const std::string& model) {
    return run(folder, {"detect", "--data", data, "--detector", "torchscript", "--weights", folder / model,
                        "--out", folder / "o"});
  };
  const Outcome outcome = detect("works.pt");
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, AllOf(HasSubstr("AP by Mirage's rules"), HasSubstr("AP 0.7 (95 %)"),
                                 HasSubstr("AP by KITTI's kit, bev, IoU 0.7 (0.5):"), HasSubstr("moderate")));
  const auto result = read_json(folder / "o/result.json");
  EXPECT_EQ(result.at("detector"), "torchscript");
  EXPECT_EQ(result.at("kitti_ap").at("iou"), 0.7);
  for (const char* level : {"easy", "moderate", "hard"})
    EXPECT_TRUE(result.at("kitti_ap").at("bev").contains(level)) << level;
  for (const char* key : {"frames", "vehicles", "ap50", "ap70", "recall50"})
    EXPECT_TRUE(result.at(key).is_number()) << key;
  for (const char* key : {"0_20_m", "20_40_m", "40_70_m", "0_40_m", "easy", "moderate", "hard"})
    EXPECT_TRUE(result.at("strata").at(key).at("ap70").is_number()) << key;
  EXPECT_TRUE(fs::exists(folder / "o/precision_recall.json"));
  for (const auto& plot : result.at("plots")) EXPECT_TRUE(fs::exists(folder / "o" / plot.get<std::string>()));
  EXPECT_EQ(result.at("plane"), "bev");
  const Outcome seen = detect("picture.pt");
  ASSERT_EQ(seen.code, 0) << seen.err;
  EXPECT_EQ(read_json(folder / "o/result.json").at("plane"), "picture");
  EXPECT_TRUE(read_json(folder / "o/result.json").at("kitti_ap").contains("image"));
  const auto frames = read_json(folder / "o/detections.json").at("frames");
  ASSERT_EQ(frames.at(0).at("detections").size(), 2u);
  EXPECT_EQ(frames.at(0).at("detections").at(0).at("right").get<double>() -
                frames.at(0).at("detections").at(1).at("right").get<double>(),
            frames.at(0).at("detections").at(0).at("left") == 2 ? -30 : 30);
  const Outcome blind = run(folder, {"attack", "--data", data, "--detector", "torchscript", "--weights",
                                     folder / "picture.pt", "--target", "lidar", "--out", folder / "a"});
  EXPECT_EQ(blind.code, 2);
  expect_one_line(blind.err);
  EXPECT_THAT(blind.err, HasSubstr("--target"));
  for (const char* model :
       {"one_tensor.pt", "not_finite.pt", "detached.pt", "negative_sides.pt", "missing.pt"}) {
    const Outcome wrong = detect(model);
    EXPECT_EQ(wrong.code, 2) << model;
    expect_one_line(wrong.err);
    EXPECT_THAT(wrong.err, HasSubstr(model));
  }
}
#endif

}  // namespace
}  // namespace mirage
