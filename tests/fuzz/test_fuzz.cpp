// Earlier findings of the fuzzer, every parser's seeds, and a few thousand mutations of them: needs no clang.
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "base/files.h"
#include "base/random.h"
#include "fuzz/parsers.h"
#include "fuzz/repair.h"
#include "fuzz/seeds.h"

namespace mirage::fuzz {
namespace {

namespace fs = std::filesystem;

class Parsers : public testing::Test {
 protected:
  void SetUp() override {
    spdlog::set_level(spdlog::level::off);  // warnings about thousands of files
  }
  void TearDown() override { spdlog::set_level(spdlog::level::info); }
};

TEST_F(Parsers, EachTakesItsSeeds) {
  const std::vector<Seed> all = seeds();
  for (const Parser& parser : parsers())
    EXPECT_TRUE(std::any_of(all.begin(), all.end(), [&](const Seed& s) { return s.parser == parser.name; }))
        << parser.name << " has no seed";
  for (const Seed& seed : all)
    EXPECT_EQ(read_bytes(parser_named(seed.parser), seed.bytes), "") << seed.parser << '/' << seed.name;
}

// Every file of regressions/PARSER was a crash, a hang, or invalid data that was accepted. Now it is refused
// in one line. Its name describes the error.
TEST_F(Parsers, WhatWasFoundIsRefused) {
  int files = 0;
  for (const auto& entry :
       fs::recursive_directory_iterator(fs::path(MIRAGE_SOURCE) / "tests/fuzz/regressions")) {
    if (!entry.is_regular_file()) continue;
    ++files;
    const std::string parser = entry.path().parent_path().filename(), bytes = read_file(entry.path());
    std::string said;
    EXPECT_NO_THROW(said = read_bytes(parser_named(parser), bytes)) << entry.path();
    EXPECT_NE(said, "") << entry.path() << " is accepted";
  }
  EXPECT_GE(files, 1);
}

/// A few byte changes, cuts, duplications or moves.
std::size_t mutate(RandomStream& random, std::uint8_t* bytes, std::size_t size, std::size_t most) {
  const auto below = [&](std::size_t n) {
    return std::min(n - 1, static_cast<std::size_t>(random.uniform() * static_cast<double>(n)));
  };
  for (std::size_t left = 1 + below(4); left > 0; --left) {
    const std::size_t kind = below(6);
    if (size == 0 || (kind == 0 && size < most)) {
      std::copy_backward(bytes, bytes + size, bytes + size + 1);
      bytes[0] = static_cast<std::uint8_t>(below(256));
      ++size;
    } else if (kind == 1) {
      size = below(size + 1);
    } else if (kind == 2) {
      const std::size_t from = below(size), to = below(size), length = 1 + below(8);
      std::copy_n(bytes + from, std::min(length, size - std::max(from, to)), bytes + to);
    } else if (kind == 3) {
      constexpr char kTelling[] = "-9e\n {}[]\",:.\0\xff";
      bytes[below(size)] = static_cast<std::uint8_t>(kTelling[below(sizeof kTelling)]);
    } else {
      bytes[below(size)] ^= static_cast<std::uint8_t>(1u << below(8));
    }
  }
  return size;
}

TEST_F(Parsers, MutatedSeedsAreTakenOrRefusedInALine) {
  for (const Seed& seed : seeds()) {
    const Parser& parser = parser_named(seed.parser);
    int refused = 0;
    RandomStream random(19, seed.parser + seed.name);
    for (int round = 0; round < 300; ++round) {
      const std::size_t most = seed.bytes.size() + 16;
      const Mutate change = [&](auto* bytes, auto size, auto room) {
        return mutate(random, bytes, size, room);
      };
      std::string bytes = seed.bytes;
      if (seed.parser == "png") {
        bytes = mutate_png(bytes, most, static_cast<unsigned>(round), change);
      } else if (seed.parser == "gltf") {
        bytes = mutate_glb(bytes, most, static_cast<unsigned>(round), change);
      } else {
        bytes.resize(most);
        bytes.resize(change(reinterpret_cast<std::uint8_t*>(bytes.data()), seed.bytes.size(), most));
      }
      std::string said;
      EXPECT_NO_THROW(said = read_bytes(parser, bytes)) << seed.parser << ", round " << round;
      refused += !said.empty();
    }
    EXPECT_GT(refused, 0) << seed.parser << '/' << seed.name << ": nothing was ever refused";
  }
}

}  // namespace
}  // namespace mirage::fuzz
