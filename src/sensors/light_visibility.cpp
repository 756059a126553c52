// The rays of the light model with visibility, one pencil of them for each direction.
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>

#include "base/error.h"
#include "geometry/atlas_triangles.h"
#include "sensors/gloss.h"
#include "sensors/light_sun.h"
#include "sensors/soft_rasterizer.h"

namespace mirage {
namespace {

/// Point k of n on the unit sphere, evenly spread (Fibonacci lattice; Swinbank & Purser, QJRMS 2006).
Vec3d lattice_direction(int k, int n) {
  const double z = 1 - (2.0 * k + 1) / n, r = std::sqrt(1 - z * z);
  const double turn = 2 * std::numbers::pi * std::fmod(k * (std::numbers::phi - 1), 1.0);
  return {r * std::cos(turn), r * std::sin(turn), z};
}

double fraction(double x) {
  return x - std::floor(x);
}
/// x in [0, 2) brought to [0, 1).
float wrapped(float x) {
  return x >= 1 ? x - 1 : x;
}

/// Point i of a rank-1 lattice in the unit square.
Vec2f lattice_point(int i, double u, double v) {
  return {static_cast<float>(fraction(i * u)), static_cast<float>(fraction(i * v))};
}

struct Sent {
  int node;
  int direction;  ///< which of the directions
};

class Tracer {
 public:
  Tracer(const TexturedMesh& placed, const Lighting& light, const LightSurroundings* around, const Vec3d* eye,
         const VisibleLightSettings& settings)
      : faces_(static_cast<int>(placed.mesh.faces.size())),
        resolution_(placed.atlas.resolution),
        light_(light),
        around_(around),
        settings_(settings) {
    const Vec3d centre = bounds(placed.mesh).center();
    if (faces_ > 0) pencil_.emplace(placed.mesh, centre);
    nodes_ = light_nodes(placed, centre, pencil_ ? &*pencil_ : nullptr, around, eye, settings);
    if (around) roof_from_velo_ = around->velo_from_roof.inverse();
    cosines_.assign(static_cast<std::size_t>(nodes()), 0);
    met_points_.resize(static_cast<std::size_t>(nodes()));
  }

  LightVisibility run() {
    if (pencil_) trace_all();
    collect();
    return std::move(result_);
  }

 private:
  int nodes() const { return nodes_.nodes(); }
  const LightLeaf& leaf(int node) const { return nodes_.leaves[static_cast<std::size_t>(node)]; }
  int side_of(int patch) const { return nodes_.side_of[static_cast<std::size_t>(patch)]; }
  /// Where a side's nodes start.
  int first(int side) const { return nodes_.first_of_side[static_cast<std::size_t>(side)]; }

  void send(const Vec3f& start, int node, int direction) {
    starts_.push_back(start);
    sent_.push_back({node, direction});
  }

  /// Rays of the sides that are shown, then of what those meet, of what these meet, and so on: what nothing
  /// shows lights nothing.
  void trace_all() {
    std::vector<bool> asked(static_cast<std::size_t>(nodes()), false);
    std::vector<int> seen, others;
    for (int i = 0; i < nodes_.patches(); ++i) {
      const auto side = static_cast<std::size_t>(side_of(i));
      const bool is_seen = nodes_.is_seen(i);
      if (!is_seen && nodes_.side(nodes_.face_of(side)) != side) continue;
      (is_seen ? seen : others).push_back(i);
      asked[static_cast<std::size_t>(i)] = true;
    }
    const std::size_t about = seen.size() * static_cast<std::size_t>(settings_.directions) +
                              others.size() * static_cast<std::size_t>(settings_.rough_directions);
    starts_.reserve(about), sent_.reserve(about), hits_.reserve(about), met_.reserve(about);
    trace(seen, settings_.directions);
    std::size_t first = 0;
    do {
      const std::size_t end = sent_.size();
      for (std::size_t ray = first; ray < end; ++ray) {
        const int node = met_[ray];
        if (node < 0 || nodes_.is_seen(node)) continue;
        if (!asked[static_cast<std::size_t>(node)]) others.push_back(node);
        asked[static_cast<std::size_t>(node)] = true;
        if (node < nodes_.patches() && cosines_[static_cast<std::size_t>(node)] == 0)
          met_points_[static_cast<std::size_t>(node)].push_back(
              nodes_.wholes[static_cast<std::size_t>(side_of(node))].at(hits_[ray].b1, hits_[ray].b2));
      }
      first = end;
      std::sort(others.begin(), others.end());
      trace(others, settings_.rough_directions);
      others.clear();
    } while (first < sent_.size());
  }

  /// Rays along n directions from some nodes.
  void trace(const std::vector<int>& from, int n) {
    if (from.empty()) return;
    for (int k = 0; k < n; ++k) {
      const Vec3d direction = lattice_direction(k, n);
      const Vec3f towards = direction.cast<float>();
      const Vec2f point = lattice_point(k, 0.7548776662466927, 0.5698402909980532);  // Roberts's R2 sequence
      const int index = static_cast<int>(directions_.size());
      directions_.push_back(direction);
      sky_.push_back(sky(direction));
      const Vec3d in_roof = roof_from_velo_.linear() * direction;
      const std::size_t before = starts_.size();
      for (const int i : from) {
        const float cosine = leaf(i).normal.dot(towards);
        if (cosine <= 0) continue;
        cosines_[static_cast<std::size_t>(i)] += cosine;
        send(start_of(i, k, point), i, index);
      }
      const std::size_t count = starts_.size() - before;
      hits_.resize(starts_.size());
      pencil_->along(towards);
      pencil_->intersect(std::span(starts_).last(count), std::span(hits_).last(count));
      for (std::size_t ray = before; ray < starts_.size(); ++ray) {
        const int face = hits_[ray].face;
        met_.push_back(face < 0 ? meet_surroundings(starts_[ray], direction, in_roof)
                                : met_patch(ray, face, direction));
      }
    }
  }

  /// Where a node's ray along direction k starts. `point`: of the unit square, for direction k.
  Vec3f start_of(int node, int k, const Vec2f& point) const {
    // What runs through others is lit as where it is seen: by the camera, or by those that it lights.
    const std::vector<Vec3f>& starts = nodes_.is_seen(node) && !nodes_.seen_points.empty()
                                           ? nodes_.seen_points[static_cast<std::size_t>(node)]
                                           : met_points_[static_cast<std::size_t>(node)];
    if (!starts.empty()) return starts[static_cast<std::size_t>(k) % starts.size()];
    const Vec2f shift = lattice_point(node, 0.6180339887498949, 0.4142135623730951);  // from node to node
    Vec2f b(wrapped(point.x() + shift.x()), wrapped(point.y() + shift.y()));
    if (node < nodes_.patches() && b.sum() > 1) b = Vec2f::Ones() - b;
    return leaf(node).at(b.x(), b.y());
  }

  Vec3d sky(const Vec3d& direction) const {
    return light_.ambient + light_.hemisphere / 2 + 0.75 * direction.z() * light_.hemisphere;
  }
  /// What the gloss of a flat surface under the open sky sends back of sky and sun, met along a direction. It
  /// is as rough and glossy as the object's: so are the vehicle and the road in the path tracer.
  struct Sheen {
    Vec3d sky = Vec3d::Zero(), sun = Vec3d::Zero();
  };
  Sheen sheen(const Vec3d& normal, const Vec3d& direction) const {
    const Vec3d v = -direction;
    return {specular_albedo(normal.dot(v)) * sky(direction + 2 * normal.dot(v) * normal),
            specular_response(normal, light_.to_sun_velo, v) * light_.sun};
  }
  /// Radiance of a level surface under the open sky, met along a direction that goes down.
  Vec3d level_radiance(const Vec3d& albedo, const Vec3d& direction) const {
    const Vec3d n = Vec3d::UnitZ(), &l = light_.to_sun_velo;
    const Vec3d lit = light_.ambient + light_.hemisphere +
                      std::max(0.0, l.z()) * diffuse_response(n, l, -direction) * light_.sun;
    const Sheen gloss = sheen(n, direction);
    return albedo.cwiseProduct(lit) + gloss.sky + gloss.sun;
  }
  /// What deck, road and the roof's gloss send against each direction.
  void light_surroundings() {
    deck_.assign(directions_.size(), Vec3d::Zero());
    road_ = deck_;
    roof_.resize(directions_.size());
    if (!around_) return;
    const Vec3d& roof = result_.roof_normal;
    for (std::size_t k = 0; k < directions_.size(); ++k) {
      if (directions_[k].z() < 0) {
        deck_[k] = level_radiance(around_->paint, directions_[k]);
        road_[k] = level_radiance(around_->road, directions_[k]);
      }
      if (directions_[k].dot(roof) < 0) roof_[k] = sheen(roof, directions_[k]);
    }
  }
  /// Share of an even light that the gloss of a node of the object sends against direction k.
  double gloss_along(int node, std::size_t k) const {
    if (nodes_.views.empty() || node >= nodes_.patches()) return 0;
    return specular_albedo(-leaf(node).normal.cast<double>().dot(directions_[k]));
  }
  /// The light from direction k where `met` is, but for what a node reflects by its albedo.
  Vec3d fixed_radiance(int met, std::size_t k) const {
    if (met == kSky) return sky_[k];
    if (met == kDeck) return deck_[k];
    if (met == kRoad) return road_[k];
    const double sunny = result_.sun_share[static_cast<std::size_t>(met)];
    if (met >= nodes_.patches()) return roof_[k].sky + sunny * roof_[k].sun;
    if (nodes_.views.empty() || sunny == 0) return Vec3d::Zero();
    return sunny * specular_response(leaf(met).normal.cast<double>(), light_.to_sun_velo, -directions_[k]) *
           light_.sun;
  }

  static constexpr int kSky = -1, kDeck = -2, kRoad = -3;
  /// What a ray that misses the object meets: a cell's node, or kSky, kDeck, kRoad. `d`: its direction in the
  /// roof's frame.
  int meet_surroundings(const Vec3f& start, const Vec3d& direction, const Vec3d& d) const {
    if (!around_) return kSky;
    if (d.z() < 0) {
      const Vec3d p = roof_from_velo_ * (start.cast<double>() + nodes_.centre);
      const auto crossing = [&](double z) { return Vec2d((p + (z - p.z()) / d.z() * d).head<2>()); };
      if (p.z() > 0) {
        const Vec2d at = crossing(0);
        if (around_->roof.contains(at)) {
          const Vec2d share = (at - around_->roof.min()).cwiseQuotient(around_->roof.sizes().cwiseMax(1e-3));
          const int column = std::clamp(static_cast<int>(share.x() * nodes_.columns), 0, nodes_.columns - 1),
                    row = std::clamp(static_cast<int>(share.y() * nodes_.rows), 0, nodes_.rows - 1);
          return nodes_.patches() + row * nodes_.columns + column;
        }
      }
      if (around_->deck.contains(crossing(-around_->deck_below))) return kDeck;
    }
    return direction.z() < 0 ? kRoad : kSky;
  }

  void share_sun() {
    SunShares sun = mirage::share_sun(nodes_, pencil_ ? &*pencil_ : nullptr, met_points_, light_.to_sun_velo,
                                      resolution_, settings_);
    result_.rays += sun.rays;
    result_.sun = std::move(sun.of_parts);
    result_.sun_share = std::move(sun.of_nodes);
    result_.shown = std::move(sun.parts);
    result_.resolution = resolution_;
    for (std::size_t f = 0; f < nodes_.faces; ++f) {
      const auto finest = static_cast<std::size_t>(result_.shown.resolution_of(f) / resolution_);
      while (result_.texel_of_part.size() < finest) {
        std::vector<int>& texel_of = result_.texel_of_part.emplace_back();
        for (const Vec2d& part :
             texel_centroids(resolution_ * static_cast<int>(result_.texel_of_part.size())))
          texel_of.push_back(texel_index<double>(part.x(), part.y(), resolution_));
      }
    }
  }

  void collect() {
    LightVisibility& r = result_;
    const auto count = static_cast<std::size_t>(nodes());
    static_cast<LightLayout&>(r) = nodes_;
    r.rays = sent_.size();
    share_sun();
    r.blocked.assign(count, Eigen::Matrix3d::Zero());
    r.first.assign(count + 1, 0);
    r.specular.assign(count, Vec3d::Zero());
    r.specular_sun.assign(count, 0);
    r.diffuse.assign(count, 1);
    r.diffuse_sun.assign(count, 1);
    if (around_) {
      r.roof_normal = around_->velo_from_roof.linear().col(2);
      r.paint = around_->paint;
    }
    if (sent_.empty()) return;
    aim_gloss();
    light_surroundings();
    for (const double sum : cosines_) weights_.push_back(sum > 0 ? 1 / sum : 0);
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      const Sent& sent = sent_[i];
      const auto k = static_cast<std::size_t>(sent.direction);
      const Vec3d& direction = directions_[k];
      const Vec3d fixed = fixed_radiance(met_[i], k);
      r.specular[static_cast<std::size_t>(sent.node)] += specular_weight(i) * fixed;
      if (met_[i] == kSky) continue;
      r.blocked[static_cast<std::size_t>(sent.node)] +=
          weight(sent.node) * direction * (fixed - sky_[k]).transpose();
      if (met_[i] >= 0) ++r.first[static_cast<std::size_t>(sent.node) + 1];
    }
    for (std::size_t i = 1; i < r.first.size(); ++i) r.first[i] += r.first[i - 1];
    r.reflections.resize(static_cast<std::size_t>(r.first.back()));
    std::vector<int> next(r.first.begin(), r.first.end() - 1);
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      const Sent& sent = sent_[i];
      if (met_[i] < 0) continue;
      const int at = next[static_cast<std::size_t>(sent.node)]++;
      r.reflections[static_cast<std::size_t>(at)] = {
          met_[i], weight(sent.node) * directions_[static_cast<std::size_t>(sent.direction)],
          specular_weight(i), gloss_along(met_[i], static_cast<std::size_t>(sent.direction))};
    }
  }

  /// The node of the object that a ray met.
  int met_patch(std::size_t ray, int face, const Vec3d& direction) const {
    const int front = leaf(first(face)).normal.dot(direction.cast<float>()) < 0 ? face : face + faces_;
    const int parts = nodes_.parts[static_cast<std::size_t>(front)];
    if (parts == 1) return first(front);
    const double b1 = hits_[ray].b1, b2 = hits_[ray].b2;
    return first(front) + texel_index<double>(std::max(0.0, 1 - b1 - b2), b1, parts);
  }

  /// Whether the camera sees the node's gloss.
  bool is_glossy(int node) const {
    return !nodes_.views.empty() && nodes_.is_seen(node) && !leaf(node).normal.isZero(0);
  }
  const Vec3d& view(int patch) const { return nodes_.views[static_cast<std::size_t>(patch)]; }
  /// What gloss and diffuse lobe of each side that the camera sees make of its rays.
  void aim_gloss() {
    LightVisibility& r = result_;
    if (nodes_.views.empty()) return;
    responses_.assign(sent_.size(), 0);
    std::vector<double> towards_eye(nodes_.side_of.size(), 0), total = towards_eye;
    for (int i = 0; i < nodes_.patches(); ++i) {
      const Vec3d n = leaf(i).normal.cast<double>();
      const double cosine = n.dot(view(i));
      if (!is_glossy(i) || cosine <= 0) continue;
      const auto node = static_cast<std::size_t>(i);
      towards_eye[node] = cosine;
      r.specular_sun[node] = specular_response(n, light_.to_sun_velo, view(i));
      r.diffuse_sun[node] = diffuse_response(n, light_.to_sun_velo, view(i));
      r.diffuse[node] = diffuse_albedo(cosine);
    }
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      const Sent& sent = sent_[i];
      const auto node = static_cast<std::size_t>(sent.node);
      if (sent.node >= nodes_.patches() || towards_eye[node] <= 0) continue;
      const Vec3d& l = directions_[static_cast<std::size_t>(sent.direction)];
      responses_[i] = specular_response(leaf(sent.node).normal.cast<double>().dot(l), towards_eye[node],
                                        view(sent.node).dot(l));
      total[node] += responses_[i];
    }
    for (std::size_t node = 0; node < total.size(); ++node)
      if (total[node] > 0) total[node] = specular_albedo(towards_eye[node]) / total[node];
    for (std::size_t i = 0; i < sent_.size(); ++i)
      if (responses_[i] > 0) responses_[i] *= total[static_cast<std::size_t>(sent_[i].node)];
  }
  /// a_i f_k / Σ f_k of a ray.
  double specular_weight(std::size_t ray) const { return responses_.empty() ? 0 : responses_[ray]; }
  /// 4/K, scaled so that the cosines' weights of the node sum to one.
  double weight(int node) const { return weights_[static_cast<std::size_t>(node)]; }

  int faces_, resolution_;
  const Lighting& light_;
  const LightSurroundings* around_;
  const VisibleLightSettings& settings_;
  std::optional<RayPencil> pencil_;
  LightNodes nodes_;
  std::vector<double> responses_;  ///< of each ray: specular_weight()
  std::vector<double> cosines_;    ///< of each node: sum over the directions that it sends rays along
  std::vector<double> weights_;    ///< of each node: 1 / that sum
  std::vector<std::vector<Vec3f>> met_points_;  ///< of each node that the camera does not see
  Transform roof_from_velo_ = Transform::Identity();
  std::vector<Vec3d> directions_;
  std::vector<Vec3d> sky_;          ///< of each direction: the open sky's radiance
  std::vector<Vec3d> deck_, road_;  ///< of each direction: their radiance, met along it
  std::vector<Sheen> roof_;         ///< of each direction: that of the roof's gloss
  std::vector<Vec3f> starts_;
  std::vector<Sent> sent_;
  std::vector<RayPencil::Met> hits_;  ///< of each ray
  std::vector<int> met_;              ///< of each ray: a node, or kSky, kDeck, kRoad
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
