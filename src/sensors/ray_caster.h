// Ray casting on Embree 3. A scene is static after construction; several threads may trace at once.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "geometry/mesh.h"

namespace mirage {

struct Ray {
  Vec3f origin, direction;  ///< direction need not be unit; t counts in its length
  float t_min = 0, t_max = 1e30f;
};

struct Hit {
  float t = -1;                  ///< ray parameter; < 0 where nothing was hit
  int mesh = -1;                 ///< which mesh, in the order they were given
  int face = -1;                 ///< which face of it
  float b1 = 0, b2 = 0;          ///< barycentrics of vertices 1 and 2; b0 = 1 − b1 − b2
  Vec3f normal = Vec3f::Zero();  ///< unnormalised face normal, wound as the face is
  bool hit() const { return mesh >= 0; }
};

class RayCaster {
 public:
  /// Builds one scene over all meshes (they are copied).
  explicit RayCaster(std::span<const Mesh> meshes);
  ~RayCaster();
  RayCaster(RayCaster&&) noexcept;
  RayCaster& operator=(RayCaster&&) noexcept;

  /// Nearest hit (both sides of a face count).
  Hit intersect(const Ray& ray) const;
  /// Nearest hits of many rays, in parallel. hits.size() == rays.size().
  void intersect(std::span<const Ray> rays, std::span<Hit> hits) const;
  /// Whether anything lies between t_min and t_max.
  bool occluded(const Ray& ray) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace mirage
