#include "detection/defense_words.h"

#include <charconv>
#include <string_view>

#include "base/fields.h"
#include "detection/detector.h"

namespace mirage {

int jpeg_quality(const std::string& defense) {
  constexpr std::string_view word = "jpeg:";
  if (!defense.starts_with(word)) return 0;
  int quality = 0;
  const char *first = defense.data() + word.size(), *end = defense.data() + defense.size();
  const auto [read, error] = std::from_chars(first, end, quality);
  if (error != std::errc() || read != end || quality < 1 || quality > 100)
    throw FieldError("defense", defense, "is no JPEG quality", "use jpeg:1 to jpeg:100");
  return quality;
}

bool stands_around(const std::string& defense) {
  return defense == kConsistency || defense == kShadows || jpeg_quality(defense) > 0;
}

}  // namespace mirage
