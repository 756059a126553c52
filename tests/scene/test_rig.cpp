// The rig that a data set names.
#include <dlfcn.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "base/error.h"
#include "base/files.h"
#include "scene/data/data_rig.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;

TEST(DataRig, IsWhatTheSetSaysElseKitti) {
  const TemporaryFolder folder;
  EXPECT_EQ(data_rig(folder.path()), "kitti64");
  write_file(folder / "dataset.json", R"({"rig": "xenith", "seed": 1})");
  EXPECT_EQ(data_rig(folder.path()), "xenith");
  for (const char* text : {R"({"seed": 1})", R"({"rig": 3})", "[]"}) {
    write_file(folder / "dataset.json", text);
    EXPECT_THAT(error_text<InputError>([&] { data_rig(folder.path()); }),
                ::testing::HasSubstr("dataset.json: rig"));
  }
}

TEST(DataRig, WhatIsAskedForComesFirst) {
  const TemporaryFolder folder;
  EXPECT_TRUE(rig_is_assumed(folder.path()));
  EXPECT_EQ(lidar_of(folder.path()).beams.size(), 64u);
  EXPECT_EQ(lidar_of(folder.path(), "nuscenes").beams.size(), 32u);
  EXPECT_EQ(data_rig(folder.path(), "nuscenes"), "nuscenes");
  const std::string own = shipped_file("scenes/rigs/xenith.toml").string();
  EXPECT_EQ(lidar_of(folder.path(), own).beams.size(), 72u);
  EXPECT_EQ(data_rig(folder.path(), own), "kitti64") << "a file names no shipped weights";
  std::filesystem::copy_file(own, folder / "rig.toml");
  EXPECT_FALSE(rig_is_assumed(folder.path()));
  EXPECT_EQ(lidar_of(folder.path()).beams.size(), 72u);
  EXPECT_EQ(lidar_of(folder.path(), "kitti64").beams.size(), 64u);
}

TEST(DataRig, AnUnknownOneIsAnsweredWithThoseThereAre) {
  for (const char* rig : {"kitti", "hdl64", "../kitti64"})
    EXPECT_THAT(error_text<InputError>([&] { rig_file(rig); }),
                testing::AllOf(testing::HasSubstr("kitti64"), testing::HasSubstr("nuscenes"),
                               testing::HasSubstr("xenith")));
  EXPECT_THAT(error_text<InputError>([&] { rig_file("nowhere.toml"); }), testing::HasSubstr("mirage rig"));
}

}  // namespace
}  // namespace mirage

namespace {

// The BLAS of a program with Ceres: LibTorch uses the first one that its process finds.

/// The library in which this process finds a symbol.
std::string library_of(const char* symbol) {
  Dl_info info{};
  void* found = dlsym(RTLD_DEFAULT, symbol);
  return found && dladdr(found, &info) && info.dli_fname ? info.dli_fname : "";
}

TEST(Blas, IsOpenBlasAndNotTheAtlasThatCeresBrings) {
  if (!dlopen("libopenblas.so.0", RTLD_LAZY | RTLD_LOCAL)) GTEST_SKIP() << "no OpenBLAS on this machine";
  for (const char* routine : {"sgemm_", "dgemm_", "sgemv_", "ssyrk_"})
    EXPECT_NE(library_of(routine).find("openblas"), std::string::npos)
        << routine << " is that of " << library_of(routine);
}

}  // namespace
