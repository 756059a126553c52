#include "detection/precision.h"

#include <mutex>

#include "base/error.h"
#include "base/logging.h"

namespace mirage {

bool multiplies_bfloat16() {
#ifdef __x86_64__
  return __builtin_cpu_supports("avx512bf16") != 0;
#else
  return false;
#endif
}

std::string usable_precision(const std::string& asked, bool has_bfloat16) {
  if (asked == kFloat || asked == kDouble || (asked == kBfloat16 && has_bfloat16)) return asked;
  if (asked != kBfloat16)
    throw InputError("--precision", asked, "is no precision", "use float, bfloat16 or double");
  static std::once_flag told;
  std::call_once(
      told, [] { spdlog::warn("this processor has no instructions for bfloat16: --precision is float"); });
  return kFloat;
}

}  // namespace mirage
