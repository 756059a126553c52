// The program's png_set_error_fn stands before the library's: it gives libpng a handler that does not return.
// Without libpng's header: what passes through here is opaque.
#include "base/quiet_png.h"

#include <dlfcn.h>

#include <atomic>

namespace {

using ErrorHandler = void (*)(void* png, const char* message);
using SetHandlers = void (*)(void* png, void* owner, ErrorHandler error, ErrorHandler warning);

std::atomic<bool> silent{false};
std::atomic<ErrorHandler> told{nullptr};  ///< OpenImageIO's reader's, which keeps the message

template <class Function>
Function library(void* where, const char* name) {
  return reinterpret_cast<Function>(dlsym(where, name));
}

void tell_and_leave(void* png, const char* message) {
  if (const ErrorHandler handler = told) handler(png, message);
  static const auto leave = library<void (*)(void*, int)>(RTLD_DEFAULT, "png_longjmp");
  leave(png, 1);
}

}  // namespace

extern "C" __attribute__((visibility("default"))) void png_set_error_fn(void* png, void* owner,
                                                                        ErrorHandler error,
                                                                        ErrorHandler warning) {
  static const auto set = library<SetHandlers>(RTLD_NEXT, "png_set_error_fn");
  ErrorHandler none = nullptr;
  // One handler is wrapped: another would be told with the first one's owner.
  const bool wrapped = silent && error && (told.compare_exchange_strong(none, error) || none == error);
  set(png, owner, wrapped ? tell_and_leave : error, warning);
}

namespace mirage {

void silence_libpng() {
  silent = true;
}

}  // namespace mirage
