#include "frames/host_views.h"

#include "geometry/shapes.h"
#include "simulation/insertion.h"

namespace mirage {

std::vector<HostView> host_views(const PreparedFrame& prepared, const std::vector<Carrier>& carriers,
                                 const PlaceChoice& place, const std::array<double, 4>& region,
                                 const SimulationSettings& simulation) {
  const TexturedMesh reference = grey_ellipsoid(kRoofBox);
  const auto& labels = prepared.frame.labels;
  std::vector<HostView> views;
  for (std::size_t i = 0; i < labels.size(); ++i) {
    const BevBox& box = labels[i].box.bev;
    if (labels[i].type != "Car" || !has_box(labels[i]) || box.x < region[0] || box.x > region[1] ||
        box.y < region[2] || box.y > region[3])
      continue;
    const Simulated seen = simulate(prepared, placement_of(place, carriers[i]), reference, simulation);
    views.push_back({static_cast<int>(i), seen.visible_share, carriers[i].from_box});
  }
  return views;
}

}  // namespace mirage
