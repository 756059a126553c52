// Child processes: a detector of the user's, the Blender worker, the report's Python.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace mirage {

/// The program on PATH, or an empty path. A name with a slash is looked up as it is.
std::filesystem::path find_program(const std::string& name);

/// Python for reports and plots: the system's, since a pyenv's python3 on PATH may lack the packages; else
/// the one on PATH; empty if there is none.
std::filesystem::path plotting_python();

/// A child with its own process group, so that Ctrl-C reaches us first. It dies with this program, however
/// that ends, and not with the thread that starts it. Its stdin and stdout are one socket, its stderr goes to
/// `log`, or where ours goes if that is empty.
class ChildProcess {
 public:
  /// Failure if it can't be started, or the log can't be written.
  ChildProcess(const std::vector<std::string>& arguments, const std::filesystem::path& log);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  /// The child's process number; −1 after stop().
  pid_t pid() const { return pid_; }
  /// False when the child no longer listens.
  bool write_line(const std::string& line);
  /// A line that is longer than any answer, as of a program that writes without end.
  static constexpr std::size_t kMaxLineBytes = 1 << 23;  // an inspected FBX file takes 2 MB
  /// How read_line ended. lost: the child closed its output; endless: kMaxLineBytes bytes came without an
  /// end.
  enum class Read { line, lost, timed_out, interrupted, endless };
  /// Next line, waiting up to `seconds`. Ctrl-C ends the wait after `patience` seconds; so do kMaxLineBytes
  /// bytes without an end.
  Read read_line(std::string& line, double seconds, double patience = 0);
  /// Closes its input and waits up to `seconds`, then kills it and what it has started. How it ended: "exit
  /// code 3", "signal 9"; empty if it had to be killed.
  std::string stop(double seconds);

 private:
  /// Whether it has; it is not reaped yet.
  bool has_ended() const;

  pid_t pid_ = -1;
  int socket_ = -1;
  std::string buffer_;
};

/// A child that answers jobs: a JSON object a line on its standard input, {"id": N, …}, and one a line back,
/// {"id": N, "ok": true or false, …}.
class JsonWorker {
 public:
  /// `busy`: what it does, for the message after Ctrl-C ("Blender was rendering"). `patience`: how long an
  /// answer is waited for after Ctrl-C, s. Errors as ChildProcess's.
  JsonWorker(const std::vector<std::string>& arguments, const std::filesystem::path& log, std::string busy,
             double patience = 0)
      : child_(arguments, log), busy_(std::move(busy)), patience_(patience) {}

  /// Sends the job and waits for its answer, `timeout` seconds, whatever else the child says meanwhile.
  /// False, with how it was lost, if there is none. `starting`: what it prints before is passed over, but for
  /// an object with "id" and "ok", which is an answer. Interrupted after Ctrl-C.
  bool exchange(nlohmann::json job, double timeout, nlohmann::json& answer, bool starting = false);
  /// "ended unexpectedly", "gave no answer in 900 s", "gave a malformed answer ('…')", …
  const std::string& lost() const { return lost_; }
  /// How it ended, if it was lost by that: ChildProcess::stop's word.
  const std::optional<std::string>& end() const { return end_; }
  /// Whether it was lost by an answer with another "id", or with an "ok" that is no boolean: one that is
  /// started again would give the same.
  bool broke_protocol() const { return broke_protocol_; }

  /// ChildProcess::pid.
  pid_t pid() const { return child_.pid(); }
  /// ChildProcess::stop; how the child ended is not told.
  void stop(double seconds) { child_.stop(seconds); }

 private:
  ChildProcess child_;
  std::string busy_;
  double patience_;
  long next_id_ = 0;
  std::string lost_;
  std::optional<std::string> end_;
  bool broke_protocol_ = false;
};

/// The text in that field of an answer; another one where it has none.
std::string text_of(const nlohmann::json& answer, const char* key, const std::string& otherwise);

/// Runs a program to its end without input; it dies with this program. What it prints goes to our stderr, or
/// if `last_line` is given, its last line goes there and the rest nowhere. Returns the exit status.
int run_program(const std::vector<std::string>& arguments, std::string* last_line = nullptr);
/// The same of a shipped Python program (shipped_file) on a folder; −1 where there is no Python.
int run_script(const std::string& script, const std::filesystem::path& folder,
               std::string* last_line = nullptr);

}  // namespace mirage
