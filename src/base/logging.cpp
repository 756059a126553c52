#include "base/logging.h"

#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_color_sinks.h>

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

}  // namespace mirage
