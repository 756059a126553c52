#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <memory>

#include "base/error.h"
#include "base/files.h"
#include "base/folder_lock.h"
#include "support/files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

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
