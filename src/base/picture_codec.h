// How the files of pictures are decoded and encoded: by plugins/pictures, which is loaded with the first one.
// Its OpenImageIO brings along 230 libraries in Debian, and loading these takes longer than most commands
// that end without a picture.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace mirage {

/// What a picture's file says before its pixels.
struct PictureHeader {
  int width = 0, height = 0, channels = 0;
  int x = 0, y = 0;                ///< of its first pixel, on its page
  int orientation = 1;             ///< EXIF's; 1: upright
  bool is_16_bit = false;          ///< whole numbers
  std::vector<std::string> names;  ///< of the channels
};

/// What pixels are in memory.
enum class PixelType { kByte, kWord, kFloat };

/// A picture that is open. Where a function fails, here and below, `error` says why, which may be several
/// lines or nothing.
class PictureDecoder {
 public:
  PictureDecoder() = default;
  PictureDecoder(const PictureDecoder&) = delete;
  PictureDecoder& operator=(const PictureDecoder&) = delete;
  virtual ~PictureDecoder() = default;
  /// As the file says.
  virtual const PictureHeader& header() const = 0;
  /// All pixels, converted; `values` has room for width × height × channels. False if it fails.
  virtual bool read(PixelType type, void* values, std::string& error) = 0;
};

/// The plugin's table. Made by the same compiler as the program, so that C++ passes through it.
struct PictureCodec {
  std::uint32_t abi_version;
  /// `format`: png, jpeg or openexr. Of the file or, where that is empty, of the bytes, which outlive what is
  /// returned. Null if it is not readable.
  std::unique_ptr<PictureDecoder> (*open)(const std::filesystem::path& file, std::string_view bytes,
                                          const std::string& format, std::string& error);
  /// A whole file; empty if it fails. `format`: png or exr; `shape`: width, height and channels are read.
  std::string (*encode)(const std::string& format, const PictureHeader& shape, PixelType type,
                        const void* pixels, std::string& error);
};

/// plugins/pictures/picture_codec.cpp; exported as "mirage_pictures".
inline constexpr std::uint32_t kPictureCodec = 1;

}  // namespace mirage
