#include "sensors/ray_camera.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/parallel.h"
#include "base/random.h"
#include "base/sizes.h"
#include "geometry/mesh.h"

namespace mirage {
namespace {

constexpr float kLift = 2e-3f;         // m, secondary rays start this far off the surface
constexpr float kSkyReach = 12.f;      // m, largest distance of an occluder of the sky's light
constexpr float kOpenDistance = 1.5f;  // m, distance from which a neighbouring surface counts as lit
constexpr int kMaxPanes = 4;           // a car has two windows in a row
constexpr float kGlossyLimit = 0.4f;   // highlights of the sun's disc are wider than the real sun's

std::vector<Mesh> meshes_of(std::span<const Surface> surfaces) {
  std::vector<Mesh> meshes;
  meshes.reserve(surfaces.size());
  for (const Surface& s : surfaces) meshes.push_back(s.mesh);
  return meshes;
}

float schlick(float normal_incidence, float cosine) {
  const float m = 1 - std::clamp(cosine, 0.f, 1.f), m2 = m * m;
  return normal_incidence + (1 - normal_incidence) * m2 * m2 * m;
}

class Shader {
 public:
  Shader(const RayScene& scene, const SceneLight& light, int sky_rays)
      : scene_(scene), sky_(light.sky), sky_rays_(sky_rays) {
    to_sun_ = light.lighting.to_sun_velo.cast<float>();
    sun_ = light.lighting.sun.cast<float>();
    bounce_ = light.lighting.ambient.cast<float>();
  }

  Vec3f miss(const Vec3f& direction) const { return sky_.seen * sky_.radiance(direction, to_sun_); }

  /// Radiance towards the eye from a hit, without the sky's diffuse part: albedo · sky, returned separately
  /// because its noise is filtered. `footprint`: a pixel's size in rad.
  struct Shade {
    Vec3f color = Vec3f::Zero(), albedo = Vec3f::Zero(), sky = Vec3f::Zero();
  };
  Shade shade(const Ray& ray, const Hit& hit, float footprint, RandomStream& random) const {
    const Material& m = scene_.materials[as_size(hit.mesh)];
    const Vec3f d = ray.direction.normalized();
    Vec3f n = scene_.shading_normal(hit);
    if (hit.normal.dot(d) > 0) n = -n;
    const Vec3f p = ray.origin + hit.t * ray.direction;
    const float distance = hit.t * ray.direction.norm(), cosine = std::max(0.05f, -n.dot(d));
    Shade out;
    out.color = m.emission;
    const float gloss = surface_gloss(m, p, n), mirror = gloss > 0 ? schlick(gloss, cosine) : 0.f;
    const float through = seen_through(m) * (1 - mirror);
    if (through < 1) {
      const Vec3f albedo = scene_.albedo(hit, p, n, footprint * distance / std::sqrt(cosine));
      out.albedo = (1 - mirror - through) * albedo;
      out.color += out.albedo.cwiseProduct(sun_at(p, n));
      out.sky = sky_at(p, n, random);
    }
    if (mirror > 0) out.color += mirror * reflection(p, n, d);
    if (through > 0) out.color += through * behind(p, d, footprint, random);
    return out;
  }

 private:
  /// Irradiance / π from the sun.
  Vec3f sun_at(const Vec3f& p, const Vec3f& n) const {
    const float facing = n.dot(to_sun_);
    if (facing <= 0 || scene_.caster.occluded({p + kLift * n, to_sun_, 0, 200.f})) return Vec3f::Zero();
    return facing * sun_;
  }

  /// Irradiance / π from the sky and from surfaces in front of it.
  Vec3f sky_at(const Vec3f& p, const Vec3f& n, RandomStream& random) const {
    const Vec3f start = p + kLift * n;
    Vec3f sum = Vec3f::Zero();
    // Cosine-distributed directions, one in each of `sky_rays_` sectors of azimuth.
    const Vec3f side =
        (std::abs(n.z()) < 0.9f ? Vec3f(Vec3f::UnitZ().cross(n)) : Vec3f(Vec3f::UnitX().cross(n)))
            .normalized();
    const Vec3f other = n.cross(side);
    const float turn = static_cast<float>(random.uniform());
    for (int k = 0; k < sky_rays_; ++k) {
      const float r2 =
          (static_cast<float>(k) + static_cast<float>(random.uniform())) / static_cast<float>(sky_rays_);
      const float angle = 2 * std::numbers::pi_v<float> * (turn + 0.618034f * static_cast<float>(k));
      const float r = std::sqrt(r2);
      const Vec3f w = r * std::cos(angle) * side + r * std::sin(angle) * other + std::sqrt(1 - r2) * n;
      const Hit hit = scene_.caster.intersect({start, w, 0, kSkyReach});
      // Crevices and the road under a car get next to no bounced light: close surfaces are shaded.
      if (hit.hit())
        sum += bounce_ * std::min(1.f, 0.08f + hit.t / kOpenDistance);
      else
        sum += w.z() < 0 ? bounce_ : sky_.radiance(w, to_sun_);
    }
    return sum / static_cast<float>(sky_rays_);
  }

  /// Radiance of a mirror reflection: surroundings with a cheap light (no shadows), or the sky.
  Vec3f reflection(const Vec3f& p, const Vec3f& n, const Vec3f& d) const {
    const Vec3f r = d - 2 * n.dot(d) * n;
    const Ray ray{p + kLift * n, r, 0, 300.f};
    const Hit hit = scene_.caster.intersect(ray);
    if (!hit.hit()) {
      const float highlight = std::max(0.f, r.dot(to_sun_));
      const float lobe = std::pow(highlight, 900.f) * 60.f;
      Vec3f sky = sky_.radiance(r, to_sun_);
      return sky + std::min(lobe, kGlossyLimit / 0.04f) * sun_;
    }
    const Material& m = scene_.materials[as_size(hit.mesh)];
    Vec3f face = hit.normal.normalized();
    if (face.dot(r) > 0) face = -face;
    const Vec3f q = ray.origin + hit.t * r;
    const Vec3f albedo = scene_.albedo(hit, q, face, 0.02f * hit.t) * (1 - seen_through(m));
    return albedo.cwiseProduct(bounce_ + 0.5f * sky_.zenith + 0.6f * std::max(0.f, face.dot(to_sun_)) * sun_);
  }

  Vec3f behind(const Vec3f& p, const Vec3f& d, float footprint, RandomStream& random) const {
    Ray ray{p, d, kLift, 300.f};
    float left = 1;
    for (int layer = 0; layer < kMaxPanes; ++layer) {
      const Hit hit = scene_.caster.intersect(ray);
      if (!hit.hit()) return left * miss(d);
      const Material& m = scene_.materials[as_size(hit.mesh)];
      if (seen_through(m) > 0) {
        left *= seen_through(m);
        ray.t_min = hit.t + kLift;
        continue;
      }
      Vec3f n = hit.normal.normalized();
      if (n.dot(d) > 0) n = -n;
      const Vec3f q = ray.origin + hit.t * d;
      return left *
             scene_.albedo(hit, q, n, footprint * hit.t).cwiseProduct(sun_at(q, n) + sky_at(q, n, random));
    }
    return Vec3f::Zero();
  }

  const RayScene& scene_;
  const Sky& sky_;
  int sky_rays_;
  Vec3f to_sun_, sun_, bounce_;
};

/// Per-pixel inputs of the filter.
struct Layers {
  ImageF albedo, sky, normal;
};

// Few rays sample the sky: smooth its light over neighbours on the same surface, then add albedo · sky.
void add_sky_light(RayImage& image, const Layers& layers) {
  constexpr int reach = 3;
  const int width = image.color.width, height = image.color.height;
  parallel_for(as_size(height), [&](std::size_t row) {
    const int v = static_cast<int>(row);
    for (int u = 0; u < width; ++u) {
      const float depth = image.depth.at(u, v);
      const Eigen::Map<const Vec3f> n(layers.normal.pixel(u, v));
      Vec3f sum = Vec3f::Zero();
      float weights = 0;
      for (int y = std::max(0, v - reach); y <= std::min(height - 1, v + reach); ++y)
        for (int x = std::max(0, u - reach); x <= std::min(width - 1, u + reach); ++x) {
          if (layers.albedo.at(x, y) + layers.albedo.at(x, y, 1) <= 0) continue;  // sky, or a mirror
          const float other = image.depth.at(x, y);
          // Grazing surfaces change depth quickly from row to row; their normals tell them apart.
          if (std::abs(other - depth) > 0.06f * depth || (depth == 0 && (x != u || y != v))) continue;
          const float facing = n.dot(Eigen::Map<const Vec3f>(layers.normal.pixel(x, y)));
          if (facing < 0.8f && (x != u || y != v)) continue;
          sum += Eigen::Map<const Vec3f>(layers.sky.pixel(x, y));
          weights += 1;
        }
      if (weights == 0) {  // no similar neighbour: the pixel's own samples
        sum = Eigen::Map<const Vec3f>(layers.sky.pixel(u, v));
        weights = 1;
      }
      for (int c = 0; c < 3; ++c) image.color.at(u, v, c) += layers.albedo.at(u, v, c) * sum[c] / weights;
    }
  });
}

}  // namespace

RayScene::RayScene(std::span<const Surface> surfaces) : caster(meshes_of(surfaces)) {
  for (const Surface& s : surfaces) {
    materials.push_back(s.material);
    objects.push_back(s.object);
    atlases_.push_back(s.atlas);
    Smooth& smooth = smooth_.emplace_back();
    if (!s.smooth) continue;
    smooth.faces = s.mesh.faces;
    smooth.normals.assign(s.mesh.vertices.size(), Vec3f::Zero());
    const std::vector<Vec3d> flat = face_normals(s.mesh);
    for (std::size_t f = 0; f < flat.size(); ++f)
      for (int v : s.mesh.faces[f]) smooth.normals[as_size(v)] += flat[f].cast<float>();
  }
}

std::size_t RayScene::texel(const Hit& hit) const {
  const TexelAtlas& atlas = atlases_[as_size(hit.mesh)];
  return as_size(hit.face) * atlas.per_face() +
         as_size(texel_index(1 - hit.b1 - hit.b2, hit.b1, atlas.resolution));
}

Vec3f RayScene::albedo(const Hit& hit, const Vec3f& p, const Vec3f& n, float footprint) const {
  const TexelAtlas& atlas = atlases_[as_size(hit.mesh)];
  if (atlas.texels.empty()) return surface_albedo(materials[as_size(hit.mesh)], p, n, footprint);
  return atlas.texels[texel(hit)].cast<float>();
}

bool RayScene::same_texel(const Hit& a, const Hit& b) const {
  return atlases_[as_size(a.mesh)].texels.empty() || texel(a) == texel(b);
}

Vec3f RayScene::shading_normal(const Hit& hit) const {
  const Smooth& smooth = smooth_[as_size(hit.mesh)];
  if (smooth.faces.empty()) return hit.normal.normalized();
  const Face& f = smooth.faces[as_size(hit.face)];
  const Vec3f n = (1 - hit.b1 - hit.b2) * smooth.normals[as_size(f[0])].normalized() +
                  hit.b1 * smooth.normals[as_size(f[1])].normalized() +
                  hit.b2 * smooth.normals[as_size(f[2])].normalized();
  return n.squaredNorm() > 1e-6f ? Vec3f(n.normalized()) : Vec3f(hit.normal.normalized());
}

Vec3f Sky::radiance(const Vec3f& direction, const Vec3f& to_sun) const {
  const float up = std::max(0.f, direction.z());
  const float t = std::sqrt(up);
  Vec3f color = horizon + t * (zenith - horizon);
  if (clouds > 0 && up > 0.02f) {
    // Two octaves of a smooth pattern on a plane overhead.
    const float x = direction.x() / (up + 0.15f) + 0.37f * static_cast<float>(variant % 97),
                y = direction.y() / (up + 0.15f);
    const float pattern =
        0.5f + 0.3f * std::sin(1.7f * x + 1.3f * std::sin(1.1f * y)) * std::sin(1.9f * y + 0.7f * x) +
        0.2f * std::sin(4.3f * x - 3.1f * y) * std::sin(5.1f * y + 1.7f * std::sin(2.3f * x));
    const float cover = std::clamp((pattern - 1 + clouds) * 3.f, 0.f, 1.f);
    color += cover * (Vec3f::Constant(0.95f * std::max(horizon.maxCoeff(), 0.3f)) - color);
  }
  const float near_sun = std::max(0.f, direction.dot(to_sun));
  const float n4 = near_sun * near_sun * near_sun * near_sun;
  return color + glow * (0.35f * n4 + std::pow(n4, 16.f)) * Vec3f(1, 0.95f, 0.85f);
}

Vec3f Sky::irradiance(const Vec3f& to_sun) const {
  constexpr int rings = 8, sectors = 24;
  Vec3f sum = Vec3f::Zero();
  for (int i = 0; i < rings; ++i)
    for (int k = 0; k < sectors; ++k) {
      const float r2 = (static_cast<float>(i) + 0.5f) / rings, r = std::sqrt(r2);
      const float a = 2 * std::numbers::pi_v<float> * (static_cast<float>(k) + 0.5f) / sectors;
      sum += radiance({r * std::cos(a), r * std::sin(a), std::sqrt(1 - r2)}, to_sun);
    }
  return sum / (rings * sectors);
}

RayImage render(const RayScene& scene, const PinholeCamera& camera, const Transform& camera_from_velo,
                const SceneLight& light, const RayCameraSettings& settings) {
  RayImage out{ImageF(camera.width, camera.height, 3), ImageF(camera.width, camera.height, 1),
               Image<int>(camera.width, camera.height, 1, -1), ImageF(camera.width, camera.height, 1)};
  const Transform velo_from_camera = camera_from_velo.inverse();
  const Eigen::Matrix3f turn = velo_from_camera.linear().cast<float>();
  const Vec3f eye = velo_from_camera.translation().cast<float>();
  Layers layers{ImageF(camera.width, camera.height, 3), ImageF(camera.width, camera.height, 3),
                ImageF(camera.width, camera.height, 3)};
  const Shader shader(scene, light, settings.sky_rays);
  const int grid = std::max(1, settings.grid), samples = grid * grid, middle = (grid / 2) * grid + grid / 2;
  const float footprint = static_cast<float>(1 / camera.fx);

  parallel_for(as_size(camera.height), [&](std::size_t row) {
    const int v = static_cast<int>(row);
    RandomStream random(settings.seed, "camera row", row);
    std::vector<Ray> rays(as_size(samples));
    std::vector<Hit> hits(as_size(samples));
    for (int u = 0; u < camera.width; ++u) {
      for (int s = 0; s < samples; ++s) {
        const double jitter_u = grid > 1 ? random.uniform() : 0.5,
                     jitter_v = grid > 1 ? random.uniform() : 0.5;
        const double du = (s % grid + jitter_u) / grid - 0.5, dv = (s / grid + jitter_v) / grid - 0.5;
        rays[as_size(s)] = {eye, turn * camera.unproject(u + du, v + dv, 1).cast<float>(), 0.05f, 1e6f};
      }
      const auto cast = [&](int s) { hits[as_size(s)] = scene.caster.intersect(rays[as_size(s)]); };
      const auto alike = [&](const Hit& a, const Hit& b) {
        if (!a.hit() || !b.hit()) return a.hit() == b.hit();
        return a.mesh == b.mesh && scene.same_texel(a, b) &&
               a.normal.normalized().dot(b.normal.normalized()) > 0.98f;
      };
      cast(0);
      if (samples > 1) cast(samples - 1);
      // Both corners of the pixel are on one flat piece: the rays between would hit the same.
      const bool even = settings.sparse && samples == 4 && alike(hits[0], hits[3]);
      for (int s = 1; s < samples - 1; ++s) {
        if (!even) {
          cast(s);
          continue;
        }
        rays[as_size(s)] = rays[s == 1 ? 0 : 3];
        hits[as_size(s)] = hits[s == 1 ? 0 : 3];
      }
      if (const Hit& hit = hits[as_size(middle)]; hit.hit()) {
        out.depth.at(u, v) = hit.t;  // the direction's camera z is 1
        out.object.at(u, v) = scene.objects[as_size(hit.mesh)];
      }
      // Samples on one flat piece of one mesh share their light: shade one of them for all.
      Vec3f sum = Vec3f::Zero(), albedo = Vec3f::Zero(), sky = Vec3f::Zero();
      float lit = 0;
      unsigned done = 0;
      for (int s = 0; s < samples; ++s) {
        if (s < 32 && (done >> s & 1)) continue;
        if (!hits[as_size(s)].hit()) {
          sum += shader.miss(rays[as_size(s)].direction.normalized());
          continue;
        }
        float weight = 1;
        for (int other = s + 1; other < std::min(samples, 32); ++other)
          if (!(done >> other & 1) && hits[as_size(other)].hit() &&
              alike(hits[as_size(s)], hits[as_size(other)])) {
            done |= 1u << other;
            weight += 1;
          }
        const Shader::Shade shade = shader.shade(rays[as_size(s)], hits[as_size(s)], footprint, random);
        sum += weight * shade.color;
        albedo += weight * shade.albedo;
        sky += weight * shade.sky;
        lit += weight;
      }
      const float inverse = 1 / static_cast<float>(samples);
      out.coverage.at(u, v) = lit * inverse;
      for (int c = 0; c < 3; ++c) {
        out.color.at(u, v, c) = sum[c] * inverse;
        layers.albedo.at(u, v, c) = albedo[c] * inverse;
        layers.sky.at(u, v, c) = lit > 0 ? sky[c] / lit : 0;
        layers.normal.at(u, v, c) =
            hits[as_size(middle)].hit() ? hits[as_size(middle)].normal.normalized()[c] : 0;
      }
    }
  });
  add_sky_light(out, layers);
  return out;
}

}  // namespace mirage
