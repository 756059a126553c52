#include "cli/version.h"

namespace mirage::cli {

std::string version() {
  const std::string commit = MIRAGE_COMMIT;  // both by src/cli/CMakeLists.txt
  return "mirage " MIRAGE_VERSION " (" + (commit.empty() ? "sources without git" : "commit " + commit) + ")";
}

}  // namespace mirage::cli
