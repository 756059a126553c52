// Pictures of other programs, as OpenImageIO itself writes them.
#include <OpenImageIO/imageio.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/sizes.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

void write_with(const std::filesystem::path& file, int channels, const std::vector<std::uint8_t>& pixel,
                int orientation) {
  OIIO::ImageSpec spec(4, 3, channels, OIIO::TypeDesc::UINT8);
  spec.attribute("oiio:UnassociatedAlpha", 1);
  if (channels % 2 == 0) spec.alpha_channel = channels - 1;
  if (orientation > 0) spec.attribute("Orientation", orientation);
  std::vector<std::uint8_t> pixels;
  for (int i = 0; i < 12; ++i) pixels.insert(pixels.end(), pixel.begin(), pixel.end());
  auto output = OIIO::ImageOutput::create(file.string());
  ASSERT_TRUE(output && output->open(file.string(), spec));
  ASSERT_TRUE(output->write_image(OIIO::TypeDesc::UINT8, pixels.data()) && output->close());
}

// Cameras of simulators write alpha 0.
TEST(ImageFiles, ColoursAreTakenAsStoredWhateverTheAlpha) {
  const TemporaryFolder folder;
  for (const std::uint8_t alpha : std::initializer_list<std::uint8_t>{0, 128, 255}) {
    write_with(folder / "a.png", 4, {200, 100, 50, alpha}, 0);
    const ImageF image = read_srgb(folder / "a.png");
    for (int c = 0; c < 3; ++c)
      EXPECT_EQ(image.at(2, 1, c), linear_level(std::array<std::uint8_t, 3>{200, 100, 50}[as_size(c)]))
          << int{alpha};
    write_with(folder / "grey.png", 2, {90, alpha}, 0);
    EXPECT_EQ(read_srgb(folder / "grey.png").at(2, 1, 2), linear_level(90)) << int{alpha};
  }
}

// libjpeg fills the rest with grey, and only warns.
TEST(ImageFiles, AJpegThatIsCutOffOrDamagedIsRefused) {
  const TemporaryFolder folder;
  const auto file = folder / "a.jpg";
  std::vector<std::uint8_t> pixels(3 * 64 * 64);
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<std::uint8_t>(i * i % 251);
  auto output = OIIO::ImageOutput::create(file.string());
  ASSERT_TRUE(output && output->open(file.string(), OIIO::ImageSpec(64, 64, 3, OIIO::TypeDesc::UINT8)));
  ASSERT_TRUE(output->write_image(OIIO::TypeDesc::UINT8, pixels.data()) && output->close());
  EXPECT_NO_THROW(read_srgb(file));
  const std::string whole = read_file(file);
  std::string damaged = whole;
  for (std::size_t i = whole.size() / 2; i < whole.size() / 2 + 40; ++i) damaged[i] = '\xff';
  for (const std::string& bytes : {whole.substr(0, whole.size() / 2), damaged}) {
    write_file(file, bytes);
    EXPECT_THAT(error_text<InputError>([&] { read_srgb(file); }),
                AllOf(HasSubstr("a.jpg"), HasSubstr("truncated or damaged")));
  }
}

TEST(ImageFiles, APictureThatAsksToBeTurnedIsRefused) {
  const TemporaryFolder folder;
  for (const int upright : {0, 1}) {
    write_with(folder / "a.jpg", 3, {200, 100, 50}, upright);
    EXPECT_NO_THROW(read_srgb(folder / "a.jpg"));
  }
  for (const int turned : {3, 6, 8}) {
    write_with(folder / "a.jpg", 3, {200, 100, 50}, turned);
    EXPECT_THAT(error_text<InputError>([&] { read_srgb(folder / "a.jpg"); }),
                AllOf(HasSubstr("a.jpg"), HasSubstr("EXIF orientation " + std::to_string(turned))));
  }
}

}  // namespace
}  // namespace mirage
