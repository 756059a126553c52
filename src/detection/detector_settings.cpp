#include "detection/detector_settings.h"

#include <algorithm>
#include <array>
#include <mutex>
#include <optional>
#include <string_view>

#include "base/fields.h"
#include "base/logging.h"
#include "base/names.h"

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

std::string usable_precision(const std::string& precision, bool has_bfloat16) {
  check_precision(precision);
  if (precision != kBfloat16 || has_bfloat16) return precision;
  static std::once_flag warned;
  std::call_once(
      warned, [] { spdlog::warn("this processor has no instructions for bfloat16: --precision is float"); });
  return kFloat;
}

namespace {

bool stands_around(const std::string& word) {
  return word == kConsistency || word == kShadows || jpeg_quality(word) > 0 || ceiling_height(word) > 0;
}

/// Not std::views::split, which clang 14 does not compile with GCC 12's library.
std::vector<std::string> split_words(const std::string& text) {
  std::vector<std::string> words(1);
  for (const char letter : text)
    if (letter == '+')
      words.emplace_back();
    else
      words.back() += letter;
  return words;
}

/// The number after a word's name and colon; nullopt for another word, −1 without a valid number.
template <class Number>
std::optional<Number> number_after(std::string_view name, const std::string& text) {
  if (!text.starts_with(name)) return std::nullopt;
  return try_parse_number<Number>(std::string_view(text).substr(name.size())).value_or(Number(-1));
}

}  // namespace

std::vector<std::string> untrained_defenses() {
  return {"none", "jpeg:QUALITY", "ceiling:HEIGHT", kConsistency, kShadows};
}

int jpeg_quality(const std::string& text) {
  const auto quality = number_after<int>("jpeg:", text);
  if (quality && !(*quality >= 1 && *quality <= 100))
    throw FieldError("defense", text, "is not a JPEG quality", "use jpeg:1 to jpeg:100");
  return quality.value_or(0);
}

double ceiling_height(const std::string& text) {
  const auto height = number_after<double>("ceiling:", text);
  if (height && !(*height > 0 && *height <= 10))
    throw FieldError("defense", text, "is not a height over the road", "use metres, such as ceiling:1.6");
  return height.value_or(0);
}

bool Defense::has(const std::string& word) const {
  return std::ranges::find(around, word) != around.end();
}

Defense read_defense(const std::string& text) {
  Defense defense;
  if (text.empty() || text == "none") return defense;
  for (const std::string& word : split_words(text)) {
    if (word.empty() || word == "none" ||
        (!stands_around(word) && word.find_first_not_of("abcdefghijklmnopqrstuvwxyz-") != std::string::npos))
      throw FieldError("defense", text, "is not a defence",
                       use_one_of(word, untrained_defenses(),
                                  "the word of shipped weights, such as adversarial; several as "
                                  "adversarial+shadows"));
    if (defense.has(word)) throw FieldError("defense", text, "names " + word + " twice", "name it once");
    if (stands_around(word)) {
      defense.around.push_back(word);
    } else if (defense.weights.empty()) {
      defense.weights = word;
      if (word == kCeiling) defense.around.emplace_back(kTrainedCeiling);
    } else {
      throw FieldError("defense", text, "names two sets of weights, " + defense.weights + " and " + word,
                       "leave one of them out");
    }
  }
  return defense;
}

}  // namespace mirage
