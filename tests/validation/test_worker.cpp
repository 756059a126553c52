// The Blender worker when Blender dies, hangs or fails again and again.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <tuple>
#include <vector>

#include "base/error.h"
#include "base/files.h"
#include "fixture.h"
#include "support/files.h"
#include "validation/blender/blender_process.h"

namespace mirage {
namespace {

using ::testing::HasSubstr;

/// A program that answers a ping, and runs `otherwise` for any other job.
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
  } catch (const ReferenceLost& lost) {
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
  // Hangs at the first other job, and answers it after that.
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

/// The Failure that `work` throws (a ReferenceLost is one), and the time until then.
template <class Work>
std::pair<std::string, double> failure(const Work& work) {
  const auto start = std::chrono::steady_clock::now();
  std::string text = test::error_text<Failure>(work);
  return {std::move(text), std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count()};
}

TEST(Worker, TheDeadlineIsTheJobsAndNotALines) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const test::TemporaryFolder folder;
  // Each of these prints all the time and never answers; none can block the job. Only the last one runs into
  // the deadline; a busy machine needs a while to read an answer that is too long.
  for (const auto& [talk, how, deadline] :
       {std::tuple{"while :; do echo '{\"id\":0,\"ok\":true}'; sleep 0.1; done", "malformed answer", 20.0},
        std::tuple{"exec yes", "malformed answer", 20.0},
        std::tuple{"exec tr '\\\\0' x < /dev/zero", "an answer without end", 20.0},
        std::tuple{"exec sleep 100", "no answer in 0.5 s", 0.5}}) {
    BlenderWorker worker(folder / "log", stand_in(folder, talk));
    const auto [text, seconds] = failure([&] { worker.request({{"job", "render"}}, deadline); });
    EXPECT_THAT(
        text, testing::AllOf(HasSubstr(how), HasSubstr("3 times on one job"), testing::Not(HasSubstr("\n"))))
        << talk;
    EXPECT_LT(seconds, 3 * deadline + 10) << talk;
  }
}

TEST(Worker, OneThatNeverStopsTalkingWhileStartingIsGivenUp) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const test::TemporaryFolder folder;
  for (const char* script :
       {"#!/bin/sh\nexec yes\n", "#!/bin/sh\nwhile :; do echo Blender; sleep 0.1; done\n",
        "#!/bin/sh\nexec cat /dev/zero\n"}) {
    write_file(folder / "talker", script);
    std::filesystem::permissions(folder / "talker", std::filesystem::perms::owner_all);
    const auto [text, seconds] = failure([&] { BlenderWorker(folder / "log", folder / "talker", 0.7); });
    EXPECT_THAT(text, testing::AllOf(HasSubstr("talker: does not answer"), testing::Not(HasSubstr("\n"))))
        << script;
    EXPECT_LT(seconds, 10) << script;
  }
}

TEST(Worker, OneThatDiesWhileStartingIsStartedAgainButNotForEver) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const test::TemporaryFolder folder;
  const std::filesystem::path good = stand_in(folder, ":"), count = folder / "count";
  const auto dies = [&](int times) {
    write_file(folder / "dies", "#!/bin/sh\nn=$(cat " + count.string() + ")\necho $((n + 1)) > " +
                                    count.string() + "\n[ $n -lt " + std::to_string(times) +
                                    " ] && exit 11\nexec " + good.string() + "\n");
    std::filesystem::permissions(folder / "dies", std::filesystem::perms::owner_all);
    write_file(count, "0");
    return (folder / "dies").string();
  };
  {
    const BlenderWorker worker(folder / "log", dies(2), 20);
    EXPECT_EQ(worker.restarts(), 2);
    EXPECT_EQ(worker.version(), "none");
  }
  const auto [text, seconds] = failure([&] { BlenderWorker(folder / "log", dies(100), 20); });
  EXPECT_THAT(text, HasSubstr("ended unexpectedly while starting, 3 times"));
  EXPECT_EQ(read_file(count), "3\n");
}

TEST(Worker, AMalformedAnswerIsOneClearLine) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const test::TemporaryFolder folder;
  for (const char* answer :
       {"{\\\"id\\\":\\\"$id\\\",\\\"ok\\\":true}", "{\\\"id\\\":$id,\\\"ok\\\":\\\"yes\\\"}",
        "{\\\"id\\\":$id}", "[[[[", "null", "{\\\"id\\\":$id,", "$(printf '\\033[31m%500s')"}) {
    BlenderWorker worker(
        folder / "log",
        stand_in(folder, "id=$(echo \"$line\" | sed 's/.*\"id\":\\([0-9]*\\).*/\\1/'); echo \"" +
                             std::string(answer) + "\""));
    const auto [text, seconds] = failure([&] { worker.request({{"job", "render"}}, 20); });
    EXPECT_THAT(text, testing::AllOf(HasSubstr("gave a malformed answer ('"), testing::Not(HasSubstr("\n")),
                                     testing::Not(HasSubstr("\033"))))
        << answer;
    EXPECT_LT(text.size(), 300u + folder.path().string().size() * 2) << answer;
  }
  // An error that is not text, and missing seconds: neither is trusted.
  BlenderWorker worker(folder / "log",
                       stand_in(folder,
                                "id=$(echo \"$line\" | sed 's/.*\"id\":\\([0-9]*\\).*/\\1/'); "
                                "echo \"{\\\"id\\\":$id,\\\"ok\\\":false,\\\"error\\\":5}\""));
  EXPECT_THAT(failure([&] { worker.request({{"job", "render"}}, 20); }).first, HasSubstr("unknown error"));
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
  const Rendered before = worker.render(job);
  EXPECT_FALSE(worker.request({{"job", "ping"}}, 10).value("runs_scripts", true));
  job.samples = 200;
  const Rendered whole = worker.render(job);
  const pid_t first = worker.pid();
  std::thread killer([&] {
    std::this_thread::sleep_for(std::chrono::duration<double>(0.5 * whole.seconds));
    kill(first, SIGKILL);
  });
  const Rendered again = worker.render(job);
  killer.join();
  EXPECT_NE(worker.pid(), first);
  EXPECT_EQ(worker.losses().size(), 1u);
  EXPECT_EQ(again.rgba.data, whole.rgba.data);
  EXPECT_EQ(again.catcher.data, whole.catcher.data);
  EXPECT_NE(again.rgba.data, before.rgba.data);
}

}  // namespace
}  // namespace mirage
