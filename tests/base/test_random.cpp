#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <vector>

#include "base/files.h"
#include "base/provenance.h"
#include "base/random.h"
#include "support/files.h"

namespace mirage {
namespace {

std::vector<std::uint32_t> first(RandomStream stream, int n) {
  std::vector<std::uint32_t> values;
  for (int i = 0; i < n; ++i) values.push_back(stream.next_u32());
  return values;
}

TEST(RandomStream, SameKeySameNumbers) {
  EXPECT_EQ(first({7, "paint", 3}, 100), first({7, "paint", 3}, 100));
}

TEST(RandomStream, SeedPurposeAndIndexEachChangeIt) {
  const auto base = first({7, "paint", 3}, 8);
  EXPECT_NE(base, first({8, "paint", 3}, 8));
  EXPECT_NE(base, first({7, "noise", 3}, 8));
  EXPECT_NE(base, first({7, "paint", 4}, 8));
  EXPECT_NE(base, first({7, "paint", 3 + (1ull << 32)}, 8));
}

TEST(RandomStream, StreamsDoNotOverlap) {
  std::set<std::uint64_t> seen;
  for (std::uint64_t index = 0; index < 50; ++index) {
    RandomStream stream(1, "overlap", index);
    for (int i = 0; i < 200; ++i) {
      const std::uint64_t high = stream.next_u32();
      EXPECT_TRUE(seen.insert(high << 32 | stream.next_u32()).second);
    }
  }
}

TEST(RandomStream, UniformAndNormalHaveTheirMoments) {
  RandomStream stream(5, "moments");
  constexpr int n = 200000;
  double mean = 0, square = 0, normal = 0, normal2 = 0, normal4 = 0;
  for (int i = 0; i < n; ++i) {
    const double u = stream.uniform();
    ASSERT_GE(u, 0);
    ASSERT_LT(u, 1);
    mean += u / n, square += u * u / n;
    const double z = stream.normal();
    normal += z / n, normal2 += z * z / n, normal4 += z * z * z * z / n;
  }
  EXPECT_NEAR(mean, 0.5, 0.004);
  EXPECT_NEAR(square, 1.0 / 3, 0.004);
  EXPECT_NEAR(normal, 0, 0.01);
  EXPECT_NEAR(normal2, 1, 0.02);
  EXPECT_NEAR(normal4, 3, 0.15);
}

TEST(RandomStream, NeighbouringStreamsAreUncorrelated) {
  constexpr int n = 50000;
  double product = 0;
  for (std::uint64_t i = 0; i < n; ++i)
    product += (RandomStream(1, "a", i).uniform() - 0.5) * (RandomStream(1, "a", i + 1).uniform() - 0.5) / n;
  EXPECT_NEAR(product * 12, 0, 5 / std::sqrt(n));
}

TEST(RandomStream, BelowReachesEveryValueAndNoOther) {
  RandomStream stream(9, "below");
  std::set<int> seen;
  for (int i = 0; i < 500; ++i) seen.insert(stream.below(6));
  EXPECT_EQ(seen, (std::set<int>{0, 1, 2, 3, 4, 5}));
}

}  // namespace

// The program's identity in a result.

namespace {

TEST(ProgramIdentity, IsItsContentButForTheCommit) {
  const test::TemporaryFolder folder;
  const auto file = folder / "program";
  const std::string program = read_file(program_file());
  write_file(file, program);
  const std::string own = program_identity();
  EXPECT_EQ(program_identity(file), own);
  write_file(file, program + " ");
  EXPECT_NE(program_identity(file), own);
  std::string other = program;
  other[other.size() / 2] ^= 1;
  write_file(file, other);
  EXPECT_NE(program_identity(file), own);
  EXPECT_THAT(Provenance().provenance().at("program"), testing::StrEq(own));
}

TEST(Provenance, IdentityIsOfProgramInputsAndSettingsAlone) {
  const test::TemporaryFolder folder;
  write_file(folder / "mesh.glb", "mesh");
  const auto provenance = [&](const auto& change) {
    Provenance all;
    all.set("score", 0.3);
    all.file("mesh", folder / "mesh.glb");
    all.input("data", "1");
    all.record("date", "2026-11-27");
    change(all);
    return all.identity();
  };
  const std::string before = provenance([](Provenance&) {});
  EXPECT_NE(provenance([](Provenance& p) { p.set("score", 0.4); }), before);
  EXPECT_NE(provenance([](Provenance& p) { p.set("iou", 0.4); }), before);
  EXPECT_NE(provenance([](Provenance& p) { p.input("data", "2"); }), before);
  EXPECT_EQ(provenance([](Provenance& p) { p.record("date", "2026-11-28"); }), before);
  write_file(folder / "mesh.glb", "mess");
  EXPECT_NE(provenance([](Provenance&) {}), before);
}

TEST(Provenance, AResultSaysEverything) {
  Provenance all;
  all.input("weights", "abc");
  all.record("command", "mirage detect");
  const nlohmann::json json = all.json();
  for (const char* key : {"program", "version", "commit", "identity", "inputs", "settings", "command"})
    EXPECT_TRUE(json.contains(key)) << key;
  EXPECT_EQ(json.at("inputs").at("weights"), "abc");
  EXPECT_EQ(json.at("identity"), all.identity());
}

}  // namespace
}  // namespace mirage
