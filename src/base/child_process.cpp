#include "base/child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <system_error>
#include <thread>

#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "base/schedule.h"
#include "base/sizes.h"

namespace mirage {
namespace {

std::vector<char*> c_arguments(const std::vector<std::string>& arguments) {
  std::vector<char*> pointers;
  for (const std::string& argument : arguments) pointers.push_back(const_cast<char*>(argument.c_str()));
  pointers.push_back(nullptr);
  return pointers;
}

/// The arguments, files and process group of a new child.
struct Start {
  std::vector<char*> arguments;
  int in = -1, out = -1, errors = -1;  ///< its standard streams
  bool own_group = false;
};

/// Forks from one thread that lives as long as the program. PR_SET_PDEATHSIG kills a child when the thread
/// that forked it ends, and callers are workers of a pool, which come and go.
class Spawner {
 public:
  Spawner() {
    std::thread([this] { serve(); }).detach();
  }

  /// The child's pid, or −1 with errno.
  pid_t start(const Start& child) {
    const std::lock_guard turn(turn_);
    std::unique_lock lock(mutex_);
    asked_ = &child;
    changed_.notify_all();
    changed_.wait(lock, [&] { return asked_ == nullptr; });
    errno = error_;
    return pid_;
  }

 private:
  void serve() {
    std::unique_lock lock(mutex_);
    for (;;) {
      changed_.wait(lock, [&] { return asked_ != nullptr; });
      pid_ = fork_and_exec(*asked_);
      error_ = errno;
      asked_ = nullptr;
      changed_.notify_all();
    }
  }

  static pid_t fork_and_exec(const Start& child) {
    const pid_t parent = ::getpid(), pid = ::fork();
    if (pid != 0) return pid;
    // Only async-signal-safe calls from here to exec.
    if (child.own_group) ::setpgid(0, 0);
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::getppid() != parent) ::_exit(127);
    ::dup2(child.in, 0);
    ::dup2(child.out, 1);
    ::dup2(child.errors, 2);
    ::execv(child.arguments[0], child.arguments.data());
    ::_exit(127);
  }

  std::mutex turn_, mutex_;
  std::condition_variable changed_;
  const Start* asked_ = nullptr;
  pid_t pid_ = -1;
  int error_ = 0;
};

/// As Spawner::start. Failure if there is no room for its thread.
pid_t start_child(const Start& child) {
  static std::mutex mutex;
  static pid_t owner = -1;
  static Spawner* spawner = nullptr;  // never destroyed: its thread ends with the program
  {
    const std::lock_guard lock(mutex);
    if (owner != ::getpid()) {  // the first, or after a fork, which takes no other thread along
      try {
        spawner = new Spawner;
      } catch (const std::system_error& problem) {
        throw Failure(child.arguments[0], problem.what(), "close other programs");
      }
      owner = ::getpid();
    }
  }
  return spawner->start(child);
}

/// Waits for a child and reaps it. Returns waitpid's status.
int wait_for(pid_t child) {
  int status = 0;
  while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return status;
}

/// The start of a child's line in quotes, for a message.
std::string quoted_line(const std::string& line) {
  std::string text = line.substr(0, 60);
  for (char& c : text)
    if (c < ' ' || c > '~') c = '?';
  return "'" + text + (line.size() > 60 ? "…'" : "'");
}

/// Whether a line is an answer by the protocol: an object with both keys.
bool is_meant_as_answer(const std::string& line, nlohmann::json& answer) {
  try {
    check_json_depth(line, "answer");
  } catch (const InputError&) {
    return false;
  }
  answer = nlohmann::json::parse(line, nullptr, false);
  return answer.is_object() && answer.contains("id") && answer.contains("ok");
}

/// Why the answer does not answer job `id`; empty if it does.
std::string answer_problem(const nlohmann::json& answer, long id) {
  if (!answer["id"].is_number_integer() || answer["id"] != id)
    return fmt::format("id is not {}, the job's", id);
  return answer["ok"].is_boolean() ? "" : "ok is neither true nor false";
}

/// Reads to the end, closes the file and returns the last line.
std::string read_last_line(int file) {
  std::string line;
  char bytes[4096];
  for (ssize_t size; (size = ::read(file, bytes, sizeof bytes)) > 0 || (size < 0 && errno == EINTR);)
    for (ssize_t i = 0; i < size; ++i) {
      if (!line.empty() && line.back() == '\n') line.clear();
      if (line.size() < 4096) line += bytes[i];
    }
  ::close(file);
  while (!line.empty() && line.back() == '\n') line.pop_back();
  return line;
}

}  // namespace

std::filesystem::path find_program(const std::string& name) {
  if (name.find('/') != std::string::npos) return ::access(name.c_str(), X_OK) == 0 ? name : "";
  const char* folders = std::getenv("PATH");
  for (const std::string_view folder : split(folders ? folders : "", ":")) {
    const std::filesystem::path file = std::filesystem::path(folder) / name;
    if (::access(file.c_str(), X_OK) == 0 && !std::filesystem::is_directory(file)) return file;
  }
  return {};
}

std::filesystem::path plotting_python() {
  const std::filesystem::path system = find_program("/usr/bin/python3");
  return system.empty() ? find_program("python3") : system;
}

ChildProcess::ChildProcess(const std::vector<std::string>& arguments, const std::filesystem::path& log) {
  const int errors = log.empty() ? ::fcntl(2, F_DUPFD_CLOEXEC, 3)
                                 : ::open(log.c_str(), O_CREAT | O_WRONLY | O_APPEND | O_CLOEXEC, 0644);
  if (errors < 0) {
    const int reason = errno;
    throw Failure(log.string(), std::strerror(reason), fix_for(reason));
  }
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) {
    const int reason = errno;
    ::close(errors);
    throw Failure(arguments[0], std::strerror(reason), "close other programs");
  }
  pid_ = start_child({c_arguments(arguments), ends[1], ends[1], errors, true});
  const int reason = errno;
  ::close(ends[1]);
  ::close(errors);
  socket_ = ends[0];
  if (pid_ < 0) {
    ::close(socket_);
    throw Failure(arguments[0], std::strerror(reason), "close other programs");
  }
}

ChildProcess::~ChildProcess() {
  stop(0);
}

bool ChildProcess::write_line(const std::string& line) {
  const std::string bytes = line + "\n";
  for (std::size_t sent = 0; sent < bytes.size();) {
    const ssize_t n = ::send(socket_, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    sent += as_size(n);
  }
  return true;
}

ChildProcess::Read ChildProcess::read_line(std::string& line, double seconds, double patience) {
  auto deadline = Clock::now() + std::chrono::duration<double>(seconds);
  bool stopping = false;
  for (;;) {
    // Before the buffer: a child that never stops writing lines must not keep us from looking.
    if (interrupted() && !stopping) {
      if (patience <= 0) return Read::interrupted;
      stopping = true;
      deadline = std::min(deadline, Clock::now() + std::chrono::duration<double>(patience));
    }
    const double left = std::chrono::duration<double>(deadline - Clock::now()).count();
    if (left <= 0) return stopping ? Read::interrupted : Read::timed_out;
    if (const std::size_t end = buffer_.find('\n'); end != std::string::npos) {
      line = buffer_.substr(0, end);
      buffer_.erase(0, end + 1);
      return Read::line;
    }
    if (buffer_.size() > kMaxLineBytes) return Read::endless;
    pollfd wait{socket_, POLLIN, 0};
    const bool gone = has_ended();  // before the poll, so that its last output is there
    const int ready = ::poll(&wait, 1, static_cast<int>(std::min(left, 0.2) * 1000) + 1);
    if (ready == 0 && gone) return Read::lost;  // children of its own may keep the socket open
    if (ready <= 0) continue;
    char chunk[4096];
    const ssize_t n = ::recv(socket_, chunk, sizeof chunk, 0);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return Read::lost;
    buffer_.append(chunk, as_size(n));
  }
}

bool ChildProcess::has_ended() const {
  siginfo_t info{};
  return ::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
         info.si_pid == pid_;
}

std::string ChildProcess::stop(double seconds) {
  if (pid_ <= 0) return "";
  ::shutdown(socket_, SHUT_WR);
  const auto deadline = Clock::now() + std::chrono::duration<double>(seconds);
  while (!has_ended() && Clock::now() < deadline) ::usleep(5000);
  const bool killed = !has_ended();
  ::kill(-pid_, SIGKILL);             // with its children, before another process can take its number
  if (killed) ::kill(pid_, SIGKILL);  // it may not have come to make its group
  const int status = wait_for(pid_);
  ::close(socket_);
  pid_ = -1;
  socket_ = -1;
  if (killed) return "";
  return WIFSIGNALED(status) ? fmt::format("signal {}", WTERMSIG(status))
                             : fmt::format("exit code {}", WEXITSTATUS(status));
}

std::string text_of(const nlohmann::json& answer, const char* key, const std::string& otherwise) {
  const auto field = answer.find(key);
  return field != answer.end() && field->is_string() ? field->get<std::string>() : otherwise;
}

bool JsonWorker::exchange(nlohmann::json job, double timeout, nlohmann::json& answer, bool starting) {
  job["id"] = ++next_id_;
  end_.reset();
  broke_protocol_ = false;
  const auto lost_by_its_end = [&] {
    constexpr double kReaped = 1;  // s, for a child that has closed its socket to be gone
    end_ = child_.stop(kReaped);
    lost_ = "ended unexpectedly";
    return false;
  };
  if (!child_.write_line(job.dump())) return lost_by_its_end();
  const auto asked = Clock::now();
  for (std::string line;;) {
    const double left = timeout - seconds_since(asked);
    switch (child_.read_line(line, left, patience_)) {
      case ChildProcess::Read::line:
        break;
      case ChildProcess::Read::interrupted:
        throw Interrupted("stopped while " + busy_ + "; what is finished is kept, run again to go on");
      case ChildProcess::Read::timed_out:
        lost_ = fmt::format("gave no answer in {:g} s", timeout);
        return false;
      case ChildProcess::Read::endless:
        lost_ = "gave an answer without end";
        return false;
      default:
        return lost_by_its_end();
    }
    if (is_meant_as_answer(line, answer)) {
      const std::string problem = answer_problem(answer, next_id_);
      if (problem.empty()) return true;
      lost_ = fmt::format("gave a malformed answer ({}), whose {}", quoted_line(line), problem);
      broke_protocol_ = true;
      return false;
    }
    if (!starting) {
      lost_ = fmt::format("gave a malformed answer ({})", quoted_line(line));
      return false;
    }
  }
}

int run_program(const std::vector<std::string>& arguments, std::string* last_line) {
  int pipe[2] = {-1, -1};
  if (last_line && ::pipe2(pipe, O_CLOEXEC) != 0)
    throw Failure(arguments[0], std::strerror(errno), "close other programs");
  const int nothing = ::open("/dev/null", O_RDONLY | O_CLOEXEC), output = last_line ? pipe[1] : 2;
  const pid_t pid = start_child({c_arguments(arguments), nothing, output, output, false});
  const int reason = errno;
  if (nothing >= 0) ::close(nothing);
  if (last_line) ::close(pipe[1]);
  if (pid < 0) {
    if (last_line) ::close(pipe[0]);
    throw Failure(arguments[0], std::strerror(reason), "close other programs");
  }
  if (last_line) *last_line = read_last_line(pipe[0]);
  const int status = wait_for(pid);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

int run_script(const std::string& script, const std::filesystem::path& folder, std::string* last_line) {
  const std::string python = plotting_python().string();
  if (python.empty()) return -1;
  return run_program({python, shipped_file(script).string(), folder.string()}, last_line);
}

}  // namespace mirage
