#include "base/image.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <memory>

#include "base/error.h"
#include "base/files.h"

namespace mirage {

namespace {

std::uint8_t level_of(float linear) {
  return static_cast<std::uint8_t>(std::lround(255 * srgb_from_linear(linear)));
}

/// level_of as a table that is looked up without a branch, by a value's sign, exponent and upper eight bits
/// of the mantissa. Values of an entry have two levels at most: it holds the lower one times 2^16, and so
/// much more that with the other bits of the first value of the upper level it carries over.
class LevelTable {
 public:
  LevelTable() : entries_(std::size_t{1} << (32 - kShift)) {
    for (std::uint32_t i = kWhite >> kShift; i <= kInfinity >> kShift; ++i) entries_[i] = 255u << 16;
    for (std::uint32_t i = kDark >> kShift; i < kWhite >> kShift; ++i) {
      const std::uint32_t first = i << kShift, level = level_of(std::bit_cast<float>(first));
      std::uint32_t low = first, high = first + (1u << kShift);
      while (low < high) {  // the first value of another level
        const std::uint32_t middle = low + (high - low) / 2;
        if (level_of(std::bit_cast<float>(middle)) == level)
          low = middle + 1;
        else
          high = middle;
      }
      entries_[i] = (level << 16) + (1u << 16) - (low - first);
    }
  }
  const std::uint32_t* data() const { return entries_.data(); }
  static constexpr int kShift = 15;

 private:
  // 6e-5, which is level 0 yet; 1; infinity.
  static constexpr std::uint32_t kDark = 0x38800000, kWhite = 0x3f800000, kInfinity = 0x7f800000;
  std::vector<std::uint32_t> entries_;
};

using File = OIIO::Filesystem::IOProxy;

/// As much of the file from `at` on as there is, at most `window`.
template <std::size_t N>
std::string_view read_at(File& file, std::size_t at, char (&window)[N]) {
  return {window, file.pread(window, N, static_cast<std::int64_t>(at))};
}

/// OpenEXR sets aside what an attribute of the header claims before it reads it.
std::string exr_claim(File& file) {
  constexpr std::size_t kHead = 8, kMaxNamesLength = 2 * 256;
  constexpr unsigned char kManyParts = 0x10;  // of the version's second byte
  const std::size_t size = file.size();
  char window[kMaxNamesLength + 4] = {};
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
    for (int i = 3; i >= 0; --i)
      claimed = claimed << 8 | static_cast<unsigned char>(text[type + 1 + as_size(i)]);
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
  constexpr std::size_t kSignature = 8, kCheckSum = 4, kMaxTexts = 1 << 12;
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
    if (texts > kMaxTexts)
      return fmt::format("has more than {} bytes of compressed texts, which nothing here needs", kMaxTexts);
    at += claimed + kCheckSum;
  }
  return "";
}

namespace fs = std::filesystem;

constexpr const char* kRestore = "restore the file from its source";
constexpr std::int64_t kMaxImageOrigin = 1 << 20;  // px

/// The format by a file's first bytes; OpenImageIO would go by the name and then try everything that it
/// knows, down to film and raw formats.
const char* format_of(std::string_view head) {
  if (head.starts_with("\x89PNG")) return "png";
  if (head.starts_with("\xff\xd8")) return "jpeg";
  if (head.starts_with("\x76\x2f\x31\x01")) return "openexr";
  return nullptr;
}

/// What OpenImageIO says, on the same line; it may be several lines or nothing.
std::string reason(std::string text) {
  std::replace(text.begin(), text.end(), '\n', ' ');
  return text.empty() ? "" : " (" + text + ")";
}

/// A file whose reads give all that was asked for, or what is left of it: OpenImageIO's decoders take fewer
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

/// A picture with its header read and judged; nothing is decoded or reserved before.
class Picture {
 public:
  Picture(const fs::path& path, PictureSize expected) : Picture(path.string(), "header", nullptr) {
    if (!fs::is_regular_file(path))
      throw InputError(path.string(), "", fs::exists(path) ? "is no regular file" : "no such image",
                       "check the data set's image folder");
    auto file = std::make_unique<CompleteReads>(path.string());
    if (!file->opened()) throw InputError(path.string(), "", "cannot be opened", "check its permissions");
    proxy_ = std::move(file);
    open(expected);
  }
  Picture(std::string_view bytes, const std::string& where, const std::string& field, PictureSize expected)
      : Picture(
            where, field,
            std::make_unique<OIIO::Filesystem::IOMemReader>(const_cast<char*>(bytes.data()), bytes.size())) {
    open(expected);
  }

  const OIIO::ImageSpec& spec() const { return input_->spec(); }
  std::size_t pixels() const { return as_size(spec().width) * as_size(spec().height); }
  bool is_grey16() const { return spec().nchannels == 1 && spec().format == OIIO::TypeDesc::UINT16; }
  /// All of them, converted; `values` has room for pixels() × channels. OpenImageIO's own conversion sets 16
  /// MB or more aside, however small the picture, so it is left to what needs it: tiles, and channels of
  /// several types.
  void read(OIIO::TypeDesc type, void* values) {
    const OIIO::ImageSpec& is = spec();
    if (is.tile_width > 0 || !is.channelformats.empty())
      return check(input_->read_image(0, 0, 0, is.nchannels, type, values));
    const std::size_t count = pixels() * as_size(is.nchannels);
    std::vector<std::byte> raw(is.format == type ? 0 : count * is.format.size());
    check(
        input_->read_native_scanlines(0, 0, is.y, is.y + is.height, is.z, raw.empty() ? values : raw.data()));
    if (!raw.empty())
      OIIO::convert_pixel_values(is.format, raw.data(), type, values, static_cast<int>(count));
  }

 private:
  Picture(std::string where, std::string field, std::unique_ptr<OIIO::Filesystem::IOProxy> proxy)
      : where_(std::move(where)), field_(std::move(field)), proxy_(std::move(proxy)) {}

  void check(bool decoded) {
    if (!decoded)
      throw InputError(where_, field_ == "header" ? "pixels" : field_,
                       "truncated or damaged" + reason(input_->geterror()), kRestore);
  }

  [[noreturn]] void bad(const std::string& problem, const std::string& fix = kRestore) const {
    throw InputError(where_, field_, problem, fix);
  }

  void open(PictureSize expected) {
    char head[4] = {};
    const std::size_t size = proxy_->size();
    const std::size_t read = proxy_->pread(head, sizeof head, 0);
    const char* format = format_of(std::string_view(head, read));
    if (!format) bad("is no PNG, JPEG or EXR picture", "give one of these");
    const std::string claim = format == std::string_view("openexr") ? exr_claim(*proxy_)
                              : format == std::string_view("png")   ? png_claim(*proxy_)
                                                                    : "";
    if (!claim.empty()) bad(claim);
    input_ = OIIO::ImageInput::create(format);
    OIIO::ImageSpec ignored, config;
    config.attribute("oiio:UnassociatedAlpha", 1);  // else a PNG's colours come multiplied by its alpha
    if (!input_ || !input_->set_ioproxy(proxy_.get()) ||
        !input_->open(std::string("picture.") + format, ignored, config))
      bad("not a readable image" + reason(input_ ? input_->geterror() : OIIO::geterror()));
    if (const int turned = spec().get_int_attribute("Orientation", 1); turned > 1 && turned <= 8)
      bad(fmt::format("its EXIF orientation {} asks viewers to turn or mirror it", turned),
          "store its pixels upright (exiftran -ai, or mogrify -auto-orient)");
    const int width = spec().width, height = spec().height, channels = spec().nchannels;
    const std::string claims = fmt::format("claims {}×{} pixels", width, height);
    if (width < 1 || height < 1 || channels < 1 || pixels() > kMaxPixels ||
        pixels() * as_size(channels) > 4 * kMaxPixels)
      bad(fmt::format("{}, {} channels; more than {} pixels are not read", claims, channels, kMaxPixels),
          "give a smaller picture");
    if (expected.width > 0 && (width != expected.width || height != expected.height))
      bad(fmt::format("is {}×{}, the camera {}×{}", width, height, expected.width, expected.height),
          "give the picture that belongs to the calibration");
    // Where the picture lies on a page does not matter, but that its last line has a number.
    if (std::max(std::abs(std::int64_t{spec().x}), std::abs(std::int64_t{spec().y})) > kMaxImageOrigin)
      bad(fmt::format("claims to begin at pixel ({}, {})", spec().x, spec().y));
    // Deflate packs at most 1032 bytes into one.
    if (std::string_view(format) == "png" && pixels() * png_bits_a_pixel() / 8 / 1032 > size)
      bad(fmt::format("{}, which {} bytes cannot hold", claims, size));
  }

  /// By the file's header (PNG, 3rd edition, section 11.2.1), which libpng has checked; 1 at least.
  std::size_t png_bits_a_pixel() const {
    constexpr std::size_t kDepth = 24, kColourType = 25;
    std::array<unsigned char, kColourType + 1> head{};
    if (proxy_->pread(head.data(), head.size(), 0) != head.size()) return 1;
    constexpr std::array<std::size_t, 7> kSamples = {1, 0, 3, 1, 2, 0, 4};
    const std::size_t samples = head[kColourType] < kSamples.size() ? kSamples[head[kColourType]] : 1;
    return std::max<std::size_t>(1, samples * head[kDepth]);
  }

  std::string where_, field_;
  std::unique_ptr<OIIO::Filesystem::IOProxy> proxy_;  // outlives input_
  std::unique_ptr<OIIO::ImageInput> input_;
};

/// 8-bit sRGB pixels as scene-linear RGB.
ImageF read_linear(Picture picture) {
  const OIIO::ImageSpec& spec = picture.spec();
  const int channels = spec.nchannels;
  std::vector<std::uint8_t> bytes(picture.pixels() * as_size(channels));
  picture.read(OIIO::TypeDesc::UINT8, bytes.data());
  ImageF image(spec.width, spec.height, 3);
  for (std::size_t i = 0; i < picture.pixels(); ++i)
    for (std::size_t c = 0; c < 3; ++c)
      image.data[3 * i + c] = linear_level(bytes[i * as_size(channels) + (channels >= 3 ? c : 0)]);
  return image;
}

/// The whole file in memory: a disk that is full can then spoil nothing but the writing of it, which is
/// checked.
template <class T>
std::string encoded(const std::string& format, const Image<T>& shape, OIIO::TypeDesc type,
                    const void* pixels) {
  std::vector<unsigned char> file;
  OIIO::Filesystem::IOVecOutput proxy(file);
  auto output = OIIO::ImageOutput::create(format);
  const OIIO::ImageSpec spec(shape.width, shape.height, shape.channels, type);
  if (!output || !output->set_ioproxy(&proxy) || !output->open("picture." + format, spec) ||
      !output->write_image(type, pixels) || !output->close())
    throw Failure(format + " encoder", output ? output->geterror() : OIIO::geterror(),
                  "install OpenImageIO with PNG and EXR support");
  return {file.begin(), file.end()};
}

}  // namespace

void write_srgb_bytes(std::span<const float> linear, std::uint8_t* bytes) {
  static const LevelTable table;
  const std::uint32_t* entries = table.data();
  constexpr std::uint32_t kRest = (1u << LevelTable::kShift) - 1;
  for (std::size_t i = 0; i < linear.size(); ++i) {
    const auto bits = std::bit_cast<std::uint32_t>(linear[i]);
    bytes[i] = static_cast<std::uint8_t>((entries[bits >> LevelTable::kShift] + (bits & kRest)) >> 16);
  }
}

std::vector<std::uint8_t> srgb_bytes(const ImageF& linear) {
  std::vector<std::uint8_t> bytes(linear.data.size());
  write_srgb_bytes(linear.data, bytes.data());
  return bytes;
}

void through_srgb_slope(std::span<const std::uint8_t> levels, std::span<float> gradient) {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> slopes{};
    for (std::size_t i = 0; i < slopes.size(); ++i) {
      const float linear = linear_level(static_cast<std::uint8_t>(i));
      slopes[i] = 255 * (linear <= 0.0031308f ? 12.92f : 1.055f / 2.4f * std::pow(linear, 1 / 2.4f - 1));
    }
    return slopes;
  }();
  const float* slopes = table.data();
  for (std::size_t i = 0; i < gradient.size(); ++i) gradient[i] *= slopes[levels[i]];
}

float linear_level(std::uint8_t level) {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> values{};
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = linear_from_srgb(static_cast<float>(i) / 255);
    return values;
  }();
  return table[level];
}

ImageF linear_image(std::span<const std::uint8_t> bytes, int width, int height) {
  ImageF image(width, height, 3);
  for (std::size_t i = 0; i < bytes.size(); ++i) image.data[i] = linear_level(bytes[i]);
  return image;
}

ImageF read_srgb(const fs::path& path, PictureSize expected) {
  return read_linear(Picture(path, expected));
}

ImageF decode_srgb(std::string_view bytes, const std::string& where, const std::string& field,
                   PictureSize expected) {
  return read_linear(Picture(bytes, where, field, expected));
}

void write_srgb(const fs::path& path, const ImageF& linear) {
  write_file(path, encode_srgb_png(linear));
}

std::string encode_srgb_png(const ImageF& linear) {
  return encoded("png", linear, OIIO::TypeDesc::UINT8, srgb_bytes(linear).data());
}

void read_image_size(const fs::path& path, int& width, int& height) {
  const Picture picture(path, {});
  width = picture.spec().width;
  height = picture.spec().height;
}

void write_depth_png(const fs::path& path, const ImageF& depth) {
  std::vector<std::uint16_t> words(depth.data.size());
  for (std::size_t i = 0; i < words.size(); ++i)
    if (const float z = depth.data[i]; z > 0)
      words[i] = static_cast<std::uint16_t>(std::clamp(std::round(256 * std::min(z, 1e3f)), 1.f, 65535.f));
  write_file(path, encoded("png", depth, OIIO::TypeDesc::UINT16, words.data()));
}

ImageF read_depth_png(const fs::path& path) {
  Picture picture(path, {});
  if (!picture.is_grey16())
    throw InputError(path.string(), "header", "not a 16-bit grey picture",
                     "store depth as KITTI does: 16-bit PNG of 256 times the metres");
  std::vector<std::uint16_t> words(picture.pixels());
  picture.read(OIIO::TypeDesc::UINT16, words.data());
  ImageF depth(picture.spec().width, picture.spec().height, 1);
  for (std::size_t i = 0; i < words.size(); ++i) depth.data[i] = static_cast<float>(words[i]) / 256;
  return depth;
}

void write_index_png(const fs::path& path, const Image<std::uint16_t>& indices) {
  write_file(path, encoded("png", indices, OIIO::TypeDesc::UINT16, indices.data.data()));
}

Image<std::uint16_t> read_index_png(const fs::path& path) {
  Picture picture(path, {});
  if (!picture.is_grey16())
    throw InputError(path.string(), "header", "not a 16-bit grey picture",
                     "store one 16-bit number a pixel, as mirage generate --truth does");
  Image<std::uint16_t> indices(picture.spec().width, picture.spec().height, 1);
  picture.read(OIIO::TypeDesc::UINT16, indices.data.data());
  return indices;
}

ImageF read_exr(const fs::path& path) {
  Picture picture(path, {});
  const OIIO::ImageSpec& spec = picture.spec();
  ImageF image(spec.width, spec.height, spec.nchannels);
  picture.read(OIIO::TypeDesc::FLOAT, image.data.data());
  return image;
}

void write_exr(const fs::path& path, const ImageF& image) {
  write_file(path, encoded("exr", image, OIIO::TypeDesc::FLOAT, image.data.data()));
}

}  // namespace mirage
