#include "detection/defense_words.h"

#include <algorithm>
#include <charconv>
#include <string_view>

#include "base/fields.h"

namespace mirage {
namespace {

bool stands_around(const std::string& word) {
  return word == kConsistency || word == kShadows || jpeg_quality(word) > 0;
}

std::vector<std::string> split_words(const std::string& text) {
  std::vector<std::string> words(1);
  for (const char letter : text)
    if (letter == '+')
      words.emplace_back();
    else
      words.back() += letter;
  return words;
}

}  // namespace

int jpeg_quality(const std::string& text) {
  constexpr std::string_view word = "jpeg:";
  if (!text.starts_with(word)) return 0;
  int quality = 0;
  const char *first = text.data() + word.size(), *end = text.data() + text.size();
  const auto [read, error] = std::from_chars(first, end, quality);
  if (error != std::errc() || read != end || quality < 1 || quality > 100)
    throw FieldError("defense", text, "is no JPEG quality", "use jpeg:1 to jpeg:100");
  return quality;
}

bool Defense::has(const std::string& word) const {
  return std::find(around.begin(), around.end(), word) != around.end();
}

Defense read_defense(const std::string& text) {
  Defense defense;
  if (text.empty() || text == "none") return defense;
  for (const std::string& word : split_words(text)) {
    if (word.empty() || word == "none" ||
        (!stands_around(word) && word.find_first_not_of("abcdefghijklmnopqrstuvwxyz-") != std::string::npos))
      throw FieldError("defense", text, "is no defence",
                       "use none, jpeg:QUALITY, consistency, shadows or the word of shipped weights, such as "
                       "adversarial; several as adversarial+shadows");
    if (defense.has(word)) throw FieldError("defense", text, "names " + word + " twice", "name it once");
    if (stands_around(word)) {
      defense.around.push_back(word);
    } else if (defense.weights.empty()) {
      defense.weights = word;
    } else {
      throw FieldError("defense", text, "names two sets of weights, " + defense.weights + " and " + word,
                       "leave one of them out");
    }
  }
  return defense;
}

void check_defense(const std::string& text) {
  read_defense(text);
}

}  // namespace mirage
