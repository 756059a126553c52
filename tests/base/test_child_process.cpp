// Child processes, however they and this program end.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "base/child_process.h"
#include "support/files.h"

namespace mirage {
namespace {

TEST(Process, AChildOutlivesTheThreadThatStartedIt) {
  const test::TemporaryFolder folder;
  std::unique_ptr<ChildProcess> child;
  std::thread([&] {
    child = std::make_unique<ChildProcess>(std::vector<std::string>{"/bin/cat"}, folder / "log");
  }).join();
  std::string line;
  for (int i = 0; i < 3; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    ASSERT_TRUE(child->write_line("still here"));
    ASSERT_EQ(child->read_line(line, 10), ChildProcess::Read::line);
    EXPECT_EQ(line, "still here");
  }
}

/// Whether a process runs; one that has ended and waits for its parent does not.
bool runs(pid_t pid) {
  std::ifstream stat("/proc/" + std::to_string(pid) + "/stat");
  std::string number, name;
  char state = 'X';
  return stat >> number >> name >> state && state != 'Z' && state != 'X';
}

TEST(Process, AChildEndsWithTheProgramThatIsKilled) {
  const test::TemporaryFolder folder;
  const auto starts = {+[](const std::filesystem::path& log) {  // a renderer that hangs and reads no input
                         static std::unique_ptr<ChildProcess> child;
                         std::thread([&] {
                           child = std::make_unique<ChildProcess>(
                               std::vector<std::string>{"/bin/sh", "-c", "echo $$ >&2; exec sleep 60"}, log);
                         }).join();
                         pause();
                       },
                       +[](const std::filesystem::path& log) {  // the report's Python
                         run_program({"/bin/sh", "-c", "echo $$ > " + log.string() + "; exec sleep 60"});
                       }};
  for (const auto start : starts) {
    const std::filesystem::path log = folder / "log";
    std::filesystem::remove(log);
    const pid_t program = fork();
    if (program == 0) {
      start(log);
      _exit(0);
    }
    pid_t child = 0;
    for (int i = 0; i < 500 && !(std::ifstream(log) >> child); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    ASSERT_GT(child, 0);
    EXPECT_TRUE(runs(child));
    kill(program, SIGKILL);
    waitpid(program, nullptr, 0);
    for (int i = 0; i < 100 && runs(child); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(20));
    EXPECT_FALSE(runs(child));
    kill(child, SIGKILL);
  }
}

TEST(Process, HowItEndedIsTold) {
  for (const auto& [command, end] : {std::pair{"exit 3", "exit code 3"}, {"kill -9 $$", "signal 9"}}) {
    JsonWorker worker({"/bin/sh", "-c", command}, "", "it was at work");
    nlohmann::json answer;
    EXPECT_FALSE(worker.ask({{"job", "any"}}, 20, answer));
    EXPECT_EQ(worker.lost(), "ended unexpectedly");
    EXPECT_EQ(worker.end().value_or("it has not"), end);
  }
  JsonWorker silent({"/bin/sleep", "60"}, "", "it was at work");
  nlohmann::json answer;
  EXPECT_FALSE(silent.ask({{"job", "any"}}, 0.2, answer));
  EXPECT_EQ(silent.lost(), "gave no answer in 0.2 s");
  EXPECT_FALSE(silent.end());
}

}  // namespace
}  // namespace mirage
