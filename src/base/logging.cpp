#include "base/logging.h"

#include <fmt/format.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <unistd.h>

#include <cstdio>

#include "base/names.h"

namespace mirage {
namespace {

/// The message, which may hold names of files, as a terminal can show it.
class Shown : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg& message, const std::tm&, spdlog::memory_buf_t& into) override {
    const std::string text = printable({message.payload.data(), message.payload.size()});
    into.append(text.data(), text.data() + text.size());
  }
  std::unique_ptr<custom_flag_formatter> clone() const override { return std::make_unique<Shown>(); }
};

bool always_quiet = false;

std::string clock_text(double seconds) {
  const long total = static_cast<long>(seconds + 0.5);
  return total >= 3600 ? fmt::format("{}:{:02}:{:02}", total / 3600, total / 60 % 60, total % 60)
                       : fmt::format("{}:{:02}", total / 60, total % 60);
}

ProgressListener listener;

}  // namespace

void keep_logging_quiet(bool quiet) {
  always_quiet = quiet;
}

void start_logging(bool quiet) {
  auto logger =
      std::make_shared<spdlog::logger>("mirage", std::make_shared<spdlog::sinks::stderr_color_sink_mt>());
  auto formatter = std::make_unique<spdlog::pattern_formatter>();
  formatter->add_flag<Shown>('*').set_pattern("%^%l%$ %*");
  logger->set_formatter(std::move(formatter));
  logger->set_level(quiet || always_quiet ? spdlog::level::warn : spdlog::level::info);
  spdlog::set_default_logger(std::move(logger));
}

ProgressListenerScope::ProgressListenerScope(ProgressListener told) {
  listener = std::move(told);
}

ProgressListenerScope::~ProgressListenerScope() {
  listener = nullptr;
}

Progress::Progress(std::string what, std::size_t total, bool quiet)
    : what_(std::move(what)),
      total_(total),
      shown_(listener || (!quiet && isatty(STDERR_FILENO))),
      start_(std::chrono::steady_clock::now()),
      last_(start_) {}

Progress::~Progress() {
  if (shown_ && started_ && !listener) std::fputs("\n", stderr);
}

void Progress::add(std::size_t more, const std::string& note) {
  const std::scoped_lock lock(adding_);
  update(done_ += more, note);
}

void Progress::update(std::size_t done, const std::string& note) {
  if (!shown_) return;
  const auto now = std::chrono::steady_clock::now();
  if (!started_) {
    // A resumed run starts in the middle: the estimate counts only what this process did.
    first_ = done > 0 ? done - 1 : 0;
    started_ = true;
  } else if (done < total_ && now - last_ < std::chrono::milliseconds(100)) {
    return;
  }
  last_ = now;
  const double elapsed = std::chrono::duration<double>(now - start_).count();
  const double left = done > first_ ? elapsed / double(done - first_) * double(total_ - done) : 0;
  if (listener) return listener(what_, done, total_, clock_text(left), note);
  std::fputs(
      fmt::format("\r\033[K{} {}/{}  {} left  {}", what_, done, total_, clock_text(left), note).c_str(),
      stderr);
  std::fflush(stderr);
}

}  // namespace mirage
