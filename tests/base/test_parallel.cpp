// Loops see what came before them, and what follows sees them: for ThreadSanitizer too (make tsan), which
// must still tell of parts that disturb each other.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <numeric>
#include <thread>
#include <vector>

#include "base/parallel.h"

namespace mirage {
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

}  // namespace
}  // namespace mirage
