#include "scene/data/oxts.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <charconv>
#include <chrono>
#include <cmath>
#include <numbers>

#include "base/angles.h"
#include "base/error.h"
#include "base/files.h"
#include "scene/data/kitti_rows.h"

namespace mirage {
namespace {

constexpr double kEarthRadius = 6378137;  // m, the development kit's
constexpr const char* kRestoreRow = "restore the file from the recording";

std::string row_name(std::size_t row) {
  return fmt::format("row {}", row + 1);
}

}  // namespace

OxtsRow oxts_row(std::string_view line, const std::filesystem::path& file, std::size_t row) {
  constexpr std::size_t kFewest = 25;
  const auto words = split(line, " \t\r\n");
  if (words.size() < kFewest)
    throw InputError(file.string(), row_name(row), fmt::format("{} numbers where 30 belong", words.size()),
                     kRestoreRow);
  double value[6];
  for (std::size_t i = 0; i < 6; ++i)
    value[i] = to_number(words[i], file, fmt::format("{}, number {}", row_name(row), i + 1));
  const OxtsRow pose{value[0], value[1], value[2], value[3], value[4], value[5]};
  if (!(std::abs(pose.latitude) < 89 && std::abs(pose.longitude) <= 360 && std::abs(pose.altitude) < 1e5))
    throw InputError(file.string(), row_name(row),
                     "is no place on a road: latitude and longitude in degrees, altitude in metres",
                     kRestoreRow);
  return pose;
}

Transform world_from_imu(const OxtsRow& row, const OxtsRow& first) {
  const double scale = std::cos(first.latitude * kDegree) * kEarthRadius;
  const auto place = [&](const OxtsRow& at) {
    return Vec3d(scale * at.longitude * kDegree,
                 scale * std::log(std::tan((90 + at.latitude) * std::numbers::pi / 360)), at.altitude);
  };
  Transform pose = Transform::Identity();
  pose.linear() = (Eigen::AngleAxisd(row.yaw, Vec3d::UnitZ()) * Eigen::AngleAxisd(row.pitch, Vec3d::UnitY()) *
                   Eigen::AngleAxisd(row.roll, Vec3d::UnitX()))
                      .toRotationMatrix();
  pose.translation() = place(row) - place(first);
  return pose;
}

double stamp_seconds(std::string_view stamp, const std::filesystem::path& file, std::size_t row) {
  const auto words = split(stamp, "-: \t\r\n");
  double value[6] = {};
  bool good = words.size() == 6;
  for (std::size_t i = 0; good && i < 6; ++i) {
    const char* end = words[i].data() + words[i].size();
    const auto [read, error] = std::from_chars(words[i].data(), end, value[i]);
    good = error == std::errc() && read == end && value[i] >= 0 && value[i] < 10000;
  }
  namespace chrono = std::chrono;
  const chrono::year_month_day day(chrono::year(static_cast<int>(value[0])),
                                   chrono::month(static_cast<unsigned>(value[1])),
                                   chrono::day(static_cast<unsigned>(value[2])));
  if (!good || !day.ok() || value[3] >= 24 || value[4] >= 60 || value[5] >= 61)
    throw InputError(file.string(), row_name(row), "is no time, as 2011-09-26 13:02:25.594360375",
                     kRestoreRow);
  const chrono::sys_days start = chrono::year(2000) / 1 / 1;
  const double days = static_cast<double>((chrono::sys_days(day) - start).count());
  return ((days * 24 + value[3]) * 60 + value[4]) * 60 + value[5];
}

std::string text_line(const std::filesystem::path& file, std::size_t row) {
  const std::string text = read_text(file, kLargestLabels);
  std::size_t begin = 0;
  for (std::size_t i = 0; i < row && begin != text.npos; ++i) {
    begin = text.find('\n', begin);
    if (begin != text.npos) ++begin;
  }
  std::string line = begin == text.npos ? "" : text.substr(begin, text.find('\n', begin) - begin);
  if (line.find_first_not_of(" \t\r") == line.npos)
    throw InputError(file.string(), row_name(row), "missing: the recording has a frame of that number",
                     kRestoreRow);
  return line;
}

}  // namespace mirage
