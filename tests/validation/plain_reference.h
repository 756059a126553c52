// A reference renderer in a hundred lines: a double loop over pixels and faces in double, without code of the
// rasteriser or the ray caster. Planted differences show that a validation finds them. With it, tests of
// validation need no Blender.
#pragma once

#include <cmath>
#include <limits>

#include "base/random.h"
#include "base/sizes.h"
#include "exchange/gltf.h"
#include "validation/reference/reference_renderer.h"

namespace mirage::test {

/// Planted differences between the reference and the light model or the mesh.
struct Planted {
  double gain = 1;              ///< factor on the object's radiance, in every render
  double bounces_gain = 1;      ///< the same in renders with bounces
  double noise = 0;             ///< standard deviation of a pixel's gain in one sample; in area renders
  int shift = 0;                ///< px by which the object is too far to the right
  double range = 0;             ///< m added to each distance
  int misses = 0;               ///< number of rays that pass through the object, the first ones that hit it
  int lost_at = -1;             ///< the job (from 0) at which it is lost for good
  std::string lost_frame = "";  ///< it is lost for good on each render of a scene of this frame
};

class PlainReference : public ReferenceRenderer {
 public:
  explicit PlainReference(Planted planted = {}) : planted_(std::move(planted)) {}

  Rendered render(const RenderJob& job) override {
    count_job("render", job.scene);
    const RenderScene scene = read_scene(job.scene);
    const TexturedMesh object = adversary_of(scene);
    Rendered result;
    result.seconds = 0.25;
    result.rgba = ImageF(job.rect.width(), job.rect.height(), 4);
    if (job.effects.surroundings == RenderEffects::Surroundings::catcher)
      result.catcher = ImageF(job.rect.width(), job.rect.height(), 3, 1.0f);
    const int samples = job.pixel_centre ? 1 : job.samples;
    for (int v = 0; v < job.rect.height(); ++v)
      for (int u = 0; u < job.rect.width(); ++u) {
        const auto pixel = static_cast<std::uint64_t>(v * job.rect.width() + u);
        RandomStream random(job.seed, "plain reference", pixel);
        Eigen::Vector4d sum = Eigen::Vector4d::Zero();
        for (int s = 0; s < samples; ++s) {
          const double du = job.pixel_centre ? 0 : random.uniform() - 0.5,
                       dv = job.pixel_centre ? 0 : random.uniform() - 0.5;
          const double noise = job.pixel_centre ? 0 : planted_.noise * random.normal();
          sum += seen(scene, object, job.rect.u0 + u + du - planted_.shift, job.rect.v0 + v + dv,
                      planted_.gain * (job.effects.bounces > 0 ? planted_.bounces_gain : 1) * (1 + noise));
        }
        for (int c = 0; c < 4; ++c) result.rgba.at(u, v, c) = static_cast<float>(sum[c] / samples);
      }
    return result;
  }

  std::vector<double> raycast(const std::filesystem::path& scene, std::span<const LidarRay> rays,
                              const std::filesystem::path& /*scratch*/) override {
    count_job("raycast", scene);
    const TexturedMesh object = adversary_of(read_scene(scene));
    std::vector<double> distances;
    int to_miss = planted_.misses;
    for (const LidarRay& ray : rays) {
      const Meeting meeting = first_meeting(object.mesh, ray.origin, ray.direction);
      const bool passes = meeting.face < 0 || to_miss-- > 0;
      distances.push_back(passes ? -1 : meeting.t + planted_.range);
    }
    return distances;
  }

  ReferenceIdentity identity() const override { return {"plain", "a plain loop", "1", {}}; }
  const std::vector<ReferenceLoss>& losses() const override { return losses_; }

 private:
  /// The first hit of a ray on a mesh: its parameter, the face (−1: none) and the barycentrics.
  struct Meeting {
    double t = std::numeric_limits<double>::infinity();
    int face = -1;
    Vec3d b = Vec3d::Zero();
  };

  void count_job(const char* job, const std::filesystem::path& scene) {
    const bool lost = jobs_++ == planted_.lost_at || (!planted_.lost_frame.empty() &&
                                                      scene.stem().string().starts_with(planted_.lost_frame));
    if (!lost) return;
    losses_.push_back({job, "was planted", 1});
    throw ReferenceLost("plain", "was planted to be lost", "plant none");
  }

  static TexturedMesh adversary_of(const RenderScene& scene) {
    for (const RenderScene::Thing& thing : scene.things)
      if (thing.role == "adversary") return thing.textured;
    throw Failure("plain", "finds no adversary in the scene", "write one");
  }

  /// Solves for each face's plane: origin + t direction = Σ b_k v_k.
  static Meeting first_meeting(const Mesh& mesh, const Vec3d& origin, const Vec3d& direction) {
    Meeting nearest;
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
      const auto corner = [&](std::size_t k) { return mesh.vertices[as_size(mesh.faces[f][k])]; };
      const Vec3d a = corner(0), n = (corner(1) - a).cross(corner(2) - a);
      const double t = n.dot(a - origin) / n.dot(direction);  // not finite for a parallel plane
      if (!(t > 0 && t < nearest.t)) continue;
      const Vec3d p = origin + t * direction;
      const double b1 = n.dot((p - a).cross(corner(2) - a)) / n.squaredNorm(),
                   b2 = n.dot((corner(1) - a).cross(p - a)) / n.squaredNorm();
      if (b1 >= 0 && b2 >= 0 && b1 + b2 <= 1) nearest = {t, static_cast<int>(f), {1 - b1 - b2, b1, b2}};
    }
    return nearest;
  }

  /// Radiance times `gain`, and coverage, at a point of the picture. Light and texels are as lighting.h and
  /// geometry/mesh.h define them.
  static Eigen::Vector4d seen(const RenderScene& scene, const TexturedMesh& object, double u, double v,
                              double gain) {
    const Transform velo_from_camera = scene.camera_from_velo.inverse();
    const Vec3d direction = velo_from_camera.linear() * scene.camera.unproject(u, v, 1);
    const Meeting meeting = first_meeting(object.mesh, velo_from_camera.translation(), direction);
    if (meeting.face < 0) return Eigen::Vector4d::Zero();
    const auto f = as_size(meeting.face);
    const Face& face = object.mesh.faces[f];
    const auto corner = [&](std::size_t k) { return object.mesh.vertices[as_size(face[k])]; };
    const Vec3d n = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
    const Lighting& light = scene.lighting;
    const Vec3d irradiance = light.ambient + light.hemisphere * (1 + n.z()) / 2 +
                             light.sun * std::max(0.0, n.dot(light.to_sun_velo));
    const int c = object.atlas.resolution;
    const double x = meeting.b[0] * c, y = meeting.b[1] * c;
    const int ix = std::min(c - 1, static_cast<int>(x)), iy = std::min(c - 1, static_cast<int>(y));
    const int texel = x + y - ix - iy <= 1 ? iy * c + ix : (c - 1 - iy) * c + (c - 1 - ix);
    const Vec3d albedo = object.atlas.texels[f * object.atlas.per_face() + as_size(texel)];
    Eigen::Vector4d rgba;
    rgba << gain * albedo.cwiseProduct(irradiance), 1;
    return rgba;
  }

  Planted planted_;
  int jobs_ = 0;
  std::vector<ReferenceLoss> losses_;
};

}  // namespace mirage::test
