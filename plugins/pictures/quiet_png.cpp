// libpng prints a line when an error handler returns, and OpenImageIO's returns. This library's
// png_set_error_fn stands before libpng's: it gives it a handler that does not, so that a damaged file is
// told of once, in Mirage's line. Without libpng's header: the data that pass through here are opaque.
#include <dlfcn.h>

#include <array>
#include <atomic>
#include <cstddef>

namespace {

using ErrorHandler = void (*)(void* png, const char* message);
using SetHandlers = void (*)(void* png, void* owner, ErrorHandler error, ErrorHandler warning);

/// OpenImageIO's: its reader's and its writer's, which keep the message. A place for each, as libpng hands a
/// handler nothing to tell it by.
std::array<std::atomic<ErrorHandler>, 4> handlers{};

template <class Function>
Function library(void* where, const char* name) {
  return reinterpret_cast<Function>(dlsym(where, name));
}

template <std::size_t K>
void report_and_jump(void* png, const char* message) {
  if (const ErrorHandler handler = handlers[K]) handler(png, message);
  static const auto leave = library<void (*)(void*, int)>(RTLD_DEFAULT, "png_longjmp");
  leave(png, 1);
}

constexpr std::array<ErrorHandler, 4> kWrappers = {report_and_jump<0>, report_and_jump<1>, report_and_jump<2>,
                                                   report_and_jump<3>};

/// The wrapper of a handler; the handler itself where all places are taken.
ErrorHandler wrapper_of(ErrorHandler handler) {
  for (std::size_t k = 0; k < handlers.size(); ++k) {
    ErrorHandler none = nullptr;
    if (handlers[k].compare_exchange_strong(none, handler) || none == handler) return kWrappers[k];
  }
  return handler;
}

}  // namespace

extern "C" __attribute__((visibility("default"))) void png_set_error_fn(void* png, void* owner,
                                                                        ErrorHandler error,
                                                                        ErrorHandler warning) {
  static const auto set = library<SetHandlers>(RTLD_NEXT, "png_set_error_fn");
  set(png, owner, error ? wrapper_of(error) : error, warning);
}
