// The rays of the light model with visibility: one table, sorted by direction, so that packets stay together.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "base/error.h"
#include "sensors/ray_caster.h"
#include "sensors/soft_rasterizer.h"
#include "sensors/visible_light.h"

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

/// Points of Roberts's R2 sequence; those of a face are shifted by a rank-1 lattice from face to face.
std::vector<Vec2f> lattice(std::size_t count, double u, double v) {
  std::vector<Vec2f> points;
  points.reserve(count);
  for (std::size_t i = 0; i < count; ++i)
    points.emplace_back(static_cast<float>(fraction(static_cast<double>(i) * u)),
                        static_cast<float>(fraction(static_cast<double>(i) * v)));
  return points;
}

/// Centroids (b0, b1) of the n² congruent triangles of a face, by their index in TexelAtlas's order.
std::vector<Vec2d> centroids(int n) {
  std::vector<Vec2d> centres(static_cast<std::size_t>(n) * n);
  for (int y = 0; y < n; ++y)
    for (int x = 0; x + y < n; ++x) {
      centres[static_cast<std::size_t>(y * n + x)] = Vec2d(x + 1.0 / 3, y + 1.0 / 3) / n;
      if (x + y < n - 1)
        centres[static_cast<std::size_t>((n - 1 - y) * n + (n - 1 - x))] =
            Vec2d(x + 2.0 / 3, y + 2.0 / 3) / n;
    }
  return centres;
}

/// Which of n² samples stand for each of C² texels: those within it, or else the one that it lies within.
std::vector<std::vector<int>> samples_of_texels(int resolution, int n) {
  std::vector<std::vector<int>> lists(static_cast<std::size_t>(resolution) * resolution);
  const std::vector<Vec2d> samples = centroids(n), texels = centroids(resolution);
  for (std::size_t i = 0; i < samples.size(); ++i)
    lists[static_cast<std::size_t>(texel_index<double>(samples[i].x(), samples[i].y(), resolution))]
        .push_back(static_cast<int>(i));
  for (std::size_t t = 0; t < lists.size(); ++t)
    if (lists[t].empty()) lists[t].push_back(texel_index<double>(texels[t].x(), texels[t].y(), n));
  return lists;
}

struct Sent {
  int node;
  int direction;  ///< kToSun, or which of the directions
  int sample;     ///< of a ray to the sun
};

constexpr int kToSun = -1;
constexpr int kSunRaysUnseen = 2;  // 2² rays to the sun from a side that only reflections show
constexpr int kLooks = 3;          // 3² rays to a face tell which of it the camera sees

/// A side of a face, or a cell of the roof, relative to the object's centre and lifted off its plane: rays
/// start here.
struct Leaf {
  Vec3f corner, edge1, edge2, normal;
  Vec3f at(float b1, float b2) const { return corner + b1 * edge1 + b2 * edge2; }
};

class Tracer {
 public:
  Tracer(const TexturedMesh& placed, const Lighting& light, const LightSurroundings* around, const Vec3d* eye,
         const VisibleLightSettings& settings)
      : mesh_(placed.mesh),
        faces_(static_cast<int>(placed.mesh.faces.size())),
        resolution_(placed.atlas.resolution),
        per_face_(placed.atlas.per_face()),
        light_(light),
        around_(around),
        settings_(settings),
        eye_(eye) {
    const Eigen::AlignedBox3d box = bounds(mesh_);
    centre_ = box.center();
    // Rays start this far off the face they leave, beyond what float32 can confuse.
    const double lift = 1e-5 * std::max(1e-3, box.diagonal().norm());
    sides_.resize(2 * mesh_.faces.size());
    result_.behind.resize(mesh_.faces.size());
    for (std::size_t f = 0; f < mesh_.faces.size(); ++f) {
      const Face& face = mesh_.faces[f];
      const Vec3d &a = mesh_.vertices[static_cast<std::size_t>(face[0])],
                  &b = mesh_.vertices[static_cast<std::size_t>(face[1])],
                  &c = mesh_.vertices[static_cast<std::size_t>(face[2])];
      const Vec3d normal = (b - a).cross(c - a);
      const double length = normal.norm();
      const Vec3d n = length > 0 ? Vec3d(normal / length) : Vec3d::Zero();
      for (const double sign : {1.0, -1.0})
        sides_[sign > 0 ? f : f + mesh_.faces.size()] = {(a + sign * lift * n - centre_).cast<float>(),
                                                         (b - a).cast<float>(), (c - a).cast<float>(),
                                                         (sign * n).cast<float>()};
      result_.behind[f] = eye && n.dot(*eye - a) < 0;
    }
    fine_.assign(sides_.size(), false);
    if (around_) make_cells(lift);
  }

  LightVisibility run() {
    if (faces_ > 0) {
      const RayCaster caster(std::span(&mesh_, 1), centre_);
      find_seen(caster);
      aim();
      trace(caster);
    }
    collect();
    return std::move(result_);
  }

 private:
  void make_cells(double lift) {
    const Vec2d size = around_->roof.sizes().cwiseMax(1e-3);
    columns_ = std::clamp(static_cast<int>(std::ceil(size.x() / settings_.cell)), 1, 64);
    rows_ = std::clamp(static_cast<int>(std::ceil(size.y() / settings_.cell)), 1, 64);
    roof_from_velo_ = around_->velo_from_roof.inverse();
    const Eigen::Matrix3d axes = around_->velo_from_roof.linear();
    for (int row = 0; row < rows_; ++row)
      for (int column = 0; column < columns_; ++column) {
        const Vec2d corner =
            around_->roof.min() + Vec2d(column * size.x() / columns_, row * size.y() / rows_);
        cells_.push_back(
            {(around_->velo_from_roof * Vec3d(corner.x(), corner.y(), lift) - centre_).cast<float>(),
             (axes.col(0) * size.x() / columns_).cast<float>(),
             (axes.col(1) * size.y() / rows_).cast<float>(), axes.col(2).cast<float>()});
      }
  }
  int cells() const { return static_cast<int>(cells_.size()); }
  int sides() const { return 2 * faces_; }
  int nodes() const { return sides() + cells(); }
  const Leaf& leaf(int node) const {
    return node < sides() ? sides_[static_cast<std::size_t>(node)]
                          : cells_[static_cast<std::size_t>(node - sides())];
  }
  bool fine(int node) const { return node < sides() && fine_[static_cast<std::size_t>(node)]; }

  /// Sides that the camera sees some of.
  void find_seen(const RayCaster& caster) {
    const std::vector<Vec2d> points = centroids(kLooks);
    const std::size_t looks = points.size();
    RayTable rays(1, mesh_.faces.size() * looks);
    const Vec3f from = eye_ ? Vec3f((*eye_ - centre_).cast<float>()) : Vec3f::Zero();
    for (std::size_t f = 0; f < mesh_.faces.size(); ++f) {
      const std::size_t side = result_.side(f);
      if (!eye_) fine_[side] = true;
      for (std::size_t i = 0; i < looks; ++i)
        rays.set(
            0, f * looks + i, from,
            sides_[side].at(static_cast<float>(points[i].x()), static_cast<float>(points[i].y())) - from);
    }
    if (!eye_) return;
    caster.intersect(rays, 0, 1e30f, hits_);
    seen_points_.resize(sides_.size());
    for (std::size_t i = 0; i < rays.columns; ++i) {
      if (hits_.face[i] < 0) continue;
      const std::size_t side = result_.side(static_cast<std::size_t>(hits_.face[i]));
      fine_[side] = true;
      seen_points_[side].emplace_back(hits_.b1[i], hits_.b2[i]);
    }
  }

  void send(const Leaf& from, const Vec2f& b12, int node, int direction, int sample = 0) {
    starts_.push_back(from.at(b12.x(), b12.y()));
    sent_.push_back({node, direction, sample});
  }

  void aim_at_sun() {
    const Vec3f to_sun = light_.to_sun_velo.cast<float>();
    const std::vector<Vec2d> many = centroids(settings_.sun_samples), few = centroids(kSunRaysUnseen);
    for (int i = 0; i < nodes(); ++i) {
      const Leaf& from = leaf(i);
      if (from.normal.dot(to_sun) <= 0) continue;
      if (i >= sides()) {
        send(from, Vec2f(0.5f, 0.5f), i, kToSun);
        continue;
      }
      const std::vector<Vec2d>& points = fine(i) ? many : few;
      for (std::size_t k = 0; k < points.size(); ++k)
        send(from, Vec2d(points[k].y(), 1 - points[k].sum()).cast<float>(), i, kToSun, static_cast<int>(k));
    }
  }

  /// Rays of all nodes, those of one direction together.
  void aim() {
    sent_.reserve(static_cast<std::size_t>(faces_) *
                  static_cast<std::size_t>(settings_.directions / 2 + settings_.rough_directions));
    starts_.reserve(sent_.capacity());
    aim_at_sun();
    const std::vector<Vec2f> shifts =
        lattice(static_cast<std::size_t>(nodes()), 0.6180339887498949, 0.4142135623730951);
    const std::vector<Vec2f> points =
        lattice(static_cast<std::size_t>(std::max(settings_.directions, settings_.rough_directions)),
                0.7548776662466927, 0.5698402909980532);
    cosines_.assign(static_cast<std::size_t>(nodes()), 0);
    const auto fan_out = [&](int n, bool with_fine) {
      for (int k = 0; k < n; ++k) {
        const Vec3d direction = lattice_direction(k, n);
        const Vec3f towards = direction.cast<float>();
        const Vec2f point = points[static_cast<std::size_t>(k)];
        const int index = static_cast<int>(directions_.size());
        directions_.push_back(direction);
        for (int i = 0; i < (with_fine ? sides() : nodes()); ++i) {
          if (fine(i) != with_fine) continue;
          const Leaf& from = leaf(i);
          const float cosine = from.normal.dot(towards);
          if (cosine <= 0) continue;
          cosines_[static_cast<std::size_t>(i)] += cosine;
          const Vec2f& shift = shifts[static_cast<std::size_t>(i)];
          Vec2f b(wrapped(point.x() + shift.x()), wrapped(point.y() + shift.y()));
          if (i < sides() && b.sum() > 1) b = Vec2f::Ones() - b;
          // A face that runs through others is lit as where the camera sees it.
          if (with_fine && !seen_points_.empty()) {
            const std::vector<Vec2f>& seen = seen_points_[static_cast<std::size_t>(i)];
            b = seen[static_cast<std::size_t>(k) % seen.size()];
          }
          send(from, b, i, index);
        }
      }
    };
    fan_out(settings_.directions, true);
    fan_out(settings_.rough_directions, false);
  }

  void trace(const RayCaster& caster) {
    RayTable rays(1, sent_.size());
    const Vec3f to_sun = light_.to_sun_velo.cast<float>();
    Vec3f direction = to_sun;
    int current = kToSun;
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      if (sent_[i].direction != current) {
        current = sent_[i].direction;
        direction =
            current == kToSun ? to_sun : Vec3f(directions_[static_cast<std::size_t>(current)].cast<float>());
      }
      rays.set(0, i, starts_[i], direction);
    }
    if (!sent_.empty()) caster.intersect(rays, 0, 1e30f, hits_);
  }

  Vec3d sky(const Vec3d& direction) const {
    return light_.ambient + light_.hemisphere / 2 + 0.75 * direction.z() * light_.hemisphere;
  }
  /// Light of a level face that sees sun and sky whole.
  Vec3d open_light() const {
    return light_.ambient + light_.hemisphere + std::max(0.0, light_.to_sun_velo.z()) * light_.sun;
  }

  static constexpr int kSky = -1, kDeck = -2, kRoad = -3;
  /// What a ray that misses the object meets: a cell's node, or kSky, kDeck, kRoad.
  int meet_surroundings(const Vec3f& start, const Vec3d& direction) const {
    if (!around_) return kSky;
    const Vec3d p = roof_from_velo_ * (start.cast<double>() + centre_),
                d = roof_from_velo_.linear() * direction;
    const auto crossing = [&](double z) { return Vec2d((p + (z - p.z()) / d.z() * d).head<2>()); };
    if (d.z() < 0) {
      if (p.z() > 0) {
        const Vec2d at = crossing(0);
        if (around_->roof.contains(at)) {
          const Vec2d share = (at - around_->roof.min()).cwiseQuotient(around_->roof.sizes().cwiseMax(1e-3));
          const int column = std::clamp(static_cast<int>(share.x() * columns_), 0, columns_ - 1),
                    row = std::clamp(static_cast<int>(share.y() * rows_), 0, rows_ - 1);
          return sides() + row * columns_ + column;
        }
      }
      if (around_->deck.contains(crossing(-around_->deck_below))) return kDeck;
    }
    return direction.z() < 0 ? kRoad : kSky;
  }

  /// The sun's share of each node and of each texel, from the samples that saw it.
  void share_sun() {
    LightVisibility& r = result_;
    const auto many = static_cast<std::size_t>(settings_.sun_samples * settings_.sun_samples);
    std::vector<std::uint8_t> lit(mesh_.faces.size() * many, 0);
    for (std::size_t i = 0; i < sent_.size() && sent_[i].direction == kToSun; ++i) {
      if (hits_.face[i] >= 0) continue;
      const int node = sent_[i].node;
      const std::size_t face = static_cast<std::size_t>(node % faces_);
      const double samples = node >= sides() ? 1
                             : fine(node)    ? static_cast<double>(many)
                                             : static_cast<double>(kSunRaysUnseen * kSunRaysUnseen);
      r.sun_share[static_cast<std::size_t>(node)] += 1 / samples;
      if (fine(node)) lit[face * many + static_cast<std::size_t>(sent_[i].sample)] = 1;
    }
    const auto lists = samples_of_texels(resolution_, settings_.sun_samples);
    for (std::size_t f = 0; f < mesh_.faces.size(); ++f)
      for (std::size_t t = 0; t < per_face_; ++t) {
        float& sun = r.sun[f * per_face_ + t];
        if (!fine_[r.side(f)]) {
          sun = static_cast<float>(r.sun_share[r.side(f)]);
          continue;
        }
        int count = 0;
        for (const int k : lists[t]) count += lit[f * many + static_cast<std::size_t>(k)];
        sun = static_cast<float>(count) / static_cast<float>(lists[t].size());
      }
  }

  void collect() {
    LightVisibility& r = result_;
    const auto count = static_cast<std::size_t>(nodes());
    r.faces = mesh_.faces.size();
    r.rays = sent_.size();
    r.sun.assign(r.faces * per_face_, 0);
    r.sun_share.assign(count, 0);
    r.blocked.assign(count, Eigen::Matrix3d::Zero());
    r.first.assign(count + 1, 0);
    if (around_) {
      r.roof_normal = around_->velo_from_roof.linear().col(2);
      r.paint = around_->paint;
    }
    if (sent_.empty()) return;
    share_sun();
    const Vec3d open = open_light();
    const Vec3d deck = around_ ? Vec3d(around_->paint.cwiseProduct(open)) : Vec3d::Zero(),
                road = around_ ? Vec3d(around_->road.cwiseProduct(open)) : Vec3d::Zero();
    std::vector<int> met(sent_.size(), kSky);
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      const Sent& sent = sent_[i];
      if (sent.direction == kToSun) continue;
      const Vec3d& direction = directions_[static_cast<std::size_t>(sent.direction)];
      const int face = hits_.face[i];
      if (face < 0)
        met[i] = meet_surroundings(starts_[i], direction);
      else
        met[i] = leaf(face).normal.dot(direction.cast<float>()) < 0 ? face : face + faces_;
      if (met[i] == kSky) continue;
      Vec3d change = -sky(direction);
      if (met[i] == kDeck) change += deck;
      if (met[i] == kRoad) change += road;
      r.blocked[static_cast<std::size_t>(sent.node)] += weight(sent.node) * direction * change.transpose();
      if (met[i] >= 0) ++r.first[static_cast<std::size_t>(sent.node) + 1];
    }
    for (std::size_t i = 1; i < r.first.size(); ++i) r.first[i] += r.first[i - 1];
    r.reflections.resize(static_cast<std::size_t>(r.first.back()));
    std::vector<int> next(r.first.begin(), r.first.end() - 1);
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      const Sent& sent = sent_[i];
      if (sent.direction == kToSun || met[i] < 0) continue;
      const int at = next[static_cast<std::size_t>(sent.node)]++;
      r.reflections[static_cast<std::size_t>(at)] = {
          met[i], weight(sent.node) * directions_[static_cast<std::size_t>(sent.direction)]};
    }
  }
  /// 4/K, scaled so that the cosines' weights of the node sum to one.
  double weight(int node) const { return 1.0 / cosines_[static_cast<std::size_t>(node)]; }

  const Mesh& mesh_;
  int faces_, resolution_;
  std::size_t per_face_;
  const Lighting& light_;
  const LightSurroundings* around_;
  const VisibleLightSettings& settings_;
  const Vec3d* eye_;
  Vec3d centre_ = Vec3d::Zero();
  std::vector<Leaf> sides_, cells_;  ///< sides: faces as wound, then their backs
  std::vector<std::vector<Vec2f>>
      seen_points_;              ///< of each side, barycentrics (b1, b2); empty without a camera
  std::vector<bool> fine_;       ///< of each side: the camera sees some of it
  std::vector<double> cosines_;  ///< of each node: sum over the directions that it sends rays along
  int columns_ = 0, rows_ = 0;
  Transform roof_from_velo_ = Transform::Identity();
  std::vector<Vec3d> directions_;
  std::vector<Vec3f> starts_;
  std::vector<Sent> sent_;
  HitTable hits_;
  LightVisibility result_;
};

}  // namespace

LightVisibility find_visibility(const TexturedMesh& placed, const Lighting& light,
                                const LightSurroundings* surroundings, const Vec3d* eye,
                                const VisibleLightSettings& settings) {
  if (settings.directions < 1 || settings.rough_directions < 1 || !(settings.cell > 0) ||
      settings.bounces < 0 || settings.sun_samples < 1)
    throw InputError("light settings", "", "a number is not positive", "use the defaults");
  return Tracer(placed, light, surroundings, eye, settings).run();
}

}  // namespace mirage
