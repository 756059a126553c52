#include "base/toml_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>

#include "base/error.h"
#include "base/files.h"
#include "base/utf8.h"

namespace mirage {
namespace {

bool is_ascii(std::string_view text) {
  return std::all_of(text.begin(), text.end(), [](unsigned char c) { return c < 0x80; });
}

/// Walks over the text by TOML's rules for strings and comments alone; what breaks any other rule stays, for
/// the parser to refuse.
class AsciiWriter {
 public:
  AsciiWriter(std::string_view text, const std::string& name) : text_(text), name_(name) {}

  std::string write() {
    at_ = byte_order_mark(text_, name_);
    while (at_ < text_.size()) {
      const char c = text_[at_];
      if (c == '#')
        comment();
      else if (c == '"' || c == '\'')
        string(c);
      else if (is_beyond(c))
        refuse(fmt::format("U+{:04X} outside of strings and comments", character()));
      else
        copy(1);
    }
    return std::move(out_);
  }

 private:
  static bool is_beyond(char c) { return static_cast<unsigned char>(c) >= 0x80; }

  [[noreturn]] void refuse(const std::string& problem) const {
    const auto line = 1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(at_), '\n');
    refuse_toml(name_, static_cast<std::size_t>(line), problem);
  }

  void copy(std::size_t count) {
    out_ += text_.substr(at_, count);
    at_ += std::min(count, text_.size() - at_);
  }
  /// The character here, beyond ASCII; goes on behind it.
  std::uint32_t character() {
    const auto [bytes, point] = first_character(text_.substr(at_));
    if (bytes == 0) refuse("holds bytes that are no UTF-8");
    at_ += bytes;
    return point;
  }
  void escape() {
    const std::uint32_t point = character();
    out_ += point < 0x10000 ? fmt::format("\\u{:04X}", point) : fmt::format("\\U{:08X}", point);
  }

  void comment() {
    while (at_ < text_.size() && text_[at_] != '\n') {
      if (is_beyond(text_[at_]))
        static_cast<void>(character()), out_ += '?';
      else
        copy(1);
    }
  }

  /// Quotes here, up to `most`.
  std::size_t quotes(char quote, std::size_t most) const {
    const std::string_view rest = text_.substr(at_, most);
    return std::min(rest.find_first_not_of(quote), rest.size());
  }

  /// From its first quote to its last, or to where it breaks off. All become basic strings if one letter of
  /// the text is beyond ASCII: only these have escapes.
  void string(char quote) {
    const std::size_t opening = quotes(quote, 3), fence = opening == 3 ? 3 : 1;
    put_quotes(fence);
    while (at_ < text_.size()) {
      const char c = text_[at_];
      // Before a fence of three there may be two quotes that belong to the string.
      if (c == quote) {
        const std::size_t count = fence == 1 ? 1 : quotes(quote, 5);
        if (count < fence) {
          copy(count);
          continue;
        }
        copy(count - fence);
        return put_quotes(fence);
      } else if (c == '\n' && fence == 1) {
        return;
      } else if (is_beyond(c)) {
        escape();
      } else if (quote == '"' && c == '\\') {
        if (at_ + 1 < text_.size() && is_beyond(text_[at_ + 1]))
          refuse("a backslash before a letter that needs none");
        copy(2);
      } else if (c == '"' || c == '\\') {  // of a literal string
        out_ += '\\';
        copy(1);
      } else {
        copy(1);
      }
    }
  }
  void put_quotes(std::size_t count) {
    out_.append(count, '"');
    at_ += count;
  }

  std::string_view text_;
  const std::string& name_;
  std::string out_;
  std::size_t at_ = 0;
};

}  // namespace

std::string toml_in_ascii(std::string_view text, const std::string& name) {
  return is_ascii(text) ? std::string(text) : AsciiWriter(text, name).write();
}

void refuse_toml(const std::string& name, std::size_t line, const std::string& problem) {
  throw InputError(name, fmt::format("line {}", line), problem, "mend the TOML syntax");
}

}  // namespace mirage
