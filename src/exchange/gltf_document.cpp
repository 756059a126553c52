#include "exchange/gltf_document.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>

#include "base/error.h"
#include "base/file_head.h"
#include "base/files.h"
#include "base/json_depth.h"
#include "exchange/folder_files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kHeader = 20;  // bytes, with that of the first chunk

void check_magic(std::string_view bytes, const std::string& file) {
  if (!bytes.starts_with("glTF"))
    throw InputError(file, "magic", "is not \"glTF\"", "give a binary glTF 2.0 file (.glb)");
}

/// The JSON text of a .glb (its first chunk) or .gltf (all of it).
std::string_view json_text(const std::string& bytes, const std::string& file, bool binary) {
  if (!binary) return bytes;
  const auto fail = [&](const char* field, const std::string& problem, const char* fix) {
    throw InputError(file, field, problem, fix);
  };
  const auto u32 = [&](std::size_t at) {
    std::uint32_t value = 0;
    std::memcpy(&value, bytes.data() + at, sizeof value);
    return value;
  };
  if (bytes.size() < kHeader)
    fail("header", fmt::format("{} bytes are too few for a .glb file", bytes.size()),
         "export the file again");
  check_magic(bytes, file);
  if (u32(4) != 2) fail("version", fmt::format("{}", u32(4)), "give a glTF 2.0 file");
  if (u32(8) > bytes.size())
    fail("length", fmt::format("truncated: {} of {} bytes", bytes.size(), u32(8)),
         "restore the file or export it again");
  if (u32(16) != 0x4E4F534A || u32(12) > bytes.size() - kHeader)
    fail("JSON", "the first chunk is not whole", "restore the file or export it again");
  return std::string_view(bytes).substr(kHeader, u32(12));
}

/// Of a document: ours have some thousands, and numbers of vertices lie in buffers.
constexpr std::size_t kMostValues = 200000;
/// Of a file, and of all buffers together: a photograph and thirty objects of a million faces.
constexpr std::size_t kMostInMemory = std::size_t{1} << 28;

bool ends_with_glb(const fs::path& file) {
  std::string extension = file.extension().string();
  for (char& c : extension)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return extension != ".gltf";
}

}  // namespace

GltfDocument open_gltf(const fs::path& file) {
  const FolderFiles folder(file);
  GltfDocument document;
  const bool binary = document.binary = ends_with_glb(file);
  // Of another kind of file the first bytes are all that is read.
  if (const std::string head = binary ? read_head(folder.file(), kHeader) : ""; head.size() == kHeader)
    check_magic(head, file.string());
  document.bytes = read_file(folder.file(), kMostInMemory);
  const std::string_view text = json_text(document.bytes, file.string(), binary);
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
      if (document.bytes.size() < 28 + text.size() || length > document.bytes.size() - 28 - text.size())
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
