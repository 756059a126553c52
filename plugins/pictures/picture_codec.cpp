// Files of pictures by OpenImageIO (base/picture_codec.h).
#include "base/picture_codec.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <cstddef>

#include "base/sizes.h"

namespace mirage {
namespace {

OIIO::TypeDesc type_of(PixelType type) {
  return type == PixelType::kByte   ? OIIO::TypeDesc::UINT8
         : type == PixelType::kWord ? OIIO::TypeDesc::UINT16
                                    : OIIO::TypeDesc::FLOAT;
}

/// A file whose reads give all requested bytes, or the rest of the file: OpenImageIO's decoders take fewer
/// bytes, which a system call may give at any time, for a damaged picture.
class CompleteReads : public OIIO::Filesystem::IOFile {
 public:
  explicit CompleteReads(const std::string& path) : IOFile(path, Read) {}
  std::size_t pread(void* bytes, std::size_t size, std::int64_t offset) override {
    std::size_t read = 0;
    while (read < size) {
      const std::size_t more = IOFile::pread(static_cast<char*>(bytes) + read, size - read,
                                             offset + static_cast<std::int64_t>(read));
      if (more == 0 || more > size - read) break;  // its end, or −1 as a size
      read += more;
    }
    return read;
  }
};

class Decoder : public PictureDecoder {
 public:
  explicit Decoder(std::unique_ptr<OIIO::Filesystem::IOProxy> proxy) : proxy_(std::move(proxy)) {}

  /// False if it is not readable.
  bool open(const std::string& format, std::string& error) {
    input_ = OIIO::ImageInput::create(format);
    OIIO::ImageSpec ignored, config;
    config.attribute("oiio:UnassociatedAlpha", 1);  // otherwise a PNG's colours come multiplied by its alpha
    if (!input_ || !input_->set_ioproxy(proxy_.get()) ||
        !input_->open("picture." + format, ignored, config)) {
      error = input_ ? input_->geterror() : OIIO::geterror();
      return false;
    }
    const OIIO::ImageSpec& is = input_->spec();
    header_.width = is.width;
    header_.height = is.height;
    header_.channels = is.nchannels;
    header_.x = is.x;
    header_.y = is.y;
    header_.orientation = is.get_int_attribute("Orientation", 1);
    header_.is_16_bit = is.format == OIIO::TypeDesc::UINT16;
    header_.names = is.channelnames;
    return true;
  }
  const PictureHeader& header() const override { return header_; }
  bool read(PixelType pixels, void* values, std::string& error) override {
    // libjpeg fills up the missing part of a truncated or damaged file, and only warns.
    const bool decoded = decode(pixels, values) && !input_->has_error();
    if (!decoded) error = input_->geterror();
    return decoded;
  }

 private:
  /// OpenImageIO's own conversion sets 16 MB or more aside, however small the picture, so it is used only
  /// where needed: tiles, and channels of several types.
  bool decode(PixelType pixels, void* values) {
    const OIIO::ImageSpec& is = input_->spec();
    const OIIO::TypeDesc type = type_of(pixels);
    if (is.tile_width > 0 || !is.channelformats.empty())
      return input_->read_image(0, 0, 0, is.nchannels, type, values);
    const std::size_t count = as_size(is.width) * as_size(is.height) * as_size(is.nchannels);
    std::vector<std::byte> raw(is.format == type ? 0 : count * is.format.size());
    if (!input_->read_native_scanlines(0, 0, is.y, is.y + is.height, is.z, raw.empty() ? values : raw.data()))
      return false;
    if (!raw.empty())
      OIIO::convert_pixel_values(is.format, raw.data(), type, values, static_cast<int>(count));
    return true;
  }

  std::unique_ptr<OIIO::Filesystem::IOProxy> proxy_;  // outlives input_
  std::unique_ptr<OIIO::ImageInput> input_;
  PictureHeader header_;
};

std::unique_ptr<PictureDecoder> open_picture(const std::filesystem::path& file, std::string_view bytes,
                                             const std::string& format, std::string& error) {
  std::unique_ptr<OIIO::Filesystem::IOProxy> proxy;
  if (file.empty())
    proxy = std::make_unique<OIIO::Filesystem::IOMemReader>(const_cast<char*>(bytes.data()), bytes.size());
  else
    proxy = std::make_unique<CompleteReads>(file.string());
  auto decoder = std::make_unique<Decoder>(std::move(proxy));
  if (!decoder->open(format, error)) return nullptr;
  return decoder;
}

std::string encode(const std::string& format, const PictureHeader& shape, PixelType pixels,
                   const void* values, std::string& error) {
  const OIIO::TypeDesc type = type_of(pixels);
  std::vector<unsigned char> file;
  OIIO::Filesystem::IOVecOutput proxy(file);
  const auto output = OIIO::ImageOutput::create(format);
  const OIIO::ImageSpec spec(shape.width, shape.height, shape.channels, type);
  if (output && output->set_ioproxy(&proxy) && output->open("picture." + format, spec) &&
      output->write_image(type, values) && output->close())
    return {file.begin(), file.end()};
  error = output ? output->geterror() : OIIO::geterror();
  return "";
}

}  // namespace
}  // namespace mirage

extern "C" __attribute__((visibility("default"))) const mirage::PictureCodec* mirage_pictures() {
  static constexpr mirage::PictureCodec codec{mirage::kPictureCodec, mirage::open_picture, mirage::encode};
  return &codec;
}
