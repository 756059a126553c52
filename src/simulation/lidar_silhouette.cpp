#include "simulation/lidar_silhouette.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "geometry/solid.h"
#include "sensors/ray_caster.h"

namespace mirage {
namespace {

/// How far outside the silhouette it is looked at what lies behind it (rad).
constexpr double kOutside = 5e-5;
/// What is not further behind the silhouette than this (m) is the object's surface there.
constexpr double kSameSurface = 1e-3;
constexpr double kSamplesPerCell = 2;
constexpr double kMostSamples = 4096;  // of an edge: a unit that is almost inside the object

class Tracer {
 public:
  Tracer(const PreparedFrame& prepared, const TexturedMesh& placed)
      : prepared_(prepared),
        mesh_(placed.mesh),
        centre_(bounds(placed.mesh).center()),
        normals_(face_normals(placed.mesh)) {
    double off = 0;  // m, of a laser from the unit's centre
    for (const LidarBeam& beam : prepared.lidar.beams)
      off = std::max(off, std::hypot(beam.lateral, beam.height));
    const Vec3d unit = prepared.lidar.velo_from_lidar.translation();
    for (std::size_t f = 0; f < normals_.size(); ++f) {
      const double height = height_over(static_cast<int>(f), unit), unsure = normals_[f].norm() * off;
      sides_.push_back(height > unsure ? 1 : height < -unsure ? -1 : 0);
    }
  }

  LidarSilhouette run() {
    const std::vector<MeshEdge> edges = edges_of(mesh_);  // candidates point into it
    for (const MeshEdge& edge : edges)
      // Where more faces meet, no two of them are the ones that border on what is behind.
      if (edge.faces.size() <= 2 && !is_inner(edge)) sample(edge);
    if (candidates_.empty()) return {};
    const RayCaster caster(std::span(&mesh_, 1), centre_);
    RayTable rays(1, candidates_.size());
    for (std::size_t i = 0; i < candidates_.size(); ++i)
      rays.set(0, i, (candidates_[i].cell.ray.ray.origin - centre_).cast<float>(),
               candidates_[i].past.cast<float>());
    HitTable hits;
    caster.intersect(rays, 0, 1e30f, hits);
    for (std::size_t i = 0; i < candidates_.size(); ++i)
      settle(candidates_[i], hits.face[i] < 0 ? std::nullopt : std::optional<double>(hits.t[i]));
    return std::move(silhouette_);
  }

 private:
  struct Candidate {
    const MeshEdge* edge = nullptr;
    double share = 0;
    Vec3d p, span;  ///< the point, and the part of the edge that it stands for
    Vec3d past;     ///< direction of a ray that just misses the object here
    RasterCell cell;
  };

  const Vec3d& vertex(int i) const { return mesh_.vertices[static_cast<std::size_t>(i)]; }

  /// Of a face's plane to a point, times twice the face's area; positive on its front.
  double height_over(int face, const Vec3d& origin) const {
    const auto f = static_cast<std::size_t>(face);
    return normals_[f].dot(origin - vertex(mesh_.faces[f][0]));
  }

  /// Whether no laser can have the edge on its silhouette: most edges, and cells are dear to look up.
  bool is_inner(const MeshEdge& edge) const {
    if (edge.faces.size() < 2) return false;
    const int first = sides_[static_cast<std::size_t>(edge.faces[0])];
    return first != 0 && first == sides_[static_cast<std::size_t>(edge.faces[1])];
  }

  /// The edge's face that is seen, if behind the edge the object turns away; −1: it does not.
  int seen_face(const MeshEdge& edge, const Vec3d& origin) const {
    if (edge.faces.size() < 2) return edge.faces[0];  // a border
    const bool first = height_over(edge.faces[0], origin) > 0,
               second = height_over(edge.faces[1], origin) > 0;
    if (first == second) return -1;
    return edge.faces[first ? 0 : 1];
  }

  /// Unit vector away from the face, across the edge and the ray; 0 where these are parallel.
  Vec3d outward(const Candidate& c, int face) const {
    const Vec3d across = (c.p - c.cell.ray.ray.origin).cross(c.span);
    double side = 0;
    for (const int i : mesh_.faces[static_cast<std::size_t>(face)])
      if (i != c.edge->vertices[0] && i != c.edge->vertices[1]) side = across.dot(vertex(i) - c.p);
    const double length = across.norm();
    if (!(length > 0) || side == 0) return Vec3d::Zero();
    return across * ((side > 0 ? -1 : 1) / length);
  }

  void sample(const MeshEdge& edge) {
    const Vec3d &a = vertex(edge.vertices[0]), &b = vertex(edge.vertices[1]);
    std::optional<RasterCell> cell;
    for (const double share : {0.5, 0.0, 1.0})
      if (!cell) cell = prepared_.index.cell_at(a + share * (b - a));
    if (!cell) return;
    const double cells =
        std::max(std::abs(cell->left_per_metre.dot(b - a)), std::abs(cell->up_per_metre.dot(b - a)));
    const int count = static_cast<int>(std::clamp(std::ceil(kSamplesPerCell * cells), 1.0, kMostSamples));
    for (int k = 0; k < count; ++k) {
      Candidate c{&edge, (k + 0.5) / count, {}, (b - a) / count, {}, {}};
      c.p = a + c.share * (b - a);
      const auto here = prepared_.index.cell_at(c.p);
      if (!here) continue;
      c.cell = *here;
      const int face = seen_face(edge, c.cell.ray.ray.origin);  // lasers start off the unit's centre
      if (face < 0) continue;
      const Vec3d out = outward(c, face), towards = c.p - c.cell.ray.ray.origin;
      if (out.isZero(0)) continue;
      c.past = (towards + kOutside * towards.norm() * out).normalized();
      candidates_.push_back(c);
    }
  }

  int place(const Vec3d& p) {
    const Vec3f at = p.cast<float>();
    silhouette_.places.push_back({at.x(), at.y(), at.z(), 0});
    return static_cast<int>(silhouette_.places.size()) - 1;
  }

  /// `met`: how far off the ray just beside the object meets another part of it.
  void settle(const Candidate& c, std::optional<double> met) {
    const SweepRay& ray = c.cell.ray;
    const Vec3d towards = c.p - ray.ray.origin;
    const double range = towards.norm();
    if (met && *met < range + kSameSurface) return;  // in front of the edge, or the surface itself
    const auto in_range = [&](double r) {
      return r >= prepared_.lidar.range_min && r <= prepared_.lidar.range_max;
    };
    if (!in_range(range)) return;
    if (ray.point >= 0 && ray.range <= range) return;  // of two returns the nearer stays
    LidarSilhouette::Sample sample;
    sample.vertices = c.edge->vertices;
    sample.share = c.share;
    // The area over the raster that the point's part of the edge sweeps.
    const double left = c.cell.left_per_metre.dot(c.span), up = c.cell.up_per_metre.dot(c.span);
    sample.gain = left * c.cell.up_per_metre - up * c.cell.left_per_metre;
    if (sample.gain.dot(c.past * range - towards) < 0) sample.gain = -sample.gain;
    sample.near = place(c.p);
    if (ray.point >= 0 && (!met || ray.range <= *met)) {
      const LidarPoint& measured = prepared_.frame.sweep[static_cast<std::size_t>(ray.point)];
      sample.behind = place(measured.position().cast<double>());
    } else if (met && in_range(*met)) {
      sample.behind = place(ray.ray.origin + *met * c.past);
    }
    silhouette_.samples.push_back(sample);
  }

  const PreparedFrame& prepared_;
  const Mesh& mesh_;
  Vec3d centre_;
  std::vector<Vec3d> normals_;  ///< of the faces, as long as twice their areas
  std::vector<int> sides_;      ///< of each face all lasers are on: 1 front, −1 back, 0 they may differ
  std::vector<Candidate> candidates_;
  LidarSilhouette silhouette_;
};

}  // namespace

LidarSilhouette lidar_silhouette(const PreparedFrame& prepared, const TexturedMesh& placed) {
  if (placed.mesh.faces.empty()) return {};
  return Tracer(prepared, placed).run();
}

template <class S>
void lidar_silhouette_vjp(const LidarSilhouette& silhouette, std::span<const S> presence,
                          std::vector<Vec3d>& d_vertices) {
  const auto at = [&](int place) { return static_cast<double>(presence[static_cast<std::size_t>(place)]); };
  for (const LidarSilhouette::Sample& sample : silhouette.samples) {
    const double gained = at(sample.near) - (sample.behind >= 0 ? at(sample.behind) : 0);
    const Vec3d d_point = gained * sample.gain;
    d_vertices[static_cast<std::size_t>(sample.vertices[0])] += (1 - sample.share) * d_point;
    d_vertices[static_cast<std::size_t>(sample.vertices[1])] += sample.share * d_point;
  }
}
template void lidar_silhouette_vjp(const LidarSilhouette&, std::span<const float>, std::vector<Vec3d>&);
template void lidar_silhouette_vjp(const LidarSilhouette&, std::span<const double>, std::vector<Vec3d>&);

}  // namespace mirage
