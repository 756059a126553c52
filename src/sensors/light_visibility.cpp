// The rays of the light model with visibility, one pencil of them for each direction.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <optional>

#include "base/error.h"
#include "base/intervals.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/light_nodes.h"
#include "sensors/lighting.h"
#include "sensors/material.h"

namespace mirage {
namespace {

constexpr int kUnseenRays = 2;  // 2² rays from a side visible only in reflections
constexpr int kMaxParts = 8;    // a texel is split into 8² at most

/// Visible shares of the sun.
struct SunShares {
  TexelGrid parts;               ///< of each face: its texels, or parts of them
  std::vector<float> of_parts;   ///< of each part, of the side that the camera sees
  std::vector<double> of_nodes;  ///< of each node
  std::size_t rays = 0;          ///< traced
};

/// Traces rays to the sun from several points on each side that the camera sees. Partly lit sides whose
/// texels the camera sees under more than `settings.sun_angle` get a second pass from all parts of their
/// texels: shadows' borders run through texels.
class SunTracer {
 public:
  /// `pencil`: the object only, about nodes.centre; null if it has no faces: nothing occludes. `beside`: a
  /// further occluder, about the same point; null: none. `resolution`: the atlas's C.
  SunTracer(const LightNodes& nodes, RayPencil* pencil, RayPencil* beside, const Vec3d& to_sun,
            int resolution, const VisibleLightSettings& settings)
      : nodes_(nodes),
        pencil_(pencil),
        beside_(beside),
        to_sun_(to_sun.cast<float>()),
        resolution_(resolution),
        settings_(settings),
        lit_(nodes.side_areas.size()),
        resolutions_(nodes.faces, resolution) {
    shares_.of_nodes.assign(as_size(nodes.nodes()), 0);
  }

  /// `met_points`: for each node hidden from the camera, the points where other rays met it; empty: all over
  /// it.
  SunShares run(const std::vector<std::vector<Vec3f>>& met_points) {
    if (pencil_) {
      pencil_->along(to_sun_);
      if (beside_) beside_->along(to_sun_);
      look_from_sides(met_points);
      refine();
    }
    share_to_nodes();
    share_to_parts();
    return std::move(shares_);
  }

 private:
  /// Sample points of one side: the centroids of n² parts.
  struct Samples {
    int n = 0;
    std::vector<std::uint8_t> lit;  ///< whether each sees the sun
  };

  bool is_turned_to_sun(const LightArea& area) const { return area.normal.dot(to_sun_) > 0; }
  static Vec3f at(const LightArea& area, const Vec2d& b01) {
    return area.at(static_cast<float>(b01.y()), static_cast<float>(1 - b01.sum()));
  }
  /// Whether a ray from each start reaches the sun.
  std::vector<std::uint8_t> visible_from(const std::vector<Vec3f>& starts) {
    std::vector<std::uint8_t> sees(starts.size(), 0);
    if (starts.empty()) return sees;
    shares_.rays += starts.size();
    std::vector<RayPencil::Met> met(starts.size());
    pencil_->intersect(starts, met);
    for (std::size_t i = 0; i < starts.size(); ++i) sees[i] = met[i].face < 0;
    if (beside_) {
      beside_->intersect(starts, met);
      for (std::size_t i = 0; i < starts.size(); ++i) sees[i] = sees[i] && met[i].face < 0;
    }
    return sees;
  }

  void look_from_sides(const std::vector<std::vector<Vec3f>>& met_points) {
    const std::vector<Vec2d>&many = texel_centroids(settings_.sun_samples),
          &few = texel_centroids(kUnseenRays);
    std::vector<Vec3f> starts;
    for (std::size_t side = 0; side < lit_.size(); ++side) {
      const LightArea& whole = nodes_.side_areas[side];
      if (!is_turned_to_sun(whole)) continue;
      const bool seen = nodes_.is_side_seen(side);
      const std::vector<Vec3f>& met = met_points[nodes_.first_node(side)];
      if (met.empty() && nodes_.side(nodes_.face_of(side)) != side) continue;  // not visible anywhere
      const std::vector<Vec2d>& points = seen ? many : few;
      lit_[side].n = seen ? settings_.sun_samples : kUnseenRays;
      for (std::size_t k = 0; k < points.size(); ++k)
        starts.push_back(seen || met.empty() ? at(whole, points[k]) : met[k * met.size() / points.size()]);
    }
    const auto first_cell = as_size(nodes_.patches());
    for (std::size_t i = first_cell; i < nodes_.node_areas.size(); ++i)
      if (is_turned_to_sun(nodes_.node_areas[i])) starts.push_back(nodes_.node_areas[i].at(0.5f, 0.5f));
    const std::vector<std::uint8_t> sees = visible_from(starts);
    auto next = sees.begin();
    for (Samples& samples : lit_) {
      samples.lit.assign(next, next + samples.n * samples.n);
      next += samples.n * samples.n;
    }
    for (std::size_t i = first_cell; i < nodes_.node_areas.size(); ++i)
      if (is_turned_to_sun(nodes_.node_areas[i])) shares_.of_nodes[i] = *next++;
  }

  /// Resamples sides that a shadow's border crosses, near the border, at the camera's resolution.
  void refine() {
    struct Again {
      std::size_t side;
      std::vector<std::uint8_t> lit;    ///< of each part: from the first pass
      std::vector<std::size_t> places;  ///< part of each ray
    };
    std::vector<Again> bordered;
    std::vector<Vec3f> starts;
    for (std::size_t side = 0; side < lit_.size(); ++side) {
      Samples& samples = lit_[side];
      const auto& lit = samples.lit;
      if (!nodes_.is_side_seen(side) || std::find(lit.begin(), lit.end(), 0) == lit.end() ||
          std::find(lit.begin(), lit.end(), 1) == lit.end())
        continue;
      const double texel = nodes_.angles[side] / (resolution_ * resolution_),
                   parts = std::min<double>(std::ceil(std::sqrt(texel / settings_.sun_angle)), kMaxParts);
      if (!(parts > 1)) continue;
      const int n = resolution_ * static_cast<int>(parts);
      const std::vector<std::uint8_t> near = near_border(samples);
      const std::vector<Vec2d>& points = texel_centroids(n);
      const std::vector<int>& sample_of = texels_of_centroids(n, samples.n);
      Again again{side, std::vector<std::uint8_t>(points.size()), {}};
      for (std::size_t i = 0; i < points.size(); ++i) {
        const auto sample = as_size(sample_of[i]);
        again.lit[i] = lit[sample];
        if (!near[sample]) continue;
        again.places.push_back(i);
        starts.push_back(at(nodes_.side_areas[side], points[i]));
      }
      samples.n = n;
      resolutions_[nodes_.face_of(side)] = n;
      bordered.push_back(std::move(again));
    }
    const std::vector<std::uint8_t> sees = visible_from(starts);
    auto next = sees.begin();
    for (Again& again : bordered) {
      for (const std::size_t place : again.places) again.lit[place] = *next++;
      lit_[again.side].lit = std::move(again.lit);
    }
  }

  /// For each sample of a side, whether a neighbour's visibility of the sun differs from its own.
  static std::vector<std::uint8_t> near_border(const Samples& samples) {
    const std::vector<std::vector<int>>& around = texel_neighbours(samples.n);
    std::vector<std::uint8_t> near(samples.lit.size(), 0);
    for (std::size_t i = 0; i < near.size(); ++i)
      for (const int k : around[i]) near[i] |= samples.lit[i] != samples.lit[as_size(k)];
    return near;
  }
  /// The share of a side's samples that are lit.
  static double share(const Samples& samples, const std::vector<int>& some) {
    int count = 0;
    for (const int k : some) count += samples.lit[as_size(k)];
    return static_cast<double>(count) / static_cast<double>(some.size());
  }
  void share_to_nodes() {
    for (std::size_t side = 0; side < lit_.size(); ++side) {
      if (lit_[side].n == 0) continue;
      std::size_t node = nodes_.first_node(side);
      for (const auto& some : centroids_within(nodes_.parts[side], lit_[side].n))
        shares_.of_nodes[node++] = share(lit_[side], some);
    }
  }

  void share_to_parts() {
    shares_.parts = TexelGrid(std::move(resolutions_));
    shares_.of_parts.assign(as_size(shares_.parts.first.back()), 0);
    for (std::size_t f = 0; f < nodes_.faces; ++f) {
      const Samples& samples = lit_[nodes_.side(f)];
      if (samples.n == 0) continue;
      float* part = &shares_.of_parts[shares_.parts.first_texel(f)];
      if (samples.n == shares_.parts.resolution_of(f)) {
        std::copy(samples.lit.begin(), samples.lit.end(), part);
        continue;
      }
      for (const auto& some : centroids_within(shares_.parts.resolution_of(f), samples.n))
        *part++ = static_cast<float>(share(samples, some));
    }
  }

  const LightNodes& nodes_;
  RayPencil *pencil_, *beside_;
  const Vec3f to_sun_;
  int resolution_;
  const VisibleLightSettings& settings_;
  std::vector<Samples> lit_;      ///< of each side; empty if it is turned away
  std::vector<int> resolutions_;  ///< of each face: of its shown parts
  SunShares shares_;
};

/// Point k of n on the unit sphere, evenly spread (Fibonacci lattice; Swinbank & Purser, QJRMS 2006).
Vec3d lattice_direction(int k, int n) {
  const double z = 1 - (2.0 * k + 1) / n, r = std::sqrt(1 - z * z);
  const double turn = 2 * std::numbers::pi * std::fmod(k * (std::numbers::phi - 1), 1.0);
  return {r * std::cos(turn), r * std::sin(turn), z};
}

double fraction(double x) {
  return x - std::floor(x);
}
/// Wraps x from [0, 2) to [0, 1).
float wrapped(float x) {
  return x >= 1 ? x - 1 : x;
}

/// Point i of a rank-1 lattice in the unit square.
Vec2f lattice_point(int i, double u, double v) {
  return {static_cast<float>(fraction(i * u)), static_cast<float>(fraction(i * v))};
}

/// A ray that met another node.
struct Link {
  int node, met, direction;
  float response;  ///< of the node's gloss
};

/// Sums over a node's rays. The colours' fourth number is unused.
struct Sums {
  Eigen::Matrix<float, 4, 3> blocked = Eigen::Matrix<float, 4, 3>::Zero();  ///< Σ (L − sky) ωᵀ of what is met
  Eigen::Vector4f specular = Eigen::Vector4f::Zero();                       ///< Σ response L
  float cosine = 0, response = 0;

  /// Adds light along a ray that does not come from the sky.
  void add(const Vec3f& light, float of_response, const LightEnvironment::Along& along) {
    const Eigen::Vector4f colour(light.x(), light.y(), light.z(), 0);
    specular += of_response * colour;
    blocked += (colour - along.sky) * along.towards.transpose();
  }
};

/// Rays along one direction.
struct Rays {
  std::vector<int> nodes;  ///< their senders
  std::vector<Vec3f> starts;
  std::vector<float> cosines, to_eye, eye_cosines;  ///< n·l, n·v and l·v
  std::vector<float> responses;                     ///< of the nodes' gloss
  std::vector<RayPencil::Met> hits, beside;         ///< on the object, and on the vehicle beside it

  void clear() { nodes.clear(), starts.clear(), cosines.clear(), to_eye.clear(), eye_cosines.clear(); }
  void add(int node, const Vec3f& start, float nl, float nv, float lv) {
    nodes.push_back(node), starts.push_back(start);
    cosines.push_back(nl), to_eye.push_back(nv), eye_cosines.push_back(lv);
  }
};

class Tracer {
 public:
  Tracer(const TexturedMesh& placed, const Lighting& light, const LightSurroundings* around, const Vec3d* eye,
         const VisibleLightSettings& settings)
      : faces_(static_cast<int>(placed.mesh.faces.size())),
        resolution_(placed.atlas.resolution),
        light_(light),
        settings_(settings) {
    const Vec3d centre = bounds(placed.mesh).center();
    if (faces_ > 0) pencil_.emplace(placed.mesh, centre);
    nodes_ = light_nodes(placed, centre, pencil_ ? &*pencil_ : nullptr, around, eye, settings);
    around_.emplace(light, around, centre, nodes_.cells);
    if (around && around->beside) {
      beside_.emplace(*around->beside, centre);
      for (const Vec3d& normal : face_normals(*around->beside))  // it is closed: seen from outside
        beside_light_.push_back(around->paint.cwiseProduct(shade(normal, light)).cast<float>());
    }
    if (around) {
      result_.roof_normal = around->velo_from_roof.linear().col(2);
      result_.paint = around->paint;
    }
    sums_.resize(as_size(nodes()));
    traced_.assign(sums_.size(), false);
    met_points_.resize(sums_.size());
  }

  LightVisibility run() {
    if (pencil_) trace_all();
    collect();
    return std::move(result_);
  }

 private:
  int nodes() const { return nodes_.nodes(); }
  const LightArea& area(int node) const { return nodes_.node_areas[as_size(node)]; }
  int side_of(int patch) const { return nodes_.side_of[as_size(patch)]; }
  /// A side's first node.
  int first(int side) const { return nodes_.first_of_side[as_size(side)]; }
  /// Whether the camera sees the node's gloss.
  bool is_glossy(int node) const {
    return !nodes_.views.empty() && nodes_.is_seen(node) && !area(node).normal.isZero(0);
  }
  const Vec3d& view(int patch) const { return nodes_.views[as_size(patch)]; }

  /// Traces rays of the visible sides, then of the nodes that they meet, and so on: other nodes light nothing
  /// visible.
  void trace_all() {
    std::vector<int> seen, others;
    for (int i = 0; i < nodes_.patches(); ++i) {
      const auto side = as_size(side_of(i));
      if (nodes_.is_seen(i)) {
        seen.push_back(i);
      } else if (nodes_.side(nodes_.face_of(side)) == side) {
        others.push_back(i);
      }
    }
    std::vector<bool> requested(as_size(nodes()), false);
    for (const auto* list : {&seen, &others})
      for (const int i : *list) requested[as_size(i)] = true;
    trace(seen, settings_.directions);
    std::size_t first = 0;
    do {
      const std::size_t end = links_.size();
      for (; first < end; ++first) {
        const int node = links_[first].met;
        if (!requested[as_size(node)]) others.push_back(node);
        requested[as_size(node)] = true;
      }
      std::sort(others.begin(), others.end());
      trace(others, settings_.rough_directions);
      others.clear();
    } while (first < links_.size());
  }

  /// A node that sends rays.
  struct Sender {
    int node;
    std::span<const Vec3f> starts;  ///< empty: all over it
  };

  /// Traces rays along n directions from some nodes.
  void trace(const std::vector<int>& from, int n) {
    if (from.empty()) return;
    std::vector<Sender> senders;
    Eigen::Matrix<float, Eigen::Dynamic, 3> normals(from.size(), 3), views(from.size(), 3);
    views.setZero();
    bool is_any_glossy = false;
    for (const int node : from) {
      const auto row = static_cast<Eigen::Index>(senders.size());
      senders.push_back({node, points_of(node)});
      traced_[as_size(node)] = true;
      normals.row(row) = area(node).normal;
      if (!is_glossy(node)) continue;
      is_any_glossy = true;
      views.row(row) = view(node).cast<float>();
    }
    const Eigen::VectorXf to_eye = normals.cwiseProduct(views).rowwise().sum();
    Eigen::VectorXf cosines, eye_cosines = to_eye;
    const std::size_t first = lattice_offset(n);
    Rays rays;
    for (int k = 0; k < n; ++k) {
      const Vec2f point = lattice_point(k, 0.7548776662466927, 0.5698402909980532);  // Roberts's R2 sequence
      const std::size_t direction = first + as_size(k);
      const Vec3f& towards = directions_[direction].towards;
      cosines.noalias() = normals * towards;
      if (is_any_glossy) eye_cosines.noalias() = views * towards;
      rays.clear();
      for (Eigen::Index at = 0; at < cosines.size(); ++at)
        if (cosines[at] > 0) {
          const Sender& sender = senders[as_size(at)];
          rays.add(sender.node, start_of(sender, k, point), cosines[at], to_eye[at], eye_cosines[at]);
        }
      rays.hits.resize(rays.nodes.size());
      rays.responses.assign(rays.nodes.size(), 0);
      if (is_any_glossy) specular_response(rays.cosines, rays.to_eye, rays.eye_cosines, rays.responses);
      pencil_->along(towards);
      pencil_->intersect(rays.starts, rays.hits);
      if (beside_) {
        rays.beside.resize(rays.nodes.size());
        beside_->along(towards);
        beside_->intersect(rays.starts, rays.beside);
      }
      add(rays, static_cast<int>(direction));
    }
  }
  /// Index of the first of the n directions of a lattice.
  std::size_t lattice_offset(int n) {
    const auto [lattice, is_new] = lattices_.try_emplace(n, directions_.size());
    for (int k = 0; is_new && k < n; ++k) directions_.push_back(around_->along(lattice_direction(k, n)));
    return lattice->second;
  }

  /// Start points of a node's rays; empty: all over it. A node that cuts through others is lit at its visible
  /// points: those seen by the camera, or by the nodes that it lights.
  std::span<const Vec3f> points_of(int node) const {
    return nodes_.is_seen(node) ? nodes_.points_seen(node) : met_points_[as_size(node)];
  }
  /// Start of a ray along direction k. `point`: that direction's point of the unit square.
  Vec3f start_of(const Sender& sender, int k, const Vec2f& point) const {
    if (!sender.starts.empty())
      return sender.starts[static_cast<unsigned>(k) % static_cast<unsigned>(sender.starts.size())];
    const Vec2f shift = lattice_point(sender.node, 0.6180339887498949, 0.4142135623730951);  // per node
    Vec2f b(wrapped(point.x() + shift.x()), wrapped(point.y() + shift.y()));
    if (sender.node < nodes_.patches() && b.sum() > 1) b = Vec2f::Ones() - b;
    return area(sender.node).at(b.x(), b.y());
  }

  /// Adds the contributions of rays along a direction.
  void add(const Rays& rays, int direction) {
    const LightEnvironment::Along& along = directions_[as_size(direction)];
    result_.rays += rays.nodes.size();
    for (std::size_t ray = 0; ray < rays.nodes.size(); ++ray) {
      const int node = rays.nodes[ray];
      const float response = rays.responses[ray];
      Sums& sums = sums_[as_size(node)];
      sums.cosine += rays.cosines[ray], sums.response += response;
      const RayPencil::Met& hit = rays.hits[ray];
      if (hit.face >= 0) {
        const int met = met_patch(hit, along.towards);
        links_.push_back({node, met, direction, response});
        if (!nodes_.is_seen(met) && !traced_[as_size(met)])
          met_points_[as_size(met)].push_back(nodes_.side_areas[as_size(side_of(met))].at(hit.b1, hit.b2));
        continue;
      }
      if (beside_ && rays.beside[ray].face >= 0) {
        const auto face = as_size(rays.beside[ray].face);
        sums.add(beside_light_[face], response, along);
        continue;
      }
      const int met = around_->meet(along, rays.starts[ray]);
      if (met == LightEnvironment::kSky) {
        sums.specular += response * along.sky;
      } else if (met < 0) {
        sums.add(met == LightEnvironment::kDeck ? along.deck : along.road, response, along);
      } else {
        links_.push_back({node, nodes_.patches() + met, direction, response});
      }
    }
  }

  /// The node of the object that a ray met.
  int met_patch(const RayPencil::Met& hit, const Vec3f& towards) const {
    const int front = area(first(hit.face)).normal.dot(towards) < 0 ? hit.face : hit.face + faces_;
    const int parts = nodes_.parts[as_size(front)];
    if (parts == 1) return first(front);
    const double b1 = hit.b1, b2 = hit.b2;
    return first(front) + texel_index<double>(std::max(0.0, 1 - b1 - b2), b1, parts);
  }

  void share_sun() {
    SunShares sun = SunTracer(nodes_, pencil_ ? &*pencil_ : nullptr, beside_ ? &*beside_ : nullptr,
                              light_.to_sun_velo, resolution_, settings_)
                        .run(met_points_);
    result_.rays += sun.rays;
    result_.sun = std::move(sun.of_parts);
    result_.sun_share = std::move(sun.of_nodes);
    result_.shown = std::move(sun.parts);
    result_.resolution = resolution_;
    for (std::size_t f = 0; f < nodes_.faces; ++f) {
      const auto finest = as_size(result_.shown.resolution_of(f) / resolution_);
      while (result_.texel_of_part.size() < finest) {
        const int parts = static_cast<int>(result_.texel_of_part.size()) + 1;
        result_.texel_of_part.push_back(texels_of_centroids(resolution_ * parts, resolution_));
      }
    }
  }

  /// Gloss response to the sun, along each link, of the node that it met, if fully lit; relative to the sun.
  std::vector<float> glints() const {
    std::vector<float> glint(links_.size(), 0);
    if (nodes_.views.empty()) return glint;
    const Vec3f to_sun = light_.to_sun_velo.cast<float>();
    std::vector<float> nl(links_.size()), nv(links_.size()), lv(links_.size());
    for (std::size_t i = 0; i < links_.size(); ++i) {
      const Vec3f &towards = directions_[as_size(links_[i].direction)].towards,
                  &normal = area(links_[i].met).normal;
      nl[i] = normal.dot(to_sun), nv[i] = -normal.dot(towards), lv[i] = -towards.dot(to_sun);
    }
    specular_response(nl, nv, lv, glint);
    return glint;
  }

  /// Adds the links as reflections, and the radiance of the nodes met that does not depend on albedo: the
  /// gloss of the sun and, for a cell, of the sky.
  void add_links() {
    result_.first = group_together(links_, sums_.size(), [](const Link& link) { return link.node; });
    const std::vector<float> glint = glints();
    const Vec3f sun = light_.sun.cast<float>();
    result_.reflections.reserve(links_.size());
    for (std::size_t i = 0; i < links_.size(); ++i) {
      const Link& link = links_[i];
      const auto node = as_size(link.node);
      const LightEnvironment::Along& along = directions_[as_size(link.direction)];
      const auto sunny = static_cast<float>(result_.sun_share[as_size(link.met)]);
      const bool is_cell = link.met >= nodes_.patches(), is_glossy = !is_cell && !nodes_.views.empty();
      const Vec3f fixed =
          is_cell ? Vec3f(along.roof_sky + sunny * along.roof_sun) : Vec3f(sunny * glint[i] * sun);
      sums_[node].add(fixed, link.response, along);
      const auto albedo =
          is_glossy ? static_cast<float>(specular_albedo(-area(link.met).normal.dot(along.towards))) : 0;
      result_.reflections.push_back(
          {link.met, weights_[node] * along.towards, mirrors_[node] * link.response, albedo});
    }
  }

  /// Sets the lobes of the nodes that the camera sees.
  void show() {
    LightVisibility& r = result_;
    for (int i = 0; i < nodes_.patches(); ++i) {
      if (!is_glossy(i)) continue;
      const auto node = as_size(i);
      const Vec3d n = area(i).normal.cast<double>();
      const double cosine = n.dot(view(i));
      if (cosine <= 0) continue;
      r.specular_sun[node] = specular_response(n, light_.to_sun_velo, view(i));
      r.diffuse_sun[node] = diffuse_response(n, light_.to_sun_velo, view(i));
      r.diffuse[node] = diffuse_albedo(cosine);
      if (sums_[node].response > 0)
        mirrors_[node] = static_cast<float>(specular_albedo(cosine)) / sums_[node].response;
    }
  }

  void collect() {
    LightVisibility& r = result_;
    const auto count = as_size(nodes());
    static_cast<LightLayout&>(r) = nodes_;
    share_sun();
    r.specular_sun.assign(count, 0);
    r.diffuse.assign(count, 1);
    r.diffuse_sun.assign(count, 1);
    mirrors_.assign(count, 0);
    for (const Sums& sums : sums_) weights_.push_back(sums.cosine > 0 ? 1 / sums.cosine : 0);
    show();
    add_links();
    r.blocked.reserve(count), r.specular.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      r.blocked.push_back((weights_[i] * sums_[i].blocked.topRows<3>().transpose()).cast<double>());
      r.specular.push_back((mirrors_[i] * sums_[i].specular.head<3>()).cast<double>());
    }
  }

  int faces_, resolution_;
  const Lighting& light_;
  const VisibleLightSettings& settings_;
  std::optional<RayPencil> pencil_, beside_;
  std::vector<Vec3f> beside_light_;  ///< radiance of each face of the vehicle beside the object
  LightNodes nodes_;
  std::optional<LightEnvironment> around_;
  std::vector<LightEnvironment::Along> directions_;
  std::map<int, std::size_t> lattices_;         ///< by number of directions: index of the first
  std::vector<Sums> sums_;                      ///< of each node
  std::vector<bool> traced_;                    ///< of each node: it has sent rays or is sending them
  std::vector<float> weights_;                  ///< of each node: 4/K, scaled so that the cosines' sum is one
  std::vector<float> mirrors_;                  ///< of each node: a_i / Σ f_k
  std::vector<std::vector<Vec3f>> met_points_;  ///< of each node hidden from the camera
  std::vector<Link> links_;
  LightVisibility result_;
};

}  // namespace

LightVisibility find_visibility(const TexturedMesh& placed, const Lighting& light,
                                const LightSurroundings* surroundings, const Vec3d* eye,
                                const VisibleLightSettings& settings) {
  if (settings.directions < 1 || settings.rough_directions < 1 || !(settings.cell > 0) ||
      settings.bounces < 0 || settings.sun_samples < 1 || !(settings.sun_angle > 0))
    throw InputError("light settings", "", "a number is not positive", "use the defaults");
  if (placed.atlas.texels.size() != placed.mesh.faces.size() * placed.atlas.per_face())
    throw InputError("light", "atlas", "does not have a face's texels for each face",
                     "give each face C² texels");
  return Tracer(placed, light, surroundings, eye, settings).run();
}

}  // namespace mirage
