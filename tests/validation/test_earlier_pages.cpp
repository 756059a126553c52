// Pages and plots of an earlier run are removed when a new result does not include them.
#include <cstdlib>
#include <string>
#include <vector>

#include "attack/tiny_world.h"
#include "cli/command.h"
#include "cli/program.h"
#include "validation/tradeoff/tradeoff.h"

namespace mirage {
namespace {

/// During its lifetime every Python that this process starts fails.
struct BrokenPython {
  BrokenPython() { ::setenv("PYTHONHOME", "/nonexistent", 1); }
  ~BrokenPython() { ::unsetenv("PYTHONHOME"); }
};

/// A command whose answer is in its folder.
struct Answering {};
void add_options(CLI::App& /*app*/, Answering& /*options*/) {}
nlohmann::json run(const Answering& /*options*/, const cli::Common& common) {
  return read_json(common.out / "answer.json");
}

class EarlierPages : public test::Program {
 protected:
  void write(const std::string& name) const { write_file(folder_ / name, "an earlier run's"); }
};

TEST_F(EarlierPages, OfPicturesThoseStayThatTheAnswerLists) {
  cli::Common common;
  common.out = folder_ / "out";
  write_json(
      common.out / "result.json",
      {{"plots", {"a.png", "b.png", "../c.png"}}, {"pictures", {"d.png", "e.png"}}, {"files", {"f.png"}}});
  write_json(common.out / "answer.json", {{"plots", {"b.png"}}, {"pictures", {"d.png"}}});
  const std::vector<std::string> staying = {"out/b.png", "c.png",     "out/pictures/d.png",
                                            "out/d.png", "out/e.png", "out/f.png"};
  for (const std::string& name : staying) write(name);
  write("out/a.png");
  write("out/pictures/e.png");
  cli::command_of<Answering>({.name = "answering"}).run(common);
  EXPECT_FALSE(exists("out/a.png"));
  EXPECT_FALSE(exists("out/pictures/e.png"));
  for (const std::string& name : staying) EXPECT_TRUE(exists(name)) << name;
}

TEST_F(EarlierPages, OfACommandGoWherePythonFails) {
  const BrokenPython broken;
  write_json(folder_ / "result.json", {{"audit", nlohmann::json::array()}});
  for (const char* page : {"audit.html", "score.html", "mine.html"}) write(page);
  cli::write_page(folder_.path());
  EXPECT_FALSE(exists("audit.html"));
  EXPECT_FALSE(exists("score.html"));
  EXPECT_TRUE(exists("mine.html"));
}

TEST_F(EarlierPages, OfAStudyGoWherePythonFails) {
  test::write_tiny_data(folder_ / "data", 1, true);
  for (const char* file : {"out/tradeoff.html", "out/tradeoff.png", "out/tradeoff.svg"}) write(file);
  TradeoffSettings settings;
  settings.overrides["data"] = at("data");
  settings.overrides["rooftop"] = "box";
  settings.out = folder_ / "out";
  settings.hosts = settings.frames = settings.repeats = 1;
  settings.reference_samples = settings.sharp_samples = 2;
  settings.directions = 4;
  settings.grid = false;
  settings.depth_frames = settings.detector_hosts = 0;
  settings.quiet = true;
  const BrokenPython broken;
  const TradeoffResult result = tradeoff(settings);
  ASSERT_TRUE(result.plots);
  EXPECT_TRUE(result.plots->empty());
  EXPECT_TRUE(exists("out/tradeoff.json"));
  for (const char* file : {"out/tradeoff.html", "out/tradeoff.png", "out/tradeoff.svg"})
    EXPECT_FALSE(exists(file)) << file;
}

TEST_F(EarlierPages, OfDetectAndOfAuditGo) {
  ASSERT_EQ(mirage("generate --frames 1 --seed 5 --quiet --out " + at("data")), 0) << said();
  const std::string of_data = " --detector clusters --data " + at("data") + " --out ";
  write("audit/audit.html");
  ASSERT_EQ(mirage("audit --gate" + of_data + at("audit")), 0) << said();
  EXPECT_FALSE(exists("audit/audit.html"));
  ASSERT_EQ(mirage("detect" + of_data + at("detect")), 0) << said();
  if (json("detect/result.json").at("plots").empty()) GTEST_SKIP() << "no plot was drawn: " << said();
  ASSERT_TRUE(exists("detect/precision_recall.png"));
  environment_ = "PYTHONHOME=/nonexistent";
  ASSERT_EQ(mirage("detect" + of_data + at("detect")), 0) << said();
  EXPECT_TRUE(json("detect/result.json").at("plots").empty());
  EXPECT_FALSE(exists("detect/precision_recall.png"));
  EXPECT_FALSE(exists("detect/precision_recall.svg"));
  EXPECT_TRUE(exists("detect/precision_recall.json"));
}

}  // namespace
}  // namespace mirage
