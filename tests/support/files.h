// A fresh folder for a test's files, removed at the end, and the folder of real frames.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <string>

namespace mirage::test {

class TemporaryFolder {
 public:
  TemporaryFolder() {
    static int count = 0;
    path_ = std::filesystem::temp_directory_path() /
            ("mirage-test-" + std::to_string(getpid()) + "-" + std::to_string(count++));
    std::filesystem::create_directories(path_);
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// Real frames in KITTI layout: MIRAGE_KITTI, by default ../shared/kitti beside the source folder. Empty if
/// absent.
inline std::filesystem::path real_frames() {
  const char* given = std::getenv("MIRAGE_KITTI");
  const std::filesystem::path folder =
      given ? std::filesystem::path(given) : std::filesystem::path(MIRAGE_SOURCE) / ".." / "shared" / "kitti";
  return std::filesystem::is_directory(folder / "training" / "velodyne") ? folder : std::filesystem::path();
}

/// The nuScenes sample beside them: MIRAGE_NUSCENES, by default ../shared/nuscenes-sample. Empty if absent.
inline std::filesystem::path real_surround() {
  const char* given = std::getenv("MIRAGE_NUSCENES");
  const std::filesystem::path folder =
      given ? std::filesystem::path(given)
            : std::filesystem::path(MIRAGE_SOURCE) / ".." / "shared" / "nuscenes-sample";
  return std::filesystem::is_directory(folder / "samples/CAM_BACK") ? folder : std::filesystem::path();
}

/// The text of the exception that `work` throws as `Error`; a test failure if it throws none.
template <class Error, class Work>
std::string error_text(const Work& work) {
  try {
    work();
  } catch (const Error& error) {
    return error.what();
  }
  ADD_FAILURE() << "no error was thrown";
  return "";
}

}  // namespace mirage::test

#define MIRAGE_NEED_REAL_FRAMES()          \
  if (mirage::test::real_frames().empty()) \
  GTEST_SKIP() << "no real frames: set MIRAGE_KITTI to a folder in KITTI layout"
