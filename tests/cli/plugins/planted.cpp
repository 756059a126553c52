// A library that leaves a mark where it is loaded: what a hostile run names.
#include <cstdio>
#include <cstdlib>

namespace {

struct Planted {
  Planted() {
    const char* mark = std::getenv("MIRAGE_TEST_MARK");
    if (std::FILE* file = mark ? std::fopen(mark, "w") : nullptr) std::fclose(file);
  }
} planted;

}  // namespace
