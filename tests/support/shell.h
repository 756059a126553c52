// Shell commands in tests.
#pragma once

#include <sys/wait.h>

#include <cstdlib>
#include <string>

#include "support/files.h"

namespace mirage::test {

/// Runs a shell command with its output in folder/said; returns its exit code.
inline int shell(const TemporaryFolder& folder, const std::string& command) {
  const int status = std::system((command + " > " + (folder / "said").string() + " 2>&1").c_str());
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128;
}

}  // namespace mirage::test
