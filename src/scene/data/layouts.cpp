#include "scene/data/layouts.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <numbers>

#include "base/names.h"
#include "scene/data/kitti_rows.h"

namespace mirage {

std::optional<Label> projected_label(std::string type, const Box3& box, const Calibration& calibration) {
  const auto seen = projected(box, calibration);
  if (!seen) return std::nullopt;
  Label label;
  label.type = std::move(type);
  label.box = box;
  label.truncated = cut_off_share(box, calibration);
  label.left = seen->left, label.top = seen->top, label.right = seen->right, label.bottom = seen->bottom;
  return label;
}

std::string box_problem(const Box3& box) {
  const Vec3d size(box.bev.length, box.bev.width, box.height), at(box.bev.x, box.bev.y, box.bottom);
  // Negated, so that NaN is refused, too.
  if (!(size.minCoeff() > 0 && size.maxCoeff() <= 50))
    return "does not have the size of a road user (0 to 50 m)";
  if (!(at.cwiseAbs().maxCoeff() <= 1000)) return "is further than 1 km away";
  return std::isfinite(box.bev.yaw) ? "" : "has no heading";
}

std::string label_problem(const Box3& box) {
  const std::string problem = box_problem(box);
  if (!problem.empty() || std::abs(box.bev.yaw) <= 2 * std::numbers::pi) return problem;
  return "has a heading of more than a full turn (rad)";
}

int track_number(std::size_t group, std::size_t index) {
  return static_cast<int>((group * kMaxVehicles + index) % 0x7fffffff);
}

InputError no_layout(const std::filesystem::path& data) {
  namespace fs = std::filesystem;
  std::error_code error;
  const auto wrong = [&](const std::string& problem, const std::string& fix) {
    return InputError(data.string(), "", problem, fix);
  };
  const auto has = [&](std::initializer_list<const char*> folders) {
    return std::any_of(folders.begin(), folders.end(),
                       [&](const char* name) { return fs::is_directory(data / name, error); });
  };
  if (!fs::exists(data, error)) return wrong("no such folder", "check --data");
  if (!fs::is_directory(data, error)) return wrong("is a file", "give the folder of a data set");
  fs::path whole = fs::absolute(data, error).lexically_normal();
  if (!whole.has_filename()) whole = whole.parent_path();
  const std::string name = whole.filename().string();
  if (has({"velodyne", "image_2", "image_02", "velodyne_points", "LIDAR_TOP", "CAM_FRONT"})) {
    const bool drive = name.find("_drive_") != std::string::npos;
    if (drive || name == "training" || name == "testing" || name == "samples")
      return wrong("is a part of a data set",
                   fmt::format("give its parent, {}{}", whole.parent_path().string(),
                               drive ? ", with calib_cam_to_cam.txt and calib_velo_to_cam.txt in it" : ""));
    return wrong("holds the folders of KITTI's benchmark themselves",
                 "put them into a folder called training, and give the folder around that");
  }
  if (has({"training/image_2", "training/label_2", "training/image_02", "testing/image_2"}))
    return wrong(fmt::format("{}/velodyne: no such folder", benchmark_part(data).filename().string()),
                 "add the benchmark's sweeps");
  if (has({"samples"}))
    return wrong("holds samples and no tables (v1.0-*/sample_data.json)", "unpack nuScenes' metadata there");
  std::vector<std::string> found;
  for (const fs::path& entry : entries_of(data)) found.push_back(entry.filename().string());
  std::sort(found.begin(), found.end());
  constexpr std::size_t kMax = 6;
  const std::size_t more = found.size() > kMax ? found.size() - kMax : 0;
  found.resize(found.size() - more);
  const std::string holds = found.empty() ? "nothing" : fmt::format("{}", fmt::join(found, ", "));
  return wrong(fmt::format("is in none of the layouts that are read: it holds {}{}", holds,
                           more > 0 ? fmt::format(" and {} more", more) : ""),
               "give KITTI's object or tracking benchmark (training/velodyne), a day of its raw recordings "
               "(calib_*.txt), nuScenes (v1.0-*), or what mirage generate makes");
}

std::filesystem::path benchmark_part(const std::filesystem::path& data) {
  std::error_code error;
  const bool testing = !std::filesystem::is_directory(data / "training", error) &&
                       std::filesystem::is_directory(data / "testing", error);
  return data / (testing ? "testing" : "training");
}

std::vector<std::filesystem::path> entries_of(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> entries;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error))
    entries.push_back(entry->path());
  return entries;
}

std::filesystem::path picture_in(const std::filesystem::path& folder, const std::string& name) {
  std::error_code error;
  for (const char* extension : {".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG"})
    if (auto file = folder / (name + extension); std::filesystem::exists(file, error)) return file;
  return folder / (name + ".png");
}

void add_numbered_sweeps(const std::filesystem::path& folder, const std::string& prefix,
                         std::vector<std::string>& ids) {
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".bin") continue;
    ids.push_back(prefix + "_" + entry.path().stem().string());
    if (!frame_id_problem(ids.back()).empty() || !split_id(ids.back()))
      throw InputError(entry.path().string(), "name", "is not a frame's name",
                       "give the frame its number, as 000012.bin");
  }
}

std::optional<std::pair<std::string, int>> split_id(const std::string& id) {
  const auto cut = id.rfind('_');
  if (cut == std::string::npos || cut == 0 || cut + 1 == id.size()) return std::nullopt;
  const auto number = try_parse_number<int>(std::string_view(id).substr(cut + 1));
  if (!number || *number < 0) return std::nullopt;
  return std::pair(id.substr(0, cut), *number);
}

}  // namespace mirage
