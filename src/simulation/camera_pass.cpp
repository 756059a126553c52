#include "simulation/camera_pass.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "base/random.h"
#include "base/sizes.h"
#include "sensors/exact_coverage.h"
#include "sensors/raster/limits.h"
#include "simulation/check_inputs.h"

namespace mirage {
namespace {

/// A window that also holds the parts of the mesh beyond the picture's edges.
RasterTarget<float> wide_target(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                                const PinholeCamera& camera) {
  const PixelRect rect = touched_pixels(mesh, settings, camera.width, camera.height,
                                        {-camera.width, -camera.height, 2 * camera.width, 2 * camera.height});
  return window_of(camera, rect, ImageF(rect.width(), rect.height(), 3));
}

class FastPass : public CameraPass {
 public:
  Image<double> draw(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                     const RasterTarget<float>& target) override {
    const RasterJob job{&mesh, &settings, &target};
    rasterize_batch({&job, 1}, {&tape_, 1});
    return to_double(tape_.rgba);
  }

  ScreenGradient<double> vjp(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                             const RasterTarget<float>& target, const Image<double>& d_rgba) const override {
    const RasterJob job{&mesh, &settings, &target};
    const ImageF upstream = to_float(d_rgba);
    ScreenGradient<double> gradient;
    rasterize_batch_vjp({&job, 1}, {&upstream, 1}, {&tape_, 1}, {&gradient, 1});
    return gradient;
  }

  double unobstructed_area(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                           const PinholeCamera& camera) const override {
    return silhouette_area(FastPass().draw(mesh, settings, wide_target(mesh, settings, camera)));
  }

 private:
  mutable RasterTape tape_;  // its VJP needs working memory
};

class ReferencePass : public CameraPass {
 public:
  Image<double> draw(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                     const RasterTarget<float>& target) override {
    return rasterize(mesh, settings, to_double(target));
  }

  ScreenGradient<double> vjp(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                             const RasterTarget<float>& target, const Image<double>& d_rgba) const override {
    return rasterize_vjp(mesh, settings, to_double(target), d_rgba);
  }

  double unobstructed_area(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                           const PinholeCamera& camera) const override {
    return silhouette_area(rasterize(mesh, settings, to_double(wide_target(mesh, settings, camera))));
  }
};

class ExactPass : public CameraPass {
 public:
  Image<double> draw(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>&,
                     const RasterTarget<float>& target) override {
    draw_exact(mesh, target, tape_);
    return tape_.rgba;
  }

  ScreenGradient<double> vjp(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>&,
                             const RasterTarget<float>& target, const Image<double>& d_rgba) const override {
    return draw_exact_vjp(mesh, target, d_rgba, tape_);
  }

  double unobstructed_area(const ScreenMesh<double>&, const SoftRasterSettings<double>&,
                           const PinholeCamera&) const override {
    return tape_.area;
  }

 private:
  ExactTape tape_;
};

/// Depth range of the rasteriser: a ball around the object that grows in steps of half a metre, so that small
/// moves of the object (derivatives) leave it constant.
void set_depth_range(const std::vector<Vec3d>& p_camera, const std::vector<std::size_t>& used,
                     SoftRasterSettings<double>& settings) {
  Vec3d centre = Vec3d::Zero();
  for (const std::size_t i : used) centre += p_camera[i] / static_cast<double>(used.size());
  double reach = 0;
  for (const std::size_t i : used) reach = std::max(reach, std::abs(p_camera[i].z() - centre.z()));
  const double radius = std::max(1.5, std::ceil(2 * reach + 0.5) / 2);
  const double middle = std::round(2 * centre.z()) / 2;
  settings.near = std::max(kNearPlane / 2, middle - radius);
  settings.far = std::max(settings.near + 1, middle + radius);  // all of it behind the camera
}

int count_opaque(const Image<double>& rgba) {
  int count = 0;
  for (std::size_t i = 3; i < rgba.data.size(); i += 4) count += rgba.data[i] > 0.5;
  return count;
}

std::unique_ptr<ObjectLight> light_on(const PreparedFrame& prepared, const Placement& placement,
                                      const TexturedMesh& placed, const SimulationSettings& settings,
                                      const Calibration& calibration) {
  const Lighting& lighting = prepared.frame.lighting;
  if (settings.light == LightModel::plain) return plain_light(placed, lighting);
  const Vec3d eye = calibration.camera_from_velo.inverse().translation();
  const std::optional<LightSurroundings> around = surroundings_of(prepared.frame, placement);
  return light_with_visibility(placed, lighting, around ? &*around : nullptr, eye,
                               settings.light == LightModel::fine ? fine_light() : settings.visible_light);
}

/// Standard normals of the three channels of a pixel of the picture.
Vec3d noise_at(const CameraEffects& effects, int u, int v) {
  RandomStream random(effects.seed, "sensor noise on the object",
                      static_cast<std::uint64_t>(v) << 32 | static_cast<std::uint64_t>(u));
  Vec3d noise;
  for (double& n : noise) n = random.normal();
  return noise;
}

/// Calls each(u, v) for every pixel of the window.
template <class Each>
void each_pixel(const Image<double>& window, const Each& each) {
  for (int v = 0; v < window.height; ++v)
    for (int u = 0; u < window.width; ++u) each(u, v);
}

}  // namespace

double silhouette_area(const Image<double>& rgba) {
  double area = 0;
  for (std::size_t i = 3; i < rgba.data.size(); i += 4) area += rgba.data[i];
  return area;
}

RasterTarget<float> window_of(const PinholeCamera& camera, const PixelRect& rect, ImageF background,
                              int supersampling) {
  return {camera.width, camera.height, rect, supersampling, std::move(background), {}};
}

std::unique_ptr<CameraPass> camera_pass(const SimulationSettings& settings) {
  if (settings.exact_coverage) return std::make_unique<ExactPass>();
  if (settings.reference) return std::make_unique<ReferencePass>();
  return std::make_unique<FastPass>();
}

bool may_see(const Calibration& calibration, const Mesh& placed, const SimulationSettings& settings) {
  const PinholeCamera& camera = calibration.camera;
  const SoftRasterSettings<double>& raster = settings.raster;
  // Reach of touched_pixels and of the blur beyond a face, in pixels.
  const double cut_off = std::max(0.0, raster.sigma * std::log(1 / raster.dist_eps - 1));
  const double margin = 2 + kBlurReach + std::sqrt(cut_off) * std::max(camera.width, camera.height) / 2;
  int behind = 0, left = 0, right = 0, above = 0, below = 0, count = 0;
  for (const std::size_t i : used_vertices(placed)) {
    const Vec3d p = calibration.camera_from_velo * placed.vertices[i];
    ++count;
    // Tests against the planes through the camera and the widened picture's edges; they hold behind it, too.
    const double u = camera.fx * p.x() + camera.cx * p.z(), v = camera.fy * p.y() + camera.cy * p.z();
    behind += p.z() < kNearPlane;
    left += u < -margin * p.z();
    right += u > (camera.width - 1 + margin) * p.z();
    above += v < -margin * p.z();
    below += v > (camera.height - 1 + margin) * p.z();
  }
  return behind < count && left < count && right < count && above < count && below < count;
}

CameraTape draw_in_camera(const PreparedFrame& prepared, const Placement& placement,
                          const TexturedMesh& placed, const SimulationSettings& settings, CameraSight& result,
                          std::size_t of) {
  const Calibration& calibration = prepared.frame.calibration_of(of);
  const PinholeCamera& camera = calibration.camera;
  const Transform& camera_from_velo = calibration.camera_from_velo;
  CameraTape tape;
  for (const Vec3d& v : placed.mesh.vertices) tape.p_camera.push_back(camera_from_velo * v);
  tape.settings = settings.raster;
  set_depth_range(tape.p_camera, used_vertices(placed.mesh), tape.settings);
  if (settings.exact_coverage) tape.settings.sigma = kMinSigma;  // edges reach no further than the faces
  tape.light = light_on(prepared, placement, placed, settings, calibration);
  tape.projected = project_mesh(tape.p_camera, placed.mesh.faces, camera, kNearPlane, Texture::atlas,
                                tape.light->grid(), tape.light->lit(placed.atlas.texels));

  PixelRect rect = touched_pixels(tape.projected.screen, tape.settings, camera.width, camera.height,
                                  {0, 0, camera.width, camera.height});
  if (settings.camera_effects.blur_sigma > 0 && !rect.empty())
    rect = {std::max(0, rect.u0 - kBlurReach), std::max(0, rect.v0 - kBlurReach),
            std::min(camera.width, rect.u1 + kBlurReach), std::min(camera.height, rect.v1 + kBlurReach)};
  result.rect = rect;
  result.rgba = Image<double>(rect.width(), rect.height(), 4);
  if (of == 0 || !rect.empty()) result.image = prepared.frame.image_of(of);
  if (rect.empty()) return tape;
  check_window(prepared, of, rect);
  const ImageF &photograph = prepared.frame.image_of(of), &completed = prepared.depth_of(of);

  tape.pass = camera_pass(settings);
  RasterTarget<float>& target = tape.target;
  target = window_of(camera, rect, ImageF(rect.width(), rect.height(), 3), settings.supersampling);
  target.depth_limit = ImageF(rect.width(), rect.height(), 1, std::numeric_limits<float>::infinity());
  bool occluded = false;
  bool obstructed = rect.u0 == 0 || rect.v0 == 0 || rect.u1 == camera.width || rect.v1 == camera.height;
  const double occluder_depth = occluder_depth_limit(placement, calibration) - settings.occlusion_margin;
  for (int v = 0; v < rect.height(); ++v)
    for (int u = 0; u < rect.width(); ++u) {
      for (int c = 0; c < 3; ++c) target.background.at(u, v, c) = photograph.at(rect.u0 + u, rect.v0 + v, c);
      const double depth = completed.at(rect.u0 + u, rect.v0 + v);
      if (depth >= occluder_depth) continue;
      target.depth_limit.at(u, v) = static_cast<float>(depth + settings.occlusion_margin);
      occluded = true;
    }
  obstructed |= occluded;
  if (!occluded) target.depth_limit = {};
  result.rgba = tape.pass->draw(tape.projected.screen, tape.settings, target);
  result.adversary_pixels = count_opaque(result.rgba);
  result.visible_share = 1;
  if (obstructed) {
    const double whole = tape.pass->unobstructed_area(tape.projected.screen, tape.settings, camera);
    result.visible_share = whole > 0 ? std::min(1.0, silhouette_area(result.rgba) / whole) : 0;
  }
  tape.effects = settings.camera_effects;
  tape.effects.seed ^= fnv1a(prepared.frame.id + " " + std::to_string(of));
  tape.softened = expose_object(tape.effects, target.background, rect.u0, rect.v0, result.rgba);
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      for (int c = 0; c < 3; ++c)  // the photograph saturates at 1, and so does the object
        result.image.at(u, v, c) =
            static_cast<float>(std::clamp(result.rgba.at(u - rect.u0, v - rect.v0, c), 0.0, 1.0));
  return tape;
}

void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed, const Calibration& calibration,
                        const CameraSight& result, const GradientView& d_image,
                        std::vector<Vec3d>& d_vertices, std::vector<Vec3d>& d_texels) {
  if (tape.target.background.empty()) return;
  const PixelRect& rect = result.rect;
  Image<double> d_rgba(rect.width(), rect.height(), 4);
  for (int v = 0; v < rect.height(); ++v) {
    std::size_t at = 3 * (as_size(rect.v0 + v) * as_size(result.image.width) + as_size(rect.u0));
    for (int u = 0; u < rect.width(); ++u)
      for (int c = 0; c < 3; ++c, ++at) {
        const double value = result.rgba.at(u, v, c);
        const bool saturated = value > 1 || value < 0;
        d_rgba.at(u, v, c) = saturated ? 0 : d_image[at];
      }
  }
  expose_object_vjp(tape.effects, tape.target.background, rect.u0, rect.v0, tape.softened, d_rgba);
  const ScreenGradient<double> gradient =
      tape.pass->vjp(tape.projected.screen, tape.settings, tape.target, d_rgba);

  std::vector<Vec3d> d_p_camera(tape.p_camera.size(), Vec3d::Zero()),
      d_lit(tape.projected.screen.texels.size(), Vec3d::Zero());
  project_mesh_vjp(tape.projected, tape.p_camera, calibration.camera, kNearPlane, gradient, d_p_camera,
                   d_lit);
  const Eigen::Matrix3d velo_from_camera = calibration.camera_from_velo.linear().transpose();
  for (std::size_t i = 0; i < d_p_camera.size(); ++i) d_vertices[i] += velo_from_camera * d_p_camera[i];
  std::vector<Vec3d> d_normals(placed.mesh.faces.size(), Vec3d::Zero());
  tape.light->vjp(placed.atlas.texels, d_lit, d_normals, d_texels);
  for (std::size_t f = 0; f < placed.mesh.faces.size(); ++f) {
    const Face& face = placed.mesh.faces[f];
    const Vec3d& d_normal = d_normals[f];
    const auto [a, b, c] = placed.mesh.corners(face);
    const Vec3d e1 = b - a, e2 = c - a;
    const Vec3d d_e1 = e2.cross(d_normal), d_e2 = d_normal.cross(e1);
    d_vertices[as_size(face[0])] -= d_e1 + d_e2;
    d_vertices[as_size(face[1])] += d_e1;
    d_vertices[as_size(face[2])] += d_e2;
  }
}

Image<double> expose_object(const CameraEffects& effects, const ImageF& photograph, int u0, int v0,
                            Image<double>& rgba) {
  if (effects.blur_sigma > 0) {
    each_pixel(rgba, [&](int u, int v) {
      double* p = rgba.pixel(u, v);
      for (int c = 0; c < 3; ++c) p[c] -= (1 - p[3]) * photograph.at(u, v, c);
    });
    soften(rgba, effects.blur_sigma);
    each_pixel(rgba, [&](int u, int v) {
      double* p = rgba.pixel(u, v);
      for (int c = 0; c < 3; ++c) p[c] += (1 - p[3]) * photograph.at(u, v, c);
    });
  }
  if (!effects.noisy()) return {};
  Image<double> softened = rgba;
  each_pixel(rgba, [&](int u, int v) {
    double* p = rgba.pixel(u, v);
    if (p[3] <= 0) return;
    const Vec3d noise = noise_at(effects, u0 + u, v0 + v);
    for (int c = 0; c < 3; ++c) p[c] += p[3] * noise[c] * noise_sigma(p[c], effects.shot, effects.read_sigma);
  });
  return softened;
}

void expose_object_vjp(const CameraEffects& effects, const ImageF& photograph, int u0, int v0,
                       const Image<double>& softened, Image<double>& d_rgba) {
  if (effects.noisy())
    each_pixel(d_rgba, [&](int u, int v) {
      const double* p = softened.pixel(u, v);
      double* d = d_rgba.pixel(u, v);
      if (p[3] <= 0) return;
      const Vec3d noise = noise_at(effects, u0 + u, v0 + v);
      for (int c = 0; c < 3; ++c) {
        const double sigma = noise_sigma(p[c], effects.shot, effects.read_sigma);
        d[3] += d[c] * noise[c] * sigma;
        if (p[c] > 0 && sigma > 0) d[c] += d[c] * p[3] * noise[c] * effects.shot / (2 * sigma);
      }
    });
  if (effects.blur_sigma <= 0) return;
  each_pixel(d_rgba, [&](int u, int v) {
    double* d = d_rgba.pixel(u, v);
    for (int c = 0; c < 3; ++c) d[3] -= d[c] * photograph.at(u, v, c);
  });
  soften_vjp(d_rgba, effects.blur_sigma);
  each_pixel(d_rgba, [&](int u, int v) {
    double* d = d_rgba.pixel(u, v);
    for (int c = 0; c < 3; ++c) d[3] += d[c] * photograph.at(u, v, c);
  });
}

}  // namespace mirage
