// Child processes: the user's detector, the Blender worker, the report's Python.
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

/// Python for reports and plots: the system's, because a pyenv's python3 on PATH may lack the packages;
/// otherwise PATH's. Empty if there is none.
std::filesystem::path plotting_python();

/// A child with its own process group, so that Ctrl-C reaches us first. It dies with this program, however
/// the program ends, but not with the thread that starts it. Its stdin and stdout share one socket. Its
/// stderr goes to `log`, or to our stderr if `log` is empty.
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
  /// Longest line in bytes. No answer is longer, so a longer line comes from a program that writes without
  /// end.
  static constexpr std::size_t kMaxLineBytes = 1 << 23;  // an inspected FBX file takes 2 MB
  /// How read_line ended. lost: the child closed its output; endless: no line end within kMaxLineBytes.
  enum class Read { line, lost, timed_out, interrupted, endless };
  /// Reads the next line, waiting up to `seconds`. Ctrl-C ends the wait after `patience` seconds. An endless
  /// line ends it at once.
  Read read_line(std::string& line, double seconds, double patience = 0);
  /// Closes the child's input, waits up to `seconds`, then kills the child and the processes that it started.
  /// Returns how it ended: "exit code 3", "signal 9"; empty if it had to be killed.
  std::string stop(double seconds);

 private:
  /// Whether the child has ended; it is not reaped yet.
  bool has_ended() const;

  pid_t pid_ = -1;
  int socket_ = -1;
  std::string buffer_;
};

/// A child that answers jobs. A job is one line with a JSON object on its standard input, {"id": N, …}; an
/// answer is one line back, {"id": N, "ok": true or false, …}.
class JsonWorker {
 public:
  /// `busy`: the child's work, for the message after Ctrl-C ("Blender was rendering"). `patience`: seconds to
  /// wait for an answer after Ctrl-C. Errors as ChildProcess.
  JsonWorker(const std::vector<std::string>& arguments, const std::filesystem::path& log, std::string busy,
             double patience = 0)
      : child_(arguments, log), busy_(std::move(busy)), patience_(patience) {}

  /// Sends the job and waits up to `timeout` seconds for its answer, whatever else the child prints
  /// meanwhile. Returns false without an answer; lost() then says why. `starting`: lines before the answer
  /// are skipped; an object with "id" and "ok" is the answer. Interrupted after Ctrl-C.
  bool exchange(nlohmann::json job, double timeout, nlohmann::json& answer, bool starting = false);
  /// "ended unexpectedly", "gave no answer in 900 s", "gave a malformed answer ('…')", …
  const std::string& lost() const { return lost_; }
  /// How the child ended, if that is why it was lost, as ChildProcess::stop says.
  const std::optional<std::string>& end() const { return end_; }
  /// Whether the child was lost because of an answer with another "id" or with an "ok" that is not boolean. A
  /// restarted child would answer the same.
  bool broke_protocol() const { return broke_protocol_; }

  /// ChildProcess::pid.
  pid_t pid() const { return child_.pid(); }
  /// As ChildProcess::stop, without its return value.
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

/// The text in the field `key` of an answer; `otherwise` if it has none.
std::string text_of(const nlohmann::json& answer, const char* key, const std::string& otherwise);

/// Runs a program to its end without input; it dies with this program. Its output goes to our stderr. If
/// `last_line` is given, that takes the last line and the rest is dropped. Returns the exit status.
int run_program(const std::vector<std::string>& arguments, std::string* last_line = nullptr);
/// The same for a shipped Python program (shipped_file) on a folder; −1 without Python.
int run_script(const std::string& script, const std::filesystem::path& folder,
               std::string* last_line = nullptr);

}  // namespace mirage
