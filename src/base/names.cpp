#include "base/names.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

namespace mirage {

Utf8Character first_character(std::string_view bytes) {
  const auto lead = static_cast<unsigned char>(bytes[0]);
  const std::size_t length = lead < 0x80            ? 1
                             : lead >> 5 == 0b110   ? 2
                             : lead >> 4 == 0b1110  ? 3
                             : lead >> 3 == 0b11110 ? 4
                                                    : 0;
  if (length == 1) return {1, lead};
  if (length == 0 || bytes.size() < length) return {};
  char32_t point = lead & (0x7fu >> length);
  for (std::size_t i = 1; i < length; ++i) {
    const auto next = static_cast<unsigned char>(bytes[i]);
    if (next >> 6 != 0b10) return {};
    point = point << 6 | (next & 0x3fu);
  }
  constexpr char32_t kMinSize[] = {0, 0, 0x80, 0x800, 0x10000};
  const bool surrogate = point >= 0xd800 && point <= 0xdfff;
  if (point < kMinSize[length] || point > 0x10ffff || surrogate) return {};
  return {length, point};
}

namespace {

/// C0, DEL and C1: terminals act on them.
bool is_control(char32_t point) {
  return point < 0x20 || (point >= 0x7f && point < 0xa0);
}

std::string escaped(std::string_view bytes, bool backslash) {
  std::string text;
  text.reserve(bytes.size());
  while (!bytes.empty()) {
    const auto [length, point] = first_character(bytes);
    const std::string_view character = bytes.substr(0, length == 0 ? 1 : length);
    if (length == 0 || is_control(point))
      for (const char c : character) text += fmt::format("\\x{:02x}", static_cast<unsigned char>(c));
    else if (backslash && character == "\\")
      text += "\\\\";
    else
      text += character;
    bytes.remove_prefix(character.size());
  }
  return text;
}

int hex_digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  return -1;
}

void make_utf8(nlohmann::json& value) {
  if (value.is_string()) {
    value = printable(value.get_ref<const std::string&>());
  } else if (value.is_array()) {
    for (auto& item : value) make_utf8(item);
  } else if (value.is_object()) {
    nlohmann::json clean = nlohmann::json::object();
    for (auto& [key, item] : value.items()) {
      make_utf8(item);
      clean[printable(key)] = std::move(item);
    }
    value = std::move(clean);
  }
}

}  // namespace

std::string printable(std::string_view bytes) {
  return escaped(bytes, false);
}

std::string escape_name(std::string_view bytes) {
  return escaped(bytes, true);
}

std::string unescape_name(std::string_view text) {
  std::string bytes;
  bytes.reserve(text.size());
  for (std::size_t i = 0; i < text.size(); ++i) {
    const std::string_view rest = text.substr(i);
    if (rest.starts_with("\\\\")) {
      bytes += '\\';
      ++i;
    } else if (rest.size() >= 4 && rest.starts_with("\\x") && hex_digit(rest[2]) >= 0 &&
               hex_digit(rest[3]) >= 0) {
      bytes += static_cast<char>(hex_digit(rest[2]) << 4 | hex_digit(rest[3]));
      i += 3;
    } else {
      bytes += text[i];
    }
  }
  return bytes;
}

std::string frame_id_problem(std::string_view id) {
  if (id.empty()) return "is empty";
  if (id == "." || id == "..") return "is a folder's name";
  if (id.find('/') != std::string_view::npos) return "holds a separator";
  if (id.find('\0') != std::string_view::npos) return "holds a NUL";
  // As it will stand in the names of files.
  if (const std::size_t bytes = escape_name(id).size(); bytes > kMaxFrameIdLength)
    return fmt::format("is {} bytes long (escaped), at most {} can be used", bytes, kMaxFrameIdLength);
  return "";
}

std::string json_text(const nlohmann::json& value, int indent) {
  try {
    return value.dump(indent);
  } catch (const nlohmann::json::type_error&) {  // a string that is no UTF-8
    nlohmann::json clean = value;
    make_utf8(clean);
    return clean.dump(indent);
  }
}

std::vector<std::string_view> split(std::string_view text, std::string_view separators) {
  std::vector<std::string_view> parts;
  while (true) {
    const auto begin = text.find_first_not_of(separators);
    if (begin == std::string_view::npos) return parts;
    text.remove_prefix(begin);
    const auto end = std::min(text.find_first_of(separators), text.size());
    parts.push_back(text.substr(0, end));
    text.remove_prefix(end);
  }
}

}  // namespace mirage
