// Decoding and encoding of picture files by plugins/pictures, which is loaded with the first picture. Its
// OpenImageIO brings along 230 libraries in Debian, and loading these takes longer than most commands that
// end without a picture.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace mirage {

/// The header of a picture file.
struct PictureHeader {
  int width = 0, height = 0, channels = 0;
  int x = 0, y = 0;                ///< of its first pixel, on its page
  int orientation = 1;             ///< EXIF's; 1: upright
  bool is_16_bit = false;          ///< 16-bit integers
  std::vector<std::string> names;  ///< of the channels
};

/// The type of pixel values in memory.
enum class PixelType { kByte, kWord, kFloat };

/// An open picture. If a function here or below fails, `error` says why, in several lines or none.
class PictureDecoder {
 public:
  PictureDecoder() = default;
  PictureDecoder(const PictureDecoder&) = delete;
  PictureDecoder& operator=(const PictureDecoder&) = delete;
  virtual ~PictureDecoder() = default;
  /// The file's header.
  virtual const PictureHeader& header() const = 0;
  /// All pixels, converted; `values` has room for width × height × channels. False if it fails.
  virtual bool read(PixelType type, void* values, std::string& error) = 0;
};

/// The plugin's table. Made by the same compiler as the program, so that C++ types can cross it.
struct PictureCodec {
  std::uint32_t abi_version;
  /// `format`: png, jpeg or openexr. Opens the file or, if `file` is empty, the bytes, which must outlive the
  /// decoder. Null if unreadable.
  std::unique_ptr<PictureDecoder> (*open)(const std::filesystem::path& file, std::string_view bytes,
                                          const std::string& format, std::string& error);
  /// A whole file; empty if it fails. `format`: png or exr. `shape` gives width, height and channels.
  std::string (*encode)(const std::string& format, const PictureHeader& shape, PixelType type,
                        const void* pixels, std::string& error);
};

/// plugins/pictures/picture_codec.cpp; exported as "mirage_pictures".
inline constexpr std::uint32_t kPictureCodec = 1;

}  // namespace mirage
