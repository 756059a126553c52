#include "simulation/adversary_lidar.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "base/random.h"
#include "base/sizes.h"
#include "geometry/solid.h"
#include "sensors/ray_caster.h"
#include "sensors/soft_rasterizer.h"

namespace mirage {
namespace {

std::array<Vec3d, 3> face_of(const Mesh& mesh, int face) {
  return mesh.corners(mesh.faces[as_size(face)]);
}

/// The ray caster works in float and may pick a face that the exact ray just misses. On needles and
/// near-grazing faces the ray then meets the plane far off the face: this keeps the return on the face.
void keep_on_face(FaceReturn<double>& hit, const LidarRay& ray, const std::array<Vec3d, 3>& face) {
  constexpr double kBeside = 1e-3;
  if ((hit.barycentric.array() >= -kBeside).all() && (hit.barycentric.array() <= 1 + kBeside).all()) return;
  if (!hit.barycentric.allFinite()) hit.barycentric.setOnes();
  hit.barycentric = hit.barycentric.cwiseMax(0.0).cwiseMin(1.0);
  hit.barycentric /= hit.barycentric.sum();
  hit.range = 0;
  for (int k = 0; k < 3; ++k)
    hit.range += hit.barycentric[k] * (face[as_size(k)] - ray.origin).dot(ray.direction);
}

class Insertion {
 public:
  Insertion(const PreparedFrame& prepared, const TexturedMesh& placed, const SimulationSettings& settings,
            Simulated& result)
      : prepared_(prepared),
        lidar_(prepared.lidar),
        placed_(placed),
        settings_(settings),
        effects_(settings.lidar_effects),
        pattern_(beam_pattern(effects_)),
        box_(bounds(placed.mesh)),
        result_(result) {}

  LidarTape run() {
    trace();
    for (std::size_t i = 0; i < sent_.size(); ++i) receive(i);
    merge();
    return std::move(tape_);
  }

 private:
  /// The unit's pose when the ray was fired, in the frame of moment 0.
  Transform pose(const SweepRay& sent) const {
    if (!effects_.moving()) return Transform::Identity();
    return start_from_moment(effects_, lidar_.firing_time(sent.beam, sent.azimuth));
  }

  /// Finds the rays that can meet the object. Motion shifts the object as the unit sees it, by an amount that
  /// changes from firing to firing: the bounding ball grows by that change.
  void find_rays() {
    Vec3d centre = box_.center();
    double radius = box_.diagonal().norm() / 2;
    if (effects_.moving()) {
      double last = 0;
      for (const LidarBeam& beam : lidar_.beams) last = std::max(last, beam.time);
      const Vec3d seen = lidar_.velo_from_lidar.inverse() * centre;
      const double middle = lidar_.firing_time(0, std::atan2(seen.y(), seen.x())) - lidar_.beams[0].time;
      const double speed = effects_.velocity.norm() + std::abs(effects_.yaw_rate) * centre.norm();
      // Beams look up to a few degrees beside the firing's azimuth: a quarter turn is enough unless the
      // object is next to the unit.
      const bool apart = centre.norm() > 2 * (radius + speed / lidar_.rate);
      radius += speed * ((apart ? 0.25 : 0.5) / lidar_.rate + last);
      centre = start_from_moment(effects_, apart ? middle : 0).inverse() * centre;
    }
    const double spread = effects_.divergence.norm() / 2;
    sent_ = prepared_.index.rays_through(centre, radius + spread * (centre.norm() + radius));
  }

  void trace() {
    find_rays();
    const std::size_t count = sent_.size();
    if (count == 0) return;
    const Vec3d centre = box_.center();
    const RayCaster caster(std::span(&placed_.mesh, 1), centre);
    traced_.resize(count * pattern_.size());
    RayTable rays(1, traced_.size());
    for (std::size_t i = 0; i < count; ++i) {
      const Transform velo_from_unit = pose(sent_[i]);
      const LidarRay& ray = sent_[i].ray;
      for (std::size_t k = 0; k < pattern_.size(); ++k) {
        LidarRay& sub = traced_[k * count + i];
        sub = ray;
        if (k > 0) sub.direction = turned(sub.direction, pattern_[k].angle);
        if (effects_.moving()) sub = {velo_from_unit * sub.origin, velo_from_unit.linear() * sub.direction};
        rays.set(0, k * count + i, (sub.origin - centre).cast<float>(), sub.direction.cast<float>());
      }
    }
    caster.intersect(rays, 0, 1e30f, hits_);
  }

  /// Traces a ray of the cone; false if it does not meet the object within the unit's range.
  bool meet(std::size_t at, double weight, LidarTape::BeamSample& part) const {
    if (hits_.face[at] < 0) return false;
    const LidarRay& ray = traced_[at];
    part.face = hits_.face[at];
    const auto face = face_of(placed_.mesh, part.face);
    FaceReturn<double> unit = intersect_face<double>(ray.origin, ray.direction, face, 1);
    if (!unit.valid) return false;
    keep_on_face(unit, ray, face);
    if (!(unit.range >= lidar_.range_min && unit.range <= lidar_.range_max)) return false;
    part.direction = ray.direction;
    part.weight = weight;
    part.reflectivity = settings_.lidar_reflectivity;
    part.texel = -1;
    if (effects_.albedo) {
      const TexelAtlas& atlas = placed_.atlas;
      part.texel = static_cast<int>(as_size(part.face) * atlas.per_face()) +
                   texel_index<double>(unit.barycentric[0], unit.barycentric[1], atlas.resolution);
      part.reflectivity = atlas.texels[as_size(part.texel)].mean();
    }
    part.hit = unit;
    part.hit.reflectance = part.reflectivity * unit.reflectance;
    return true;
  }

  void receive(std::size_t i) {
    const SweepRay& sent = sent_[i];
    const bool measured = sent.point >= 0;
    const std::size_t first = tape_.parts.size();
    bool met = false;
    reflections_.clear();
    double behind = 0;  // share of the light that passes by the object to the measured return
    for (std::size_t k = 0; k < pattern_.size(); ++k) {
      LidarTape::BeamSample part;
      const bool here = meet(k * sent_.size() + i, pattern_[k].weight, part);
      met |= here;
      // The nearer of the two returns stays; a ray without a measured return has no occluder.
      if (!here || (measured && sent.range <= part.hit.range)) {
        behind += pattern_[k].weight;
        continue;
      }
      tape_.parts.push_back(part);
      // A black surface still stops the light: one echo must be the strongest.
      reflections_.push_back({part.hit.range, std::max(strength(part), std::numeric_limits<double>::min())});
    }
    if (!met) return;
    if (tape_.parts.size() == first) {
      ++result_.occluded_points;
      return;
    }
    int strongest = 0;
    if (pattern_.size() > 1) {
      if (!win(sent, first, behind, strongest)) {
        tape_.parts.resize(first);
        if (measured) ++result_.occluded_points;
        return;
      }
    }
    if (measured) {
      removed_.push_back(sent.point);
      ++result_.removed_points;
    }
    add(sent, first, strongest);
  }

  /// Whether the strongest echo of the cone is the object's; drops the parts outside that echo.
  bool win(const SweepRay& sent, std::size_t first, double behind, int& strongest) {
    constexpr double kLeast = 0.01;  // reflectance: a return reported as 0 still came back
    const int background = static_cast<int>(reflections_.size());
    if (sent.point >= 0 && behind > 0) {
      const double reflectance = prepared_.frame.sweep[as_size(sent.point)].reflectance;
      reflections_.push_back({sent.range, behind * std::max(reflectance, kLeast) / square(sent.range)});
    }
    strongest_echo(reflections_, effects_.pulse_length, echo_);
    if (echo_.strongest < 0 || echo_.strongest == background) return false;
    std::vector<LidarTape::BeamSample> kept;
    for (int i : echo_.members) {
      if (i == background) continue;
      if (i == echo_.strongest) strongest = static_cast<int>(kept.size());
      kept.push_back(tape_.parts[first + as_size(i)]);
    }
    tape_.parts.resize(first);
    tape_.parts.insert(tape_.parts.end(), kept.begin(), kept.end());
    return true;
  }

  void add(const SweepRay& sent, std::size_t first, int strongest) {
    LidarTape::Return back;
    back.ray = sent.ray;
    back.beam = sent.beam, back.firing = sent.firing;
    back.first = static_cast<int>(first);
    back.count = static_cast<int>(tape_.parts.size() - first);
    back.strongest = strongest;
    const LidarTape::BeamSample& best = tape_.parts[first + as_size(strongest)];
    back.face = best.face;
    back.hit = best.hit;
    back.hit.reflectance = 0;
    double signal = 0, reflectivity = 0, light = 0;
    for (std::size_t p = first; p < tape_.parts.size(); ++p) {
      const LidarTape::BeamSample& part = tape_.parts[p];
      back.hit.reflectance += part.weight * part.hit.reflectance;
      signal += strength(part);
      reflectivity += part.weight * part.reflectivity, light += part.weight;
    }
    back.range = back.hit.range;
    if (effects_.range_sigma > 0 || effects_.losing()) {
      const std::uint64_t place =
          sent.firing >= 0
              ? (static_cast<std::uint64_t>(sent.beam) << 32) | static_cast<std::uint64_t>(sent.firing)
              : (std::uint64_t{1} << 63) | static_cast<std::uint64_t>(sent.point);
      RandomStream random(effects_.seed ^ fnv1a(prepared_.frame.id), "inserted return", place);
      FiringChance chance;
      chance.range_error = effects_.range_sigma * random.normal();
      chance.lost = random.uniform(), chance.weak = random.uniform();
      const double arrives =
          arrival_probability(signal, effects_) * surface_probability(reflectivity / light, effects_);
      const auto range =
          reported_range(back.range, arrives, chance, effects_, lidar_.range_min, lidar_.range_max);
      if (!range) {
        tape_.parts.resize(first);
        ++result_.lost_points;  // the object hides what is behind it all the same
        return;
      }
      back.range = *range;
    }
    tape_.returns.push_back(back);
  }

  void merge() {
    const Sweep& measured = prepared_.frame.sweep;
    std::sort(removed_.begin(), removed_.end());
    Sweep& sweep = result_.sweep;
    sweep.clear();
    sweep.reserve(measured.size() - removed_.size() + tape_.returns.size());
    auto from = measured.begin();
    for (int point : removed_) {
      const auto to = measured.begin() + point;
      sweep.insert(sweep.end(), from, to);
      from = to + 1;
    }
    sweep.insert(sweep.end(), from, measured.end());
    tape_.first = sweep.size();
    for (const auto& added : tape_.returns) {
      const Vec3d p = added.ray.origin + added.range * added.ray.direction;
      sweep.push_back({static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z()),
                       static_cast<float>(added.hit.reflectance)});
    }
    result_.adversary_points = static_cast<int>(tape_.returns.size());
  }

  static double square(double x) { return x * x; }

  /// Strength of the echo from this ray's share of the beam's light.
  static double strength(const LidarTape::BeamSample& part) {
    if (!(part.reflectivity > 0)) return 0;
    return part.weight *
           returned_signal(part.reflectivity, part.hit.reflectance / part.reflectivity, part.hit.range);
  }

  const PreparedFrame& prepared_;
  const LidarModel& lidar_;
  const TexturedMesh& placed_;
  const SimulationSettings& settings_;
  const LidarEffects& effects_;
  std::vector<SubRay> pattern_;
  Eigen::AlignedBox3d box_;
  Simulated& result_;
  std::vector<SweepRay> sent_;
  std::vector<LidarRay> traced_;  ///< pattern × sent, in the frame of moment 0
  HitTable hits_;
  std::vector<Reflection> reflections_;
  Echo echo_;
  std::vector<int> removed_;
  LidarTape tape_;
};

/// Offset outside the silhouette of the ray that looks behind it (rad).
constexpr double kOutside = 5e-5;
/// A hit up to this far behind the silhouette (m) is on the object's own surface there.
constexpr double kSameSurface = 1e-3;
constexpr double kSamplesPerCell = 2;
constexpr double kMaxSamples = 4096;  // of an edge, for a unit almost inside the object

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
      // An edge with more than two faces has no well-defined pair at the silhouette.
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

  const Vec3d& vertex(int i) const { return mesh_.vertices[as_size(i)]; }

  /// Height of a point over a face's plane, times twice the face's area; positive on its front.
  double height_over(int face, const Vec3d& origin) const {
    const auto f = as_size(face);
    return normals_[f].dot(origin - vertex(mesh_.faces[f][0]));
  }

  /// Whether no laser can have the edge on its silhouette: saves costly cell lookups for most edges.
  bool is_inner(const MeshEdge& edge) const {
    if (edge.faces.size() < 2) return false;
    const int first = sides_[as_size(edge.faces[0])];
    return first != 0 && first == sides_[as_size(edge.faces[1])];
  }

  /// The visible face of a silhouette edge; −1 if the edge is not on the silhouette.
  int seen_face(const MeshEdge& edge, const Vec3d& origin) const {
    if (edge.faces.size() < 2) return edge.faces[0];  // a border
    const bool first = height_over(edge.faces[0], origin) > 0,
               second = height_over(edge.faces[1], origin) > 0;
    if (first == second) return -1;
    return edge.faces[first ? 0 : 1];
  }

  /// Unit vector away from the face, perpendicular to edge and ray; 0 if these are parallel.
  Vec3d outward(const Candidate& c, int face) const {
    const Vec3d across = (c.p - c.cell.ray.ray.origin).cross(c.span);
    double side = 0;
    for (const int i : mesh_.faces[as_size(face)])
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
    const int count = static_cast<int>(std::clamp(std::ceil(kSamplesPerCell * cells), 1.0, kMaxSamples));
    for (int k = 0; k < count; ++k) {
      Candidate c{&edge, (k + 0.5) / count, {}, (b - a) / count, {}, {}};
      c.p = a + c.share * (b - a);
      const auto here = prepared_.index.cell_at(c.p);
      if (!here) continue;
      c.cell = *here;
      const int face = seen_face(edge, c.cell.ray.ray.origin);  // lasers aren't at the unit's centre
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

  /// `met`: range (m) at which the ray just beside the edge meets another part of the object.
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
    // The raster area that this point's part of the edge sweeps.
    const double left = c.cell.left_per_metre.dot(c.span), up = c.cell.up_per_metre.dot(c.span);
    sample.gain = left * c.cell.up_per_metre - up * c.cell.left_per_metre;
    if (sample.gain.dot(c.past * range - towards) < 0) sample.gain = -sample.gain;
    sample.near = place(c.p);
    if (ray.point >= 0 && (!met || ray.range <= *met)) {
      const LidarPoint& measured = prepared_.frame.sweep[as_size(ray.point)];
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
  std::vector<int> sides_;  ///< by face, the side that all lasers are on: 1 front, −1 back, 0 may differ
  std::vector<Candidate> candidates_;
  LidarSilhouette silhouette_;
};

}  // namespace

LidarTape draw_in_lidar(const PreparedFrame& prepared, const TexturedMesh& placed,
                        const SimulationSettings& settings, Simulated& result) {
  check_effects(settings.lidar_effects);
  if (placed.mesh.faces.empty()) {
    LidarTape tape;
    result.sweep = prepared.frame.sweep;
    tape.first = result.sweep.size();
    return tape;
  }
  return Insertion(prepared, placed, settings, result).run();
}

void draw_in_lidar_vjp(const LidarTape& tape, const TexturedMesh& placed, const SimulationSettings& settings,
                       const GradientView& d_points, std::vector<Vec3d>& d_vertices,
                       std::vector<Vec3d>& d_texels) {
  for (std::size_t i = 0; i < tape.returns.size(); ++i) {
    const auto& added = tape.returns[i];
    const std::size_t at = 4 * (tape.first + i);
    const double d_range = Vec3d(d_points[at], d_points[at + 1], d_points[at + 2]).dot(added.ray.direction);
    for (int p = 0; p < added.count; ++p) {
      const auto& part = tape.parts[as_size(added.first + p)];
      const auto face = face_of(placed.mesh, part.face);
      const double d_reflectance = part.weight * d_points[at + 3];
      const Vec3d d_point = p == added.strongest ? Vec3d(d_range * part.direction) : Vec3d::Zero();
      const auto d_face = intersect_face_vjp<double>(part.direction, face, part.hit, part.reflectivity,
                                                     settings.grazing_cosine, d_point, d_reflectance);
      const Face& corners = placed.mesh.faces[as_size(part.face)];
      for (std::size_t k = 0; k < 3; ++k) d_vertices[as_size(corners[k])] += d_face[k];
      if (part.texel < 0) continue;
      const Vec3d n = (face[1] - face[0]).cross(face[2] - face[0]);
      const double cosine = std::abs(n.dot(part.direction)) / n.norm();
      d_texels[as_size(part.texel)] += Vec3d::Constant(d_reflectance * cosine / 3);
    }
  }
}

LidarSilhouette lidar_silhouette(const PreparedFrame& prepared, const TexturedMesh& placed) {
  if (placed.mesh.faces.empty()) return {};
  return Tracer(prepared, placed).run();
}

void lidar_silhouette_vjp(const LidarSilhouette& silhouette, const GradientView& presence,
                          std::vector<Vec3d>& d_vertices) {
  const auto at = [&](int place) { return presence[as_size(place)]; };
  for (const LidarSilhouette::Sample& sample : silhouette.samples) {
    const double gained = at(sample.near) - (sample.behind >= 0 ? at(sample.behind) : 0);
    const Vec3d d_point = gained * sample.gain;
    d_vertices[as_size(sample.vertices[0])] += (1 - sample.share) * d_point;
    d_vertices[as_size(sample.vertices[1])] += sample.share * d_point;
  }
}

}  // namespace mirage
