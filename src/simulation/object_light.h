// The light on an object's texels, by one of the light models (sensors/visible_light.h names them). A texel
// is drawn as its albedo times its light. A new model is a class here and its word in LightModel.
#pragma once

#include <memory>
#include <vector>

#include "geometry/mesh.h"
#include "sensors/lighting.h"
#include "sensors/visible_light.h"

namespace mirage {

/// The light of one mesh in its present pose. Texels: linear RGB, as many as the mesh has, in the atlas's
/// order.
class ObjectLight {
 public:
  virtual ~ObjectLight() = default;
  /// The grid of lit(): the mesh's atlas, or a finer one on faces where light varies within texels.
  virtual TexelGrid grid() const = 0;
  /// Radiance of every texel of that grid.
  virtual std::vector<Vec3d> lit(const std::vector<Vec3d>& texels) const = 0;
  /// Adds d loss / d face normal (unnormalised) and d loss / d texel, given d loss / d radiance on grid().
  virtual void vjp(const std::vector<Vec3d>& texels, const std::vector<Vec3d>& d_lit,
                   std::vector<Vec3d>& d_normals, std::vector<Vec3d>& d_texels) const = 0;
};

/// The model of sensors/lighting.h: one factor a face. `placed`: in the frame of `lighting`.
std::unique_ptr<ObjectLight> plain_light(const TexturedMesh& placed, const Lighting& lighting);
/// The model of sensors/visible_light.h, with the visibility of `placed`. `around`: the vehicle under it;
/// null for an object in free space. `eye`: the camera (`velo`).
std::unique_ptr<ObjectLight> light_with_visibility(const TexturedMesh& placed, const Lighting& lighting,
                                                   const LightSurroundings* around, const Vec3d& eye,
                                                   const VisibleLightSettings& settings);

}  // namespace mirage
