// One thread for what is timed beside something else.
#pragma once

#include "base/parallel.h"

namespace mirage {

/// Bounds the threads to one for as long as it lives.
class OneThread {
 public:
  OneThread() : before_(thread_count()) { set_thread_count(1); }
  ~OneThread() { set_thread_count(before_); }
  OneThread(const OneThread&) = delete;
  OneThread& operator=(const OneThread&) = delete;

 private:
  int before_;
};

}  // namespace mirage
