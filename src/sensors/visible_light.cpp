#include "sensors/visible_light.h"

#include <algorithm>

namespace mirage {

namespace {

/// n̂, or zero for a face without area.
Vec3d unit(const Vec3d& normal) {
  const double length = normal.norm();
  return length > 0 ? Vec3d(normal / length) : Vec3d::Zero();
}

/// Unit normals of all nodes.
std::vector<Vec3d> unit_normals(const std::vector<Vec3d>& normals, const LightVisibility& visibility) {
  std::vector<Vec3d> n;
  n.reserve(visibility.nodes());
  for (const int side : visibility.side_of) {
    const std::size_t face = visibility.face_of(as_size(side));
    const Vec3d front = unit(normals[face]);
    n.push_back(as_size(side) == face ? front : Vec3d(-front));
  }
  n.resize(visibility.nodes(), visibility.roof_normal);
  return n;
}

/// The first texel of the face that a node lies on.
std::size_t first_texel(const LightVisibility& visibility, std::size_t node, std::size_t per_face) {
  return visibility.face_of(as_size(visibility.side_of[node])) * per_face;
}

}  // namespace

VisibleLightSettings fine_light() {
  VisibleLightSettings fine;
  fine.directions = 48;
  fine.enclosed_node_angle = 3e-6, fine.open_below = 0.6;
  fine.sun_angle = 2e-7;
  return fine;
}

VisibleLight visible_light(const std::vector<Vec3d>& normals, const std::vector<Vec3d>& texels,
                           const Lighting& light, const LightVisibility& visibility, int bounces) {
  const std::size_t nodes = visibility.nodes(), faces = visibility.faces;
  const std::size_t per_face = faces > 0 ? texels.size() / faces : 0;
  const Vec3d ambient = light.ambient, hemisphere = light.hemisphere, sun = light.sun,
              to_sun = light.to_sun_velo;
  const std::vector<Vec3d> n = unit_normals(normals, visibility);
  VisibleLight result;
  result.albedo.assign(nodes, visibility.paint);
  std::vector<Vec3d> open(nodes);  // sky and road, without sun and without reflections
  std::vector<Vec3d>& direct = result.direct;
  direct.resize(nodes);
  for (std::size_t i = 0; i < nodes; ++i) {
    if (i < visibility.side_of.size()) {
      const std::size_t first = first_texel(visibility, i, per_face);
      const std::vector<int>& mine = visibility.texels_of(i);
      Vec3d sum = Vec3d::Zero();
      for (const int t : mine) sum += texels[first + as_size(t)];
      result.albedo[i] = sum / static_cast<double>(mine.size());
    }
    open[i] = ambient;
    direct[i].setZero();
    if (n[i].isZero()) continue;
    open[i] += hemisphere * ((1 + n[i].z()) / 2) + visibility.blocked[i].transpose() * n[i];
    direct[i] = sun * (std::max(0.0, n[i].dot(to_sun)) * visibility.sun_share[i]);
  }
  result.weights.reserve(visibility.reflections.size());
  for (std::size_t i = 0; i < nodes; ++i)
    for (const auto& r : visibility.met_by(i)) result.weights.push_back(n[i].dot(r.towards.cast<double>()));
  std::vector<bool> is_met(nodes, false);  // a node that no other meets sends its light only to the camera
  for (const auto& r : visibility.reflections) is_met[as_size(r.node)] = true;
  std::vector<Vec3d> reflected(nodes, Vec3d::Zero());
  for (int step = 0; step < bounces; ++step) {
    std::vector<Vec3d> sky(nodes), gathered(nodes);
    for (std::size_t i = 0; i < nodes; ++i) {
      sky[i] = open[i] + reflected[i];
      gathered[i] = result.albedo[i].cwiseProduct(sky[i] + direct[i]);
    }
    const double* weight = result.weights.data();
    for (std::size_t i = 0; i < nodes; ++i) {
      if (!is_met[i] && step + 1 < bounces) {
        weight += visibility.met_by(i).size();
        continue;
      }
      reflected[i].setZero();
      for (const auto& r : visibility.met_by(i)) {
        const auto j = as_size(r.node);
        reflected[i] += *weight++ * (gathered[j] + static_cast<double>(r.gloss) * sky[j]);
      }
    }
    result.skies.push_back(std::move(sky));
  }
  result.sky.resize(nodes);
  result.factor.resize(visibility.sun.size());
  result.gloss.resize(visibility.sun.size());
  for (std::size_t i = 0; i < nodes; ++i) result.sky[i] = open[i] + reflected[i];
  // For each of a side's nodes, common to its parts: light and gloss without the sun, and the sun's addition
  // to both for a part that sees all of it.
  struct Shown {
    Vec3d light, sheen, sunlight, glint;
  };
  std::vector<Shown> parts;
  for (std::size_t f = 0; f < faces; ++f) {
    const std::size_t side = visibility.side(f), first = visibility.first_node(side);
    parts.clear();
    for (std::size_t i = first; i < visibility.first_node(side + 1); ++i) {
      Vec3d sheen = visibility.specular[i];
      if (!result.skies.empty())
        for (const auto& r : visibility.met_by(i)) {
          const auto j = as_size(r.node);
          const Vec3d& sky = result.skies.back()[j];
          sheen += static_cast<double>(r.specular) *
                   (result.albedo[j].cwiseProduct(sky + direct[j]) + static_cast<double>(r.gloss) * sky);
        }
      const double lit = std::max(0.0, n[i].dot(to_sun)) * visibility.diffuse_sun[i];
      parts.push_back({result.sky[i].cwiseMax(0.0) * visibility.diffuse[i], sheen, sun * lit,
                       sun * visibility.specular_sun[i]});
    }
    const std::vector<int>& shown_by = visibility.nodes_of_texels(side);
    std::size_t at = visibility.shown.first_texel(f);
    for (const int texel : visibility.texels_of_parts(f)) {
      const Shown& part = parts[as_size(shown_by[as_size(texel)])];
      const auto sunny = static_cast<double>(visibility.sun[at]);
      result.factor[at] = part.light + sunny * part.sunlight;
      result.gloss[at++] = part.sheen + sunny * part.glint;
    }
  }
  return result;
}

void visible_light_vjp(const std::vector<Vec3d>& normals, const std::vector<Vec3d>& texels,
                       const Lighting& light, const LightVisibility& visibility, const VisibleLight& at,
                       const std::vector<Vec3d>& d_factor, const std::vector<Vec3d>& d_gloss,
                       std::vector<Vec3d>& d_normals, std::vector<Vec3d>& d_texels) {
  const std::size_t nodes = visibility.nodes(), faces = visibility.faces;
  const std::size_t per_face = faces > 0 ? texels.size() / faces : 0;
  const Vec3d hemisphere = light.hemisphere, sun = light.sun, to_sun = light.to_sun_velo;
  const std::vector<Vec3d> n = unit_normals(normals, visibility);
  std::vector<Vec3d> d_n(nodes, Vec3d::Zero()), d_open(nodes, Vec3d::Zero()), d_direct(nodes, Vec3d::Zero()),
      d_albedo(nodes, Vec3d::Zero());
  std::vector<double> d_cosine(nodes, 0.0);  // of the angle to the sun
  std::vector<Vec3d> d_reflected(nodes, Vec3d::Zero()), d_mirrored(nodes, Vec3d::Zero()),
      d_mirrored_gloss(nodes, Vec3d::Zero());
  std::vector<Vec3d> d_sheen(nodes, Vec3d::Zero());
  for (std::size_t f = 0; f < faces; ++f) {
    const std::size_t side = visibility.side(f), first = visibility.first_node(side);
    const std::vector<int>& shown_by = visibility.nodes_of_texels(side);
    std::size_t part = visibility.shown.first_texel(f);
    for (const int texel : visibility.texels_of_parts(f)) {
      const std::size_t i = first + as_size(shown_by[as_size(texel)]);
      d_open[i] += d_factor[part];
      d_sheen[i] += d_gloss[part];
      d_cosine[i] += static_cast<double>(visibility.sun[part]) * d_factor[part].dot(sun);
      ++part;
    }
  }
  for (std::size_t i = 0; i < visibility.side_of.size(); ++i) {
    d_open[i] *= visibility.diffuse[i];
    d_cosine[i] *= visibility.diffuse_sun[i];
    for (int c = 0; c < 3; ++c)
      if (at.sky[i][c] <= 0) d_open[i][c] = 0;
    d_reflected[i] = d_open[i];
    if (at.skies.empty() || d_sheen[i].isZero(0)) continue;
    for (const auto& r : visibility.met_by(i)) {
      const auto j = as_size(r.node);
      const Vec3d d_radiance = static_cast<double>(r.specular) * d_sheen[i];
      d_mirrored[j] += d_radiance;
      d_mirrored_gloss[j] += static_cast<double>(r.gloss) * d_radiance;
    }
  }
  std::vector<double> d_weights(at.weights.size(), 0.0);
  for (std::size_t step = at.skies.size(); step-- > 0;) {
    const std::vector<Vec3d>& sky = at.skies[step];
    std::vector<Vec3d> d_gathered(nodes, Vec3d::Zero()), d_sky(nodes, Vec3d::Zero()), gathered(nodes);
    for (std::size_t i = 0; i < nodes; ++i) gathered[i] = at.albedo[i].cwiseProduct(sky[i] + at.direct[i]);
    if (step + 1 == at.skies.size()) d_gathered.swap(d_mirrored), d_sky.swap(d_mirrored_gloss);
    for (std::size_t i = 0; i < nodes; ++i) {
      if (d_reflected[i].isZero(0)) continue;
      auto at_weight = as_size(visibility.first[i]);
      for (const auto& r : visibility.met_by(i)) {
        const auto j = as_size(r.node);
        const auto gloss = static_cast<double>(r.gloss);
        const Vec3d d_radiance = at.weights[at_weight] * d_reflected[i];
        d_gathered[j] += d_radiance;
        d_sky[j] += gloss * d_radiance;
        d_weights[at_weight++] += d_reflected[i].dot(gathered[j] + gloss * sky[j]);
      }
    }
    // gathered = albedo · (sky + direct), sky = open + reflected of the step before
    for (std::size_t i = 0; i < nodes; ++i) {
      const Vec3d d_light = d_gathered[i].cwiseProduct(at.albedo[i]);
      d_direct[i] += d_light;
      d_reflected[i] = d_light + d_sky[i];
      d_open[i] += d_reflected[i];
      d_albedo[i] += d_gathered[i].cwiseProduct(sky[i] + at.direct[i]);
    }
  }
  for (std::size_t i = 0; i < nodes; ++i) {
    auto at_weight = as_size(visibility.first[i]);
    for (const auto& r : visibility.met_by(i)) d_n[i] += d_weights[at_weight++] * r.towards.cast<double>();
  }
  std::vector<Vec3d> d_unit(faces, Vec3d::Zero());
  for (std::size_t i = 0; i < visibility.side_of.size(); ++i) {
    const std::size_t first = first_texel(visibility, i, per_face);
    const std::vector<int>& mine = visibility.texels_of(i);
    const Vec3d d_texel = d_albedo[i] / static_cast<double>(mine.size());
    for (const int t : mine) d_texels[first + as_size(t)] += d_texel;
    d_n[i].z() += d_open[i].dot(hemisphere) / 2;
    d_n[i] += visibility.blocked[i] * d_open[i];
    d_cosine[i] += d_direct[i].dot(sun) * visibility.sun_share[i];
    if (n[i].dot(to_sun) > 0) d_n[i] += d_cosine[i] * to_sun;
    const auto side = as_size(visibility.side_of[i]), f = visibility.face_of(side);
    d_unit[f] += side == f ? d_n[i] : Vec3d(-d_n[i]);
  }
  for (std::size_t f = 0; f < faces; ++f) {
    const double length = normals[f].norm();
    if (!(length > 0)) continue;
    const Vec3d front = normals[f] / length;
    d_normals[f] += (d_unit[f] - front * front.dot(d_unit[f])) / length;
  }
}

}  // namespace mirage
