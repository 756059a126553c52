// The format of weights files, which is that of safetensors: the length of a JSON header (8 bytes), the
// header, and tensors one after the other as little-endian numbers. Without LibTorch, so that a fuzzer can
// read it quickly.
//
// A file may name other files in its folder, its parts, by name and SHA-256 ("parts" in "__metadata__", as
// sha256sum prints them): networks that share a frozen branch hold it once. A tensor that the file does not
// hold comes from the first part that holds it; only a part's own tensors count.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace mirage {

/// Bytes of the largest header: that of a training's checkpoint has 140 KB.
inline constexpr std::uint64_t kMaxHeaderBytes = std::uint64_t{1} << 19;
/// Parts that a file may name.
inline constexpr std::size_t kMaxParts = 8;

/// "F32", "F16", "F64" and "I64" in the header.
enum class Element { float32, float16, float64, int64 };
std::size_t element_size(Element element);

/// Row-major, little-endian; `data` is a view of memory.
struct StoredTensor {
  Element element = Element::float32;
  std::vector<std::int64_t> shape;
  std::string_view data;
};

using StoredTensors = std::map<std::string, StoredTensor, std::less<>>;
using Facts = std::map<std::string, std::string, std::less<>>;

/// A file's name, without a folder, and the SHA-256 of its bytes (64 hexadecimal digits).
struct NamedPart {
  std::string file, sha256;
};

struct TensorFile {
  Facts facts;                   ///< "__metadata__" without the parts
  std::vector<NamedPart> parts;  ///< in the order in which they are asked for a tensor
  StoredTensors tensors;         ///< by name; they point into the bytes that were read
};

/// The file with these bytes, which outlive it. std::runtime_error, in words for the user: a LibTorch archive
/// (then with the command that converts it); a header that is cut, larger than kMaxHeaderBytes, with a key
/// twice or not of this form; data that leave the file, overlap or leave a gap, or disagree with type and
/// shape; a floating-point value that is not finite; parts whose names hold a folder.
TensorFile parse_tensor_file(std::string_view bytes);

/// The bytes of a file with these tensors.
std::string tensor_file_bytes(const Facts& facts, const StoredTensors& tensors);

}  // namespace mirage
