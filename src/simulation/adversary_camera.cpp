#include <algorithm>
#include <cmath>
#include <limits>

#include "scene/depth_completion.h"
#include "scene/light_surroundings.h"
#include "sensors/raster/limits.h"
#include "sensors/shading.h"
#include "simulation/adversary_view.h"
#include "simulation/check_inputs.h"

namespace mirage {
namespace {

constexpr double kNearestVertex = 0.1;  // m; faces are clipped at this depth

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
  settings.far = std::max(settings.near + 1, middle + radius);  // all of it behind the camera
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

template <class S>
double silhouette_area(const Image<S>& rgba) {
  double area = 0;
  for (std::size_t i = 3; i < rgba.data.size(); i += 4) area += rgba.data[i];
  return area;
}

/// Pixels that the object would cover with nothing in front of it and no image border.
double unobstructed_area(const CameraTape& tape, const PinholeCamera& camera) {
  if (tape.exact_coverage) return tape.exact.area;
  const PixelRect wide{-camera.width, -camera.height, 2 * camera.width, 2 * camera.height};
  RasterTarget<float> target;
  target.width = camera.width;
  target.height = camera.height;
  target.rect = touched_pixels(tape.projected.screen, tape.settings, target.width, target.height, wide);
  target.background = ImageF(target.rect.width(), target.rect.height(), 3);
  if (tape.reference)
    return silhouette_area(rasterize(tape.projected.screen, tape.settings, to_double(target)));
  const RasterJob job{&tape.projected.screen, &tape.settings, &target};
  RasterTape raster;
  rasterize_batch({&job, 1}, {&raster, 1});
  return silhouette_area(raster.rgba);
}

/// Texels times their light.
std::vector<Vec3d> lit_texels(const PreparedFrame& prepared, const Label& host, const Rooftop* rooftop,
                              const TexturedMesh& placed, const SimulationSettings& settings,
                              CameraTape& tape) {
  const Lighting& lighting = prepared.frame.lighting;
  std::vector<Vec3d> lit = placed.atlas.texels;
  if (settings.light == LightModel::visible) {
    const Vec3d eye = prepared.frame.calibration.camera_from_velo.inverse().translation();
    LightSurroundings around;
    if (rooftop) around = light_surroundings(prepared.frame, host, *rooftop);
    tape.visibility =
        find_visibility(placed, lighting, rooftop ? &around : nullptr, &eye, settings.visible_light);
    tape.visible = visible_light(tape.normals, placed.atlas.texels, lighting, tape.visibility,
                                 settings.visible_light.bounces);
    tape.gloss = settings.visible_light.gloss;
    for (std::size_t t = 0; t < lit.size(); ++t)
      lit[t] = (lit[t] + Vec3d::Constant(tape.gloss)).cwiseProduct(tape.visible.factor[t]);
    return lit;
  }
  for (std::size_t f = 0; f < tape.normals.size(); ++f) {
    tape.light.push_back(shade<double>(tape.normals[f], lighting));
    for (std::size_t t = f * placed.atlas.per_face(); t < (f + 1) * placed.atlas.per_face(); ++t)
      lit[t] = lit[t].cwiseProduct(tape.light.back());
  }
  return lit;
}

/// d loss / d texels and face normals, given d loss / d lit texels.
void lit_texels_vjp(const CameraTape& tape, const TexturedMesh& placed, const Lighting& lighting,
                    const std::vector<Vec3d>& d_lit, std::vector<Vec3d>& d_normals,
                    std::vector<Vec3d>& d_texels) {
  const std::vector<Vec3d>& texels = placed.atlas.texels;
  if (tape.light.empty()) {
    std::vector<Vec3d> d_factor(d_lit.size());
    for (std::size_t t = 0; t < d_lit.size(); ++t) {
      d_texels[t] += d_lit[t].cwiseProduct(tape.visible.factor[t]);
      d_factor[t] = d_lit[t].cwiseProduct(texels[t] + Vec3d::Constant(tape.gloss));
    }
    visible_light_vjp(tape.normals, texels, lighting, tape.visibility, tape.visible, d_factor, d_normals,
                      d_texels);
    return;
  }
  const std::size_t per_face = placed.atlas.per_face();
  for (std::size_t f = 0; f < d_normals.size(); ++f) {
    Vec3d d_light = Vec3d::Zero();
    for (std::size_t t = f * per_face; t < (f + 1) * per_face; ++t) {
      d_texels[t] += d_lit[t].cwiseProduct(tape.light[f]);
      d_light += d_lit[t].cwiseProduct(texels[t]);
    }
    d_normals[f] += shade_vjp<double>(tape.normals[f], lighting, d_light);
  }
}

}  // namespace

CameraTape draw_in_camera(const PreparedFrame& prepared, const Label& host, const TexturedMesh& placed,
                          const SimulationSettings& settings, Simulated& result, const Rooftop* rooftop) {
  const PinholeCamera& camera = prepared.frame.calibration.camera;
  const Transform& camera_from_velo = prepared.frame.calibration.camera_from_velo;
  CameraTape tape;
  for (const Vec3d& v : placed.mesh.vertices) tape.p_camera.push_back(camera_from_velo * v);
  tape.settings = settings.raster;
  set_depth_range(tape.p_camera, tape.settings);
  tape.exact_coverage = settings.exact_coverage;
  if (tape.exact_coverage) tape.settings.sigma = kSmallestSigma;  // edges reach no further than the faces
  tape.normals = face_normals(placed.mesh);
  tape.projected =
      project_mesh(tape.p_camera, placed.mesh.faces, camera, kNearestVertex, Texture::atlas,
                   placed.atlas.resolution, lit_texels(prepared, host, rooftop, placed, settings, tape));

  const PixelRect rect = touched_pixels(tape.projected.screen, tape.settings, camera.width, camera.height,
                                        {0, 0, camera.width, camera.height});
  result.image = prepared.frame.image;
  result.rect = rect;
  result.rgba = Image<double>(rect.width(), rect.height(), 4);
  if (rect.empty()) return tape;
  check_window(prepared, rect);

  tape.reference = settings.reference;
  RasterTarget<float>& target = tape.target;
  target.width = camera.width;
  target.height = camera.height;
  target.rect = rect;
  target.supersampling = settings.supersampling;
  target.background = ImageF(rect.width(), rect.height(), 3);
  target.depth_limit = ImageF(rect.width(), rect.height(), 1, std::numeric_limits<float>::infinity());
  bool occluded = false;
  bool obstructed = rect.u0 == 0 || rect.v0 == 0 || rect.u1 == camera.width || rect.v1 == camera.height;
  const double occluder_depth = host_near_depth(host, prepared.frame.calibration) - settings.occlusion_margin;
  for (int v = 0; v < rect.height(); ++v)
    for (int u = 0; u < rect.width(); ++u) {
      for (int c = 0; c < 3; ++c)
        target.background.at(u, v, c) = prepared.frame.image.at(rect.u0 + u, rect.v0 + v, c);
      const double depth = prepared.depth.at(rect.u0 + u, rect.v0 + v);
      if (depth >= occluder_depth) continue;
      target.depth_limit.at(u, v) = static_cast<float>(depth + settings.occlusion_margin);
      occluded = true;
    }
  obstructed |= occluded;
  if (!occluded) target.depth_limit = {};
  if (tape.exact_coverage) {
    draw_exact(tape.projected.screen, target, tape.exact);
    result.rgba = tape.exact.rgba;
  } else if (tape.reference) {
    result.rgba = rasterize(tape.projected.screen, tape.settings, to_double(target));
  } else {
    const RasterJob job{&tape.projected.screen, &tape.settings, &target};
    rasterize_batch({&job, 1}, {&tape.raster, 1});
    result.rgba = to_double(tape.raster.rgba);
  }
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

template <class S>
void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed, const Calibration& calibration,
                        const Lighting& lighting, const Simulated& result, const S* d_image,
                        std::vector<Vec3d>& d_vertices, std::vector<Vec3d>& d_texels) {
  if (tape.target.background.empty()) return;
  const PixelRect& rect = result.rect;
  const auto upstream = [&]<class T>(Image<T> d_rgba) {
    for (int v = 0; v < rect.height(); ++v) {
      const S* row = d_image + 3 * (static_cast<std::size_t>(rect.v0 + v) * result.image.width + rect.u0);
      for (int u = 0; u < rect.width(); ++u)
        for (int c = 0; c < 3; ++c) {
          const double value = result.rgba.at(u, v, c);
          const bool saturated = value > 1 || value < 0;
          d_rgba.at(u, v, c) = saturated ? T(0) : static_cast<T>(row[3 * u + c]);
        }
    }
    return d_rgba;
  };
  ScreenGradient<double> gradient;
  if (tape.exact_coverage) {
    gradient = draw_exact_vjp(tape.projected.screen, tape.target,
                              upstream(Image<double>(rect.width(), rect.height(), 4)), tape.exact);
  } else if (tape.reference) {
    gradient = rasterize_vjp(tape.projected.screen, tape.settings, to_double(tape.target),
                             upstream(Image<double>(rect.width(), rect.height(), 4)));
  } else {
    const RasterJob job{&tape.projected.screen, &tape.settings, &tape.target};
    const ImageF d_rgba = upstream(ImageF(rect.width(), rect.height(), 4));
    rasterize_batch_vjp({&job, 1}, {&d_rgba, 1}, {&tape.raster, 1}, {&gradient, 1});
  }

  std::vector<Vec3d> d_p_camera(tape.p_camera.size(), Vec3d::Zero()),
      d_lit(placed.atlas.texels.size(), Vec3d::Zero());
  project_mesh_vjp(tape.projected, tape.p_camera, calibration.camera, kNearestVertex, gradient, d_p_camera,
                   d_lit);
  const Eigen::Matrix3d velo_from_camera = calibration.camera_from_velo.linear().transpose();
  for (std::size_t i = 0; i < d_p_camera.size(); ++i) d_vertices[i] += velo_from_camera * d_p_camera[i];
  std::vector<Vec3d> d_normals(placed.mesh.faces.size(), Vec3d::Zero());
  lit_texels_vjp(tape, placed, lighting, d_lit, d_normals, d_texels);
  for (std::size_t f = 0; f < placed.mesh.faces.size(); ++f) {
    const Face& face = placed.mesh.faces[f];
    const Vec3d& d_normal = d_normals[f];
    const Vec3d e1 = placed.mesh.vertices[face[1]] - placed.mesh.vertices[face[0]];
    const Vec3d e2 = placed.mesh.vertices[face[2]] - placed.mesh.vertices[face[0]];
    const Vec3d d_e1 = e2.cross(d_normal), d_e2 = d_normal.cross(e1);
    d_vertices[face[0]] -= d_e1 + d_e2;
    d_vertices[face[1]] += d_e1;
    d_vertices[face[2]] += d_e2;
  }
}
template void draw_in_camera_vjp(const CameraTape&, const TexturedMesh&, const Calibration&, const Lighting&,
                                 const Simulated&, const float*, std::vector<Vec3d>&, std::vector<Vec3d>&);
template void draw_in_camera_vjp(const CameraTape&, const TexturedMesh&, const Calibration&, const Lighting&,
                                 const Simulated&, const double*, std::vector<Vec3d>&, std::vector<Vec3d>&);

}  // namespace mirage
