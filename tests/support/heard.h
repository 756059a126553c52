// The program's messages during a test.
#pragma once

#include <spdlog/sinks/ostream_sink.h>
#include <spdlog/spdlog.h>

#include <memory>
#include <sstream>
#include <string>

namespace mirage::test {

/// Records the log during its lifetime.
class Heard {
 public:
  Heard() : before_(spdlog::default_logger()) {
    spdlog::set_default_logger(
        std::make_shared<spdlog::logger>("test", std::make_shared<spdlog::sinks::ostream_sink_mt>(text_)));
  }
  ~Heard() { spdlog::set_default_logger(before_); }
  std::string text() const { return text_.str(); }
  int warnings() const {
    int count = 0;
    for (std::size_t at = 0; (at = text().find("[warning]", at)) != std::string::npos; ++at) ++count;
    return count;
  }

 private:
  std::ostringstream text_;
  std::shared_ptr<spdlog::logger> before_;
};

}  // namespace mirage::test
