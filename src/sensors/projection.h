// From a mesh in the camera's frame to the rasteriser's screen: projection, clipping at a near plane, and the
// VJP of both.
#pragma once

#include <array>
#include <vector>

#include "geometry/mesh.h"
#include "sensors/camera.h"
#include "sensors/soft_rasterizer.h"

namespace mirage {

/// A corner of a screen face: a point on edge (a, b) of its source face, p = (1 − t) p_a + t p_b. An uncut
/// corner has a == b and t = 0.
struct ScreenCorner {
  int a = 0, b = 0;              ///< vertex indices of the mesh
  int place_a = 0, place_b = 0;  ///< their indices in the source face, 0 … 2
  double t = 0;
  /// Whether the near plane made this corner.
  bool is_cut() const { return place_a != place_b; }
};

/// A mesh on screen, and the source of its faces.
struct ProjectedMesh {
  ScreenMesh<double> screen;
  std::vector<int> source;                           ///< face of the mesh, one a screen face
  std::vector<std::array<ScreenCorner, 3>> corners;  ///< one a screen face
  /// The mesh's own corner colours, if clipping replaced them in `screen` (Texture::vertex).
  std::vector<Vec3d> vertex_texels;
};

/// Projects a mesh given by its vertices in `camera` (m) and shaded texels (Texture::atlas: faces × C²;
/// vertex: faces × 3). Faces that cross the plane z = near are clipped (Sutherland and Hodgman 1974) into one
/// or two parts; faces behind it vanish, and so do those with a vertex that is not finite. near > 0.
ProjectedMesh project_mesh(const std::vector<Vec3d>& p_camera, const std::vector<Face>& faces,
                           const PinholeCamera& camera, double near, Texture texture, const TexelGrid& grid,
                           std::vector<Vec3d> texels);

/// Adds d loss / d p_camera and d loss / d texels (of the mesh's own faces), given the rasteriser's gradient.
/// Exact, clipping included: a cut corner slides along its edge.
void project_mesh_vjp(const ProjectedMesh& projected, const std::vector<Vec3d>& p_camera,
                      const PinholeCamera& camera, double near, const ScreenGradient<double>& gradient,
                      std::vector<Vec3d>& d_p_camera, std::vector<Vec3d>& d_texels);

}  // namespace mirage
