// What a kept vehicle's result depends on: with anything else it is made again.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <set>

#include "attack/tiny_world.h"
#include "base/files.h"
#include "base/image_io.h"
#include "support/each_field.h"
#include "support/files.h"
#include "validation/blender/blender_process.h"
#include "validation/fidelity/validate.h"
#include "validation/tradeoff/settings.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// A run on two tiny frames and a plugin and weights of its own, as validate() completes them.
struct Judged {
  explicit Judged(const fs::path& at) : folder(at) {
    test::write_tiny_data(folder / "data", 2);
    fs::create_directories(folder / "run");
    write_file(folder / "run/adversary.glb", "mesh");
    write_file(folder / "weights", "weights");
    fs::copy_file(MIRAGE_BUILD "/test_plugins/fake_works.so", folder / "fake.so");
    run.settings.data = folder / "data";
    run.settings.rooftop = "box";
    settings.run = folder / "run";
    settings.detector.detector = folder / "fake.so";
    settings.detector.weights = folder / "weights";
    settings.detector.defense = "none";
    settings.detector.precision = kFloat;
    settings.detector.locality = 0;
  }
  std::string key(const std::string& blender = "3.4") const {
    return validation_key(settings, run, "000000",
                          {"blender", "Blender Cycles", blender, renderer_programs()});
  }
  fs::path folder;
  ValidationSettings settings;
  ::mirage::Run run;
};

TEST(ValidationKey, ChangesWithEverySettingThatAResultDependsOn) {
  const test::TemporaryFolder folder;
  const Judged judged(folder.path());
  std::set<std::string> keys = {judged.key()};
  EXPECT_EQ(*keys.begin(), judged.key());
  // Those of frames, simulation and detector; paths count by what they lead to (below).
  const auto differs = [&](const Judged& other, const char* what, bool matters = true) {
    EXPECT_EQ(keys.insert(other.key()).second, matters) << what;
  };
  int fields = 0;
  const auto change_each = [&](auto part) {
    fields += test::for_each_field(part(judged), [&](auto& changed, const Field& field, auto& value, bool,
                                                     const char*) {
      if (std::is_same_v<std::decay_t<decltype(value)>, fs::path> || std::string(field.name) == "detector")
        return;
      test::change(field, value);
      if constexpr (std::is_same_v<std::decay_t<decltype(value)>, std::string>) {
        if (std::string(field.name) == "depth") value = "ip-basic-bilateral";
        if (std::string(field.name) == "rooftop") value = "shape";
        if (std::string(field.name) == "rig") value = "xenith";
      }
      Judged other = judged;
      part(other) = changed;
      differs(other, field.name, field.matters);
    });
  };
  change_each([](auto& j) -> auto& { return as_base<FrameSource>(j.run.settings); });
  change_each([](auto& j) -> auto& { return j.run.settings.simulation; });
  change_each([](auto& j) -> auto& { return j.settings.detector; });
  EXPECT_GT(fields, 45);
  const auto changed = [&](const char* what, const auto& change) {
    Judged other = judged;
    change(other);
    differs(other, what);
  };
  changed("samples", [](Judged& j) { ++j.settings.samples; });
  changed("noise", [](Judged& j) { j.settings.noise = 0.05; });
  changed("seed", [](Judged& j) { ++j.settings.seed; });
  changed("score", [](Judged& j) { j.settings.evaluation_settings.score_threshold = 0.5; });
  changed("IoU", [](Judged& j) { j.settings.evaluation_settings.detected_iou = 0.5; });
  EXPECT_TRUE(keys.insert(judged.key("3.5")).second) << "Blender";
}

TEST(ValidationKey, ChangesWithTheContentOfEveryInputAndNotWithItsPlace) {
  const test::TemporaryFolder folder;
  const fs::path here = folder / "here", there = folder / "there";
  const Judged judged(here);
  const std::string before = judged.key();
  for (const char* input : {"run/adversary.glb", "weights", "fake.so", "data/training/image_2/000000.png",
                            "data/training/velodyne/000000.bin", "data/training/label_2/000000.txt",
                            "data/training/calib/000000.txt"}) {
    const std::string bytes = read_file(here / input);
    std::string other = bytes;
    if (fs::path(input).extension() == ".bin")
      other[12] ^= 1;  // a return's reflectance
    else if (fs::path(input).extension() == ".png")
      write_srgb(here / input, ImageF(248, 75, 3, 0.31f));
    else
      other += "\n";
    if (fs::path(input).extension() != ".png") write_file(here / input, other);
    EXPECT_NE(judged.key(), before) << input;
    write_file(here / input, bytes);
    EXPECT_EQ(judged.key(), before) << input;
  }
  write_file(here / "data/training/track_2/000000.txt", "4\n");
  EXPECT_NE(judged.key(), before) << "who the vehicle is";
  fs::remove(here / "data/training/track_2/000000.txt");
  write_file(here / "data/training/velodyne/000001.bin", "");
  EXPECT_EQ(judged.key(), before) << "another frame's";
  fs::remove_all(here / "data/training/track_2");
  const Judged moved(there);
  EXPECT_EQ(moved.key(), before);
}

TEST(Tradeoff, EachSettingChangesTheIdentity) {
  const test::TemporaryFolder folder;
  test::expect_identity_follows(TradeoffSettings(), folder.path());
}

TEST(ValidationKey, ChangesWithThePythonThatMakesTheLight) {
  const test::TemporaryFolder folder;
  const Judged judged(folder.path());
  // The worker's imports from the package are among the programs that count.
  std::set<std::string> names;
  for (const fs::path& file : renderer_programs()) names.insert(file.filename().string());
  for (const char* needed : {"blender_worker.py", "physical_light.py", "cycles_light.py", "scene_import.py",
                             "camera.py", "paint.py"})
    EXPECT_TRUE(names.contains(needed)) << needed;
  const fs::path home = folder / "home";
  for (const fs::path& file : renderer_programs()) {
    const fs::path name = file.filename();
    const bool worker = name == "blender_worker.py" || name == "physical_light.py";
    const fs::path to = home / (worker ? "validation" : "plugins/blender/mirage_blender");
    fs::create_directories(to);
    write_file(to / name, read_file(file));
  }
  fs::create_directory_symlink(MIRAGE_SOURCE "/scenes", home / "scenes");
  ::setenv("MIRAGE_HOME", home.c_str(), 1);
  const std::string before = judged.key();
  std::set<std::string> keys = {before};
  for (const fs::path& file : renderer_programs()) {
    const std::string text = read_file(file);
    write_file(file, text + "# edited\n");
    EXPECT_TRUE(keys.insert(judged.key()).second) << file;
    write_file(file, text);
  }
  EXPECT_EQ(judged.key(), before);
  ::setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
}

}  // namespace
}  // namespace mirage
