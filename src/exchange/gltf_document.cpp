#include "exchange/gltf_document.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <utility>

#include "base/error.h"
#include "base/file_head.h"
#include "base/files.h"
#include "base/json_depth.h"
#include "base/open_file.h"
#include "exchange/folder_files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kHeader = 20, kChunkHeader = 8;  // bytes; the former with the first chunk's
/// Bytes of the JSON of a .glb, whose data lie behind it.
constexpr std::size_t kLargestGlbJson = std::size_t{1} << 24;

void check_magic(std::string_view bytes, const std::string& file) {
  if (!bytes.starts_with("glTF"))
    throw InputError(file, "magic", "is not \"glTF\"", "give a binary glTF 2.0 file (.glb)");
}

/// Bytes of the JSON, a .glb's first chunk, by the file's `head` and size.
std::size_t json_size(std::string_view head, std::uintmax_t size, const std::string& file) {
  const auto fail = [&](const char* field, const std::string& problem, const char* fix) {
    throw InputError(file, field, problem, fix);
  };
  const auto u32 = [&](std::size_t at) {
    std::uint32_t value = 0;
    std::memcpy(&value, head.data() + at, sizeof value);
    return value;
  };
  if (head.size() < kHeader)
    fail("header", fmt::format("{} bytes are too few for a .glb file", head.size()), "export the file again");
  check_magic(head, file);
  if (u32(4) != 2) fail("version", fmt::format("{}", u32(4)), "give a glTF 2.0 file");
  if (u32(8) > size)
    fail("length", fmt::format("truncated: {} of {} bytes", size, u32(8)),
         "restore the file or export it again");
  if (u32(16) != 0x4E4F534A || u32(12) > size - kHeader)
    fail("JSON", "the first chunk is not whole", "restore the file or export it again");
  if (u32(12) > kLargestGlbJson)
    fail("JSON", fmt::format("is larger than {} bytes", kLargestGlbJson),
         "export the file again, with its data in the binary chunk");
  return u32(12);
}

/// Of a document: ours have some thousands, and numbers of vertices lie in buffers.
constexpr std::size_t kMostValues = 200000;
/// Of a file, and of all buffers together: a photograph and thirty objects of a million faces.
constexpr std::size_t kMostInMemory = std::size_t{1} << 28;

}  // namespace

bool looks_like_json(std::string_view head) {
  if (head.starts_with("\xEF\xBB\xBF")) head.remove_prefix(3);  // a byte order mark
  const std::size_t first = head.find_first_not_of(" \t\r\n");
  return first != std::string_view::npos && head[first] == '{';
}

GltfDocument open_gltf(const fs::path& file) {
  const FolderFiles folder(file);
  GltfDocument document;
  // By content, as whoever named the file need not have known; only what is neither is judged by its name.
  const std::string head = read_head(folder.file(), kHeader);
  const bool binary = document.binary =
      head.starts_with("glTF") || (!looks_like_json(head) && lower_extension(file) != ".gltf");
  std::string text;
  if (binary) {
    // Alone at first: what is wrong there is refused before the rest is in memory.
    const std::uintmax_t size = OpenFile(folder.file()).size();
    const std::size_t length = json_size(head, size, file.string());
    text = read_head(folder.file(), kHeader + length).substr(kHeader);
  } else {
    text = read_text(folder.file(), kMostInMemory);
  }
  check_json_depth(text, file.string(), "JSON");
  check_json_values(text, file.string(), kMostValues);
  try {
    document.json = nlohmann::json::parse(text);
  } catch (const nlohmann::json::parse_error& error) {
    throw InputError(file.string(), "JSON", fmt::format("byte {}: not valid JSON", error.byte),
                     "export the file again");
  } catch (const nlohmann::json::exception&) {
    throw InputError(file.string(), "JSON", "holds a number beyond all limits", "export the file again");
  }
  check_gltf(document.json, file.string());
  const std::size_t behind = kHeader + text.size() + kChunkHeader;  // where a .glb's data begin
  if (binary) {
    document.bytes = read_file(folder.file(), kMostInMemory);
    if (std::string_view(document.bytes).substr(std::min(kHeader, document.bytes.size()), text.size()) !=
        text)
      throw InputError(file.string(), "JSON", "changed while it was read", "try again");
  } else {
    document.bytes = std::move(text);
  }
  if (!document.json.contains("buffers")) return document;
  const nlohmann::json& buffers = document.json["buffers"];
  document.buffers.resize(buffers.size());
  std::size_t all = 0;
  for (std::size_t b = 0; b < buffers.size(); ++b) {
    const std::string field = fmt::format("buffers[{}]", b);
    const auto bad = [&](const std::string& problem) {
      throw InputError(file.string(), field, problem, "export the file again");
    };
    const auto length = buffers[b]["byteLength"].get<std::size_t>();
    if (length > kMostInMemory - std::min(all, kMostInMemory))
      bad(fmt::format("with those before it, holds more than {} bytes", kMostInMemory));
    all += length;
    if (!buffers[b].contains("uri")) {
      if (b > 0 || !binary) bad("has no uri and is not the first of a .glb");
      if (document.bytes.size() < behind || length > document.bytes.size() - behind)
        bad(fmt::format("{} bytes are more than the file holds", length));
      continue;
    }
    const auto uri = buffers[b]["uri"].get<std::string>();
    if (uri.starts_with("data:")) continue;
    const auto name = percent_decoded(uri);
    if (!name) bad("uri: is no well-formed URI");
    document.buffers[b] = folder.read(*name, field + ".uri", length);
    if (document.buffers[b].size() < length)
      bad(fmt::format("uri: the file has {} bytes of {}", document.buffers[b].size(), length));
  }
  return document;
}

}  // namespace mirage
