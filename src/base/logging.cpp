#include "base/logging.h"

#include <spdlog/sinks/stdout_color_sinks.h>

namespace mirage {

void start_logging(bool quiet) {
  auto logger =
      std::make_shared<spdlog::logger>("mirage", std::make_shared<spdlog::sinks::stderr_color_sink_mt>());
  logger->set_pattern("%^%l%$ %v");
  logger->set_level(quiet ? spdlog::level::warn : spdlog::level::info);
  spdlog::set_default_logger(std::move(logger));
}

}  // namespace mirage
