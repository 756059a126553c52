#include "base/picture_claims.h"

#include <fmt/format.h>

#include <cstdint>

namespace mirage {
namespace {

using File = OIIO::Filesystem::IOProxy;

/// As much of the file from `at` on as there is, at most `window`.
template <std::size_t N>
std::string_view read_at(File& file, std::size_t at, char (&window)[N]) {
  return {window, file.pread(window, N, static_cast<std::int64_t>(at))};
}

/// OpenEXR sets aside what an attribute of the header claims before it reads it.
std::string exr_claim(File& file) {
  constexpr std::size_t kHead = 8, kLongestNames = 2 * 256;
  constexpr unsigned char kManyParts = 0x10;  // of the version's second byte
  const std::size_t size = file.size();
  char window[kLongestNames + 4] = {};
  const bool many_parts = read_at(file, 0, window).size() > kHead && (window[5] & kManyParts) != 0;
  bool header_ended = false;
  for (std::size_t at = kHead; at < size;) {
    const std::string_view text = read_at(file, at, window);
    const std::size_t name = text.find('\0');
    if (name == 0 && many_parts && !header_ended) {
      header_ended = true;
      ++at;
      continue;
    }
    const std::size_t type = name == 0 || name == text.npos ? text.npos : text.find('\0', name + 1);
    if (type == text.npos || type + 5 > text.size()) return "";
    std::uint32_t claimed = 0;
    for (int i = 3; i >= 0; --i) claimed = claimed << 8 | static_cast<unsigned char>(text[type + 1 + i]);
    at += type + 5;
    if (claimed > size - at)
      return fmt::format("an attribute claims {} bytes, of {} that are left", claimed, size - at);
    at += claimed;
    header_ended = false;
  }
  return "";
}

/// Whether the text of the iTXt chunk at `at` is compressed: so says the byte behind its keyword.
bool is_compressed(File& file, std::size_t at) {
  char keyword[81] = {};
  const std::string_view text = read_at(file, at, keyword);
  const std::size_t end = text.find('\0');
  return end + 1 < text.size() && text[end + 1] != 0;
}

/// libpng sets aside what a chunk claims, but for pixels, which it reads piece by piece; and what compressed
/// texts become, a thousand times what they are.
std::string png_claim(File& file) {
  constexpr std::size_t kSignature = 8, kCheckSum = 4, kMostTexts = 1 << 12;
  std::size_t texts = 0;
  const std::size_t size = file.size();
  char head[8] = {};
  for (std::size_t at = kSignature; read_at(file, at, head).size() == sizeof head;) {
    at += sizeof head;
    std::uint32_t claimed = 0;
    for (int i = 0; i < 4; ++i) claimed = claimed << 8 | static_cast<unsigned char>(head[i]);
    const std::string_view type(head + 4, 4);
    if (claimed > size - at && type != "IDAT")
      return fmt::format("a chunk claims {} bytes, of {} that are left", claimed, size - at);
    if (claimed > size - at || type == "IEND") return "";
    if (type == "zTXt" || (type == "iTXt" && is_compressed(file, at))) texts += claimed;
    if (texts > kMostTexts)
      return fmt::format("has more than {} bytes of compressed texts, which nothing here needs", kMostTexts);
    at += claimed + kCheckSum;
  }
  return "";
}

}  // namespace

std::string claim_beyond_file(File& file, std::string_view format) {
  return format == "openexr" ? exr_claim(file) : format == "png" ? png_claim(file) : "";
}

}  // namespace mirage
