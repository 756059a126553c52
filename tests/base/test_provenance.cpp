// What a result is made of.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/files.h"
#include "base/program.h"
#include "base/provenance.h"
#include "support/files.h"

namespace mirage {
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
  EXPECT_THAT(Provenance().made_of().at("program"), testing::StrEq(own));
}

TEST(Provenance, IdentityIsOfProgramInputsAndSettingsAlone) {
  const test::TemporaryFolder folder;
  write_file(folder / "mesh.glb", "mesh");
  const auto made_of = [&](const auto& change) {
    Provenance all;
    all.set("score", 0.3);
    all.file("mesh", folder / "mesh.glb");
    all.input("data", "1");
    all.tell("date", "2026-11-27");
    change(all);
    return all.identity();
  };
  const std::string before = made_of([](Provenance&) {});
  EXPECT_NE(made_of([](Provenance& p) { p.set("score", 0.4); }), before);
  EXPECT_NE(made_of([](Provenance& p) { p.set("iou", 0.4); }), before);
  EXPECT_NE(made_of([](Provenance& p) { p.input("data", "2"); }), before);
  EXPECT_EQ(made_of([](Provenance& p) { p.tell("date", "2026-11-28"); }), before);
  write_file(folder / "mesh.glb", "mess");
  EXPECT_NE(made_of([](Provenance&) {}), before);
}

TEST(Provenance, AResultSaysEverything) {
  Provenance all;
  all.input("weights", "abc");
  all.tell("command", "mirage detect");
  const nlohmann::json json = all.json();
  for (const char* key : {"program", "version", "commit", "identity", "inputs", "settings", "command"})
    EXPECT_TRUE(json.contains(key)) << key;
  EXPECT_EQ(json.at("inputs").at("weights"), "abc");
  EXPECT_EQ(json.at("identity"), all.identity());
}

}  // namespace
}  // namespace mirage
