#include "base/fields.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <sstream>

#include "base/files.h"

namespace mirage {

std::string Range::words() const {
  if (low == kPositive.low) return high == kMax ? "above 0" : fmt::format("above 0, at most {}", high);
  if (low == -kMax) return high == kMax ? "a number" : fmt::format("at most {}", high);
  if (high == kMax) return fmt::format("at least {}", low);
  // Thresholds and shares are often given in percent.
  return fmt::format("{} to {}{}", low, high, low == 0 && high == 1 ? " (70 % is 0.7)" : "");
}

std::string Field::option_name() const {
  std::string text = option ? option : name;
  std::replace(text.begin(), text.end(), '_', '-');
  return text;
}

std::vector<std::string> listed_words(const std::string& text) {
  std::vector<std::string> words;
  std::istringstream list(text);
  for (std::string word; std::getline(list, word, ',');) words.push_back(word);
  return words;
}

double parse_number(const std::string& text, const std::string& field) {
  const auto value = try_parse_number<double>(text, true);
  if (!value) throw FieldError(field, text, "is not a number", "use a number");
  return *value;
}

void check_number(const Field& field, double value) {
  if (!field.range.contains(value))
    throw FieldError(field.name, fmt::format("{}", value), "out of range", "use " + field.range.words());
}

namespace {

namespace fs = std::filesystem;

/// No table here has longer words, and the distance's time and memory grow with the product of the lengths.
constexpr std::size_t kMaxWordLength = 64;

std::string plain(std::string_view word) {
  std::string text(word.substr(0, kMaxWordLength));
  for (char& c : text) c = c == '_' ? '-' : static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

bool begins_with(const std::string& whole, const std::string& start) {
  constexpr std::size_t kMinCount = 3;  // letters that identify a word
  return start.size() >= kMinCount && whole.starts_with(start);
}

std::string comma_separated(const std::vector<std::string>& words) {
  std::string text;
  for (std::size_t i = 0; i < words.size(); ++i)
    text += (i == 0 ? "" : i + 1 == words.size() ? " or " : ", ") + words[i];
  return text;
}

}  // namespace

int edit_distance(std::string_view first, std::string_view second) {
  const std::string a = plain(first), b = plain(second);
  // Rows of the table of distances between the beginnings of a and b: of two letters less of a, one less,
  // all.
  std::vector<int> before, last(b.size() + 1), row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) last[j] = static_cast<int>(j);
  for (std::size_t i = 1; i <= a.size(); ++i) {
    row[0] = static_cast<int>(i);
    for (std::size_t j = 1; j <= b.size(); ++j) {
      row[j] = std::min({last[j] + 1, row[j - 1] + 1, last[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1)});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        row[j] = std::min(row[j], before[j - 2] + 1);
    }
    before = last;
    last = row;
  }
  return last[b.size()];
}

std::vector<std::string> closest_words(std::string_view word, const std::vector<std::string>& choices) {
  const std::string typed = plain(word);
  std::vector<std::pair<int, std::string>> near;
  for (const std::string& candidate : choices) {
    const int slips = edit_distance(word, candidate);
    const std::string its = plain(candidate);
    const auto longer = static_cast<int>(std::max(typed.size(), its.size()));
    const bool begins = begins_with(its, typed) || begins_with(typed, its);
    if (!typed.empty() && (begins || slips <= std::max(1, longer / 3)) && slips < longer)
      near.emplace_back(slips, candidate);
  }
  std::stable_sort(near.begin(), near.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<std::string> words;
  for (const auto& [slips, candidate] : near) words.push_back(candidate);
  return words;
}

std::string use_one_of(std::string_view word, const std::vector<std::string>& choices,
                       const std::string& forms) {
  std::vector<std::string> all = closest_words(word, choices);
  const std::string question = all.empty() ? "" : "did you mean " + all.front() + "? ";
  for (const std::string& other : choices)
    if (std::find(all.begin(), all.end(), other) == all.end()) all.push_back(other);
  if (!forms.empty()) all.push_back(forms);
  return question + "use " + comma_separated(all);
}

FieldError unknown_word(const std::string& field, const std::string& word,
                        const std::vector<std::string>& choices, const std::string& forms) {
  return {field, word, "unknown", use_one_of(word, choices, forms)};
}

std::vector<std::string> shipped_names(const std::string& folder, const std::string& extension) {
  std::vector<std::string> names;
  try {
    for (const auto& entry : fs::directory_iterator(shipped_file(folder)))
      if (entry.path().extension() == extension) names.push_back(entry.path().stem().string());
  } catch (const InputError&) {  // no such folder
  } catch (const fs::filesystem_error&) {
  }
  std::sort(names.begin(), names.end());
  return names;
}

fs::path shipped_choice(const std::string& folder, const std::string& extension, const std::string& word,
                        const std::string& field, const std::string& forms) {
  const fs::path place = shipped_file(folder);
  const std::vector<std::string> names = shipped_names(folder, extension);
  if (std::find(names.begin(), names.end(), word) == names.end())
    throw unknown_word(field, word, names, forms);
  return place / (word + extension);
}

std::size_t place_of(const std::string& word, const std::string& field, const char* const* words,
                     std::size_t count) {
  for (std::size_t i = 0; i < count; ++i)
    if (word == words[i]) return i;
  throw unknown_word(field, word, {words, words + count});
}

}  // namespace mirage
