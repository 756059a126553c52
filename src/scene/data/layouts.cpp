#include "scene/data/layouts.h"

#include <charconv>
#include <cmath>

#include "base/error.h"
#include "base/names.h"
#include "scene/data/kitti_results.h"

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
  // Asked this way round: what is no number is no size.
  if (!(size.minCoeff() > 0 && size.maxCoeff() <= 50)) return "has no size of a road user (0 to 50 m)";
  if (!(at.cwiseAbs().maxCoeff() <= 1000)) return "is further than 1 km away";
  return std::isfinite(box.bev.yaw) ? "" : "has no heading";
}

int track_number(std::size_t group, std::size_t index) {
  return static_cast<int>((group * kMostVehicles + index) % 0x7fffffff);
}

void add_numbered_sweeps(const std::filesystem::path& folder, const std::string& prefix,
                         std::vector<std::string>& ids) {
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".bin") continue;
    ids.push_back(prefix + "_" + entry.path().stem().string());
    if (!frame_id_problem(ids.back()).empty() || !split_id(ids.back()))
      throw InputError(entry.path().string(), "name", "is no frame's name",
                       "give the frame its number, as 000012.bin");
  }
}

std::optional<std::pair<std::string, int>> split_id(const std::string& id) {
  const auto cut = id.rfind('_');
  if (cut == std::string::npos || cut == 0 || cut + 1 == id.size()) return std::nullopt;
  int number = 0;
  const char* end = id.data() + id.size();
  const auto [read, error] = std::from_chars(id.data() + cut + 1, end, number);
  if (error != std::errc() || read != end || number < 0) return std::nullopt;
  return std::pair(id.substr(0, cut), number);
}

}  // namespace mirage
