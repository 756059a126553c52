// What a kept vehicle's result depends on: with anything else it is made again.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <set>

#include "base/files.h"
#include "support/files.h"
#include "validation/blender/blender_process.h"
#include "validation/fidelity/validate.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// Settings as validate() completes them, in a folder with a mesh and weights.
ValidationSettings completed(const test::TemporaryFolder& folder) {
  fs::create_directories(folder / "run");
  write_file(folder / "run/adversary.glb", "mesh");
  write_file(folder / "weights", "weights");
  ValidationSettings settings;
  settings.run = folder / "run";
  settings.detector.detector = "fusion";
  settings.detector.weights = folder / "weights";
  settings.detector.defense = "none";
  return settings;
}

TEST(ValidationKey, ChangesWithEveryThingThatAResultDependsOn) {
  const test::TemporaryFolder folder;
  const ValidationSettings settings = completed(folder);
  ::mirage::Run run;
  run.settings.rooftop = "box";
  std::set<std::string> keys = {validation_key(settings, run, "3.4")};
  EXPECT_EQ(*keys.begin(), validation_key(settings, run, "3.4"));
  std::size_t count = 1;
  const auto differs = [&](const char* what, const auto& change) {
    ValidationSettings other = settings;
    ::mirage::Run other_run = run;
    change(other, other_run);
    keys.insert(validation_key(other, other_run, "3.4"));
    EXPECT_EQ(keys.size(), ++count) << what;
  };
  using S = ValidationSettings;
  using R = ::mirage::Run;
  differs("JPEG before the same weights", [](S& s, R&) { s.detector.defense = "jpeg:50"; });
  differs("JPEG's quality", [](S& s, R&) { s.detector.defense = "jpeg:90"; });
  differs("detector", [](S& s, R&) { s.detector.detector = "late"; });
  differs("sun", [](S&, R& r) { r.settings.sun = "90,30"; });
  differs("depth", [](S&, R& r) { r.settings.depth = "ip-basic-bilateral"; });
  differs("rooftop", [](S&, R& r) { r.settings.rooftop = "shape"; });
  differs("samples", [](S& s, R&) { ++s.samples; });
  differs("noise", [](S& s, R&) { s.noise = 0.05; });
  differs("seed", [](S& s, R&) { ++s.seed; });
  differs("score", [](S& s, R&) { s.evaluation_settings.score_threshold = 0.5; });
  differs("light", [](S&, R& r) { r.settings.simulation.light = LightModel::visible; });
  differs("σ", [](S&, R& r) { r.settings.simulation.raster.sigma *= 2; });
  write_file(settings.detector.weights, "others");
  differs("content of the weights", [](S&, R&) {});
  write_file(settings.run / "adversary.glb", "other");
  differs("content of the mesh", [](S&, R&) {});
  keys.insert(validation_key(settings, run, "3.5"));
  EXPECT_EQ(keys.size(), ++count) << "Blender";
}

TEST(ValidationKey, ChangesWithThePythonThatMakesTheLight) {
  const test::TemporaryFolder folder;
  const ValidationSettings settings = completed(folder);
  ::mirage::Run run;
  run.settings.rooftop = "box";
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
  ::setenv("MIRAGE_HOME", home.c_str(), 1);
  const std::string before = validation_key(settings, run, "3.4");
  std::set<std::string> keys = {before};
  for (const fs::path& file : renderer_programs()) {
    const std::string text = read_file(file);
    write_file(file, text + "# edited\n");
    EXPECT_TRUE(keys.insert(validation_key(settings, run, "3.4")).second) << file;
    write_file(file, text);
  }
  EXPECT_EQ(validation_key(settings, run, "3.4"), before);
  ::unsetenv("MIRAGE_HOME");
}

}  // namespace
}  // namespace mirage
