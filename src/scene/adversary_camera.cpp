#include <algorithm>
#include <cmath>
#include <limits>

#include "scene/adversary_view.h"
#include "scene/depth_completion.h"
#include "sensors/shading.h"

namespace mirage {
namespace {

constexpr double kNearestVertex = 0.1;  // m; a vertex nearer than this (or behind) has no place on the screen

/// Depth range of the rasteriser: a ball around the object that grows in steps of half a metre, so that it is
/// constant under the small moves that derivatives are about.
void set_depth_range(const std::vector<Vec3d>& p_camera, SoftRasterSettings<double>& settings) {
  Vec3d centre = Vec3d::Zero();
  for (const Vec3d& p : p_camera) centre += p / static_cast<double>(p_camera.size());
  double reach = 0;
  for (const Vec3d& p : p_camera) reach = std::max(reach, std::abs(p.z() - centre.z()));
  const double radius = std::max(1.5, std::ceil(2 * reach + 0.5) / 2);
  const double middle = std::round(2 * centre.z()) / 2;
  settings.near = std::max(kNearestVertex / 2, middle - radius);
  settings.far = middle + radius;
}

ScreenMesh<double> to_screen(const Mesh& mesh, const std::vector<Vec3d>& p_camera,
                             const PinholeCamera& camera) {
  ScreenMesh<double> screen;
  screen.faces.reserve(mesh.faces.size());
  for (const Face& face : mesh.faces) {
    std::array<Vec3d, 3> corners;
    bool visible = true;
    for (int k = 0; k < 3; ++k) {
      const Vec3d& p = p_camera[face[k]];
      if (p.z() < kNearestVertex) {
        visible = false;
        break;
      }
      const Vec2d pixel = camera.project(p);
      corners[k] << ndc_from_pixel(pixel.x(), pixel.y(), camera.width, camera.height), p.z();
    }
    if (!visible) corners.fill(Vec3d(0, 0, -1));  // the rasteriser skips faces behind the camera
    screen.faces.push_back(corners);
  }
  return screen;
}

double host_near_depth(const Label& host, const Calibration& calibration) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const Vec3d& corner : corners(host.box))
    nearest = std::min(nearest, (calibration.camera_from_velo * corner).z());
  return nearest;
}

int count_opaque(const Image<double>& rgba) {
  int count = 0;
  for (std::size_t i = 3; i < rgba.data.size(); i += 4) count += rgba.data[i] > 0.5;
  return count;
}

/// Mean of each s × s block of samples.
Image<double> averaged(const Image<double>& samples, int s) {
  Image<double> pixels(samples.width / s, samples.height / s, samples.channels);
  for (int v = 0; v < samples.height; ++v)
    for (int u = 0; u < samples.width; ++u)
      for (int c = 0; c < samples.channels; ++c) pixels.at(u / s, v / s, c) += samples.at(u, v, c) / (s * s);
  return pixels;
}

double silhouette_area(const Image<double>& rgba) {
  double area = 0;
  for (std::size_t i = 3; i < rgba.data.size(); i += 4) area += rgba.data[i];
  return area;
}

/// Pixels that the object would cover with nothing in front of it and no image border.
double unobstructed_area(const CameraTape& tape, const PinholeCamera& camera) {
  const PixelRect wide{-camera.width, -camera.height, 2 * camera.width, 2 * camera.height};
  RasterTarget<double> target;
  target.width = camera.width;
  target.height = camera.height;
  target.rect = touched_pixels(tape.screen, tape.settings, target.width, target.height, wide);
  target.background = Image<double>(target.rect.width(), target.rect.height(), 3);
  return silhouette_area(rasterize(tape.screen, tape.settings, target));
}

}  // namespace

CameraTape draw_in_camera(const PreparedFrame& prepared, const Label& host, const TexturedMesh& placed,
                          const SimulationSettings& settings, Simulated& result) {
  const PinholeCamera& camera = prepared.frame.calibration.camera;
  const Transform& camera_from_velo = prepared.frame.calibration.camera_from_velo;
  CameraTape tape;
  for (const Vec3d& v : placed.mesh.vertices) tape.p_camera.push_back(camera_from_velo * v);
  tape.settings = settings.raster;
  set_depth_range(tape.p_camera, tape.settings);
  tape.screen = to_screen(placed.mesh, tape.p_camera, camera);
  tape.normals = face_normals(placed.mesh);
  tape.screen.resolution = placed.atlas.resolution;
  tape.screen.texels = placed.atlas.texels;
  for (std::size_t f = 0; f < tape.normals.size(); ++f) {
    tape.light.push_back(shade<double>(tape.normals[f], prepared.frame.lighting));
    for (std::size_t t = 0; t < placed.atlas.per_face(); ++t) {
      Vec3d& texel = tape.screen.texels[f * placed.atlas.per_face() + t];
      texel = texel.cwiseProduct(tape.light.back());
    }
  }

  const int samples = tape.supersampling = settings.supersampling;
  const PixelRect rect = touched_pixels(tape.screen, tape.settings, camera.width, camera.height,
                                        {0, 0, camera.width, camera.height});
  result.image = prepared.frame.image;
  result.rect = rect;
  result.rgba = Image<double>(rect.width(), rect.height(), 4);
  if (rect.empty()) return tape;

  // NDC does not change with the resolution: a finer grid over the same window is the same picture.
  RasterTarget<double>& target = tape.target;
  target.width = samples * camera.width;
  target.height = samples * camera.height;
  target.rect = {samples * rect.u0, samples * rect.v0, samples * rect.u1, samples * rect.v1};
  target.background = Image<double>(target.rect.width(), target.rect.height(), 3);
  target.depth_limit =
      Image<double>(target.rect.width(), target.rect.height(), 1, std::numeric_limits<double>::infinity());
  bool obstructed = rect.u0 == 0 || rect.v0 == 0 || rect.u1 == camera.width || rect.v1 == camera.height;
  const double occluder_depth = host_near_depth(host, prepared.frame.calibration) - settings.occlusion_margin;
  for (int v = 0; v < target.rect.height(); ++v)
    for (int u = 0; u < target.rect.width(); ++u) {
      const int pixel_u = rect.u0 + u / samples, pixel_v = rect.v0 + v / samples;
      for (int c = 0; c < 3; ++c)
        target.background.at(u, v, c) = prepared.frame.image.at(pixel_u, pixel_v, c);
      const double depth = prepared.depth.at(pixel_u, pixel_v);
      if (depth >= occluder_depth) continue;
      target.depth_limit.at(u, v) = depth + settings.occlusion_margin;
      obstructed = true;
    }
  result.rgba = averaged(rasterize(tape.screen, tape.settings, target), samples);
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      for (int c = 0; c < 3; ++c)  // the photograph saturates at 1, and so does what is drawn into it
        result.image.at(u, v, c) =
            static_cast<float>(std::clamp(result.rgba.at(u - rect.u0, v - rect.v0, c), 0.0, 1.0));
  result.adversary_pixels = count_opaque(result.rgba);
  result.visible_share = 1;
  if (obstructed) {
    const double whole = unobstructed_area(tape, camera);
    result.visible_share = whole > 0 ? std::min(1.0, silhouette_area(result.rgba) / whole) : 0;
  }
  return tape;
}

void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed, const Calibration& calibration,
                        const Lighting& lighting, const Simulated& result, const ImageF& d_image,
                        std::vector<Vec3d>& d_vertices, std::vector<Vec3d>& d_texels) {
  if (tape.target.background.empty()) return;
  const int samples = tape.supersampling;
  const PixelRect& rect = result.rect;
  Image<double> d_rgba(tape.target.rect.width(), tape.target.rect.height(), 4);
  for (int v = 0; v < d_rgba.height; ++v)
    for (int u = 0; u < d_rgba.width; ++u)
      for (int c = 0; c < 3; ++c) {
        const double value = result.rgba.at(u / samples, v / samples, c);
        const bool saturated = value > 1 || value < 0;
        d_rgba.at(u, v, c) =
            saturated ? 0 : d_image.at(rect.u0 + u / samples, rect.v0 + v / samples, c) / (samples * samples);
      }
  const auto gradient = rasterize_vjp(tape.screen, tape.settings, tape.target, d_rgba);

  const PinholeCamera& camera = calibration.camera;
  const double ndc = 2.0 / std::max(camera.width, camera.height);
  const Eigen::Matrix3d velo_from_camera = calibration.camera_from_velo.linear().transpose();
  const std::size_t per_face = placed.atlas.per_face();
  for (std::size_t f = 0; f < placed.mesh.faces.size(); ++f) {
    const Face& face = placed.mesh.faces[f];
    for (int k = 0; k < 3; ++k) {
      const Vec3d& d = gradient.faces[f][k];
      const Vec3d& p = tape.p_camera[face[k]];
      const double dx = ndc * camera.fx * d.x() / p.z(), dy = -ndc * camera.fy * d.y() / p.z();
      d_vertices[face[k]] += velo_from_camera * Vec3d(dx, dy, d.z() - (dx * p.x() + dy * p.y()) / p.z());
    }
    Vec3d d_light = Vec3d::Zero();
    for (std::size_t t = f * per_face; t < (f + 1) * per_face; ++t) {
      d_texels[t] += gradient.texels[t].cwiseProduct(tape.light[f]);
      d_light += gradient.texels[t].cwiseProduct(placed.atlas.texels[t]);
    }
    const Vec3d d_normal = shade_vjp<double>(tape.normals[f], lighting, d_light);
    const Vec3d e1 = placed.mesh.vertices[face[1]] - placed.mesh.vertices[face[0]];
    const Vec3d e2 = placed.mesh.vertices[face[2]] - placed.mesh.vertices[face[0]];
    const Vec3d d_e1 = e2.cross(d_normal), d_e2 = d_normal.cross(e1);
    d_vertices[face[0]] -= d_e1 + d_e2;
    d_vertices[face[1]] += d_e1;
    d_vertices[face[2]] += d_e2;
  }
}

}  // namespace mirage
