// A value that costs something and that nobody may ask for.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <utility>

#include "base/parallel.h"

namespace mirage {

/// Made when it is first asked for, once for all copies. Several threads may ask; if making it throws, that
/// is for who asked, and the next makes it again.
template <class T>
class Lazy {
 public:
  explicit Lazy(std::function<T()> make) : state_(std::make_shared<State>()) {
    state_->make = std::move(make);
  }
  /// The value; it lives as long as any copy.
  const T& get() const {
    const std::lock_guard lock(state_->mutex);
    if (state_->make) {
      isolated([&] { state_->value = state_->make(); });
      state_->make = nullptr;
    }
    return state_->value;
  }

 private:
  struct State {
    std::mutex mutex;
    std::function<T()> make;  ///< null: it is made
    T value;
  };
  std::shared_ptr<State> state_;
};

}  // namespace mirage
