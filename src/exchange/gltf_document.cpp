#include "exchange/gltf_document.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <utility>

#include "base/error.h"
#include "base/files.h"
#include "base/json_depth.h"
#include "base/open_file.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

const char* kCheckPath = "check the path and its permissions";
const char* kPutBeside = "put it beside the file that names it";

/// The first `most` bytes of a regular file, opened without following a link at its end and without waiting.
std::string read_regular_file(const fs::path& file, std::size_t most) {
  const int handle = ::open(file.c_str(), O_RDONLY | O_NONBLOCK | O_NOFOLLOW | O_CLOEXEC);
  struct stat about {};
  if (handle < 0 || ::fstat(handle, &about) != 0 || !S_ISREG(about.st_mode)) {
    const std::string reason = handle < 0 ? std::strerror(errno) : "is no regular file";
    if (handle >= 0) ::close(handle);
    throw InputError(file.string(), "", reason, kCheckPath);
  }
  std::string bytes(std::min(most, static_cast<std::size_t>(about.st_size)), '\0');
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::read(handle, bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    done += static_cast<std::size_t>(n);
  }
  const int reason = errno;
  ::close(handle);
  if (done < bytes.size()) throw InputError(file.string(), "", std::strerror(reason), kCheckPath);
  return bytes;
}

}  // namespace

FolderFiles::FolderFiles(const fs::path& file) : given_(file) {
  std::error_code error;
  file_ = fs::canonical(file, error);
  if (error) throw InputError(file.string(), "", error.message(), kCheckPath);
  if (!fs::is_regular_file(file_, error))
    throw InputError(file.string(), "", "is no regular file", "give the mesh or scene as a file");
  // Of the path as given: a link to a file elsewhere stands for a file in the link's own folder.
  folder_ = fs::canonical(fs::absolute(file).parent_path(), error);
  if (error) throw InputError(file.string(), "", error.message(), kCheckPath);
}

fs::path FolderFiles::find(const std::string& name, const std::string& field) const {
  const auto bad = [&](const char* problem) {
    return InputError(given_.string(), field, problem, kPutBeside);
  };
  if (name.empty() || name.find('\0') != std::string::npos) throw bad("names no file");
  std::error_code error;
  const fs::path path = fs::canonical(folder_ / name, error);  // an absolute name replaces the folder
  const bool inside =
      !error &&
      std::mismatch(folder_.begin(), folder_.end(), path.begin(), path.end()).first == folder_.end();
  // One answer for both: whether a file exists elsewhere is no business of the naming file's author.
  if (!inside) throw bad("names a file that is not in its folder");
  if (!fs::is_regular_file(path, error)) throw bad("names something that is no regular file");
  return path;
}

std::string FolderFiles::read(const std::string& name, const std::string& field, std::size_t most) const {
  const fs::path path = find(name, field);
  try {
    return read_regular_file(path, most);
  } catch (const InputError&) {
    throw InputError(given_.string(), field, "names a file that cannot be read", "check its permissions");
  }
}

std::string lower_extension(const fs::path& file) {
  std::string extension = file.extension().string();
  for (char& c : extension)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return extension;
}

std::optional<std::string> percent_decoded(const std::string& uri) {
  const auto digit = [](char c) {
    if (c >= '0' && c <= '9') return c - '0';
    const char lower = static_cast<char>(c | 0x20);
    return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
  };
  std::string text;
  for (std::size_t i = 0; i < uri.size(); ++i) {
    if (uri[i] != '%') {
      text.push_back(uri[i]);
      continue;
    }
    if (i + 2 >= uri.size()) return std::nullopt;
    const int high = digit(uri[i + 1]), low = digit(uri[i + 2]);
    if (high < 0 || low < 0 || high + low == 0) return std::nullopt;
    text.push_back(static_cast<char>(16 * high + low));
    i += 2;
  }
  return text;
}

namespace {

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
