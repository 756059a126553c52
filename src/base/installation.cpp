#include "base/installation.h"

#include "base/files.h"

namespace mirage {

namespace fs = std::filesystem;

fs::path built_file(const std::string& relative) {
  const fs::path beside = executable_folder() / relative;
  if (fs::exists(beside)) return beside;
  const fs::path installed = executable_folder().parent_path() / "lib/mirage" / relative;
  return fs::exists(installed) ? installed : beside;
}

}  // namespace mirage
