#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/color.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/parallel.h"
#include "base/random.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

TEST(Color, KnownValuesAndInverse) {
  EXPECT_NEAR(srgb_from_linear(0.5f), 0.735357f, 1e-5f);
  EXPECT_NEAR(srgb_from_linear(0.002f), 0.02584f, 1e-6f);
  EXPECT_NEAR(linear_from_srgb(0.5f), 0.214041f, 1e-5f);
  for (int i = 0; i <= 1000; ++i) {
    const float x = static_cast<float>(i) / 1000;
    EXPECT_NEAR(linear_from_srgb(srgb_from_linear(x)), x, 2e-6f);
  }
  EXPECT_EQ(srgb_from_linear(-1), 0);
  EXPECT_EQ(srgb_from_linear(7), 1);
  EXPECT_EQ(srgb_from_linear(std::nanf("")), 0);
  const float white[] = {1, 1, 1};
  EXPECT_NEAR(luminance(white), 1, 1e-6f);
}

ImageF noise(int width, int height, int channels) {
  ImageF image(width, height, channels);
  RandomStream random(2, "image test");
  for (float& value : image.data) value = static_cast<float>(random.uniform());
  return image;
}

TEST(ImageFiles, EightBitPngKeepsEveryCode) {
  TemporaryFolder folder;
  ImageF image(256, 1, 3);
  for (int i = 0; i < 256; ++i)
    for (int c = 0; c < 3; ++c)
      image.at(i, 0, c) = linear_from_srgb(static_cast<float>((i + 40 * c) % 256) / 255);
  write_srgb(folder / "codes.png", image);
  const ImageF again = read_srgb(folder / "codes.png");
  EXPECT_EQ(again.data, image.data);
  write_file(folder / "memory.png", encode_srgb_png(image));
  EXPECT_EQ(read_srgb(folder / "memory.png").data, image.data);
  int width = 0, height = 0;
  read_image_size(folder / "codes.png", width, height);
  EXPECT_EQ(width, 256);
  EXPECT_EQ(height, 1);
}

TEST(ImageFiles, GreyComesBackAsRgb) {
  TemporaryFolder folder;
  write_srgb(folder / "grey.png", ImageF(5, 4, 1, 0.5f));
  const ImageF again = read_srgb(folder / "grey.png");
  EXPECT_EQ(again.channels, 3);
  EXPECT_NEAR(again.at(4, 3, 2), 0.5, 0.005);
}

TEST(ImageFiles, ExrKeepsFloatsExactly) {
  TemporaryFolder folder;
  for (int channels : {1, 3, 4}) {
    ImageF image = noise(17, 9, channels);
    image.data[0] = 1e6f;
    image.data[1] = -3.25f;
    write_exr(folder / "values.exr", image);
    const ImageF again = read_exr(folder / "values.exr");
    EXPECT_EQ(again.channels, channels);
    EXPECT_EQ(again.data, image.data);
  }
}

TEST(ImageFiles, ErrorsNameTheFile) {
  TemporaryFolder folder;
  EXPECT_THAT(error_text<InputError>([&] { read_srgb(folder / "none.png"); }), HasSubstr("none.png"));
  write_file(folder / "text.png", "no image at all");
  EXPECT_THAT(error_text<InputError>([&] { read_srgb(folder / "text.png"); }), HasSubstr("text.png"));
  write_srgb(folder / "cut.png", noise(64, 64, 3));
  const std::string whole = read_file(folder / "cut.png");
  write_file(folder / "cut.png", whole.substr(0, whole.size() / 2));
  EXPECT_THAT(error_text<InputError>([&] { read_srgb(folder / "cut.png"); }),
              AllOf(HasSubstr("cut.png"), HasSubstr("truncated")));
  write_file(folder / "file", "");
  EXPECT_THAT(error_text<Failure>([&] { write_srgb(folder / "file/a.png", noise(2, 2, 3)); }),
              HasSubstr("a.png"));
}

TEST(ParallelFor, VisitsEveryIndexOnceWithAnyThreadCount) {
  const int before = thread_count();
  for (int threads : {1, 2, 4}) {
    set_thread_count(threads);
    std::vector<int> visits(1000, 0);
    parallel_for(visits.size(), [&](std::size_t i) { ++visits[i]; });
    EXPECT_EQ(visits, std::vector<int>(1000, 1));
  }
  set_thread_count(before);
}

TEST(DepthPng, KeepsKittisFormat) {
  TemporaryFolder folder;
  ImageF depth(3, 2, 1);
  depth.data = {0, 1, 80.5f, 300, 0.0001f, -4};
  write_depth_png(folder / "d.png", depth);
  const ImageF back = read_depth_png(folder / "d.png");
  const std::vector<float> expected = {0, 1, 80.5f, 65535.f / 256, 1.f / 256, 0};
  EXPECT_EQ(back.data, expected);
  depth.data[2] = std::nanf("");
  write_depth_png(folder / "d.png", depth);
  EXPECT_EQ(read_depth_png(folder / "d.png").data[2], 0);
  write_srgb(folder / "c.png", noise(4, 4, 3));
  EXPECT_THAT(error_text<InputError>([&] { read_depth_png(folder / "c.png"); }),
              AllOf(HasSubstr("c.png"), HasSubstr("16-bit")));
}

}  // namespace
}  // namespace mirage
