#include "generator/labels.h"

#include <algorithm>
#include <cmath>

#include "base/parallel.h"
#include "geometry/box.h"

namespace mirage::generator {
namespace {

constexpr double kNearestProjected = 0.3;  // m, corners nearer than this to the camera's plane lie on it
constexpr int kProbes = 3000;              // rays a thing to count its own pixels
constexpr int kRows = 25;  // pixels of height that make a thing without returns one to be found (KITTI)

}  // namespace

StreetLabels label_street(const Street& street, const Calibration& calibration, const Image<int>& object,
                          std::span<const int> returned) {
  const PinholeCamera& camera = calibration.camera;
  const Transform velo_from_camera = calibration.camera_from_velo.inverse();
  const std::size_t count = street.placed.size();
  std::vector<int> visible(count, 0), first(count, object.height), last(count, -1), returns(count, 0);
  for (int v = 0; v < object.height; ++v)
    for (int u = 0; u < object.width; ++u)
      if (const int id = object.at(u, v); id >= 0)
        ++visible[id], first[id] = std::min(first[id], v), last[id] = v;
  for (int id : returned)
    if (id >= 0) ++returns[id];

  std::vector<Label> labels(count);
  parallel_for(count, [&](std::size_t i) {
    if (returns[i] == 0 && last[i] - first[i] + 1 < kRows) return;
    const BevBox& place = street.placed[i].box.bev;
    if (visible[i] == 0 &&
        (calibration.camera_from_velo * Vec3d(place.x, place.y, 0)).z() < kNearestProjected)
      return;
    std::vector<Mesh> meshes;
    for (const Surface& s : street.surfaces)
      if (s.object == static_cast<int>(i)) meshes.push_back(s.mesh);
    // KITTI's boxes in the picture are those around the corners of the 3-D box, which is wider than the
    // outline of a round body.
    PictureBox full{1e9, 1e9, -1e9, -1e9};
    for (const Vec3d& corner : corners(street.placed[i].box)) {
      Vec3d p = calibration.camera_from_velo * corner;
      p.z() = std::max(p.z(), kNearestProjected);
      const Vec2d pixel = camera.project(p);
      full = joined(full, {pixel.x(), pixel.y(), pixel.x(), pixel.y()});
    }
    const PictureBox seen = within(full, camera.width, camera.height);
    if (seen.right - seen.left < 1 || seen.bottom - seen.top < 1) return;
    // The thing alone: how many pixels would it cover?
    const RayCaster alone(meshes);
    const int step = std::max(1, static_cast<int>(std::sqrt(area(seen) / kProbes)));
    int own = 0, shown = 0;
    for (int v = static_cast<int>(seen.top); v <= static_cast<int>(seen.bottom); v += step)
      for (int u = static_cast<int>(seen.left); u <= static_cast<int>(seen.right); u += step) {
        const Ray ray{velo_from_camera.translation().cast<float>(),
                      (velo_from_camera.linear() * camera.unproject(u, v, 1)).cast<float>(), 0.05f};
        if (!alone.occluded(ray)) continue;
        ++own;
        if (object.at(u, v) == static_cast<int>(i)) ++shown;
      }
    const double share = own > 0 ? static_cast<double>(shown) / own : 1;
    Label& label = labels[i];
    label.type = street.placed[i].type;
    label.box = street.placed[i].box;
    label.truncated = std::clamp(1 - area(seen) / std::max(area(full), 1e-9), 0.0, 1.0);
    label.occluded = visible[i] == 0 ? 3 : share > 0.8 ? 0 : share > 0.35 ? 1 : 2;
    label.left = seen.left, label.top = seen.top, label.right = seen.right, label.bottom = seen.bottom;
  });
  StreetLabels out;
  for (Label& label : labels) {
    out.line.push_back(label.type.empty() ? -1 : static_cast<int>(out.labels.size()));
    if (!label.type.empty()) out.labels.push_back(std::move(label));
  }
  return out;
}

}  // namespace mirage::generator
