// A library that writes a marker file when it is loaded; hostile runs name it.
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
