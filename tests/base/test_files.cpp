#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <memory>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/sizes.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

std::size_t entries(const std::filesystem::path& folder) {
  return as_size(std::distance(std::filesystem::directory_iterator(folder), {}));
}

TEST(WriteFile, MakesFoldersAndReplacesWhole) {
  TemporaryFolder folder;
  write_file(folder / "a/b/c.bin", std::string("one\0two", 7));
  EXPECT_EQ(read_file(folder / "a/b/c.bin"), std::string("one\0two", 7));
  write_file(folder / "a/b/c.bin", "x");
  EXPECT_EQ(read_file(folder / "a/b/c.bin"), "x");
  EXPECT_EQ(entries(folder / "a/b"), 1u);
}

// A file-size limit stands in for a full disk: the old file stays, and no temporary file remains.
TEST(WriteFile, FailingHalfWayKeepsTheOldFile) {
  TemporaryFolder folder;
  write_file(folder / "kept.txt", "old");
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit small = before;
  small.rlim_cur = 4096;
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const std::string text =
      error_text<Failure>([&] { write_file(folder / "kept.txt", std::string(100000, 'x')); });
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  EXPECT_THAT(text, AllOf(HasSubstr("kept.txt"), HasSubstr("cannot be written")));
  EXPECT_EQ(read_file(folder / "kept.txt"), "old");
  EXPECT_EQ(entries(folder.path()), 1u);
}

// In a folder from another user, a name may lead to a pipe without a writer, or to a device without end.
TEST(ReadFile, TakesRegularFilesAlone) {
  TemporaryFolder folder;
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  std::filesystem::create_symlink("/dev/zero", folder / "endless");
  for (const char* name : {"pipe", "endless"})
    EXPECT_THAT(error_text<InputError>([&] { read_file(folder / name); }),
                AllOf(HasSubstr((folder / name).string()), HasSubstr("is not a regular file")));
}

// A sparse file of 50 GB takes one block on its sender's disk.
TEST(ReadFile, WhatIsTooLargeIsRefusedBeforeItIsRead) {
  TemporaryFolder folder;
  write_file(folder / "huge", "");
  std::filesystem::resize_file(folder / "huge", std::uintmax_t{50} << 30);
  EXPECT_THAT(error_text<InputError>([&] { read_file(folder / "huge"); }),
              AllOf(HasSubstr((folder / "huge").string()), HasSubstr("larger than 1073741824 bytes")));
  write_file(folder / "ten", "0123456789");
  EXPECT_EQ(read_file(folder / "ten", 10), "0123456789");
  EXPECT_THAT(error_text<InputError>([&] { read_file(folder / "ten", 9); }),
              HasSubstr("larger than 9 bytes"));
  // A system file that reports no size.
  EXPECT_THAT(error_text<InputError>([&] { read_file("/proc/cpuinfo", 9); }),
              HasSubstr("larger than 9 bytes"));
}

TEST(ReadText, SkipsTheByteOrderMarkAndNamesOtherEncodings) {
  TemporaryFolder folder;
  write_file(folder / "a.txt", "\xef\xbb\xbfP2: 1");
  EXPECT_EQ(read_text(folder / "a.txt"), "P2: 1");
  EXPECT_EQ(read_file(folder / "a.txt").size(), 8u);
  write_file(folder / "a.txt", "\xef\xbb\xbf");
  EXPECT_EQ(read_text(folder / "a.txt"), "");
  write_file(folder / "a.json", "\xef\xbb\xbf[1]");
  EXPECT_EQ(read_json(folder / "a.json"), nlohmann::json::array({1}));
  for_each_json_row(folder / "a.json", "", "mend it",
                    [](std::size_t, const nlohmann::json& row) { EXPECT_EQ(row, 1); });
  write_file(folder / "a.toml", "\xef\xbb\xbfx = 1");
  EXPECT_EQ(read_toml(folder / "a.toml").at("x"), 1);
  for (const char* mark : {"\xff\xfe", "\xfe\xff"}) {
    write_file(folder / "b.txt", mark + std::string("P\0002\0", 4));
    EXPECT_THAT(error_text<InputError>([&] { read_text(folder / "b.txt"); }),
                AllOf(HasSubstr("b.txt"), HasSubstr("UTF-16")));
  }
}

TEST(FileHash, IsThatOfTheContentWhateverItsSize) {
  TemporaryFolder folder;
  for (const std::size_t size : {0u, 1u, 65535u, 65536u, 65537u, 200000u}) {
    std::string bytes(size, 'a');
    if (size > 3) bytes[size - 3] = 'b';
    write_file(folder / "some", bytes);
    EXPECT_EQ(file_hash(folder / "some"), content_hash(bytes)) << size;
  }
  EXPECT_THAT(error_text<InputError>([&] { file_hash(folder / "none"); }), HasSubstr("none"));
  EXPECT_THAT(error_text<InputError>([&] { file_hash(folder / "some", 199999); }),
              HasSubstr("larger than 199999"));
  std::filesystem::resize_file(folder / "some", std::uintmax_t{50} << 30);
  EXPECT_THAT(error_text<InputError>([&] { file_hash(folder / "some"); }), HasSubstr("larger than"));
}

TEST(WriteFile, AFileInThePlaceOfAFolderIsAFailure) {
  TemporaryFolder folder;
  write_file(folder / "file", "");
  EXPECT_THAT(error_text<Failure>([&] { write_file(folder / "file/inside.txt", "x"); }), HasSubstr("file"));
  EXPECT_THAT(error_text<Failure>([&] { make_output_folder(folder / "file"); }), HasSubstr("--out"));
  EXPECT_THAT(error_text<Failure>([&] { make_output_folder("/proc/none"); }), HasSubstr("/proc/none"));
}

TEST(MakeOutputFolder, LeavesNoProbe) {
  TemporaryFolder folder;
  make_output_folder(folder / "deep/out");
  EXPECT_EQ(entries(folder / "deep/out"), 0u);
}

TEST(ReadFile, MissingFileOrFolderIsAnInputError) {
  TemporaryFolder folder;
  EXPECT_THAT(error_text<InputError>([&] { read_file(folder / "none.txt"); }),
              AllOf(HasSubstr("none.txt"), HasSubstr("No such file")));
  EXPECT_THAT(error_text<InputError>([&] { read_file(folder.path()); }), HasSubstr("is a folder"));
}

TEST(ReadFile, APathThatLeadsNowhereIsAnInputErrorToo) {
  TemporaryFolder folder;
  std::filesystem::create_symlink("loop", folder / "loop");
  EXPECT_THAT(error_text<InputError>([&] { read_file(folder / "loop"); }), HasSubstr("loop"));
  EXPECT_THAT(error_text<InputError>([&] { read_file(folder / std::string(5000, 'a')); }), HasSubstr("aaa"));
  EXPECT_THAT(error_text<InputError>([] { make_output_folder(""); }), HasSubstr("--out: names no folder"));
}

TEST(ReadJson, NamesFileAndByte) {
  TemporaryFolder folder;
  write_file(folder / "bad.json", "{\"a\": 1,,}");
  EXPECT_THAT(error_text<InputError>([&] { read_json(folder / "bad.json"); }),
              AllOf(HasSubstr("bad.json"), HasSubstr("byte 9")));
  write_json(folder / "good.json", {{"a", 0.1}, {"b", {1, 2}}});
  EXPECT_EQ(read_json(folder / "good.json")["a"], 0.1);
}

TEST(ShippedFile, UnknownNameSaysHowToFindIt) {
  EXPECT_THAT(error_text<InputError>([] { shipped_file("scenes/none.toml"); }),
              AllOf(HasSubstr("scenes/none.toml"), HasSubstr("MIRAGE_HOME")));
}

TEST(ConfigTable, StrictAboutKeysTypesAndRanges) {
  TemporaryFolder folder;
  write_file(folder / "c.toml",
             "number = 3\ntext = \"a\"\nlist = [1, 2.5]\n[table]\nrows = [[1, 2], [3, 4]]\n");
  ConfigTable table = ConfigTable::read(folder / "c.toml");
  EXPECT_EQ(table.number("number", 0, 10), 3);
  EXPECT_EQ(table.text("text"), "a");
  EXPECT_EQ(table.numbers("list", 2, 0, 10), (std::vector<double>{1, 2.5}));
  EXPECT_THAT(error_text<InputError>([&] { table.check_all_known(); }), HasSubstr("table: unknown key"));
  ConfigTable inner = table.table("table");
  table.check_all_known();
  EXPECT_EQ(inner.rows("rows", 2, 0, 10)[1][0], 3);
  EXPECT_THAT(error_text<InputError>([&] { inner.rows("rows", 3, 0, 10); }), HasSubstr("table.rows[0]"));
  EXPECT_THAT(error_text<InputError>([&] { inner.rows("rows", 2, 0, 3); }), HasSubstr("table.rows[1][1]"));
  EXPECT_THAT(error_text<InputError>([&] { table.number("none", 0, 1); }), HasSubstr("none: missing key"));
  EXPECT_THAT(error_text<InputError>([&] { table.number("text", 0, 1); }), HasSubstr("text: not a number"));
  EXPECT_THAT(error_text<InputError>([&] { table.number("number", 0, 1); }),
              HasSubstr("number: 3 is out of range"));
  EXPECT_THAT(error_text<InputError>([&] { table.text("number"); }), HasSubstr("number: not a text"));
  write_file(folder / "c.toml", "a = 1\nb = = 2\n");
  EXPECT_THAT(error_text<InputError>([&] { ConfigTable::read(folder / "c.toml"); }),
              AllOf(HasSubstr("c.toml"), HasSubstr("line 2")));
}

namespace fs = std::filesystem;

/// Another process that holds the folder until it is killed.
pid_t holder_of(const fs::path& folder) {
  int ready[2];
  if (pipe(ready) != 0) return -1;
  const pid_t child = fork();
  if (child == 0) {
    const FolderLock lock(folder);
    if (write(ready[1], "x", 1) != 1) _exit(1);
    pause();
    _exit(0);
  }
  char seen = 0;
  EXPECT_EQ(read(ready[0], &seen, 1), 1);
  close(ready[0]);
  close(ready[1]);
  return child;
}

void end(pid_t child) {
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
}

TEST(FolderLock, NamesItsHolderAndADeadOnesIsTaken) {
  TemporaryFolder folder;
  const pid_t other = holder_of(folder.path());
  char host[256] = "";
  gethostname(host, sizeof host - 1);
  EXPECT_THAT(error_text<Failure>([&] { FolderLock lock(folder.path()); }),
              AllOf(HasSubstr(folder.path().string()), HasSubstr("process " + std::to_string(other)),
                    HasSubstr(host), HasSubstr("--out")));
  end(other);
  EXPECT_TRUE(fs::exists(folder / ".mirage-lock"));  // as a killed process leaves it
  { const FolderLock lock(folder.path()); }
  EXPECT_TRUE(fs::is_empty(folder.path()));
}

TEST(FolderLock, OneProcessMayAskTwice) {
  TemporaryFolder folder;
  const auto lock = std::make_unique<FolderLock>(folder.path());
  { const FolderLock again(folder.path() / "."); }
  EXPECT_TRUE(fs::exists(folder / ".mirage-lock"));
}

TEST(FolderLock, WhatItsFileSaysIsShownEscaped) {
  TemporaryFolder folder;
  const pid_t other = holder_of(folder.path());
  write_file(folder / "words", "\x1b[2Jboo");
  fs::copy_file(folder / "words", folder / ".mirage-lock", fs::copy_options::overwrite_existing);
  EXPECT_THAT(error_text<Failure>([&] { FolderLock lock(folder.path()); }), HasSubstr("\\x1b[2Jboo"));
  end(other);
}

TEST(FolderLock, ClearsAwayWhatTheDeadLeft) {
  TemporaryFolder folder;
  const pid_t dead = fork();
  if (dead == 0) _exit(0);
  waitpid(dead, nullptr, 0);
  const std::string gone = std::to_string(dead), alive = std::to_string(getppid());
  for (const std::string& name :
       {"a.png.mirage-" + gone + ".tmp", "training/image_2/b.mirage-" + gone + ".tmp",
        ".probe.mirage-" + gone + ".tmp"})
    write_file(folder / name, "");
  const std::string kept[] = {"a.png", "a.mirage-" + alive + ".tmp", "mine." + gone + ".tmp",
                              "x.tmp", "a.mirage-12x.tmp",           "1/2/3/deep.mirage-" + gone + ".tmp"};
  for (const std::string& name : kept) write_file(folder / name, "");
  remove_stale_files(folder.path());
  for (const std::string& name : kept) EXPECT_TRUE(fs::exists(folder / name)) << name;
  std::size_t files = 0;
  for (const auto& entry : fs::recursive_directory_iterator(folder.path())) files += entry.is_regular_file();
  EXPECT_EQ(files, std::size(kept));
}

TEST(FixFor, NamesTheRealCause) {
  EXPECT_THAT(fix_for(ENOSPC), HasSubstr("disk is full"));
  EXPECT_THAT(fix_for(EACCES), HasSubstr("permissions"));
  EXPECT_THAT(fix_for(EROFS), HasSubstr("read-only"));
  EXPECT_THAT(fix_for(ENAMETOOLONG), HasSubstr("shorter"));
  EXPECT_THAT(fix_for(EMFILE), HasSubstr("open files"));
  TemporaryFolder folder;
  fs::create_directories(folder / "there/inside");
  write_file(folder / "new", "");
  EXPECT_THAT(error_text<Failure>([&] { replace_file(folder / "new", folder / "there"); }),
              testing::Not(HasSubstr("permissions")));
  EXPECT_THAT(error_text<InputError>([&] { read_file(folder / "none"); }),
              testing::Not(HasSubstr("permissions")));
}

}  // namespace
}  // namespace mirage
