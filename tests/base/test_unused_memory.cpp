#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <memory>
#include <vector>

#include "base/unused_memory.h"

namespace mirage {
namespace {

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
  // The last one stays, above all others: the heap's end cannot simply be cut off.
  blocks.erase(blocks.begin(), blocks.end() - 1);
  EXPECT_GT(resident(), before + 100) << "nothing is kept that could be given back";
  return_unused_memory();
  EXPECT_LT(resident(), before + 50);
}

}  // namespace
}  // namespace mirage
