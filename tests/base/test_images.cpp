#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <csignal>
#include <fstream>
#include <functional>
#include <thread>
#include <tuple>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
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
  const PictureSize size = read_image_size(folder / "codes.png");
  EXPECT_EQ(size.width, 256);
  EXPECT_EQ(size.height, 1);
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

TEST(ImageFiles, AChunkThatClaimsMoreThanTheFileIsRefusedBeforeDecoding) {
  TemporaryFolder folder;
  const std::string whole = encode_srgb_png(noise(5, 4, 3));
  const std::size_t after_header = 8 + 12 + 13;
  const auto with = [&](const std::string& chunk, std::size_t at) {
    write_file(folder / "chunk.png", whole.substr(0, at) + chunk + whole.substr(at));
    return folder / "chunk.png";
  };
  using namespace std::string_literals;
  EXPECT_THAT(error_text<InputError>([&] { read_srgb(with("\x73IDHeXIf"s, after_header)); }),
              AllOf(HasSubstr("chunk.png"), HasSubstr("a chunk claims 1934181448 bytes"),
                    HasSubstr("that are left")));
  // An unknown ancillary chunk: a decoder skips it.
  EXPECT_NO_THROW(read_srgb(with("\0\0\0\x02mrAg\x01\x02\x1f\x9f\xbc\x18"s, after_header)));
}

// libpng allocates up to eight megabytes for each, and keeps them all.
TEST(ImageFiles, CompressedTextsAreRefusedBeforeTheyAreRead) {
  TemporaryFolder folder;
  const std::string whole = encode_srgb_png(noise(5, 4, 3));
  const auto with = [&](const char* type, const std::string& body, int times) {
    std::string chunk;
    for (int shift = 24; shift >= 0; shift -= 8)
      chunk.push_back(static_cast<char>(body.size() >> shift & 0xff));
    chunk += type + body + "sums";  // a decoder skips texts with a wrong checksum
    std::string file = whole.substr(0, 8 + 12 + 13);
    for (int i = 0; i < times; ++i) file += chunk;
    write_file(folder / "texts.png", file + whole.substr(8 + 12 + 13));
    return folder / "texts.png";
  };
  using namespace std::string_literals;
  const std::string packed = "a\0\0"s + std::string(1300, 'x'),
                    marked = "a\0\1\0\0\0"s + std::string(1300, 'x'),
                    plain = "a\0\0\0\0\0"s + std::string(1300, 'x');
  for (const auto& [type, body] : {std::pair("zTXt", packed), std::pair("iTXt", marked)}) {
    EXPECT_NO_THROW(read_srgb(with(type, body, 3))) << type;
    const std::filesystem::path four = with(type, body, 4);
    EXPECT_THAT(error_text<InputError>([&] { read_srgb(four); }),
                AllOf(HasSubstr("texts.png"), HasSubstr("4096 bytes of compressed texts")))
        << type;
  }
  EXPECT_NO_THROW(read_srgb(with("iTXt", plain, 4)));
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
              AllOf(HasSubstr("cut.png"), HasSubstr("truncated"), testing::Not(HasSubstr(" )"))));
  write_file(folder / "file", "");
  EXPECT_THAT(error_text<Failure>([&] { write_srgb(folder / "file/a.png", noise(2, 2, 3)); }),
              HasSubstr("file: Not a directory"));
}

/// A PNG of a signature, a header that claims width × height, and an end: 57 bytes.
std::string claiming_png(std::uint32_t width, std::uint32_t height) {
  std::string header = "IHDR";
  for (std::uint32_t value : {width, height})
    for (int shift = 24; shift >= 0; shift -= 8) header.push_back(static_cast<char>(value >> shift & 0xff));
  header += std::string("\x08\x02\0\0\0", 5);
  const auto chunk = [](const std::string& body) {
    std::uint32_t crc = 0xffffffffu;
    for (const char c : body) {
      crc ^= static_cast<unsigned char>(c);
      for (int bit = 0; bit < 8; ++bit) crc = crc & 1 ? crc >> 1 ^ 0xedb88320u : crc >> 1;
    }
    std::string out;
    for (std::uint32_t value : {static_cast<std::uint32_t>(body.size() - 4)})
      for (int shift = 24; shift >= 0; shift -= 8) out.push_back(static_cast<char>(value >> shift & 0xff));
    out += body;
    for (int shift = 24; shift >= 0; shift -= 8) out.push_back(static_cast<char>(~crc >> shift & 0xff));
    return out;
  };
  return "\x89PNG\r\n\x1a\n" + chunk(header) + chunk("IDAT") + chunk("IEND");
}

TEST(ImageFiles, AHeaderThatClaimsTooMuchIsRefusedBeforeDecoding) {
  TemporaryFolder folder;
  write_srgb(folder / "small.png", noise(8, 4, 3));  // loads the decoders, which would exceed the limit
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_AS, &before), 0);
  [[maybe_unused]] rlimit small = before;
  std::ifstream statm("/proc/self/statm");
  rlim_t pages = 0;
  statm >> pages;
  small.rlim_cur = pages * 4096 + (64u << 20);  // the memory that is mapped now, and 64 MiB
  const auto limited = [&](const auto& work) {
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // sanitizers need their own memory
    setrlimit(RLIMIT_AS, &small);
#endif
    const std::string text = error_text<InputError>(work);
    setrlimit(RLIMIT_AS, &before);
    return text;
  };
  for (const auto& [w, h, why] :
       {std::tuple{60000u, 60000u, "more than 67108864 pixels"}, std::tuple{1000000u, 1000000u, "claims"},
        std::tuple{8192u, 8192u, "bytes cannot hold"}}) {
    const std::string huge = claiming_png(w, h);
    write_file(folder / "huge.png", huge);
    EXPECT_THAT(limited([&] { read_srgb(folder / "huge.png"); }),
                AllOf(HasSubstr("huge.png: header"), HasSubstr(why)));
    EXPECT_THAT(limited([&] { read_image_size(folder / "huge.png"); }), HasSubstr(why));
    EXPECT_THAT(limited([&] { read_depth_png(folder / "huge.png"); }), HasSubstr(why));
    EXPECT_THAT(limited([&] { read_index_png(folder / "huge.png"); }), HasSubstr(why));
    EXPECT_THAT(limited([&] { decode_srgb(huge, "scene.glb", "photograph"); }),
                AllOf(HasSubstr("scene.glb: photograph"), HasSubstr(why)));
  }
  EXPECT_THAT(error_text<InputError>([&] {
                read_srgb(folder / "small.png", {9, 4});
              }),
              AllOf(HasSubstr("8×4"), HasSubstr("9×4")));
  EXPECT_EQ(read_srgb(folder / "small.png", {8, 4}).height, 4);
}

TEST(ImageFiles, OnlyPicturesAreOpenedAndNoPipes) {
  TemporaryFolder folder;
  for (const std::string& bytes :
       {std::string("P6 2 2 255\n############"), std::string("\x49\x49\x2a\0", 4) + std::string(40, 'x')}) {
    write_file(folder / "other.png", bytes);
    EXPECT_THAT(error_text<InputError>([&] { read_srgb(folder / "other.png"); }),
                HasSubstr("not a PNG, JPEG or EXR"));
  }
  ASSERT_EQ(mkfifo((folder / "pipe.png").c_str(), 0600), 0);
  EXPECT_THAT(error_text<InputError>([&] { read_srgb(folder / "pipe.png"); }),
              HasSubstr("not a regular file"));
}

// A file-size limit stands in for a full disk.
TEST(ImageFiles, AFullDiskLeavesTheOldPictureAndSaysSo) {
  TemporaryFolder folder;
  const ImageF old = noise(8, 8, 1), larger = noise(300, 300, 1);
  Image<std::uint16_t> indices(300, 300, 1);
  RandomStream random(3, "indices");
  for (auto& index : indices.data) index = static_cast<std::uint16_t>(random.below(65536));
  const std::vector<std::pair<std::string, std::function<void(const std::filesystem::path&)>>> writers = {
      {"a.png", [&](const auto& file) { write_srgb(file, larger); }},
      {"b.png", [&](const auto& file) { write_depth_png(file, larger); }},
      {"c.png", [&](const auto& file) { write_index_png(file, indices); }},
      {"d.exr", [&](const auto& file) { write_exr(file, larger); }}};
  for (const auto& [name, write] : writers) {
    if (name == "d.exr")
      write_exr(folder / name, old);
    else
      write_srgb(folder / name, old);
    const std::string before = read_file(folder / name);
    rlimit limit{};
    ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &limit), 0);
    const auto handler = std::signal(SIGXFSZ, SIG_IGN);
    rlimit small = limit;
    small.rlim_cur = 8192;
    ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
    const std::function<void()> writing = std::bind(write, folder / name);
    const std::string text = error_text<Failure>(writing);
    setrlimit(RLIMIT_FSIZE, &limit);
    std::signal(SIGXFSZ, handler);
    EXPECT_THAT(text, AllOf(HasSubstr(name), HasSubstr("cannot be written")));
    EXPECT_EQ(read_file(folder / name), before) << name;
    write(folder / name);
    EXPECT_NE(read_file(folder / name), before) << name;
  }
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 4);
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

// oneTBB cancels the inner loops of a failing outer one; a frame from such loops was written to disk.
TEST(ParallelFor, NothingIsMadeOfAnInnerLoopThatWasStopped) {
  const int before = thread_count();
  set_thread_count(4);
  for (int round = 0; round < 20; ++round) {
    std::atomic<int> finished_short = 0;
    EXPECT_THAT(error_text<Failure>([&] {
                  parallel_for(8, [&](std::size_t i) {
                    if (i == 0) {
                      std::this_thread::sleep_for(std::chrono::milliseconds(5));
                      throw Failure("disk", "full", "free some space");
                    }
                    std::atomic<int> done = 0;
                    parallel_for(200, [&](std::size_t) {
                      std::this_thread::sleep_for(std::chrono::microseconds(200));
                      ++done;
                    });
                    finished_short += done != 200;
                  });
                }),
                HasSubstr("disk: full"));
    EXPECT_EQ(finished_short, 0);
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

TEST(SrgbBytes, TheTableIsTheCurveRounded) {
  std::vector<float> values = {-1, 0, 1, 2, std::nanf(""), 1e-30f, 6e-5f};
  for (int level = 0; level < 255; ++level) {  // on both sides of the border to the next level, and between
    const float edge = linear_from_srgb((static_cast<float>(level) + 0.5f) / 255);
    for (int step = -40; step <= 40; ++step)
      values.push_back(
          std::bit_cast<float>(std::bit_cast<std::uint32_t>(edge) + static_cast<std::uint32_t>(step)));
  }
  for (std::uint32_t bits = 0x38000000; bits < 0x3f800000; bits += 9973)
    values.push_back(std::bit_cast<float>(bits));
  std::vector<std::uint8_t> bytes(values.size());
  write_srgb_bytes(values, bytes.data());
  for (std::size_t i = 0; i < values.size(); ++i)
    ASSERT_EQ(bytes[i], std::lround(255 * srgb_from_linear(values[i]))) << values[i];
}

TEST(SrgbBytes, TheSlopeIsTheCurves) {
  for (int level = 1; level < 255; ++level) {
    const auto byte = static_cast<std::uint8_t>(level);
    float slope = 1;
    through_srgb_slope({&byte, 1}, {&slope, 1});
    const float linear = linear_level(byte), step = 1e-3f * linear;
    const double numeric =
        255.0 * (srgb_from_linear(linear + step) - srgb_from_linear(linear - step)) / (2 * step);
    EXPECT_NEAR(slope, numeric, 0.001 * numeric) << level;
  }
}

}  // namespace
}  // namespace mirage
