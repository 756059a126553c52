#include "simulation/object_light.h"

#include "base/sizes.h"

namespace mirage {
namespace {

class PlainLight : public ObjectLight {
 public:
  PlainLight(const TexturedMesh& placed, const Lighting& lighting)
      : normals_(face_normals(placed.mesh)),
        resolution_(placed.atlas.resolution),
        per_face_(placed.atlas.per_face()),
        lighting_(lighting) {
    for (const Vec3d& normal : normals_) factors_.push_back(shade(normal, lighting));
  }

  TexelGrid grid() const override { return resolution_; }
  std::vector<Vec3d> lit(const std::vector<Vec3d>& texels) const override {
    std::vector<Vec3d> radiance = texels;
    for (std::size_t t = 0; t < radiance.size(); ++t)
      radiance[t] = radiance[t].cwiseProduct(factors_[t / per_face_]);
    return radiance;
  }

  void vjp(const std::vector<Vec3d>& texels, const std::vector<Vec3d>& d_lit, std::vector<Vec3d>& d_normals,
           std::vector<Vec3d>& d_texels) const override {
    for (std::size_t f = 0; f < normals_.size(); ++f) {
      Vec3d d_factor = Vec3d::Zero();
      for (std::size_t t = f * per_face_; t < (f + 1) * per_face_; ++t) {
        d_texels[t] += d_lit[t].cwiseProduct(factors_[f]);
        d_factor += d_lit[t].cwiseProduct(texels[t]);
      }
      d_normals[f] += shade_vjp(normals_[f], lighting_, d_factor);
    }
  }

 private:
  std::vector<Vec3d> normals_;
  int resolution_;
  std::size_t per_face_;
  Lighting lighting_;
  std::vector<Vec3d> factors_;  ///< of each face
};

class LightWithVisibility : public ObjectLight {
 public:
  LightWithVisibility(const TexturedMesh& placed, const Lighting& lighting, const LightSurroundings* around,
                      const Vec3d& eye, const VisibleLightSettings& settings)
      : normals_(face_normals(placed.mesh)),
        lighting_(lighting),
        per_face_(placed.atlas.per_face()),
        visibility_(find_visibility(placed, lighting, around, &eye, settings)),
        visible_(visible_light(normals_, placed.atlas.texels, lighting, visibility_, settings.bounces)) {}

  TexelGrid grid() const override { return visibility_.shown; }
  std::vector<Vec3d> lit(const std::vector<Vec3d>& texels) const override {
    std::vector<Vec3d> radiance(visible_.factor.size());
    for_each_part([&](std::size_t i, std::size_t t) {
      radiance[i] = texels[t].cwiseProduct(visible_.factor[i]) + visible_.gloss[i];
    });
    return radiance;
  }

  void vjp(const std::vector<Vec3d>& texels, const std::vector<Vec3d>& d_lit, std::vector<Vec3d>& d_normals,
           std::vector<Vec3d>& d_texels) const override {
    std::vector<Vec3d> d_factor(d_lit.size());
    for_each_part([&](std::size_t i, std::size_t t) {
      d_texels[t] += d_lit[i].cwiseProduct(visible_.factor[i]);
      d_factor[i] = d_lit[i].cwiseProduct(texels[t]);
    });
    visible_light_vjp(normals_, texels, lighting_, visibility_, visible_, d_factor, d_lit, d_normals,
                      d_texels);
  }

 private:
  /// Calls do_part(part, the texel that it belongs to) for each shown part.
  template <class F>
  void for_each_part(F do_part) const {
    std::size_t part = 0;
    for (std::size_t f = 0; f < visibility_.faces; ++f)
      for (const int texel : visibility_.texels_of_parts(f)) do_part(part++, f * per_face_ + as_size(texel));
  }

  std::vector<Vec3d> normals_;
  Lighting lighting_;
  std::size_t per_face_;
  LightVisibility visibility_;  ///< of sun, sky and bounces
  VisibleLight visible_;        ///< the light of each texel
};

}  // namespace

std::unique_ptr<ObjectLight> plain_light(const TexturedMesh& placed, const Lighting& lighting) {
  return std::make_unique<PlainLight>(placed, lighting);
}

std::unique_ptr<ObjectLight> light_with_visibility(const TexturedMesh& placed, const Lighting& lighting,
                                                   const LightSurroundings* around, const Vec3d& eye,
                                                   const VisibleLightSettings& settings) {
  return std::make_unique<LightWithVisibility>(placed, lighting, around, eye, settings);
}

}  // namespace mirage
