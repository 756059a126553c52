// Child processes: the Blender worker and the report's Python.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <string>
#include <vector>

namespace mirage {

/// The program on PATH, or an empty path. A name with a slash is looked up as it is.
std::filesystem::path find_program(const std::string& name);

/// Python for reports and plots: the system's, since a pyenv's python3 on PATH may lack the packages; else
/// the one on PATH; empty if there is none.
std::filesystem::path plotting_python();

/// A child with its own process group, so that Ctrl-C reaches us first. It dies with this program, however
/// that ends, and not with the thread that starts it. Its stdin and stdout are one socket, its stderr goes to
/// `log`.
class ChildProcess {
 public:
  /// Failure if it can't be started, or the log can't be written.
  ChildProcess(const std::vector<std::string>& arguments, const std::filesystem::path& log);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  pid_t pid() const { return pid_; }
  /// False when the child no longer listens.
  bool write_line(const std::string& line);
  /// A line that is longer than any answer, as of a program that writes without end.
  static constexpr std::size_t kLongestLine = 1 << 23;  // an inspected FBX file takes 2 MB
  enum class Read { line, lost, timed_out, interrupted, endless };
  /// Next line, waiting up to `seconds`. Ctrl-C ends the wait; so do kLongestLine bytes without an end.
  Read read_line(std::string& line, double seconds);
  /// Closes its input and waits up to `seconds`, then kills it and what it has started.
  void stop(double seconds);

 private:
  pid_t pid_ = -1;
  int socket_ = -1;
  std::string buffer_;
};

/// Runs a program to its end without input; it dies with this program. What it prints goes to our stderr, or
/// if `last_line` is given, its last line goes there and the rest nowhere. Returns the exit status.
int run_program(const std::vector<std::string>& arguments, std::string* last_line = nullptr);

}  // namespace mirage
