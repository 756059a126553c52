#include "sensors/light_nodes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "base/intervals.h"
#include "geometry/mesh.h"
#include "sensors/material.h"
#include "sensors/screen_mesh.h"

namespace mirage {
namespace {

constexpr int kLooks = 3;       // 3² rays to a face find its visible part
constexpr int kTexelLooks = 2;  // 2² rays to a texel

/// The value of make() for a key, made on first use.
template <class Key, class Value, class Make>
const Value& once(std::map<Key, Value>& made, const Key& key, const Make& make) {
  const auto [at, is_new] = made.try_emplace(key);
  if (is_new) at->second = make();
  return at->second;
}

/// The corners (b1, b2) of each texel's triangle, by its index.
const std::vector<std::array<Vec2f, 3>>& texel_corners(int resolution) {
  thread_local std::map<int, std::vector<std::array<Vec2f, 3>>> made;
  return once(made, resolution, [&] {
    std::vector<std::array<Vec2f, 3>> corners(as_size(resolution) * as_size(resolution));
    for (const AtlasTriangle& triangle : atlas_triangles(resolution))
      for (std::size_t i = 0; i < 3; ++i) {
        const Vec2d& b = triangle.corners[i];
        corners[as_size(triangle.texel)][i] = Vec2d(b.y(), 1 - b.sum()).cast<float>();
      }
    return corners;
  });
}

/// The area of each whole side.
std::vector<LightArea> whole_sides(const Mesh& mesh, const Vec3d& centre, double lift) {
  std::vector<LightArea> sides(2 * mesh.faces.size());
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const auto [a, b, c] = mesh.corners(mesh.faces[f]);
    const Vec3d normal = (b - a).cross(c - a);
    const double length = normal.norm();
    const Vec3d n = length > 0 ? Vec3d(normal / length) : Vec3d::Zero();
    for (const double sign : {1.0, -1.0})
      sides[sign > 0 ? f : f + mesh.faces.size()] = {(a + sign * lift * n - centre).cast<float>(),
                                                     (b - a).cast<float>(), (c - a).cast<float>(),
                                                     (sign * n).cast<float>()};
  }
  return sides;
}

class Nodes {
 public:
  Nodes(const TexturedMesh& placed, const Vec3d& centre, const VisibleLightSettings& settings)
      : mesh_(placed.mesh), resolution_(placed.atlas.resolution), settings_(settings) {
    // Rays start this far off the face they leave, beyond float32's rounding.
    lift_ = 1e-5 * std::max(1e-3, bounds(mesh_).diagonal().norm());
    made_.centre = centre;
    made_.side_areas = whole_sides(mesh_, centre, lift_);
    made_.faces = mesh_.faces.size();
    made_.behind.resize(made_.faces);
    points_.resize(made_.side_areas.size());
    is_whole_.assign(made_.faces, false);
    for (const std::size_t i : used_vertices(mesh_))
      vertices_.push_back((mesh_.vertices[i] - centre).cast<float>());
    made_.angles.assign(made_.side_areas.size(), 0);
  }

  /// Sets the side of each face that faces the camera, its solid angle, and its visible points.
  void set_eye(RayPencil& pencil, const Vec3d& eye) {
    const std::vector<Vec2d>& points = texel_centroids(kLooks);
    std::vector<Vec3f> targets;
    for (std::size_t f = 0; f < mesh_.faces.size(); ++f) {
      const LightArea& front = made_.side_areas[f];
      const Vec3d normal = front.edge1.cross(front.edge2).cast<double>(),
                  to_eye = eye - made_.centre - middle(front);
      made_.behind[f] = normal.dot(to_eye) < 0;
      const std::size_t side = made_.side(f);
      const double distance = to_eye.norm();
      if (distance > 0)
        made_.angles[side] = std::abs(normal.dot(to_eye)) / (2 * distance * distance * distance);
      for (const Vec2d& point : points) targets.push_back(point_of(made_.side_areas[side], point));
    }
    const Vec3f from = (eye - made_.centre).cast<float>();
    pencil.from(from, from.isZero(0) ? Vec3f::UnitX() : Vec3f(-from));
    std::vector<RayPencil::Met> hits(targets.size());
    pencil.intersect(targets, hits);
    std::vector<std::size_t> own(mesh_.faces.size(), 0);
    for (std::size_t i = 0; i < hits.size(); ++i) {
      if (hits[i].face < 0) continue;
      const std::size_t face = as_size(hits[i].face), side = made_.side(face);
      points_[side].push_back(made_.side_areas[side].at(hits[i].b1, hits[i].b2));
      own[face] += i / points.size() == face;
    }
    for (std::size_t f = 0; f < own.size(); ++f) is_whole_[f] = own[f] == points.size();
  }

  /// Makes the nodes except the cells.
  void make_patches() {
    for (int n = 1; n <= resolution_; ++n) {
      made_.texels_of_node.push_back(centroids_within(n, resolution_));
      made_.node_of_texel.push_back(texels_of_centroids(resolution_, n));
    }
    made_.first_of_side.push_back(0);
    for (std::size_t side = 0; side < made_.side_areas.size(); ++side) {
      const LightArea& whole = made_.side_areas[side];
      made_.parts.push_back(parts_of(side));
      for (const auto& [p, q, r] : texel_corners(made_.parts.back()))
        made_.node_areas.push_back(
            {whole.at(p.x(), p.y()), (q.x() - p.x()) * whole.edge1 + (q.y() - p.y()) * whole.edge2,
             (r.x() - p.x()) * whole.edge1 + (r.y() - p.y()) * whole.edge2, whole.normal});
      made_.side_of.resize(made_.node_areas.size(), static_cast<int>(side));
      made_.first_of_side.push_back(static_cast<int>(made_.node_areas.size()));
    }
    made_.seen.assign(made_.side_of.size(), false);
  }

  /// Finds the patches that the camera sees, and their visible points.
  void look_at_patches(const RayPencil& pencil) {
    const std::vector<Vec2d>& points = texel_centroids(kTexelLooks);
    std::vector<std::pair<std::size_t, Vec3f>> seen;  // of a patch, a point
    std::vector<Vec3f> targets;
    for (std::size_t side = 0; side < made_.side_areas.size(); ++side) {
      const std::size_t first = made_.first_node(side);
      if (made_.parts[side] == 1) {
        for (const Vec3f& point : points_[side]) seen.emplace_back(first, point);
        continue;
      }
      const bool is_whole = is_whole_[made_.face_of(side)];
      for (std::size_t i = first; i < made_.first_node(side + 1); ++i)
        for (const Vec2d& point : points) {
          const Vec3f at = point_of(made_.node_areas[i], point);
          if (is_whole) {
            seen.emplace_back(i, at);
          } else {
            targets.push_back(at);
          }
        }
    }
    std::vector<RayPencil::Met> hits(targets.size());
    pencil.intersect(targets, hits);
    for (const RayPencil::Met& hit : hits) {
      if (hit.face < 0) continue;
      const std::size_t side = made_.side(as_size(hit.face));
      if (made_.parts[side] == 1) continue;
      const int part = texel_index<double>(std::max(0.0f, 1 - hit.b1 - hit.b2), hit.b1, made_.parts[side]);
      seen.emplace_back(made_.first_node(side) + as_size(part), made_.side_areas[side].at(hit.b1, hit.b2));
    }
    keep(std::move(seen));
  }

  /// Sets each patch's unit vector towards the camera.
  void view(const Vec3d& eye) {
    for (const LightArea& area : made_.node_areas)
      made_.views.push_back((eye - made_.centre - middle(area)).normalized());
  }

  LightNodes finish(const LightSurroundings* around, bool has_eye) {
    if (!has_eye) std::fill_n(made_.seen.begin(), mesh_.faces.size(), true);
    if (around) add_cells(*around);
    return std::move(made_);
  }

 private:
  /// Horizon of the object over a side's plane, seen from the side's middle: sine of the highest corner's
  /// elevation.
  double horizon(std::size_t side) const {
    const LightArea& whole = made_.side_areas[side];
    const Vec3f at = whole.at(1 / 3.0f, 1 / 3.0f);
    float highest = 0;
    for (const Vec3f& vertex : vertices_) {
      const Vec3f to = vertex - at;
      const float height = whole.normal.dot(to);
      if (height > 0) highest = std::max(highest, height * height / to.squaredNorm());
    }
    return std::sqrt(highest);
  }
  int parts_of(std::size_t side) const {
    const double angle = made_.angles[side];
    double most = settings_.node_angle;
    if (points_[side].empty() || angle <= std::min(most, settings_.enclosed_node_angle)) return 1;
    if (settings_.enclosed_node_angle < most && horizon(side) > settings_.open_below)
      most = settings_.enclosed_node_angle;
    if (angle <= most) return 1;
    const double parts = std::ceil(std::sqrt(angle / most));
    return parts < resolution_ ? static_cast<int>(parts) : resolution_;
  }
  static Vec3d middle(const LightArea& area) { return area.at(1 / 3.0f, 1 / 3.0f).cast<double>(); }
  static Vec3f point_of(const LightArea& area, const Vec2d& b12) {
    return area.at(static_cast<float>(b12.x()), static_cast<float>(b12.y()));
  }
  /// Stores the points that the camera sees, by patch.
  void keep(std::vector<std::pair<std::size_t, Vec3f>> seen) {
    made_.first_seen_point =
        group_together(seen, made_.seen.size(), [](const auto& point) { return point.first; });
    for (const auto& [patch, point] : seen) {
      made_.seen[patch] = true;
      made_.seen_points.push_back(point);
    }
  }

  void add_cells(const LightSurroundings& around) {
    const Vec2d size = around.roof.sizes().cwiseMax(1e-3);
    made_.cells.columns = std::clamp(static_cast<int>(std::ceil(size.x() / settings_.cell)), 1, 64);
    made_.cells.rows = std::clamp(static_cast<int>(std::ceil(size.y() / settings_.cell)), 1, 64);
    const Eigen::Matrix3d axes = around.velo_from_roof.linear();
    const Vec2d cell(size.x() / made_.cells.columns, size.y() / made_.cells.rows);
    for (int row = 0; row < made_.cells.rows; ++row)
      for (int column = 0; column < made_.cells.columns; ++column) {
        const Vec2d corner = around.roof.min() + Vec2d(column * cell.x(), row * cell.y());
        made_.node_areas.push_back(
            {(around.velo_from_roof * Vec3d(corner.x(), corner.y(), lift_) - made_.centre).cast<float>(),
             (axes.col(0) * cell.x()).cast<float>(), (axes.col(1) * cell.y()).cast<float>(),
             axes.col(2).cast<float>()});
      }
  }

  const Mesh& mesh_;
  int resolution_;
  const VisibleLightSettings& settings_;
  double lift_ = 0;
  std::vector<std::vector<Vec3f>> points_;  ///< of each side: points that the camera sees
  std::vector<bool> is_whole_;              ///< of each face: found nowhere hidden
  std::vector<Vec3f> vertices_;             ///< about the centre
  LightNodes made_;
};

}  // namespace

const std::vector<Vec2d>& texel_centroids(int n) {
  thread_local std::map<int, std::vector<Vec2d>> made;
  return once(made, n, [&] {
    std::vector<Vec2d> centroids;
    for (const auto& [p, q, r] : texel_corners(n)) {
      const Vec2d b12 = (p + q + r).cast<double>() / 3;
      centroids.emplace_back(1 - b12.sum(), b12.x());
    }
    return centroids;
  });
}

const std::vector<int>& texels_of_centroids(int n, int p) {
  thread_local std::map<std::pair<int, int>, std::vector<int>> made;
  return once(made, std::pair(n, p), [&] {
    std::vector<int> texels;
    for (const Vec2d& b : texel_centroids(n)) texels.push_back(texel_index<double>(b.x(), b.y(), p));
    return texels;
  });
}

const std::vector<std::vector<int>>& centroids_within(int p, int n) {
  thread_local std::map<std::pair<int, int>, std::vector<std::vector<int>>> made;
  return once(made, std::pair(p, n), [&] {
    const std::vector<int>&part_of = texels_of_centroids(n, p), &own = texels_of_centroids(p, n);
    std::vector<std::vector<int>> lists(own.size());
    for (std::size_t i = 0; i < part_of.size(); ++i)
      lists[as_size(part_of[i])].push_back(static_cast<int>(i));
    for (std::size_t k = 0; k < lists.size(); ++k)
      if (lists[k].empty()) lists[k].push_back(own[k]);
    return lists;
  });
}

const std::vector<std::vector<int>>& texel_neighbours(int n) {
  constexpr double kApart = 2.1;  // edges of the triangles
  thread_local std::map<int, std::vector<std::vector<int>>> made;
  return once(made, n, [&] {
    const std::vector<Vec2d>& centroids = texel_centroids(n);
    std::vector<std::vector<int>> lists(centroids.size());
    for (std::size_t i = 0; i < centroids.size(); ++i)
      for (std::size_t k = 0; k < centroids.size(); ++k) {
        const Vec2d d = centroids[k] - centroids[i];
        const double furthest = std::max({std::abs(d.x()), std::abs(d.y()), std::abs(d.sum())});
        if (k != i && furthest < kApart / n) lists[i].push_back(static_cast<int>(k));
      }
    return lists;
  });
}

LightNodes light_nodes(const TexturedMesh& placed, const Vec3d& centre, RayPencil* pencil,
                       const LightSurroundings* around, const Vec3d* eye,
                       const VisibleLightSettings& settings) {
  Nodes nodes(placed, centre, settings);
  const bool has_eye = pencil && eye;
  if (has_eye) nodes.set_eye(*pencil, *eye);
  nodes.make_patches();
  if (has_eye) nodes.look_at_patches(*pencil);
  if (has_eye && settings.glossy) nodes.view(*eye);
  return nodes.finish(around, has_eye);
}

LightEnvironment::LightEnvironment(const Lighting& light, const LightSurroundings* around,
                                   const Vec3d& centre, RoofCells cells)
    : light_(light), around_(around), cells_(cells) {
  if (!around) return;
  roof_from_velo_ = around->velo_from_roof.inverse();
  centre_in_roof_ = roof_from_velo_ * centre;
  roof_ = around->roof.cast<float>(), deck_ = around->deck.cast<float>();
  cells_per_metre_ = Vec2f(static_cast<float>(cells.columns), static_cast<float>(cells.rows))
                         .cwiseQuotient(roof_.sizes().cwiseMax(1e-3f));
}

Vec3d LightEnvironment::sky(const Vec3d& direction) const {
  return light_.ambient + light_.hemisphere / 2 + 0.75 * direction.z() * light_.hemisphere;
}

LightEnvironment::Sheen LightEnvironment::sheen(const Vec3d& normal, const Vec3d& direction) const {
  const Vec3d v = -direction;
  return {specular_albedo(normal.dot(v)) * sky(direction + 2 * normal.dot(v) * normal),
          specular_response(normal, light_.to_sun_velo, v) * light_.sun};
}

/// Radiance of a level surface under the open sky, seen along a downward direction.
Vec3d LightEnvironment::level_radiance(const Vec3d& albedo, const Vec3d& direction) const {
  const Vec3d n = Vec3d::UnitZ(), &l = light_.to_sun_velo;
  const Vec3d lit = light_.ambient + light_.hemisphere +
                    std::max(0.0, l.z()) * diffuse_response(n, l, -direction) * light_.sun;
  const Sheen gloss = sheen(n, direction);
  return albedo.cwiseProduct(lit) + gloss.sky + gloss.sun;
}

LightEnvironment::Along LightEnvironment::along(const Vec3d& direction) const {
  Along along;
  along.towards = direction.cast<float>();
  along.goes_down = direction.z() < 0;
  along.sky << sky(direction).cast<float>(), 0;
  along.deck = along.road = along.roof_sky = along.roof_sun = Vec3f::Zero();
  if (!around_) return along;
  if (direction.z() < 0) {
    along.deck = level_radiance(around_->paint, direction).cast<float>();
    along.road = level_radiance(around_->road, direction).cast<float>();
  }
  const Eigen::Matrix3d turn = roof_from_velo_.linear();
  const Vec3d d = turn * direction;
  if (!(d.z() < 0)) return along;
  along.falls = true;
  const Sheen roof = sheen(around_->velo_from_roof.linear().col(2), direction);
  along.roof_sky = roof.sky.cast<float>(), along.roof_sun = roof.sun.cast<float>();
  const Vec2d slope = d.head<2>() / d.z();
  along.crossing = (turn.topRows<2>() - slope * turn.row(2)).cast<float>();
  along.crossing_offset = (centre_in_roof_.head<2>() - centre_in_roof_.z() * slope).cast<float>();
  along.deck_shift = (-around_->deck_below * slope).cast<float>();
  along.height = turn.row(2).transpose().cast<float>();
  along.height_offset = static_cast<float>(centre_in_roof_.z());
  return along;
}

int LightEnvironment::meet(const Along& along, const Vec3f& start) const {
  if (!around_) return kSky;
  if (along.falls) {
    const Vec2f at = along.crossing * start + along.crossing_offset;
    if (along.height.dot(start) + along.height_offset > 0 && roof_.contains(at)) {
      const Vec2f cell = (at - roof_.min()).cwiseProduct(cells_per_metre_);
      return std::clamp(static_cast<int>(cell.y()), 0, cells_.rows - 1) * cells_.columns +
             std::clamp(static_cast<int>(cell.x()), 0, cells_.columns - 1);
    }
    if (deck_.contains(Vec2f(at + along.deck_shift))) return kDeck;
  }
  return along.goes_down ? kRoad : kSky;
}

}  // namespace mirage
