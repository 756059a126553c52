#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "sensors/ray_caster.h"
#include "simulation/adversary_lidar.h"
#include "validation/tradeoff/sensor_studies.h"

namespace mirage {
namespace {

constexpr int kFewest = 8;  // hits that a host needs

enum class Arithmetic { embree, face, plain };

/// What a ray met.
struct Met {
  int face = -1;
  double range = 0;
  FaceReturn<double> hit;  ///< not with Arithmetic::embree
};

class Study {
 public:
  Study(const PreparedFrame& prepared, const TexturedMesh& placed, const SimulationSettings& settings)
      : prepared_(prepared), placed_(placed), settings_(settings), box_(bounds(placed.mesh)) {
    sent_ = prepared.index.rays_through(box_.center(), box_.diagonal().norm() / 2);
    for (const Face& f : placed.mesh.faces)
      corners_.push_back({placed.mesh.vertices[static_cast<std::size_t>(f[0])],
                          placed.mesh.vertices[static_cast<std::size_t>(f[1])],
                          placed.mesh.vertices[static_cast<std::size_t>(f[2])]});
    reference_ = trace(every(1), Arithmetic::plain);
    for (const Met& met : reference_) hits_ += met.face >= 0;
  }

  int hits() const { return hits_; }

  TradeoffPoint measure(std::string axis, std::string label, Arithmetic arithmetic, std::size_t stride,
                        int repeats) const {
    TradeoffPoint point{"lidar", std::move(axis), std::move(label)};
    point.settings = {{"every", stride},
                      {"arithmetic", arithmetic == Arithmetic::embree ? "float"
                                     : arithmetic == Arithmetic::face ? "float face, double range"
                                                                      : "double"}};
    const std::vector<std::size_t> sampled = every(stride), all = every(1);
    const std::vector<Met> met = trace(sampled, arithmetic);
    point.errors = compare(sampled, met);
    if (arithmetic != Arithmetic::embree) {
      const Agreement gradients = agreement(gradient(sampled, met), gradient(all, reference_));
      point.errors["gradient_cosine"] = gradients.cosine;
      point.errors["gradient_norm"] = gradients.norm;
      point.errors["gradient"] = 1 - gradients.cosine;
    }
    time_beside(
        point, repeats, [&] { trace(all, Arithmetic::face); }, [&] { trace(sampled, arithmetic); });
    return point;
  }

 private:
  /// Indices of every stride-th ray of each beam.
  std::vector<std::size_t> every(std::size_t stride) const {
    std::vector<std::size_t> sampled;
    std::size_t in_beam = 0;
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      if (i > 0 && sent_[i].beam != sent_[i - 1].beam) in_beam = 0;
      if (in_beam++ % stride == 0) sampled.push_back(i);
    }
    return sampled;
  }

  std::vector<Met> trace(const std::vector<std::size_t>& sampled, Arithmetic arithmetic) const {
    std::vector<Met> met(sampled.size());
    if (arithmetic == Arithmetic::plain) {
      for (std::size_t i = 0; i < sampled.size(); ++i) met[i] = nearest(sent_[sampled[i]].ray);
      return met;
    }
    const Vec3d centre = box_.center();
    const RayCaster caster(std::span(&placed_.mesh, 1), centre);
    RayTable rays(1, sampled.size());
    for (std::size_t i = 0; i < sampled.size(); ++i) {
      const LidarRay& ray = sent_[sampled[i]].ray;
      rays.set(0, i, (ray.origin - centre).cast<float>(), ray.direction.cast<float>());
    }
    HitTable table;
    caster.intersect(rays, 0, 1e30f, table);
    for (std::size_t i = 0; i < sampled.size(); ++i) {
      met[i].face = table.face[i];
      if (met[i].face < 0) continue;
      met[i].range = table.t[i];
      if (arithmetic == Arithmetic::embree) continue;
      const LidarRay& ray = sent_[sampled[i]].ray;
      met[i].hit = intersect_face<double>(ray.origin, ray.direction,
                                          corners_[static_cast<std::size_t>(met[i].face)], 1);
      met[i].range = met[i].hit.range;
    }
    return met;
  }

  Met nearest(const LidarRay& ray) const {
    Met best;
    for (std::size_t f = 0; f < corners_.size(); ++f) {
      const auto hit = intersect_face<double>(ray.origin, ray.direction, corners_[f], 1);
      if (!hit.valid || hit.range <= 0 || (hit.barycentric.array() < 0).any()) continue;
      if (best.face < 0 || hit.range < best.range) best = {static_cast<int>(f), hit.range, hit};
    }
    return best;
  }

  /// Every ray takes the range of the nearest traced one of its beam.
  std::map<std::string, double> compare(const std::vector<std::size_t>& sampled,
                                        const std::vector<Met>& met) const {
    double sum = 0, largest = 0;
    int both = 0, disagreed = 0;
    std::size_t at = 0;
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      while (at + 1 < sampled.size() && sent_[sampled[at + 1]].beam == sent_[i].beam &&
             (sent_[sampled[at]].beam != sent_[i].beam ||
              distance(sampled[at + 1], i) < distance(sampled[at], i)))
        ++at;
      while (at + 1 < sampled.size() && sent_[sampled[at]].beam != sent_[i].beam) ++at;
      const bool here = met[at].face >= 0, there = reference_[i].face >= 0;
      if (here && there) {
        const double error = std::abs(met[at].range - reference_[i].range);
        sum += error;
        largest = std::max(largest, error);
        ++both;
      }
      disagreed += here != there;
    }
    return {{"range_error_m", both > 0 ? sum / both : 0},
            {"range_max_m", largest},
            {"disagreements", static_cast<double>(disagreed) / hits_}};
  }

  static std::size_t distance(std::size_t a, std::size_t b) { return a > b ? a - b : b - a; }

  std::vector<double> gradient(const std::vector<std::size_t>& sampled, const std::vector<Met>& met) const {
    std::vector<double> d_vertices(3 * placed_.mesh.vertices.size());
    for (std::size_t i = 0; i < sampled.size(); ++i) {
      if (met[i].face < 0) continue;
      const LidarRay& ray = sent_[sampled[i]].ray;
      const Vec3d& d = ray.direction;
      const double azimuth = std::atan2(d.y(), d.x()), elevation = std::asin(std::clamp(d.z(), -1.0, 1.0));
      const double weight = (std::cos(150 * azimuth + 0.4) + std::sin(210 * elevation)) *
                            static_cast<double>(sent_.size()) / static_cast<double>(sampled.size());
      const std::size_t f = static_cast<std::size_t>(met[i].face);
      const auto d_face =
          intersect_face_vjp<double>(d, corners_[f], met[i].hit, 1, settings_.grazing_cosine, weight * d, 0);
      for (std::size_t k = 0; k < 3; ++k)
        for (std::size_t c = 0; c < 3; ++c)
          d_vertices[3 * static_cast<std::size_t>(placed_.mesh.faces[f][k]) + c] +=
              d_face[k][static_cast<Eigen::Index>(c)];
    }
    return d_vertices;
  }

  const PreparedFrame& prepared_;
  const TexturedMesh& placed_;
  const SimulationSettings& settings_;
  Eigen::AlignedBox3d box_;
  std::vector<SweepRay> sent_;
  std::vector<std::array<Vec3d, 3>> corners_;
  std::vector<Met> reference_;
  int hits_ = 0;
};

/// The returns of an insertion by (beam, firing).
std::map<std::pair<int, int>, double> ranges(const LidarTape& tape) {
  std::map<std::pair<int, int>, double> out;
  for (const auto& back : tape.returns)
    if (back.firing >= 0) out[{back.beam, back.firing}] = back.range;
  return out;
}

std::vector<TradeoffPoint> beams(const PreparedFrame& prepared, const TexturedMesh& placed,
                                 const SimulationSettings& settings, int repeats) {
  SimulationSettings thin = settings, wide = settings;
  thin.lidar_effects = wide.lidar_effects = {};
  wide.lidar_effects.divergence = prepared.lidar.divergence;
  const auto insert = [&](const SimulationSettings& how) {
    Simulated result;
    return draw_in_lidar(prepared, placed, how, result);
  };
  const auto narrow = ranges(insert(thin)), cone = ranges(insert(wide));
  double sum = 0, largest = 0;
  std::size_t both = 0;
  for (const auto& [place, range] : cone) {
    const auto other = narrow.find(place);
    if (other == narrow.end()) continue;
    ++both;
    const double error = std::abs(other->second - range);
    sum += error;
    largest = std::max(largest, error);
  }
  TradeoffPoint ray{"lidar", "beam", "one thin ray", {{"rays_a_beam", 1}}},
      rays{"lidar", "beam", "cone of 19 rays", {{"rays_a_beam", beam_pattern(wide.lidar_effects).size()}}};
  ray.errors = {{"range_error_m", both > 0 ? sum / static_cast<double>(both) : 0},
                {"range_max_m", largest},
                {"disagreements", static_cast<double>(cone.size() + narrow.size() - 2 * both) /
                                      std::max<double>(1, static_cast<double>(cone.size()))}};
  rays.errors = {{"range_error_m", 0}, {"range_max_m", 0}, {"disagreements", 0}};
  time_beside(
      rays, repeats, [&] { insert(thin); }, [&] { insert(wide); });
  ray.ms = ray.baseline_ms = rays.baseline_ms;
  return {ray, rays};
}

}  // namespace

std::vector<TradeoffPoint> lidar_study(const PreparedFrame& prepared, const TexturedMesh& placed,
                                       const SimulationSettings& settings, int repeats) {
  const Study study(prepared, placed, settings);
  if (study.hits() < kFewest) return {};
  std::vector<TradeoffPoint> all = {
      study.measure("arithmetic", "Embree's float range", Arithmetic::embree, 1, repeats),
      study.measure("arithmetic", "Embree's face, range in double", Arithmetic::face, 1, repeats),
      study.measure("arithmetic", "every face in double", Arithmetic::plain, 1, repeats)};
  for (std::size_t stride : {1, 2, 4, 8})
    all.push_back(study.measure("rays",
                                stride == 1   ? "every ray"
                                : stride == 2 ? "every 2nd ray"
                                              : "every " + std::to_string(stride) + "th ray",
                                Arithmetic::face, stride, repeats));
  if (!prepared.lidar.divergence.isZero(0))
    for (TradeoffPoint& figures : beams(prepared, placed, settings, repeats))
      all.push_back(std::move(figures));
  return all;
}

}  // namespace mirage
