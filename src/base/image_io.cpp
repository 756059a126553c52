#include "base/image_io.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>

#include "base/error.h"
#include "base/files.h"
#include "base/srgb_bytes.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

std::unique_ptr<OIIO::ImageInput> open_image(const fs::path& path) {
  if (!fs::exists(path))
    throw InputError(path.string(), "", "no such image", "check the data set's image folder");
  auto input = OIIO::ImageInput::open(path.string());
  if (!input)
    throw InputError(path.string(), "header", "not a readable image (" + OIIO::geterror() + ")",
                     "restore the file from its source");
  return input;
}

[[noreturn]] void bad_pixels(const fs::path& path, const std::string& why) {
  throw InputError(path.string(), "pixels", "truncated or damaged (" + why + ")",
                   "restore the file from its source");
}

/// 8-bit sRGB pixels of an opened picture as scene-linear RGB.
ImageF read_linear(OIIO::ImageInput& input, const std::string& where, const std::string& field) {
  const OIIO::ImageSpec& spec = input.spec();
  std::vector<std::uint8_t> bytes(static_cast<std::size_t>(spec.width) * spec.height * spec.nchannels);
  if (!input.read_image(0, 0, 0, spec.nchannels, OIIO::TypeDesc::UINT8, bytes.data()))
    throw InputError(where, field, "truncated or damaged (" + input.geterror() + ")",
                     "restore the file from its source");
  ImageF image(spec.width, spec.height, 3);
  const std::size_t pixels = static_cast<std::size_t>(spec.width) * spec.height;
  for (std::size_t i = 0; i < pixels; ++i)
    for (int c = 0; c < 3; ++c)
      image.data[3 * i + c] = linear_level(bytes[i * spec.nchannels + (spec.nchannels >= 3 ? c : 0)]);
  return image;
}

template <class T>
void write_image(const fs::path& path, const Image<T>& shape, OIIO::TypeDesc type, const void* pixels) {
  // The extension picks the format, so it stays last in the temporary name.
  const fs::path temporary = path.parent_path() / (std::string(".") + path.stem().string() + "." +
                                                   std::to_string(getpid()) + path.extension().string());
  std::error_code ignored;
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), ignored);
  auto output = OIIO::ImageOutput::create(temporary.string());
  const OIIO::ImageSpec spec(shape.width, shape.height, shape.channels, type);
  const bool written = output && output->open(temporary.string(), spec) &&
                       output->write_image(type, pixels) && output->close();
  if (!written) {
    const std::string why = output ? output->geterror() : OIIO::geterror();
    output.reset();
    fs::remove(temporary, ignored);
    throw Failure(path.string(), "cannot be written (" + why + ")",
                  "free some space or choose another folder");
  }
  replace_file(temporary, path);
}

}  // namespace

ImageF read_srgb(const fs::path& path) {
  return read_linear(*open_image(path), path.string(), "pixels");
}

ImageF decode_srgb(std::string_view bytes, const std::string& where, const std::string& field) {
  OIIO::Filesystem::IOMemReader proxy(const_cast<char*>(bytes.data()), bytes.size());
  const char* name = bytes.starts_with("\xff\xd8") ? "memory.jpg" : "memory.png";
  auto input = OIIO::ImageInput::open(name, nullptr, &proxy);
  if (!input)
    throw InputError(where, field, "not a readable image (" + OIIO::geterror() + ")",
                     "give a PNG or JPEG picture");
  return read_linear(*input, where, field);
}

void write_srgb(const fs::path& path, const ImageF& linear) {
  write_image(path, linear, OIIO::TypeDesc::UINT8, srgb_bytes(linear).data());
}

std::string encode_srgb_png(const ImageF& linear) {
  std::vector<unsigned char> file;
  OIIO::Filesystem::IOVecOutput proxy(file);
  auto output = OIIO::ImageOutput::create("memory.png");
  const OIIO::ImageSpec spec(linear.width, linear.height, linear.channels, OIIO::TypeDesc::UINT8);
  if (!output) throw Failure("PNG encoder", OIIO::geterror(), "install OpenImageIO with PNG support");
  output->set_ioproxy(&proxy);
  if (!output->open("memory.png", spec) ||
      !output->write_image(OIIO::TypeDesc::UINT8, srgb_bytes(linear).data()) || !output->close())
    throw Failure("PNG encoder", output->geterror(), "report this as a bug");
  return {file.begin(), file.end()};
}

void read_image_size(const fs::path& path, int& width, int& height) {
  auto input = open_image(path);
  width = input->spec().width;
  height = input->spec().height;
}

void write_depth_png(const fs::path& path, const ImageF& depth) {
  std::vector<std::uint16_t> words(depth.data.size());
  for (std::size_t i = 0; i < words.size(); ++i)
    if (const float z = depth.data[i]; z > 0)
      words[i] = static_cast<std::uint16_t>(std::clamp(std::round(256 * std::min(z, 1e3f)), 1.f, 65535.f));
  write_image(path, depth, OIIO::TypeDesc::UINT16, words.data());
}

ImageF read_depth_png(const fs::path& path) {
  auto input = open_image(path);
  const OIIO::ImageSpec& spec = input->spec();
  if (spec.nchannels != 1 || spec.format != OIIO::TypeDesc::UINT16)
    throw InputError(path.string(), "header", "not a 16-bit grey picture",
                     "store depth as KITTI does: 16-bit PNG of 256 times the metres");
  std::vector<std::uint16_t> words(static_cast<std::size_t>(spec.width) * spec.height);
  if (!input->read_image(0, 0, 0, 1, OIIO::TypeDesc::UINT16, words.data()))
    bad_pixels(path, input->geterror());
  ImageF depth(spec.width, spec.height, 1);
  for (std::size_t i = 0; i < words.size(); ++i) depth.data[i] = static_cast<float>(words[i]) / 256;
  return depth;
}

void write_index_png(const fs::path& path, const Image<std::uint16_t>& indices) {
  write_image(path, indices, OIIO::TypeDesc::UINT16, indices.data.data());
}

Image<std::uint16_t> read_index_png(const fs::path& path) {
  auto input = open_image(path);
  const OIIO::ImageSpec& spec = input->spec();
  if (spec.nchannels != 1 || spec.format != OIIO::TypeDesc::UINT16)
    throw InputError(path.string(), "header", "not a 16-bit grey picture",
                     "store one 16-bit number a pixel, as mirage generate --truth does");
  Image<std::uint16_t> indices(spec.width, spec.height, 1);
  if (!input->read_image(0, 0, 0, 1, OIIO::TypeDesc::UINT16, indices.data.data()))
    bad_pixels(path, input->geterror());
  return indices;
}

ImageF read_exr(const fs::path& path) {
  auto input = open_image(path);
  const OIIO::ImageSpec& spec = input->spec();
  ImageF image(spec.width, spec.height, spec.nchannels);
  if (!input->read_image(0, 0, 0, spec.nchannels, OIIO::TypeDesc::FLOAT, image.data.data()))
    bad_pixels(path, input->geterror());
  return image;
}

void write_exr(const fs::path& path, const ImageF& image) {
  write_image(path, image, OIIO::TypeDesc::FLOAT, image.data.data());
}

}  // namespace mirage
