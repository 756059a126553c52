#include "simulation/render_scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/error.h"
#include "base/sizes.h"
#include "sensors/projection.h"
#include "sensors/ray_camera.h"
#include "simulation/camera_pass.h"
#include "simulation/object_light.h"

namespace mirage {
namespace {

constexpr double kDepthMargin = 0.5;             // m around the scene's depth range
constexpr double kDepthSoftness = 0.03;          // m; the default γ times (far − near)
constexpr std::size_t kMaxTexels = 170'000'000;  // 4 GB

void check(const RenderScene& scene, const ImageF& background) {
  const PinholeCamera& camera = scene.camera;
  const auto finite = [](double value) { return std::isfinite(value); };
  if (camera.width < 1 || camera.height < 1 || camera.width > 32768 || camera.height > 32768)
    throw InputError("scene", "camera.width, height", fmt::format("{}×{}", camera.width, camera.height),
                     "give 1 to 32768 pixels a side");
  if (!(camera.fx > 0 && camera.fy > 0) || !finite(camera.fx) || !finite(camera.fy) || !finite(camera.cx) ||
      !finite(camera.cy))
    throw InputError("scene", "camera.fx, fy, cx, cy", "are not finite with fx, fy > 0",
                     "export the scene again");
  if (!scene.camera_from_velo.matrix().allFinite())
    throw InputError("scene", "camera.velo_from_camera", "is not finite", "export the scene again");
  const Lighting& light = scene.lighting;
  for (const Vec3d& v : {light.to_sun_velo, light.sun, light.ambient, light.hemisphere})
    if (!v.allFinite()) throw InputError("scene", "lighting", "is not finite", "export the scene again");
  std::size_t faces = 0;
  for (const RenderScene::Thing& thing : scene.things) {
    check_mesh(thing.textured, thing.name);
    faces += thing.textured.mesh.faces.size();
  }
  if (faces == 0)
    throw InputError("scene", "meshes", "there are no faces to draw", "give a scene with meshes");
  if (background.width != camera.width || background.height != camera.height || background.channels != 3)
    throw InputError("background", "size",
                     fmt::format("{}×{} in a scene of {}×{}", background.width, background.height,
                                 camera.width, camera.height),
                     "give a picture of the camera's size");
}

/// All things as one mesh with one atlas resolution.
TexturedMesh merged(const RenderScene& scene) {
  std::size_t resolution = 1, faces = 0;
  for (const auto& thing : scene.things) {
    faces += thing.textured.mesh.faces.size();
    if (!thing.textured.atlas.texels.empty())
      resolution = std::lcm(resolution, as_size(thing.textured.atlas.resolution));
    if (resolution > 4096 || faces * resolution * resolution > kMaxTexels)
      throw InputError(
          "scene", "texels",
          fmt::format("{} faces with {}×{} texels each are too many", faces, resolution, resolution),
          "give the meshes one texture resolution");
  }
  TexturedMesh all;
  const int c = static_cast<int>(resolution);
  all.atlas.resolution = c;
  all.atlas.texels.reserve(faces * resolution * resolution);
  for (const auto& thing : scene.things) {
    const auto& [mesh, atlas] = thing.textured;
    const int first = static_cast<int>(all.mesh.vertices.size());
    all.mesh.vertices.insert(all.mesh.vertices.end(), mesh.vertices.begin(), mesh.vertices.end());
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
      const Face& face = mesh.faces[f];
      all.mesh.faces.push_back({first + face[0], first + face[1], first + face[2]});
      // The finer atlas cuts each of the coarser atlas's C² congruent triangles: a texel has the coarse
      // colour at any point inside it. The layout of TexelAtlas: lower triangles at (ix, iy) with
      // ix + iy < C, upper ones mirrored into the rest of the square.
      for (int iy = 0; iy < c; ++iy)
        for (int ix = 0; ix < c; ++ix) {
          const bool lower = ix + iy < c;
          const double x = lower ? ix + 1 / 3.0 : c - 1 - ix + 2 / 3.0,
                       y = lower ? iy + 1 / 3.0 : c - 1 - iy + 2 / 3.0;
          all.atlas.texels.push_back(
              atlas.texels.empty()
                  ? Vec3d::Constant(0.5)
                  : atlas
                        .texels[f * atlas.per_face() + as_size(texel_index(x / c, y / c, atlas.resolution))]);
        }
    }
  }
  return all;
}

/// Depth at the pixels' centres: a hard pass in which each corner's colour is its depth. Perspective-correct
/// interpolation is exact for depth, which is linear in space.
ImageF depth_at_centres(const std::vector<Vec3d>& p_camera, const std::vector<Face>& faces,
                        const PinholeCamera& camera, const SoftRasterSettings<double>& soft,
                        const PixelRect& rect) {
  std::vector<Vec3d> depths;
  depths.reserve(3 * faces.size());
  for (const Face& face : faces)
    for (int k : face) depths.push_back(Vec3d::Constant(p_camera[as_size(k)].z()));
  const ProjectedMesh projected =
      project_mesh(p_camera, faces, camera, kNearPlane, Texture::vertex, 1, std::move(depths));
  SoftRasterSettings<double> hard = soft;
  hard.coverage = Coverage::hard;
  hard.color = ColorBlend::hard;
  hard.silhouette = SilhouetteBlend::hard;
  hard.background = Background::silhouette;
  const auto rgba = camera_pass({})->draw(projected.screen, hard,
                                          window_of(camera, rect, ImageF(rect.width(), rect.height(), 3)));
  ImageF depth(rect.width(), rect.height(), 1);
  for (std::size_t i = 0; i < depth.data.size(); ++i)
    depth.data[i] = rgba.data[4 * i + 3] > 0.5 ? static_cast<float>(rgba.data[4 * i]) : 0;
  return depth;
}

void render_soft(const RenderScene& scene, const SceneRenderSettings& settings, const ImageF& background,
                 SceneImage& out) {
  const TexturedMesh all = merged(scene);
  std::vector<Vec3d> p_camera;
  p_camera.reserve(all.mesh.vertices.size());
  for (const Vec3d& v : all.mesh.vertices) p_camera.push_back(scene.camera_from_velo * v);
  double nearest = std::numeric_limits<double>::infinity(), farthest = kNearPlane;
  for (const std::size_t i : used_vertices(all.mesh)) {
    nearest = std::min(nearest, std::max(kNearPlane, p_camera[i].z()));
    farthest = std::max(farthest, p_camera[i].z());
  }
  SoftRasterSettings<double> raster = settings.raster;
  raster.near = std::max(kNearPlane / 2, nearest - kDepthMargin);
  raster.far = std::max(raster.near + 1, farthest + kDepthMargin);
  raster.gamma = settings.gamma.value_or(kDepthSoftness / (raster.far - raster.near));
  std::vector<Vec3d> lit = plain_light(all, scene.lighting)->lit(all.atlas.texels);
  const ProjectedMesh projected = project_mesh(p_camera, all.mesh.faces, scene.camera, kNearPlane,
                                               Texture::atlas, all.atlas.resolution, std::move(lit));
  out.rgba = to_float(camera_pass({})->draw(projected.screen, raster,
                                            window_of(scene.camera, out.rect, background, settings.samples)));
  out.depth = depth_at_centres(p_camera, all.mesh.faces, scene.camera, raster, out.rect);
  out.near = raster.near;
  out.far = raster.far;
  out.gamma = raster.gamma;
}

void render_traced(const RenderScene& scene, const SceneRenderSettings& settings, const ImageF& background,
                   SceneImage& out) {
  std::vector<Surface> surfaces;
  for (const auto& thing : scene.things) {
    Surface surface;
    surface.mesh = thing.textured.mesh;
    surface.object = static_cast<int>(surfaces.size());
    surface.atlas = thing.textured.atlas;
    surfaces.push_back(std::move(surface));
  }
  const RayScene rays(surfaces);
  SceneLight light;
  light.lighting = scene.lighting;
  // An open sky of one radiance lights a face with (1 + n·up)/2 of it, the ground with the rest: together the
  // light model's ambient and hemisphere terms.
  const Lighting& model = scene.lighting;
  light.sky.horizon = light.sky.zenith = (model.ambient + model.hemisphere).cast<float>();
  light.sky.glow = 0;
  light.sky.seen = 0;  // the background is composited below
  PinholeCamera camera = scene.camera;
  camera.width = out.rect.width();
  camera.height = out.rect.height();
  camera.cx -= out.rect.u0;
  camera.cy -= out.rect.v0;
  const RayImage image = render(rays, camera, scene.camera_from_velo, light,
                                {settings.samples, std::max(1, 8 / settings.samples), settings.seed});
  out.rgba = ImageF(camera.width, camera.height, 4);
  for (int v = 0; v < camera.height; ++v)
    for (int u = 0; u < camera.width; ++u) {
      const float alpha = image.coverage.at(u, v);
      for (int c = 0; c < 3; ++c)
        out.rgba.at(u, v, c) = image.color.at(u, v, c) + (1 - alpha) * background.at(u, v, c);
      out.rgba.at(u, v, 3) = alpha;
    }
  out.depth = image.depth;
}

}  // namespace

PinholeCamera resized(const PinholeCamera& camera, int width, int height) {
  const double sx = static_cast<double>(width) / camera.width,
               sy = static_cast<double>(height) / camera.height;
  return {camera.fx * sx, camera.fy * sy, (camera.cx + 0.5) * sx - 0.5, (camera.cy + 0.5) * sy - 0.5,
          width,          height};
}

ImageF crop(const ImageF& image, const PixelRect& rect) {
  ImageF out(rect.width(), rect.height(), image.channels);
  for (int v = 0; v < out.height; ++v)
    std::copy_n(image.pixel(rect.u0, rect.v0 + v), as_size(out.width) * as_size(image.channels),
                out.pixel(0, v));
  return out;
}

SceneImage render_scene(const RenderScene& scene, const ImageF& background,
                        const SceneRenderSettings& settings) {
  check(scene, background);
  SceneImage out;
  const PinholeCamera& camera = scene.camera;
  out.rect = settings.rect.empty() ? PixelRect{0, 0, camera.width, camera.height} : settings.rect;
  if (out.rect.u0 < 0 || out.rect.v0 < 0 || out.rect.u1 > camera.width || out.rect.v1 > camera.height)
    throw InputError("window", "",
                     fmt::format("{},{},{},{} does not lie in {}×{}", out.rect.u0, out.rect.v0, out.rect.u1,
                                 out.rect.v1, camera.width, camera.height),
                     "give u0,v0,u1,v1 inside the image");
  for (const auto& thing : scene.things) out.faces += thing.textured.mesh.faces.size();
  const ImageF behind = crop(background, out.rect);
  if (settings.renderer == SceneRenderer::soft)
    render_soft(scene, settings, behind, out);
  else
    render_traced(scene, settings, behind, out);
  for (std::size_t i = 3; i < out.rgba.data.size(); i += 4) out.covered += out.rgba.data[i] > 0.5f;
  return out;
}

double rgba_at(const CameraSight& seen, int u, int v, int c) {
  const PixelRect& r = seen.rect;
  if (u < r.u0 || u >= r.u1 || v < r.v0 || v >= r.v1) return 0;
  return seen.rgba.at(u - r.u0, v - r.v0, c);
}

ImageF radiance_of(const Simulated& simulated, const ImageF& photograph, const PixelRect& rect) {
  ImageF window = crop(photograph, rect);
  const PixelRect& drawn = simulated.rect;
  for (int v = std::max(rect.v0, drawn.v0); v < std::min(rect.v1, drawn.v1); ++v)
    for (int u = std::max(rect.u0, drawn.u0); u < std::min(rect.u1, drawn.u1); ++u)
      for (int c = 0; c < 3; ++c)
        window.at(u - rect.u0, v - rect.v0, c) = static_cast<float>(rgba_at(simulated, u, v, c));
  return window;
}

void add_to_picture(const ImageF& difference, const PixelRect& rect, Simulated& simulated) {
  const PixelRect& drawn = simulated.rect;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u) {
      const bool inside = u >= drawn.u0 && u < drawn.u1 && v >= drawn.v0 && v < drawn.v1;
      for (int c = 0; c < 3; ++c) {
        float& shown = simulated.image.at(u, v, c);
        double value = difference.at(u - rect.u0, v - rect.v0, c);
        if (inside)
          value = simulated.rgba.at(u - drawn.u0, v - drawn.v0, c) += value;
        else
          value += shown;
        shown = static_cast<float>(std::clamp(value, 0.0, 1.0));
      }
    }
}

PixelRect united(const PixelRect& a, const PixelRect& b) {
  if (a.empty()) return b;
  if (b.empty()) return a;
  return {std::min(a.u0, b.u0), std::min(a.v0, b.v0), std::max(a.u1, b.u1), std::max(a.v1, b.v1)};
}

}  // namespace mirage
