// Commands on runs, data sets and output folders from other people.
#include <fcntl.h>
#include <sys/file.h>

#include <array>

#include "program.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

const std::string kPlugins = MIRAGE_BUILD "/test_plugins/";
const std::string kSmall = "generate --rig " MIRAGE_SOURCE "/tests/faults/small-rig.toml --seed 5 --frames ";

class ForeignRuns : public test::Program {
 protected:
  ForeignRuns() { environment_ = "MIRAGE_TEST_MARK=" + at("mark"); }
  void expect_line(const std::string& about) const { expect_one_line(said(), about); }
  bool marked() const { return exists("mark"); }

  /// A run against a plugin that always finds one box.
  void make_run() {
    ASSERT_EQ(mirage(kSmall + "2 --quiet --out " + at("data")), 0) << said();
    for (const char* id : {"000000", "000001"})  // a car where the plugin finds one
      write_file(folder_ / "data/training/label_2" / (std::string(id) + ".txt"),
                 "Car 0 0 0 110 44 165 76 1.5 2 4 -1 1.65 9.73 -1.5708\n");
    fs::remove_all(folder_ / "data/training/track_2");
    write_file(folder_ / "some.weights", "weights");
    ASSERT_EQ(mirage("attack --quiet --iterations 2 --min-view 0 --rooftop box --detector " + kPlugins +
                     "fake_works.so --weights " + at("some.weights") + " --data " + at("data") + " --out " +
                     at("run")),
              0)
        << said();
  }
  void change(const char* key, const nlohmann::json& value) {
    auto run = json("run/run.json");
    run[key] = value;
    write_json(folder_ / "run/run.json", run);
  }
};

TEST_F(ForeignRuns, RunNoCodeThatTheyName) {
  make_run();
  const std::string run = " --quiet --run " + at("run") + " --out " + at("o"),
                    planted = kPlugins + "planted.so";
  // Its detector is a plugin: the user must name it again, or trust the run.
  EXPECT_EQ(mirage("evaluate" + run), 2);
  expect_line("evaluate");
  EXPECT_THAT(said(), AllOf(HasSubstr("run.json: detector"), HasSubstr(kPlugins + "fake_works.so"),
                            HasSubstr("--trust-run")));
  EXPECT_EQ(mirage("evaluate --random-meshes 0 --trust-run" + run), 0) << said();
  EXPECT_EQ(mirage("evaluate --random-meshes 0 --detector " + kPlugins + "fake_works.so --weights " +
                   at("some.weights") + run),
            0)
      << said();
  EXPECT_EQ(mirage("view" + run), 2);
  expect_line("view");
  EXPECT_EQ(mirage("view --trust-run" + run), 0) << said();
  // The attack resumes with the settings of the command line, whatever run.json says now.
  change("depth", planted);
  change("detector", planted);
  EXPECT_EQ(mirage("attack --quiet --iterations 3 --min-view 0 --rooftop box --detector " + kPlugins +
                   "fake_works.so --weights " + at("some.weights") + " --data " + at("data") + " --out " +
                   at("run")),
            0)
      << said();
  EXPECT_FALSE(marked());

  for (const char* key : {"depth", "sensors", "detector"}) {
    change("depth", "ip-basic");
    change("detector", "fusion");
    change("weights", "");
    change("sensors", "");
    change(key, planted);
    for (const std::string& command : std::vector<std::string>{"export", "evaluate", "validate", "tradeoff",
                                                               "view", "evaluate --hosts-of " + at("run")}) {
      const bool needs_it = std::string(key) != "detector" || (command != "export" && command != "tradeoff");
      if (!needs_it) continue;
      EXPECT_EQ(mirage(command + run), 2) << command << " " << said();
      expect_line(command);
      EXPECT_THAT(said(), AllOf(HasSubstr(std::string("run.json: ") + key), HasSubstr(planted))) << command;
      EXPECT_FALSE(marked()) << command << " loaded the run's " << key;
    }
  }
  // Checks the marker itself: where the user allows it, the library is loaded, and fails as it is no plugin.
  change("detector", "fusion");
  change("depth", planted);
  for (const std::string& command : std::vector<std::string>{
           "export --trust-run", "view --no-detector --trust-run", "view --no-detector --depth " + planted}) {
    fs::remove(folder_ / "mark");
    EXPECT_EQ(mirage(command + run), 2) << command;
    EXPECT_TRUE(marked()) << command;
  }
}

// A configuration holds settings, which people pass on; code is named on the command line.
TEST_F(ForeignRuns, ConfigurationsRunNoCodeThatTheyName) {
  make_run();
  const std::string planted = kPlugins + "planted.so", at_data = " --data " + at("data"),
                    at_run = " --run " + at("run"),
                    to = " --quiet --out " + at("o") + " --config " + at("c.toml");
  write_file(folder_ / "model.pt", "weights");
  const std::string model = "weights = \"" + at("model.pt") + "\"\n";
  for (const auto& [command, key, text] : std::vector<std::array<std::string, 3>>{
           {"detect" + at_data, "detector", "detector = \"" + planted + "\""},
           {"attack" + at_data, "depth", "depth = \"" + planted + "\""},
           {"export" + at_run, "depth", "depth = \"" + planted + "\""},
           {"attack" + at_data, "sensors", "sensors = \"radar," + planted + "\""},
           {"depth" + at_data, "backends", "backends = \"ip-basic," + planted + "\""},
           {"detect" + at_data, "weights", model + "detector = \"torchscript\""},
           {"detect --detector torchscript" + at_data, "weights", model},
           {"depth --backends " + planted + at_data, "weights", model},
           {"evaluate" + at_run, "weights", model},
           {"train --detector camera" + at_data, "start", "start = \"" + at("model.pt") + "\""},
           {"evaluate" + at_run, "trust-run", "trust-run = true"}}) {
    write_file(folder_ / "c.toml", text + "\n");
    EXPECT_EQ(mirage(command + to), 2) << command;
    expect_line(command);
    EXPECT_THAT(said(),
                AllOf(HasSubstr("c.toml: " + key + ": "), HasSubstr("on the command line: --" + key)));
    EXPECT_FALSE(marked()) << command;
  }
  // A configuration may name data. A library from the command line is loaded, whatever the file says.
  write_file(folder_ / "c.toml", model + "detector = \"lidar\"\nframes = 1\n");
  EXPECT_EQ(mirage("detect" + at_data + to), 2);
  EXPECT_THAT(said(), AllOf(HasSubstr("model.pt"), Not(HasSubstr("c.toml"))));
  write_file(folder_ / "c.toml", "detector = \"" + planted + "\"\n");
  EXPECT_EQ(mirage("detect --detector " + planted + " --weights " + at("model.pt") + at_data + to), 2);
  EXPECT_TRUE(marked());
}

TEST_F(ForeignRuns, WithARoofFinderOfAnyLengthAreRefusedInALine) {
  make_run();
  for (const std::size_t length : {300u, 5000u, 100'000u}) {
    change("rooftop", std::string(length, 'r'));
    for (const char* command : {"export", "evaluate --trust-run", "validate --trust-run", "tradeoff"}) {
      EXPECT_EQ(mirage(std::string(command) + " --quiet --run " + at("run") + " --out " + at("o")), 2)
          << command;
      expect_line(command);
      EXPECT_THAT(said(), HasSubstr("run.json: rooftop: is too long")) << command;
      EXPECT_LT(said().size(), 1000) << command;
    }
  }
}

TEST_F(ForeignRuns, WriteNowhereElse) {
  make_run();
  for (const char* split : {"train", "test"}) {
    auto changed = json("run/run.json");
    changed[split][0]["frame"] = "../escaped";
    write_json(folder_ / "run/run.json", changed);
  }
  EXPECT_EQ(mirage("export --quiet --run " + at("run") + " --out " + at("o/deep")), 2);
  expect_line("export");
  EXPECT_THAT(said(), HasSubstr("holds a separator"));
  write_file(folder_ / "data/dataset.json", "{\"rig\": \"../../../../etc/rig\"}");
  EXPECT_EQ(mirage("detect --quiet --data " + at("data") + " --out " + at("o")), 2);
  expect_line("detect");
  EXPECT_THAT(said(), HasSubstr("dataset.json: rig"));
}

TEST_F(ForeignRuns, AnOutputFolderInUseNamesItsHolder) {
  fs::create_directories(folder_ / "o");
  write_file(folder_ / "o/.mirage-lock", "process 4242 on elsewhere since yesterday\n");
  const std::string command = kSmall + "1 --quiet --out " + at("o");
  const int held = open(at("o/.mirage-lock").c_str(), O_RDWR | O_CLOEXEC);
  ASSERT_EQ(flock(held, LOCK_EX), 0);
  EXPECT_EQ(mirage(command), 1);
  expect_line("generate");
  EXPECT_THAT(said(), AllOf(HasSubstr(at("o")), HasSubstr("process 4242 on elsewhere"), HasSubstr("--out")));
  EXPECT_FALSE(exists("o/dataset.json"));
  close(held);  // as the kernel does it for a killed process
  write_file(folder_ / "o/cut.png.mirage-999999999.tmp", "half");
  EXPECT_EQ(mirage(command), 0) << said();
  EXPECT_TRUE(exists("o/result.json"));
  EXPECT_FALSE(exists("o/.mirage-lock"));
  EXPECT_FALSE(exists("o/cut.png.mirage-999999999.tmp"));
  // A page is written into a folder with other files; it does not clean up files deeper in that folder.
  write_file(folder_ / ".mirage-lock", "process 4242 on elsewhere since yesterday\n");
  const std::string view = "view --quiet --data " + at("o") + " --out " + at("page.html");
  const int beside = open(at(".mirage-lock").c_str(), O_RDWR | O_CLOEXEC);
  ASSERT_EQ(flock(beside, LOCK_EX), 0);
  EXPECT_EQ(mirage(view), 1);
  expect_line("view");
  EXPECT_THAT(said(), AllOf(HasSubstr("process 4242 on elsewhere"), HasSubstr("--out")));
  EXPECT_FALSE(exists("page.html"));
  close(beside);
  const std::string dead = "page.html.mirage-999999999.tmp", deeper = "o/" + dead;
  for (const std::string& name : {dead, deeper}) write_file(folder_ / name, "half");
  EXPECT_EQ(mirage(view), 0) << said();
  EXPECT_TRUE(exists("page.html"));
  EXPECT_TRUE(exists("page.result.json"));
  EXPECT_FALSE(exists(".mirage-lock"));
  EXPECT_FALSE(exists(dead));
  EXPECT_TRUE(exists(deeper));
}

TEST_F(ForeignRuns, AnEditedRigDoesNotJoinAnOldSet) {
  const std::string rig = read_file(fs::path(MIRAGE_SOURCE) / "tests/faults/small-rig.toml");
  const auto generate = [&](const std::string& frames) {
    return mirage("generate --quiet --rig " + at("mine.toml") + " --frames " + frames + " --out " + at("d"));
  };
  write_file(folder_ / "mine.toml", rig);
  ASSERT_EQ(generate("1"), 0) << said();
  const std::size_t width = rig.find("width = ");
  ASSERT_NE(width, std::string::npos);
  std::string edited = rig;
  edited.insert(rig.find_first_of("0123456789", width) + 1, "0");
  write_file(folder_ / "mine.toml", edited);
  EXPECT_EQ(generate("2"), 2);
  expect_line("generate");
  EXPECT_THAT(said(), AllOf(HasSubstr("rig.toml"), HasSubstr("--out")));
  EXPECT_FALSE(exists("d/training/velodyne/000001.bin"));
  write_file(folder_ / "mine.toml", "# a comment is no other rig\n" + rig);
  EXPECT_EQ(generate("2"), 0) << said();
  // A set without its rig file is damaged; one that was stopped before dataset.json resumes.
  fs::rename(folder_ / "d/rig.toml", folder_ / "kept.toml");
  write_file(folder_ / "mine.toml", edited);
  EXPECT_EQ(generate("3"), 2);
  expect_line("generate");
  EXPECT_THAT(said(), AllOf(HasSubstr("rig.toml"), HasSubstr("is missing"), HasSubstr("--out")));
  EXPECT_FALSE(exists("d/rig.toml"));
  fs::rename(folder_ / "kept.toml", folder_ / "d/rig.toml");
  fs::remove(folder_ / "d/dataset.json");
  EXPECT_EQ(generate("3"), 2);
  write_file(folder_ / "mine.toml", rig);
  EXPECT_EQ(generate("3"), 0) << said();
  EXPECT_TRUE(exists("d/dataset.json"));
}

// SIGXFSZ would end the process without a message.
TEST_F(ForeignRuns, ALimitOnTheSizeOfFilesIsOneLine) {
  EXPECT_EQ(shell("ulimit -f 8; " + command(kSmall + "1 --quiet --out " + at("o"))), 1);
  expect_line("generate");
  EXPECT_THAT(said(), HasSubstr("ulimit -f"));
}

TEST_F(ForeignRuns, NamesOfAnyBytesAreShownEscaped) {
  const std::string odd = (folder_ / "\xff\x1b[31m").string();
  ASSERT_EQ(mirage(kSmall + "1 --out '" + odd + "'"), 0) << said();
  EXPECT_THAT(said(), AllOf(HasSubstr("\\xff\\x1b[31m"), Not(HasSubstr("\xff"))));
  for (const char* part : {"image_2", "velodyne", "calib", "label_2", "lighting"})
    for (const auto& entry : fs::directory_iterator(fs::path(odd) / "training" / part))
      fs::rename(entry.path(), entry.path().parent_path() / ("\xe8" + entry.path().extension().string()));
  write_file(folder_ / "w", "weights");
  const std::string detect = "detect --detector " + kPlugins + "fake_works.so --weights " + at("w");
  ASSERT_EQ(mirage(detect + " --data '" + odd + "' --out '" + odd + "/o'"), 0) << said();
  EXPECT_EQ(read_json(fs::path(odd) / "o/detections.json").at("frames").at(0).at("frame"), "\\xe8");
  ASSERT_EQ(mirage("view --data '" + odd + "' --out '" + odd + "/page.html'"), 0) << said();
  EXPECT_THAT(said(), AllOf(HasSubstr("\\xff\\x1b[31m/page.html"), Not(HasSubstr("\xff"))));
  EXPECT_THAT(read_file(fs::path(odd) / "page.html"), HasSubstr(R"("frames":["\\xe8"])"));
  ASSERT_EQ(mirage("simulate --frame missing --mesh m.glb --data '" + odd + "' --out '" + odd + "/o'"), 2);
  expect_line("simulate");
  // Blender gets its file names in JSON.
  for (const char* command : {"tradeoff --cycles --data ", "tradeoff --cycles --run none --data "}) {
    EXPECT_EQ(mirage(command + at("none") + " --out '" + odd + "'"), 2);
    expect_line(command);
    EXPECT_THAT(said(), AllOf(HasSubstr("--out"), HasSubstr("UTF-8"))) << command;
  }
  EXPECT_EQ(mirage("detect --data '" + odd + "/none' --out " + at("o")), 2);
  expect_line("detect");
  EXPECT_THAT(said(), HasSubstr("\\xff\\x1b[31m/none"));
}

// libpng would print its own line.
TEST_F(ForeignRuns, ADamagedPictureIsOneLine) {
  ASSERT_EQ(mirage(kSmall + "1 --quiet --out " + at("data")), 0) << said();
  const fs::path picture = folder_ / "data/training/image_2/000000.png";
  std::string bytes = read_file(picture);
  for (const std::string& damaged : {bytes.substr(0, 2000), bytes.substr(0, bytes.size() / 2) + "x" +
                                                                bytes.substr(bytes.size() / 2 + 1)}) {
    write_file(picture, damaged);
    write_file(folder_ / "w", "weights");
    EXPECT_EQ(mirage("detect --quiet --detector " + kPlugins + "fake_works.so --weights " + at("w") +
                     " --data " + at("data") + " --out " + at("o")),
              2);
    expect_line("detect");
    EXPECT_THAT(said(), HasSubstr("000000.png"));
  }
}

}  // namespace
}  // namespace mirage
