// `mirage reproduce` runs only missing steps: finished steps, their records, and steps that fail.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <set>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "support/files.h"
#include "validation/paper/reproduce.h"
#include "validation/paper_fixture.h"

namespace mirage::paper {
namespace {

namespace fs = std::filesystem;
using mirage::test::PaperProgram;
using mirage::test::settings_in;
using mirage::test::TemporaryFolder;
using nlohmann::json;
using testing::HasSubstr;

TEST(Reproduce, FinishedStepsAreNotRunAgain) {
  TemporaryFolder folder;
  PaperProgram program;
  reproduce(settings_in(folder.path(), "table1"), std::ref(program));
  EXPECT_EQ(program.calls.size(), 9u);  // data, four attacks, four evaluations
  program.calls.clear();
  const json again = reproduce(settings_in(folder.path(), "table1"), std::ref(program));
  EXPECT_TRUE(program.calls.empty());
  EXPECT_TRUE(again.at("tables").at(0).at("rows").at(4).at("values").contains("asr"));
  // A run with another adversary: only its evaluations are out of date.
  write_file(folder / "runs/kitti64-fusion-image/adversary.glb", "another");
  reproduce(settings_in(folder.path(), "table1"), std::ref(program));
  ASSERT_EQ(program.calls.size(), 1u);
  EXPECT_EQ(program.calls[0].command, "evaluate");
  program.calls.clear();
  // With other settings, every step that depends on them runs again.
  ReproduceSettings longer = settings_in(folder.path(), "table1");
  longer.iterations = 500;
  reproduce(longer, std::ref(program));
  EXPECT_EQ(program.calls.size(), 5u);  // the attacks, and the evaluation of the one mesh that changed
}

TEST(Reproduce, ACommandIsGivenItsSettingsAndTheFoldersThatItNeeds) {
  TemporaryFolder folder;
  PaperProgram program;
  ReproduceSettings settings = settings_in(folder.path(), "table3");
  settings.threads = 5;
  const Experiments list = experiments(settings);
  execute(list, settings, std::ref(program));
  const std::string name = "evaluations/xenith-fusion-both--on--kitti64-fusion-both";
  const auto of_it = [&](const PaperProgram::Call& call) { return call.settings.at("out") == folder / name; };
  const auto call = std::find_if(program.calls.begin(), program.calls.end(), of_it);
  ASSERT_NE(call, program.calls.end());
  EXPECT_EQ(call->command, "evaluate");
  EXPECT_EQ(call->settings, (NamedSettings{{"run", folder / "runs/xenith-fusion-both"},
                                           {"hosts_of", folder / "runs/kitti64-fusion-both"},
                                           {"random_meshes", "1"},
                                           {"baseline", "sized"},
                                           {"out", folder / name},
                                           {"threads", "5"},
                                           {"quiet", "true"}}));
}

TEST(Reproduce, ARecordOfAnotherSettingIsNotTaken) {
  TemporaryFolder folder;
  PaperProgram program;
  std::set<std::string> tried;  // one entry per command and setting: hashing weights each time is slow
  for (const char* what : {"table3", "table4", "fig4", "fusions"}) {
    ReproduceSettings settings = settings_in(folder.path(), what);
    settings.real = folder / "real";
    settings.seeds = 2;
    settings.quick = true;
    const Experiments list = experiments(settings);
    execute(list, settings, std::ref(program));
    for (const Case& command : list.cases) {
      const auto is_new = [&](const std::string& setting) {
        return tried.insert(std::string(to_word(command.kind)) + " " + setting).second;
      };
      const auto expect_other = [&](const std::string& setting, const Case& other) {
        EXPECT_FALSE(is_finished(other, folder.path())) << command.name << ": " << setting;
      };
      for (const auto& [setting, value] : command.settings) {
        if (!is_new(setting)) continue;
        EXPECT_TRUE(is_finished(command, folder.path())) << command.name;
        Case other = command;
        other.settings[setting] += "1";
        expect_other(setting, other);
        other.settings.erase(setting);
        expect_other(setting, other);
      }
      for (std::size_t i = 0; i < command.needs.size(); ++i) {
        if (!is_new("needs " + command.needs[i].first)) continue;
        // The same content in another case's folder.
        const fs::path twin = folder / (command.needs[i].second + "-twin");
        fs::copy(folder / command.needs[i].second, twin,
                 fs::copy_options::recursive | fs::copy_options::overwrite_existing);
        Case other = command;
        other.needs[i].second += "-twin";
        expect_other(command.needs[i].first, other);
      }
    }
  }
  EXPECT_THAT(
      tried,
      testing::UnorderedElementsAre(
          "generate rig", "generate frames", "generate seed", "attack needs data", "attack data",
          "attack detector", "attack target", "attack iterations", "attack batch", "attack vertex_rate",
          "attack texel_rate", "attack free", "attack fp_top_k", "attack lidar_gradient", "attack seed",
          "attack size", "attack defense", "evaluate needs run", "evaluate needs hosts_of", "evaluate data",
          "evaluate detector", "evaluate random_meshes", "evaluate baseline", "evaluate pictures",
          "evaluate seed", "detect needs data", "detect detector", "detect defense"));
}

TEST(Reproduce, ARecordOfAnOlderVersionIsNotTaken) {
  TemporaryFolder folder;
  PaperProgram program;
  const ReproduceSettings settings = settings_in(folder.path(), "table1");
  const Experiments list = experiments(settings);
  execute(list, settings, std::ref(program));
  const Case& data = list.at("data/kitti64");
  EXPECT_TRUE(is_finished(data, folder.path()));
  write_json(folder / "steps/data_kitti64.json",
             {{"case", data.name},
              {"arguments", {"generate", "--rig", "kitti64", "--frames", "120", "--seed", "3"}},
              {"inputs", json::object()},
              {"seconds", 1}});
  EXPECT_FALSE(is_finished(data, folder.path()));
}

TEST(Reproduce, TheFolderMayBeMoved) {
  TemporaryFolder folder;
  PaperProgram program;
  ReproduceSettings settings = settings_in(folder / "here", "table1");
  settings.kitti64 = folder / "data";
  reproduce(settings, std::ref(program));
  fs::rename(folder / "here", folder / "there");
  program.calls.clear();
  settings.out = folder / "there";
  reproduce(settings, std::ref(program));
  EXPECT_TRUE(program.calls.empty());
}

TEST(Reproduce, AKilledStepIsRunAgain) {
  TemporaryFolder folder;
  PaperProgram program;
  reproduce(settings_in(folder.path(), "table1"), std::ref(program));
  fs::remove(folder / "evaluations/kitti64-fusion-lidar/result.json");
  program.calls.clear();
  reproduce(settings_in(folder.path(), "table1"), std::ref(program));
  ASSERT_EQ(program.calls.size(), 1u);
  EXPECT_EQ(program.calls[0].settings.at("out"), folder / "evaluations/kitti64-fusion-lidar");
}

TEST(Reproduce, AFailingStepStaysInTheTable) {
  TemporaryFolder folder;
  PaperProgram program;
  program.broken = "runs/kitti64-fusion-image";
  const json result = reproduce(settings_in(folder.path(), "table1"), std::ref(program));
  const json& rows = result.at("tables").at(0).at("rows");
  EXPECT_THAT(rows.at(3).at("error").get<std::string>(), HasSubstr("made to fail"));
  EXPECT_TRUE(rows.at(3).at("values").empty());
  EXPECT_TRUE(rows.at(4).at("values").contains("asr"));  // the other values are kept
  EXPECT_THAT(read_file(folder / "table1.md"), HasSubstr("made to fail"));
  program.broken.clear();
  program.calls.clear();
  reproduce(settings_in(folder.path(), "table1"), std::ref(program));
  EXPECT_EQ(program.calls.size(), 2u);  // the run and its evaluation
}

TEST(Reproduce, ADamagedResultIsNamedByFileAndField) {
  TemporaryFolder folder;
  PaperProgram program;
  reproduce(settings_in(folder.path(), "table4"), std::ref(program));
  const fs::path judged = folder / "evaluations/kitti64-fusion-both/result.json",
                 scored = folder / "detect/kitti64-fusion/result.json";
  json evaluation = read_json(judged), detection = read_json(scored);
  evaluation["sized"]["outcomes"][7]["clean_iou"] = "much";
  detection["ap70_interval"] = {{"value", 0.8}, {"low", 0.7}};
  write_json(judged, evaluation);
  write_json(scored, detection);
  EXPECT_THAT(test::error_text<InputError>([&] { read_evaluation(judged, "data"); }),
              testing::AllOf(HasSubstr(judged.string()), HasSubstr("sized.outcomes[7].clean_iou")));
  EXPECT_THAT(test::error_text<InputError>([&] { read_detection(scored); }),
              testing::AllOf(HasSubstr(scored.string()), HasSubstr("ap70_interval.high")));
  program.calls.clear();
  const json result = reproduce(settings_in(folder.path(), "table4"), std::ref(program));
  EXPECT_TRUE(program.calls.empty());
  const json& rows = result.at("tables").at(0).at("rows");
  EXPECT_THAT(rows.at(0).at("error").get<std::string>(), HasSubstr("sized.outcomes[7].clean_iou"));
  EXPECT_TRUE(rows.at(1).at("values").contains("asr"));  // the other values are kept
}

TEST(Reproduce, AnInterruptEndsIt) {
  TemporaryFolder folder;
  const auto interrupted = [](const std::string&, const NamedSettings&) { throw Interrupted("stopped"); };
  EXPECT_THROW(reproduce(settings_in(folder.path(), "table1"), interrupted), Interrupted);
}

}  // namespace
}  // namespace mirage::paper
