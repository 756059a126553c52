#include "tensor_file.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <utility>

#include "base/error.h"
#include "base/files.h"

namespace mirage {
namespace {

static_assert(std::endian::native == std::endian::little, "tensors are read and written as they lie");

constexpr const char* kFacts = "__metadata__";
constexpr const char* kParts = "parts";
constexpr std::size_t kLengthBytes = 8, kDigestDigits = 64;
/// Values in a header: some fifteen a tensor.
constexpr std::size_t kMaxValues = 60'000;
constexpr std::pair<const char*, Element> kElements[] = {
    {"F32", Element::float32}, {"F16", Element::float16}, {"F64", Element::float64}, {"I64", Element::int64}};

[[noreturn]] void unreadable(const std::string& why) {
  throw std::runtime_error("not a readable weights file (" + why +
                           "); restore it, or train anew with mirage train");
}

Element element_named(const nlohmann::json& word) {
  for (const auto& [name, element] : kElements)
    if (word == name) return element;
  unreadable("a tensor's dtype is not one of F32, F16, F64 and I64");
}

std::uint64_t whole_number(const nlohmann::json& value) {
  if (!value.is_number_unsigned()) unreadable("a size in its header is not a whole number");
  return value.get<std::uint64_t>();
}

/// Whether all bits of an exponent are set somewhere: infinity or no number.
template <class Word>
bool has_infinite(std::string_view data, Word exponent) {
  for (std::size_t at = 0; at < data.size(); at += sizeof(Word)) {
    Word word;
    std::memcpy(&word, data.data() + at, sizeof word);
    if ((word & exponent) == exponent) return true;
  }
  return false;
}

bool all_finite(const StoredTensor& tensor) {
  if (tensor.element == Element::float32) return !has_infinite<std::uint32_t>(tensor.data, 0x7f800000u);
  if (tensor.element == Element::float16) return !has_infinite<std::uint16_t>(tensor.data, 0x7c00u);
  if (tensor.element == Element::float64)
    return !has_infinite<std::uint64_t>(tensor.data, 0x7ff0000000000000u);
  return true;
}

bool is_plain_name(std::string_view name) {
  return !name.empty() && name.front() != '.' && name.size() < 256 &&
         std::all_of(name.begin(), name.end(), [](unsigned char c) {
           return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '.' ||
                  c == '-' || c == '_';
         });
}

/// Lines as sha256sum prints them: digest, two spaces, name.
std::vector<NamedPart> read_parts(std::string_view lines) {
  std::vector<NamedPart> parts;
  while (!lines.empty()) {
    const std::string_view line = lines.substr(0, lines.find('\n'));
    lines.remove_prefix(std::min(line.size() + 1, lines.size()));
    if (line.size() < kDigestDigits + 3 || line.find_first_not_of("0123456789abcdef") != kDigestDigits ||
        line.substr(kDigestDigits, 2) != "  " || !is_plain_name(line.substr(kDigestDigits + 2)) ||
        parts.size() == kMaxParts)
      unreadable("its parts are not at most " + std::to_string(kMaxParts) +
                 " lines of a SHA-256 and a file's name");
    parts.push_back(
        {std::string(line.substr(kDigestDigits + 2)), std::string(line.substr(0, kDigestDigits))});
  }
  return parts;
}

/// `data`: all bytes after the header.
StoredTensor read_tensor(const nlohmann::json& json, std::string_view data) {
  if (!json.is_object() || !json.contains("dtype") || !json.contains("shape") ||
      !json.contains("data_offsets") || json.size() != 3)
    unreadable("a tensor has other fields than dtype, shape and data_offsets");
  const nlohmann::json &shape = json.at("shape"), &offsets = json.at("data_offsets");
  if (!shape.is_array() || !offsets.is_array() || offsets.size() != 2)
    unreadable("a tensor's shape or data_offsets is not a list of sizes");
  const std::uint64_t begin = whole_number(offsets[0]), end = whole_number(offsets[1]);
  if (begin > end || end > data.size()) unreadable("a tensor lies outside of the file");
  StoredTensor tensor{element_named(json.at("dtype")), {}, data.substr(begin, end - begin)};
  // The product of the sizes so far is at most the bytes there are: it cannot overflow with the next one.
  std::uint64_t bytes = element_size(tensor.element);
  for (const nlohmann::json& side : shape) {
    const std::uint64_t size = whole_number(side);
    if (size == 0 || size > tensor.data.size() / bytes)
      unreadable("a tensor's shape is not that of its data");
    bytes *= size;
    tensor.shape.push_back(static_cast<std::int64_t>(size));
  }
  if (bytes != tensor.data.size()) unreadable("a tensor's shape is not that of its data");
  if (!all_finite(tensor))
    throw std::runtime_error(
        "weights that are not finite; restore the file, or train anew with mirage train");
  return tensor;
}

/// Each byte of the data belongs to one tensor.
void require_cover(const StoredTensors& tensors, std::string_view data) {
  std::vector<std::string_view> pieces;
  for (const auto& [name, tensor] : tensors) pieces.push_back(tensor.data);
  std::sort(pieces.begin(), pieces.end(),
            [](std::string_view a, std::string_view b) { return a.data() < b.data(); });
  const char* at = data.data();
  for (const std::string_view piece : pieces) {
    if (piece.data() != at) unreadable("tensors overlap or leave a gap");
    at += piece.size();
  }
  if (at != data.data() + data.size()) unreadable("bytes belong to no tensor");
}

/// Refuses repeated keys: a parser would keep the last value.
void require_single_keys(std::string_view text) {
  using Event = nlohmann::json::parse_event_t;
  std::vector<std::set<std::string>> open;  // the keys of each object around
  bool single = true;
  const nlohmann::json read = nlohmann::json::parse(text, [&](int, Event event, const nlohmann::json& value) {
    if (event == Event::object_start) open.emplace_back();
    if (event == Event::object_end) open.pop_back();
    if (event == Event::key) single = open.back().insert(value.get<std::string>()).second && single;
    return true;
  });
  if (read.is_discarded() || !single) unreadable("its header has a key twice");
}

nlohmann::json parse_header(std::string_view text) {
  try {
    check_json_values(text, "header", kMaxValues);
    nlohmann::json header = parse_json(text, "header");
    require_single_keys(text);
    return header;
  } catch (const InputError&) {
    unreadable("its header is not JSON");
  }
}

}  // namespace

std::size_t element_size(Element element) {
  return element == Element::float16 ? 2 : element == Element::float32 ? 4 : 8;
}

TensorFile parse_tensor_file(std::string_view bytes) {
  if (bytes.starts_with("PK\3\4"))
    throw std::runtime_error(
        "a LibTorch archive, not a weights file; convert weights of an earlier Mirage with: python3 "
        "convert_weights.py OLD NEW (beside the shipped weights). A TorchScript model is for --detector "
        "torchscript");
  if (bytes.size() < kLengthBytes) unreadable("it is too short");
  std::uint64_t length = 0;
  std::memcpy(&length, bytes.data(), sizeof length);
  if (length > kMaxHeaderBytes || length > bytes.size() - kLengthBytes ||
      bytes.substr(kLengthBytes, 1) != "{")
    unreadable("it does not begin with a header's length");
  const std::string_view data = bytes.substr(kLengthBytes + length);
  const nlohmann::json header = parse_header(bytes.substr(kLengthBytes, length));
  if (!header.is_object()) unreadable("its header is not a JSON object");
  TensorFile file;
  for (const auto& [name, value] : header.items()) {
    if (name != kFacts) {
      file.tensors.emplace(name, read_tensor(value, data));
      continue;
    }
    if (!value.is_object()) unreadable("its __metadata__ is not a JSON object");
    for (const auto& [key, text] : value.items()) {
      if (!text.is_string()) unreadable("its __metadata__ holds more than texts");
      if (key == kParts)
        file.parts = read_parts(text.get_ref<const std::string&>());
      else
        file.facts.emplace(key, text.get<std::string>());
    }
  }
  require_cover(file.tensors, data);
  return file;
}

std::string tensor_file_bytes(const Facts& facts, const StoredTensors& tensors) {
  nlohmann::json header = {{kFacts, facts}};
  std::uint64_t at = 0;
  for (const auto& [name, tensor] : tensors) {
    const auto* element =
        std::find_if(std::begin(kElements), std::end(kElements),
                     [&element = tensor.element](const auto& type) { return type.second == element; });
    header[name] = {
        {"dtype", element->first}, {"shape", tensor.shape}, {"data_offsets", {at, at + tensor.data.size()}}};
    at += tensor.data.size();
  }
  std::string text = header.dump();
  text.resize((text.size() + 7) / 8 * 8, ' ');  // data are aligned
  const std::uint64_t length = text.size();
  std::string bytes(reinterpret_cast<const char*>(&length), sizeof length);
  bytes.reserve(kLengthBytes + text.size() + at);
  bytes += text;
  for (const auto& [name, tensor] : tensors) bytes += tensor.data;
  return bytes;
}

}  // namespace mirage
