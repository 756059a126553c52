// Child processes, whichever way they or this program end.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <numeric>
#include <string>
#include <thread>
#include <vector>

#include "base/child_process.h"
#include "base/files.h"
#include "base/memory.h"
#include "base/parallel.h"
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

/// Whether a process runs; a zombie does not.
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
    EXPECT_FALSE(worker.exchange({{"job", "any"}}, 20, answer));
    EXPECT_EQ(worker.lost(), "ended unexpectedly");
    EXPECT_EQ(worker.end().value_or("it has not"), end);
  }
  JsonWorker silent({"/bin/sleep", "60"}, "", "it was at work");
  nlohmann::json answer;
  EXPECT_FALSE(silent.exchange({{"job", "any"}}, 0.2, answer));
  EXPECT_EQ(silent.lost(), "gave no answer in 0.2 s");
  EXPECT_FALSE(silent.end());
}

// The worker of a dead child keeps its socket open: the loss is noticed at once, and the worker ends
// too.
TEST(Process, WorkersOfAChildEndWithIt) {
  const test::TemporaryFolder folder;
  const auto log = folder / "log";
  JsonWorker worker({"/bin/sh", "-c", "sleep 60 & echo $! >&2; exit 3"}, log, "it was at work");
  nlohmann::json answer;
  const auto start = std::chrono::steady_clock::now();
  EXPECT_FALSE(worker.exchange({{"job", "any"}}, 50, answer));
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(20));
  EXPECT_EQ(worker.lost(), "ended unexpectedly");
  EXPECT_EQ(worker.end().value_or("it has not"), "exit code 3");
  const pid_t left = std::stoi(read_file(log));
  for (int i = 0; i < 100 && runs(left); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_FALSE(runs(left));
}

}  // namespace

// Parallel loops are ordered with the code before and after them, also for ThreadSanitizer (make tsan). It
// must still report data races between iterations.

namespace {

TEST(Parallel, ALoopComesAfterWhatIsBeforeItAndBeforeWhatIsAfter) {
  for (int round = 0; round < 100; ++round) {
    const std::vector<int> in(1000, round);
    std::vector<int> out(1000);
    parallel_for(in.size(), [&](std::size_t i) { out[i] = in[i] + 1; });
    EXPECT_EQ(std::accumulate(out.begin(), out.end(), 0), 1000 * (round + 1));
  }
}

#ifdef __SANITIZE_THREAD__
int disturbed = 0;

TEST(ParallelDeathTest, PartsThatWriteToOnePlaceAreFound) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  const auto disturb = [] {
    set_thread_count(2);
    for (int round = 0; round < 20; ++round) {
      std::atomic<int> here = 0;  // relaxed: two threads meet, and nothing is ordered by that
      parallel_for(2, [&](std::size_t) {
        here.fetch_add(1, std::memory_order_relaxed);
        const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(2);
        while (here.load(std::memory_order_relaxed) < 2 && std::chrono::steady_clock::now() < end)
          std::this_thread::yield();
        ++disturbed;
      });
    }
    std::exit(0);  // ThreadSanitizer makes it 66
  };
  EXPECT_EXIT(disturb(), testing::ExitedWithCode(66), "data race");
}
#endif

/// MiB of this process in memory.
double resident() {
  std::ifstream file("/proc/self/statm");
  double whole = 0, held = 0;
  file >> whole >> held;
  return held * static_cast<double>(sysconf(_SC_PAGESIZE)) / (1 << 20);
}

TEST(UnusedMemory, GoesBackToTheSystem) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "a sanitizer has an allocator of its own";
#endif
  const double before = resident();
  std::vector<std::unique_ptr<std::vector<char>>> blocks;
  for (int i = 0; i < 4096; ++i) blocks.push_back(std::make_unique<std::vector<char>>(1 << 16, 'x'));
  EXPECT_GT(resident(), before + 200);
  // Keeps the last block, above all others, so that the heap's end cannot simply be trimmed.
  blocks.erase(blocks.begin(), blocks.end() - 1);
  EXPECT_GT(resident(), before + 100) << "nothing is kept that could be given back";
  return_unused_memory();
  EXPECT_LT(resident(), before + 50);
}

}  // namespace
}  // namespace mirage
