// The Blender worker when Blender dies, hangs or fails again and again.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <cstdlib>
#include <thread>

#include "base/files.h"
#include "fixture.h"
#include "support/files.h"

namespace mirage {
namespace {

using ::testing::HasSubstr;

/// A program that answers a ping and then does `otherwise` at any other job.
std::string stand_in(const test::TemporaryFolder& folder, const std::string& otherwise) {
  const std::string file = folder / "stand-in";
  write_file(file,
             "#!/bin/sh\nwhile read -r line; do\n  case \"$line\" in\n    *'\"ping\"'*)\n"
             "      id=$(echo \"$line\" | sed 's/.*\"id\":\\([0-9]*\\).*/\\1/')\n"
             "      echo \"{\\\"id\\\":$id,\\\"ok\\\":true,\\\"version\\\":\\\"none\\\"}\" ;;\n    *) " +
                 otherwise + " ;;\n  esac\ndone\n");
  std::filesystem::permissions(file, std::filesystem::perms::owner_all);
  return file;
}

TEST(Worker, AJobThatAlwaysKillsItIsGivenUpAndTheNextOneGoesOn) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const test::TemporaryFolder folder;
  BlenderWorker worker(folder / "log", stand_in(folder, "exit 3"));
  try {
    worker.request({{"job", "render"}}, 5);
    ADD_FAILURE();
  } catch (const BlenderLost& lost) {
    EXPECT_THAT(lost.what(), HasSubstr("ended unexpectedly, 3 times on one job (render)"));
  }
  ASSERT_EQ(worker.losses().size(), 3u);
  EXPECT_EQ(worker.losses()[2].attempt, 3);
  EXPECT_EQ(worker.restarts(), 3);
  EXPECT_EQ(worker.request({{"job", "ping"}}, 5).value("version", ""), "none");
}

TEST(Worker, OneThatHangsIsKilledAndTheJobIsSentAgain) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const test::TemporaryFolder folder;
  // Hangs at the first other job and answers it after that.
  const std::string mark = folder / "hung";
  BlenderWorker worker(
      folder / "log",
      stand_in(folder, "if [ -e " + mark +
                           " ]; then id=$(echo \"$line\" | sed 's/.*\"id\":\\([0-9]*\\).*/\\1/'); "
                           "echo \"{\\\"id\\\":$id,\\\"ok\\\":true}\"; else touch " +
                           mark + "; sleep 60; fi"));
  EXPECT_TRUE(worker.request({{"job", "render"}}, 1).value("ok", false));
  ASSERT_EQ(worker.losses().size(), 1u);
  EXPECT_EQ(worker.losses()[0].how, "gave no answer in 1 s");
  EXPECT_EQ(worker.losses()[0].job, "render");
}

TEST(Worker, BlenderKilledInTheMiddleOfARenderIsStartedAgainAndThePictureIsTheSame) {
  if (find_program("blender").empty()) GTEST_SKIP() << "blender is not installed";
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const PreparedFrame prepared = test::made_up_frame();
  const HostScene scene = test::host_scene_of(prepared, test::random_mesh(2), "killed");
  BlenderWorker worker(test::scratch("killed-render.log"));
  RenderJob job = job_for(scene, {520, 120, 640, 200});
  job.effects = full_effects();
  job.samples = 4;
  const Rendered before = render(worker, job);
  EXPECT_FALSE(worker.request({{"job", "ping"}}, 10).value("runs_scripts", true));
  job.samples = 200;
  const Rendered whole = render(worker, job);
  const pid_t first = worker.pid();
  std::thread killer([&] {
    std::this_thread::sleep_for(std::chrono::duration<double>(0.5 * whole.seconds));
    kill(first, SIGKILL);
  });
  const Rendered again = render(worker, job);
  killer.join();
  EXPECT_NE(worker.pid(), first);
  EXPECT_EQ(worker.losses().size(), 1u);
  EXPECT_EQ(again.rgba.data, whole.rgba.data);
  EXPECT_EQ(again.catcher.data, whole.catcher.data);
  EXPECT_NE(again.rgba.data, before.rgba.data);
}

}  // namespace
}  // namespace mirage
