#include "base/image.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <memory>

#include "base/error.h"
#include "base/files.h"
#include "base/picture_codec.h"
#include "base/plugins.h"

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

/// The bytes of a file, or of memory.
class Bytes {
 public:
  explicit Bytes(std::string_view memory) : memory_(memory) {}
  explicit Bytes(const std::filesystem::path& file) : file_(::open(file.c_str(), O_RDONLY | O_CLOEXEC)) {}
  Bytes(const Bytes&) = delete;
  Bytes& operator=(const Bytes&) = delete;
  ~Bytes() {
    if (file_ >= 0) ::close(file_);
  }
  bool is_open() const { return memory_.data() || file_ >= 0; }
  std::size_t size() const {
    struct stat status {};
    return memory_.data() ? memory_.size() : ::fstat(file_, &status) == 0 ? as_size(status.st_size) : 0;
  }
  /// Reads up to `size` bytes from `at` on.
  std::size_t read(char* to, std::size_t size, std::size_t at) const {
    if (memory_.data()) {
      const std::string_view part = memory_.substr(std::min(at, memory_.size()), size);
      std::copy(part.begin(), part.end(), to);
      return part.size();
    }
    std::size_t done = 0;
    while (done < size) {
      const ssize_t more = ::pread(file_, to + done, size - done, static_cast<off_t>(at + done));
      if (more < 0 && errno == EINTR) continue;
      if (more <= 0) break;
      done += as_size(more);
    }
    return done;
  }

 private:
  std::string_view memory_;
  int file_ = -1;
};

/// As much from `at` on as there is, at most `window`.
template <std::size_t N>
std::string_view read_at(const Bytes& file, std::size_t at, char (&window)[N]) {
  return {window, file.read(window, N, at)};
}

/// OpenEXR allocates the size that a header attribute claims before it reads the attribute.
std::string exr_claim(const Bytes& file) {
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
bool is_compressed(const Bytes& file, std::size_t at) {
  char keyword[81] = {};
  const std::string_view text = read_at(file, at, keyword);
  const std::size_t end = text.find('\0');
  return end + 1 < text.size() && text[end + 1] != 0;
}

/// libpng allocates the size that a chunk claims, except for pixels, which it reads piece by piece. It also
/// allocates decompressed texts, which can be a thousand times larger.
std::string png_claim(const Bytes& file) {
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

/// By the file's header (PNG, 3rd edition, section 11.2.1), which libpng has checked; 1 at least.
std::size_t png_bits_a_pixel(const Bytes& file) {
  constexpr std::size_t kDepth = 24, kColourType = 25;
  char head[kColourType + 1] = {};
  if (read_at(file, 0, head).size() != sizeof head) return 1;
  constexpr std::array<std::size_t, 7> kSamples = {1, 0, 3, 1, 2, 0, 4};
  const std::size_t colour = static_cast<unsigned char>(head[kColourType]),
                    depth = static_cast<unsigned char>(head[kDepth]);
  return std::max<std::size_t>(1, (colour < kSamples.size() ? kSamples[colour] : 1) * depth);
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

/// OpenImageIO's message in brackets, if there is one.
std::string reason(const std::string& text) {
  return text.empty() ? "" : " (" + text + ")";
}

/// The plugin, loaded at the first call.
const PictureCodec& codec() {
  static const PictureCodec* const plugin = [] {
    const fs::path beside = built_file("plugins/pictures.so");
    // Not beside somebody else's program, which knows by its run path where Mirage is installed.
    return open_plugin<PictureCodec>(fs::exists(beside) ? beside : beside.filename(), "mirage_pictures",
                                     "base/picture_codec.h", {kPictureCodec});
  }();
  return *plugin;
}

/// A picture with its header read and judged; nothing is decoded or reserved before.
class Picture {
 public:
  Picture(const fs::path& path, PictureSize expected) : Picture(path.string(), "header") {
    if (!fs::is_regular_file(path))
      throw InputError(path.string(), "", fs::exists(path) ? "is not a regular file" : "no such image",
                       "check the data set's image folder");
    const Bytes bytes(path);
    if (!bytes.is_open()) throw InputError(path.string(), "", "cannot be opened", "check its permissions");
    open(bytes, path, {}, expected);
  }
  Picture(std::string_view bytes, const std::string& where, const std::string& field, PictureSize expected)
      : Picture(where, field) {
    open(Bytes(bytes), {}, bytes, expected);
  }

  const PictureHeader& header() const { return decoder_->header(); }
  std::size_t pixels() const { return as_size(header().width) * as_size(header().height); }
  /// All pixels, converted; `values` has room for pixels() × channels.
  void read(PixelType type, void* values) {
    std::string error;
    if (!decoder_->read(type, values, error))
      throw InputError(where_, field_ == "header" ? "pixels" : field_, "truncated or damaged" + reason(error),
                       kRestore);
  }

 private:
  Picture(std::string where, std::string field) : where_(std::move(where)), field_(std::move(field)) {}

  [[noreturn]] void bad(const std::string& problem, const std::string& fix = kRestore) const {
    throw InputError(where_, field_, problem, fix);
  }

  /// Opens a file, or bytes in memory.
  void open(const Bytes& file, const fs::path& path, std::string_view bytes, PictureSize expected) {
    char head[4] = {};
    const char* format = format_of(read_at(file, 0, head));
    if (!format) bad("is not a PNG, JPEG or EXR picture", "give one of these");
    const std::string claim = format == std::string_view("openexr") ? exr_claim(file)
                              : format == std::string_view("png")   ? png_claim(file)
                                                                    : "";
    if (!claim.empty()) bad(claim);
    std::string error;
    decoder_ = codec().open(path, bytes, format, error);
    if (!decoder_) bad("not a readable image" + reason(error));
    const auto& [width, height, channels, x, y, orientation, is_16_bit, names] = header();
    if (orientation > 1 && orientation <= 8)
      bad(fmt::format("its EXIF orientation {} asks viewers to turn or mirror it", orientation),
          "store its pixels upright (exiftran -ai, or mogrify -auto-orient)");
    const std::string claims = fmt::format("claims {}×{} pixels", width, height);
    if (width < 1 || height < 1 || channels < 1 || pixels() > kMaxPixels ||
        pixels() * as_size(channels) > 4 * kMaxPixels)
      bad(fmt::format("{}, {} channels; more than {} pixels are not read", claims, channels, kMaxPixels),
          "give a smaller picture");
    if (expected.width > 0 && (width != expected.width || height != expected.height))
      bad(fmt::format("is {}×{}, the camera {}×{}", width, height, expected.width, expected.height),
          "give the picture that belongs to the calibration");
    // A picture's place on its page does not matter, but its last line must have a valid number.
    if (std::max(std::abs(std::int64_t{x}), std::abs(std::int64_t{y})) > kMaxImageOrigin)
      bad(fmt::format("claims to begin at pixel ({}, {})", x, y));
    // Deflate packs at most 1032 bytes into one.
    if (const std::size_t size = file.size();
        format == std::string_view("png") && pixels() * png_bits_a_pixel(file) / 8 / 1032 > size)
      bad(fmt::format("{}, which {} bytes cannot hold", claims, size));
  }

  std::string where_, field_;
  std::unique_ptr<PictureDecoder> decoder_;
};

/// 8-bit sRGB pixels as scene-linear RGB.
ImageF read_linear(Picture picture) {
  const int channels = picture.header().channels;
  std::vector<std::uint8_t> bytes(picture.pixels() * as_size(channels));
  picture.read(PixelType::kByte, bytes.data());
  ImageF image(picture.header().width, picture.header().height, 3);
  for (std::size_t i = 0; i < picture.pixels(); ++i)
    for (std::size_t c = 0; c < 3; ++c)
      image.data[3 * i + c] = linear_level(bytes[i * as_size(channels) + (channels >= 3 ? c : 0)]);
  return image;
}

/// A picture of one channel of 16-bit numbers.
Image<std::uint16_t> read_words(const fs::path& path, const char* fix) {
  Picture picture(path, {});
  const PictureHeader& is = picture.header();
  if (is.channels != 1 || !is.is_16_bit)
    throw InputError(path.string(), "header", "not a 16-bit grey picture", fix);
  Image<std::uint16_t> words(is.width, is.height, 1);
  picture.read(PixelType::kWord, words.data.data());
  return words;
}

/// The whole file in memory: a disk that is full can then spoil nothing but the writing of it, which is
/// checked.
template <class T>
std::string encoded(const std::string& format, const Image<T>& shape, PixelType type, const void* pixels) {
  PictureHeader header;
  header.width = shape.width;
  header.height = shape.height;
  header.channels = shape.channels;
  std::string error;
  std::string file = codec().encode(format, header, type, pixels, error);
  if (file.empty()) throw Failure(format + " encoder", error, "install OpenImageIO with PNG and EXR support");
  return file;
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
  return encoded("png", linear, PixelType::kByte, srgb_bytes(linear).data());
}

PictureSize read_image_size(const fs::path& path) {
  const Picture picture(path, {});
  return {picture.header().width, picture.header().height};
}

void write_depth_png(const fs::path& path, const ImageF& depth) {
  std::vector<std::uint16_t> words(depth.data.size());
  for (std::size_t i = 0; i < words.size(); ++i)
    if (const float z = depth.data[i]; z > 0)
      words[i] = static_cast<std::uint16_t>(std::clamp(std::round(256 * std::min(z, 1e3f)), 1.f, 65535.f));
  write_file(path, encoded("png", depth, PixelType::kWord, words.data()));
}

ImageF read_depth_png(const fs::path& path) {
  const Image<std::uint16_t> words =
      read_words(path, "store depth as KITTI does: 16-bit PNG of 256 times the metres");
  ImageF depth(words.width, words.height, 1);
  for (std::size_t i = 0; i < words.data.size(); ++i) depth.data[i] = static_cast<float>(words.data[i]) / 256;
  return depth;
}

void write_index_png(const fs::path& path, const Image<std::uint16_t>& indices) {
  write_file(path, encoded("png", indices, PixelType::kWord, indices.data.data()));
}

Image<std::uint16_t> read_index_png(const fs::path& path) {
  return read_words(path, "store one 16-bit number a pixel, as mirage generate --truth does");
}

ImageF read_exr(const fs::path& path, PictureSize expected, std::vector<std::string>* names) {
  Picture picture(path, expected);
  ImageF image(picture.header().width, picture.header().height, picture.header().channels);
  picture.read(PixelType::kFloat, image.data.data());
  if (names) *names = picture.header().names;
  return image;
}

void write_exr(const fs::path& path, const ImageF& image) {
  write_file(path, encoded("exr", image, PixelType::kFloat, image.data.data()));
}

}  // namespace mirage
