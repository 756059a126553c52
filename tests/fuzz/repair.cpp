#include "fuzz/repair.h"

#include <zlib.h>

#include <algorithm>
#include <cstring>

namespace mirage::fuzz {
namespace {

std::string mutated(std::string part, std::size_t most, const Mutate& mutate) {
  const std::size_t size = part.size();
  part.resize(std::max(most, size));
  part.resize(mutate(reinterpret_cast<std::uint8_t*>(part.data()), size, part.size()));
  return part;
}

std::size_t big_endian(const std::string& file, std::size_t at) {
  std::size_t value = 0;
  for (std::size_t i = 0; i < 4; ++i) value = value << 8 | static_cast<unsigned char>(file[at + i]);
  return value;
}

std::uint32_t little_endian(const std::string& file, std::size_t at) {
  std::uint32_t value = 0;
  std::memcpy(&value, file.data() + at, sizeof value);
  return value;
}

std::string word(std::size_t value) {
  const auto number = static_cast<std::uint32_t>(value);
  return {reinterpret_cast<const char*>(&number), sizeof number};
}

}  // namespace

std::string mutate_png(std::string file, std::size_t most, unsigned seed, const Mutate& mutate) {
  file = mutated(std::move(file), most, mutate);
  constexpr std::size_t kSignature = 8, kFrame = 12;  // length, name and checksum
  constexpr std::size_t kWidth = kSignature + 8, kHeight = kWidth + 4;
  if (seed % 16 != 0 && file.size() >= kHeight + 4)
    for (const std::size_t side : {kWidth, kHeight}) file.replace(side, 3, 3, '\0');
  for (std::size_t at = kSignature; at + kFrame <= file.size();) {
    const std::size_t length = std::min(big_endian(file, at), file.size() - at - kFrame);
    for (std::size_t i = 0; i < 4; ++i) file[at + i] = static_cast<char>(length >> (24 - 8 * i));
    const auto* named = reinterpret_cast<const Bytef*>(file.data() + at + 4);
    const auto sum = crc32(0, named, static_cast<uInt>(4 + length));
    for (std::size_t i = 0; i < 4; ++i) file[at + 8 + length + i] = static_cast<char>(sum >> (24 - 8 * i));
    at += kFrame + length;
  }
  return file;
}

std::string mutate_glb(std::string file, std::size_t most, unsigned seed, const Mutate& mutate) {
  constexpr std::size_t kHead = 20;
  if (file.size() < kHead || seed % 8 == 0) return mutated(std::move(file), most, mutate);
  const std::size_t length = std::min<std::size_t>(little_endian(file, 12), file.size() - kHead);
  std::string text = file.substr(kHead, length),
              binary = file.substr(std::min(kHead + length + 8, file.size()));
  const std::size_t room = most > kHead + 16 ? most - kHead - 16 : 0;
  if (seed % 8 == 1)
    binary = mutated(binary, room - std::min(room, text.size()), mutate);
  else
    text = mutated(text, room - std::min(room, binary.size()), mutate);
  text.resize((text.size() + 3) / 4 * 4, ' ');
  return "glTF" + word(2) + word(kHead + text.size() + 8 + binary.size()) + word(text.size()) + "JSON" +
         text + word(binary.size()) + std::string("BIN\0", 4) + binary;
}

}  // namespace mirage::fuzz
