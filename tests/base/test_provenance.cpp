// A result's identity of its program, which includes the files beside the program.
#include <gtest/gtest.h>

#include "base/files.h"
#include "base/provenance.h"
#include "support/files.h"

namespace mirage {
namespace {

/// Replaces the program for its lifetime.
class OtherProgram {
 public:
  explicit OtherProgram(const std::filesystem::path& file) { set_program_file(file); }
  ~OtherProgram() { set_program_file(own_); }
  OtherProgram(const OtherProgram&) = delete;
  OtherProgram& operator=(const OtherProgram&) = delete;

 private:
  std::filesystem::path own_ = program_file();
};

// Its pixels are the start of every result.
TEST(ProgramIdentity, HoldsThePluginThatDecodesPictures) {
  const test::TemporaryFolder folder;
  const auto program = folder / "program", plugin = folder / "plugins/pictures.so";
  write_file(program, "program");
  const OtherProgram other(program);
  const std::string bare = program_identity(program);
  write_file(plugin, "decoder");
  const std::string with_it = program_identity(program);
  EXPECT_NE(with_it, bare);
  write_file(plugin, "decoded");
  EXPECT_NE(program_identity(program), with_it);
  write_file(plugin, "decoder");
  EXPECT_EQ(program_identity(program), with_it);
}

TEST(ProgramCommit, IsWhatTheBuildWroteBesideTheProgram) {
  const std::filesystem::path file = built_file("mirage.commit");
  EXPECT_EQ(program_commit() + "\n", std::filesystem::exists(file) ? read_file(file) : "\n");
}

}  // namespace
}  // namespace mirage
