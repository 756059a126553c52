// Progress told to a program that shows it itself.
#pragma once

#include <cstddef>
#include <functional>
#include <string>

namespace mirage {

/// Work, units done and in all, the time left ("1:23"), and a note.
using ProgressListener =
    std::function<void(const std::string&, std::size_t, std::size_t, const std::string&, const std::string&)>;

/// As long as it lives, progress is told to the listener, quiet or not, ten times a second at most, on the
/// thread that does the work; nothing is printed. One at a time.
class ProgressTo {
 public:
  explicit ProgressTo(ProgressListener listener);
  ~ProgressTo();
  ProgressTo(const ProgressTo&) = delete;
  ProgressTo& operator=(const ProgressTo&) = delete;
};

}  // namespace mirage
