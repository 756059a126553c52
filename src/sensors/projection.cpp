#include "sensors/projection.h"

#include <algorithm>
#include <utility>

#include "base/sizes.h"

namespace mirage {
namespace {

/// Barycentrics of a corner of a part within its source face.
Vec3d barycentrics_in_source(const ScreenCorner& corner) {
  Vec3d b = Vec3d::Zero();
  b[corner.place_a] = 1 - corner.t;
  if (corner.is_cut()) b[corner.place_b] = corner.t;
  return b;
}

/// Intersection of the edge from corner k of a face with the plane. Computed by rising vertex index, so that
/// both faces at an edge get the same point.
ScreenCorner cut(const Face& face, int k, const std::vector<Vec3d>& p_camera, double near) {
  const int next = (k + 1) % 3;
  ScreenCorner corner{face[as_size(k)], face[as_size(next)], k, next, 0};
  if (corner.a > corner.b) {
    std::swap(corner.a, corner.b);
    std::swap(corner.place_a, corner.place_b);
  }
  const double z_a = p_camera[as_size(corner.a)].z(), z_b = p_camera[as_size(corner.b)].z();
  corner.t = std::clamp((near - z_a) / (z_b - z_a), 0.0, 1.0);
  return corner;
}

/// The part of a face in front of the plane: nothing, a triangle or a quadrangle, in the face's winding.
int clip(const Face& face, const std::vector<Vec3d>& p_camera, double near,
         std::array<ScreenCorner, 4>& polygon) {
  int count = 0;
  for (int vertex : face)
    if (!p_camera[as_size(vertex)].allFinite()) return 0;
  for (int k = 0; k < 3; ++k) {
    const bool seen = p_camera[as_size(face[as_size(k)])].z() >= near,
               next_seen = p_camera[as_size(face[as_size((k + 1) % 3)])].z() >= near;
    if (seen) polygon[as_size(count++)] = {face[as_size(k)], face[as_size(k)], k, k, 0};
    if (seen != next_seen) polygon[as_size(count++)] = cut(face, k, p_camera, near);
  }
  return count;
}

Vec3d position(const ScreenCorner& corner, const std::vector<Vec3d>& p_camera, double near) {
  if (!corner.is_cut()) return p_camera[as_size(corner.a)];
  Vec3d p = (1 - corner.t) * p_camera[as_size(corner.a)] + corner.t * p_camera[as_size(corner.b)];
  p.z() = near;
  return p;
}

}  // namespace

ProjectedMesh project_mesh(const std::vector<Vec3d>& p_camera, const std::vector<Face>& faces,
                           const PinholeCamera& camera, double near, Texture texture, const TexelGrid& grid,
                           std::vector<Vec3d> texels) {
  ProjectedMesh projected;
  ScreenMesh<double>& screen = projected.screen;
  static_cast<TexelGrid&>(screen) = grid;
  screen.texture = texture;
  bool clipped = false;
  const auto add = [&](int source, const std::array<ScreenCorner, 3>& corners) {
    std::array<Vec3d, 3> on_screen;
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec3d p = position(corners[k], p_camera, near);
      const Vec2d pixel = camera.project(p);
      on_screen[k] << ndc_from_pixel(pixel.x(), pixel.y(), camera.width, camera.height), p.z();
    }
    screen.faces.push_back(on_screen);
    projected.source.push_back(source);
    projected.corners.push_back(corners);
  };
  std::array<ScreenCorner, 4> polygon;
  for (std::size_t f = 0; f < faces.size(); ++f) {
    const int count = clip(faces[f], p_camera, near, polygon);
    bool whole = count == 3;
    for (int k = 0; k < count; ++k) whole = whole && !polygon[as_size(k)].is_cut();
    clipped = clipped || !whole;
    if (count >= 3) add(static_cast<int>(f), {polygon[0], polygon[1], polygon[2]});
    if (count == 4) add(static_cast<int>(f), {polygon[0], polygon[2], polygon[3]});
  }
  if (!clipped) {
    screen.texels = std::move(texels);
    return projected;
  }
  for (std::size_t part = 0; part < screen.faces.size(); ++part) {
    const int source = projected.source[part];
    std::array<Vec3d, 3> on_source;
    for (std::size_t k = 0; k < 3; ++k) on_source[k] = barycentrics_in_source(projected.corners[part][k]);
    if (texture == Texture::atlas) {
      screen.texel_face.push_back(source);
      screen.corner_barycentrics.push_back(on_source);
      continue;
    }
    for (const Vec3d& b : on_source)
      screen.texels.push_back(b[0] * texels[as_size(3 * source)] + b[1] * texels[as_size(3 * source + 1)] +
                              b[2] * texels[as_size(3 * source + 2)]);
  }
  (texture == Texture::atlas ? screen.texels : projected.vertex_texels) = std::move(texels);
  return projected;
}

void project_mesh_vjp(const ProjectedMesh& projected, const std::vector<Vec3d>& p_camera,
                      const PinholeCamera& camera, double near, const ScreenGradient<double>& gradient,
                      std::vector<Vec3d>& d_p_camera, std::vector<Vec3d>& d_texels) {
  const double ndc = 2.0 / std::max(camera.width, camera.height);
  const bool mixed_colors = !projected.vertex_texels.empty();
  if (!mixed_colors)
    for (std::size_t t = 0; t < gradient.texels.size(); ++t) d_texels[t] += gradient.texels[t];
  for (std::size_t part = 0; part < projected.corners.size(); ++part)
    for (std::size_t k = 0; k < 3; ++k) {
      const ScreenCorner& corner = projected.corners[part][k];
      const Vec3d& d = gradient.faces[part][k];
      const Vec3d p = position(corner, p_camera, near);
      const double dx = ndc * camera.fx * d.x() / p.z(), dy = -ndc * camera.fy * d.y() / p.z();
      double d_t = 0;
      if (mixed_colors) {
        const std::size_t first = 3 * as_size(projected.source[part]), a = first + as_size(corner.place_a),
                          b = first + as_size(corner.place_b);
        const Vec3d& d_color = gradient.texels[3 * part + k];
        d_texels[a] += (1 - corner.t) * d_color;
        if (corner.is_cut()) d_texels[b] += corner.t * d_color;
        d_t = d_color.dot(projected.vertex_texels[b] - projected.vertex_texels[a]);
      }
      if (!gradient.corner_barycentrics.empty() && corner.is_cut()) {
        const Vec3d& d_barycentrics = gradient.corner_barycentrics[part][k];
        d_t += d_barycentrics[corner.place_b] - d_barycentrics[corner.place_a];
      }
      if (!corner.is_cut()) {
        d_p_camera[as_size(corner.a)] += Vec3d(dx, dy, d.z() - (dx * p.x() + dy * p.y()) / p.z());
        continue;
      }
      // The depth of a cut corner is `near`, whatever the ends do; t = (near − z_a) / (z_b − z_a).
      const Vec3d along = p_camera[as_size(corner.b)] - p_camera[as_size(corner.a)], d_p(dx, dy, 0);
      d_t += d_p.dot(along);
      d_p_camera[as_size(corner.a)] += (1 - corner.t) * (d_p - Vec3d(0, 0, d_t / along.z()));
      d_p_camera[as_size(corner.b)] += corner.t * (d_p - Vec3d(0, 0, d_t / along.z()));
    }
}

}  // namespace mirage
