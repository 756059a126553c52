#include "sensors/visible_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "base/error.h"

namespace mirage {

namespace {

/// n̂, or zero for a face without area.
template <class S>
Vec3<S> unit(const Vec3<S>& normal) {
  const S length = normal.norm();
  return length > 0 ? Vec3<S>(normal / length) : Vec3<S>::Zero();
}

/// Unit normals of all nodes.
template <class S>
std::vector<Vec3<S>> unit_normals(const std::vector<Vec3<S>>& normals, const LightVisibility& visibility) {
  std::vector<Vec3<S>> n;
  n.reserve(visibility.nodes());
  for (const Vec3<S>& normal : normals) n.push_back(unit(normal));
  for (std::size_t f = 0; f < normals.size(); ++f) n.push_back(-n[f]);
  n.resize(visibility.nodes(), visibility.roof_normal.template cast<S>());
  return n;
}

}  // namespace

template <class S>
VisibleLight<S> visible_light(const std::vector<Vec3<S>>& normals, const std::vector<Vec3<S>>& texels,
                              const Lighting& light, const LightVisibility& visibility, int bounces) {
  const std::size_t nodes = visibility.nodes(), faces = visibility.faces;
  const std::size_t per_face = faces > 0 ? texels.size() / faces : 0;
  const Vec3<S> ambient = light.ambient.cast<S>(), hemisphere = light.hemisphere.cast<S>(),
                sun = light.sun.cast<S>(), to_sun = light.to_sun_velo.cast<S>();
  const std::vector<Vec3<S>> n = unit_normals(normals, visibility);
  VisibleLight<S> result;
  result.albedo.assign(nodes, visibility.paint.cast<S>());
  std::vector<Vec3<S>> open(nodes);  // sky and road, without sun and without reflections
  std::vector<Vec3<S>> direct(nodes);
  for (std::size_t i = 0; i < nodes; ++i) {
    if (i < faces) {
      Vec3<S> sum = Vec3<S>::Zero();
      for (std::size_t t = i * per_face; t < (i + 1) * per_face; ++t) sum += texels[t];
      result.albedo[i] = result.albedo[i + faces] = sum / static_cast<S>(std::max<std::size_t>(1, per_face));
    }
    open[i] = ambient;
    direct[i].setZero();
    if (n[i].isZero()) continue;
    open[i] +=
        hemisphere * ((1 + n[i].z()) / 2) + visibility.blocked[i].template cast<S>().transpose() * n[i];
    direct[i] = sun * (std::max(S(0), n[i].dot(to_sun)) * static_cast<S>(visibility.sun_share[i]));
  }
  std::vector<Vec3<S>> reflected(nodes, Vec3<S>::Zero());
  for (int step = 0; step < bounces; ++step) {
    std::vector<Vec3<S>> received(nodes), gathered(nodes);
    for (std::size_t i = 0; i < nodes; ++i) {
      received[i] = open[i] + direct[i] + reflected[i];
      gathered[i] = result.albedo[i].cwiseProduct(received[i]);
    }
    for (std::size_t i = 0; i < nodes; ++i) {
      reflected[i].setZero();
      for (int e = visibility.first[i]; e < visibility.first[i + 1]; ++e) {
        const auto& r = visibility.reflections[static_cast<std::size_t>(e)];
        reflected[i] += n[i].dot(r.towards.template cast<S>()) * gathered[static_cast<std::size_t>(r.node)];
      }
    }
    result.received.push_back(std::move(received));
  }
  result.sky.resize(faces);
  result.factor.resize(texels.size());
  for (std::size_t f = 0; f < faces; ++f) {
    const std::size_t side = visibility.side(f);
    result.sky[f] = open[side] + reflected[side];
    const Vec3<S> shown = result.sky[f].cwiseMax(S(0)), lit = sun * std::max(S(0), n[side].dot(to_sun));
    for (std::size_t t = f * per_face; t < (f + 1) * per_face; ++t)
      result.factor[t] = shown + lit * static_cast<S>(visibility.sun[t]);
  }
  return result;
}

template <class S>
void visible_light_vjp(const std::vector<Vec3<S>>& normals, const std::vector<Vec3<S>>& texels,
                       const Lighting& light, const LightVisibility& visibility, const VisibleLight<S>& at,
                       const std::vector<Vec3<S>>& d_factor, std::vector<Vec3<S>>& d_normals,
                       std::vector<Vec3<S>>& d_texels) {
  const std::size_t nodes = visibility.nodes(), faces = visibility.faces;
  const std::size_t per_face = faces > 0 ? texels.size() / faces : 0;
  const Vec3<S> hemisphere = light.hemisphere.cast<S>(), sun = light.sun.cast<S>(),
                to_sun = light.to_sun_velo.cast<S>();
  const std::vector<Vec3<S>> n = unit_normals(normals, visibility);
  std::vector<Vec3<S>> d_n(nodes, Vec3<S>::Zero()), d_open(nodes, Vec3<S>::Zero()),
      d_direct(nodes, Vec3<S>::Zero()), d_albedo(nodes, Vec3<S>::Zero());
  std::vector<S> d_cosine(nodes, S(0));  // of the angle to the sun
  std::vector<Vec3<S>> d_reflected(nodes, Vec3<S>::Zero());
  for (std::size_t f = 0; f < faces; ++f) {
    const std::size_t side = visibility.side(f);
    Vec3<S> d_sky = Vec3<S>::Zero();
    for (std::size_t t = f * per_face; t < (f + 1) * per_face; ++t) {
      d_sky += d_factor[t];
      d_cosine[side] += static_cast<S>(visibility.sun[t]) * d_factor[t].dot(sun);
    }
    for (int c = 0; c < 3; ++c)
      if (at.sky[f][c] <= 0) d_sky[c] = 0;
    d_open[side] = d_reflected[side] = d_sky;
  }
  for (std::size_t step = at.received.size(); step-- > 0;) {
    const std::vector<Vec3<S>>& received = at.received[step];
    std::vector<Vec3<S>> d_gathered(nodes, Vec3<S>::Zero());
    for (std::size_t i = 0; i < nodes; ++i) {
      if (d_reflected[i].isZero(0)) continue;
      for (int e = visibility.first[i]; e < visibility.first[i + 1]; ++e) {
        const auto& r = visibility.reflections[static_cast<std::size_t>(e)];
        const auto j = static_cast<std::size_t>(r.node);
        const Vec3<S> towards = r.towards.template cast<S>();
        d_gathered[j] += n[i].dot(towards) * d_reflected[i];
        d_n[i] += d_reflected[i].dot(at.albedo[j].cwiseProduct(received[j])) * towards;
      }
    }
    // gathered = albedo · (open + direct + reflected of the step before)
    for (std::size_t i = 0; i < nodes; ++i) {
      const Vec3<S> d_light = d_gathered[i].cwiseProduct(at.albedo[i]);
      d_open[i] += d_light;
      d_direct[i] += d_light;
      d_reflected[i] = d_light;
      d_albedo[i] += d_gathered[i].cwiseProduct(received[i]);
    }
  }
  for (std::size_t f = 0; f < faces; ++f) {
    const Vec3<S> d_texel =
        (d_albedo[f] + d_albedo[f + faces]) / static_cast<S>(std::max<std::size_t>(1, per_face));
    for (std::size_t t = f * per_face; t < (f + 1) * per_face; ++t) d_texels[t] += d_texel;
    const S length = normals[f].norm();
    if (!(length > 0)) continue;
    for (const std::size_t side : {f, f + faces}) {
      d_n[side].z() += d_open[side].dot(hemisphere) / 2;
      d_n[side] += visibility.blocked[side].template cast<S>() * d_open[side];
      d_cosine[side] += d_direct[side].dot(sun) * static_cast<S>(visibility.sun_share[side]);
      if (n[side].dot(to_sun) > 0) d_n[side] += d_cosine[side] * to_sun;
    }
    const Vec3<S> d_unit = d_n[f] - d_n[f + faces];
    d_normals[f] += (d_unit - n[f] * n[f].dot(d_unit)) / length;
  }
}

#define MIRAGE_VISIBLE_LIGHT(S)                                                                          \
  template VisibleLight<S> visible_light<S>(const std::vector<Vec3<S>>&, const std::vector<Vec3<S>>&,    \
                                            const Lighting&, const LightVisibility&, int);               \
  template void visible_light_vjp<S>(                                                                    \
      const std::vector<Vec3<S>>&, const std::vector<Vec3<S>>&, const Lighting&, const LightVisibility&, \
      const VisibleLight<S>&, const std::vector<Vec3<S>>&, std::vector<Vec3<S>>&, std::vector<Vec3<S>>&);
MIRAGE_VISIBLE_LIGHT(float)
MIRAGE_VISIBLE_LIGHT(double)
#undef MIRAGE_VISIBLE_LIGHT

}  // namespace mirage
