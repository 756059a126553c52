#include "detection/precision.h"

#include <array>
#include <mutex>

#include "base/fields.h"
#include "base/logging.h"

namespace mirage {

bool multiplies_bfloat16() {
#ifdef __x86_64__
  return __builtin_cpu_supports("avx512bf16") != 0;
#else
  return false;
#endif
}

void check_precision(const std::string& word) {
  constexpr auto kWords = std::to_array<const char*>({kFloat, kBfloat16, kDouble});
  place_of(word, "precision", kWords.data(), kWords.size());
}

std::string usable_precision(const std::string& asked, bool has_bfloat16) {
  check_precision(asked);
  if (asked != kBfloat16 || has_bfloat16) return asked;
  static std::once_flag told;
  std::call_once(
      told, [] { spdlog::warn("this processor has no instructions for bfloat16: --precision is float"); });
  return kFloat;
}

}  // namespace mirage
