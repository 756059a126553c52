// The program as a user meets it: exit codes, messages, and its working folder.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "base/files.h"
#include "support/files.h"

namespace mirage::test {

/// A test with its own folder. Arguments are one line that the shell splits.
class Program : public testing::Test {
 protected:
  struct Outcome {
    int code = -1;
    std::string out, err;
  };
  /// Starts it with its output redirected to files of the folder.
  pid_t start(const std::string& arguments) const {
    const std::string line = "exec " + command(arguments);
    const pid_t child = fork();
    if (child != 0) return child;
    if (!freopen((folder_ / "out.txt").c_str(), "w", stdout)) _exit(99);
    if (!freopen((folder_ / "err.txt").c_str(), "w", stderr)) _exit(99);
    execl("/bin/sh", "sh", "-c", line.c_str(), nullptr);
    _exit(98);
  }
  Outcome finish(pid_t child) const {
    int status = 0;
    waitpid(child, &status, 0);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), read_file(folder_ / "out.txt"),
            read_file(folder_ / "err.txt")};
  }
  Outcome run(const std::string& arguments) const { return finish(start(arguments)); }
  /// The one-line error for these arguments.
  std::string refused(const std::string& arguments, int code = 2) const {
    const Outcome outcome = run(arguments);
    EXPECT_EQ(outcome.code, code) << arguments << ": " << outcome.err;
    expect_one_line(outcome.err, arguments);
    return outcome.err;
  }

  /// Runs a shell command; returns its exit code. said() is all that it printed.
  int shell(const std::string& line) const {
    const int status = std::system((line + " > " + at("said") + " 2>&1").c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128;
  }
  int mirage(const std::string& arguments) const { return shell(command(arguments)); }
  std::string said() const { return read_file(folder_ / "said"); }

  /// Expects one line of text that starts with "mirage: ".
  static void expect_one_line(const std::string& text, const std::string& about) {
    EXPECT_THAT(text, testing::StartsWith("mirage: ")) << about;
    EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 1) << about << ": " << text;
    EXPECT_NO_THROW(nlohmann::json(text).dump()) << about;
  }

  /// The path of a file in the folder.
  std::string at(const std::string& name) const { return (folder_ / name).string(); }
  bool exists(const std::string& name) const { return std::filesystem::exists(folder_ / name); }
  std::string text(const std::string& name) const { return read_file(folder_ / name); }
  nlohmann::json json(const std::string& name) const { return read_json(folder_ / name); }

  std::string command(const std::string& arguments) const {
    return "env " + environment_ + " " MIRAGE_BUILD "/mirage " + arguments;
  }
  TemporaryFolder folder_;
  std::string environment_;  ///< "NAME=VALUE …"
  const std::string frames_ =
      MIRAGE_BUILD "/test_data";  ///< three frames of the default rig, read-only (CMakeLists.txt)
};

}  // namespace mirage::test

#define MIRAGE_NEED_FUSION()                                       \
  if (!std::filesystem::exists(MIRAGE_BUILD "/plugins/fusion.so")) \
  GTEST_SKIP() << "the fusion plugin was not built (MIRAGE_DETECTORS)"
