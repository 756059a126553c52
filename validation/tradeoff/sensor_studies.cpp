#include "validation/tradeoff/sensor_studies.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/error.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/sizes.h"
#include "scene/depth_completion.h"
#include "sensors/ray_caster.h"
#include "simulation/adversary_lidar.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/reference/host_scene.h"

namespace mirage {
namespace {

/// The double reference of the gradient: edges of a fifth of a KITTI pixel, which its samples resolve, and
/// depths told apart at 3 mm.
SimulationSettings sharp(SimulationSettings settings, int samples) {
  settings.raster.sigma = 1e-7;
  settings.raster.gamma = 1e-3;
  settings.raster.dist_eps = 1e-6;
  settings.supersampling = samples;
  settings.reference = true;
  settings.exact_coverage = false;
  return settings;
}

constexpr int kReach = 48;  // px around the object over which the upstream field is made

std::vector<double> flat(const std::vector<Vec3d>& values) {
  std::vector<double> out;
  out.reserve(3 * values.size());
  for (const Vec3d& v : values) out.insert(out.end(), v.data(), v.data() + 3);
  return out;
}

/// The camera's part of a frame at 1/factor: colours averaged, the nearest depth kept.
PreparedFrame shrink(const PreparedFrame& prepared, int factor) {
  PreparedFrame small;
  Calibration& calibration = small.frame.calibration = prepared.frame.calibration;
  small.frame.lighting = prepared.frame.lighting;
  PinholeCamera& camera = calibration.camera;
  const double half = (factor - 1) / 2.0;
  camera = {camera.fx / factor,          camera.fy / factor,    (camera.cx - half) / factor,
            (camera.cy - half) / factor, camera.width / factor, camera.height / factor};
  small.frame.image = ImageF(camera.width, camera.height, 3);
  small.depth = ImageF(camera.width, camera.height, 1, kFarDepth);
  const float share = 1.0f / static_cast<float>(factor * factor);
  for (int v = 0; v < camera.height * factor; ++v)
    for (int u = 0; u < camera.width * factor; ++u) {
      for (int c = 0; c < 3; ++c)
        small.frame.image.at(u / factor, v / factor, c) += share * prepared.frame.image.at(u, v, c);
      float& depth = small.depth.at(u / factor, v / factor);
      depth = std::min(depth, prepared.depth.at(u, v));
    }
  return small;
}

/// The place of pixel u of the whole picture between the small picture's pixels.
struct Between {
  int first, second;
  float share;  ///< of the second
};
Between between(int u, int factor, int size) {
  const double x = std::clamp((u - (factor - 1) / 2.0) / factor, 0.0, size - 1.0);
  const int first = std::min(static_cast<int>(x), size - 1);
  return {first, std::min(first + 1, size - 1), static_cast<float>(x - first)};
}

/// Calls visit(u, v, small u, small v, weight) for each of the four small pixels that a pixel of `rect` (of
/// the small picture, grown) shows.
template <class Visit>
void enlarge(const PixelRect& rect, int factor, int small_width, int small_height, int width, int height,
             const Visit& visit) {
  const int u0 = std::max(0, (rect.u0 - 1) * factor), u1 = std::min(width, (rect.u1 + 1) * factor);
  const int v0 = std::max(0, (rect.v0 - 1) * factor), v1 = std::min(height, (rect.v1 + 1) * factor);
  for (int v = v0; v < v1; ++v) {
    const Between y = between(v, factor, small_height);
    for (int u = u0; u < u1; ++u) {
      const Between x = between(u, factor, small_width);
      visit(u, v, x.first, y.first, (1 - x.share) * (1 - y.share));
      visit(u, v, x.second, y.first, x.share * (1 - y.share));
      visit(u, v, x.first, y.second, (1 - x.share) * y.share);
      visit(u, v, x.second, y.second, x.share * y.share);
    }
  }
}

constexpr int kMinCount = 8;  // hits that a host needs

enum class Arithmetic { embree, face, plain };

/// The hit of a ray.
struct Met {
  int face = -1;
  double range = 0;
  FaceReturn<double> hit;  ///< not with Arithmetic::embree
};

/// Ranges of two ways to trace, compared.
struct RangeErrors {
  double sum = 0, largest = 0;
  std::size_t both = 0;  ///< rays that hit in both

  void add(double own, double reference) {
    const double error = std::abs(own - reference);
    sum += error;
    largest = std::max(largest, error);
    ++both;
  }
  std::map<std::string, double> figures(double disagreements) const {
    return {{"range_error_m", both > 0 ? sum / static_cast<double>(both) : 0},
            {"range_max_m", largest},
            {"disagreements", disagreements}};
  }
};

class Study {
 public:
  Study(const PreparedFrame& prepared, const TexturedMesh& placed, const SimulationSettings& settings)
      : prepared_(prepared), placed_(placed), settings_(settings), box_(bounds(placed.mesh)) {
    sent_ = prepared.index.rays_through(box_.center(), box_.diagonal().norm() / 2);
    for (const Face& f : placed.mesh.faces) corners_.push_back(placed.mesh.corners(f));
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
      met[i].hit = intersect_face<double>(ray.origin, ray.direction, corners_[as_size(met[i].face)], 1);
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
    RangeErrors errors;
    int disagreed = 0;
    std::size_t at = 0;
    for (std::size_t i = 0; i < sent_.size(); ++i) {
      while (at + 1 < sampled.size() && sent_[sampled[at + 1]].beam == sent_[i].beam &&
             (sent_[sampled[at]].beam != sent_[i].beam ||
              distance(sampled[at + 1], i) < distance(sampled[at], i)))
        ++at;
      while (at + 1 < sampled.size() && sent_[sampled[at]].beam != sent_[i].beam) ++at;
      const bool here = met[at].face >= 0, there = reference_[i].face >= 0;
      if (here && there) errors.add(met[at].range, reference_[i].range);
      disagreed += here != there;
    }
    return errors.figures(static_cast<double>(disagreed) / hits_);
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
      const std::size_t f = as_size(met[i].face);
      const auto d_face =
          intersect_face_vjp<double>(d, corners_[f], met[i].hit, 1, settings_.grazing_cosine, weight * d, 0);
      for (std::size_t k = 0; k < 3; ++k)
        for (std::size_t c = 0; c < 3; ++c)
          d_vertices[3 * as_size(placed_.mesh.faces[f][k]) + c] += d_face[k][static_cast<Eigen::Index>(c)];
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
  RangeErrors errors;
  for (const auto& [place, range] : cone)
    if (const auto other = narrow.find(place); other != narrow.end()) errors.add(other->second, range);
  TradeoffPoint ray{"lidar", "beam", "one thin ray", {{"rays_a_beam", 1}}},
      rays{"lidar", "beam", "cone of 19 rays", {{"rays_a_beam", beam_pattern(wide.lidar_effects).size()}}};
  ray.errors = errors.figures(static_cast<double>(cone.size() + narrow.size() - 2 * errors.both) /
                              std::max<double>(1, static_cast<double>(cone.size())));
  rays.errors = RangeErrors().figures(0);
  time_beside(
      rays, repeats, [&] { insert(thin); }, [&] { insert(wide); });
  ray.ms = ray.baseline_ms = rays.baseline_ms;
  return {ray, rays};
}

}  // namespace

Agreement agreement(const std::vector<double>& own, const std::vector<double>& reference) {
  double dot = 0, a = 0, b = 0;
  for (std::size_t i = 0; i < own.size(); ++i) {
    dot += own[i] * reference[i];
    a += own[i] * own[i];
    b += reference[i] * reference[i];
  }
  if (!(a > 0) || !(b > 0)) return {};
  return {dot / std::sqrt(a * b), std::sqrt(a / b)};
}

CameraStudy::CameraStudy(const PreparedFrame& prepared, const Placement& placement, TexturedMesh placed,
                         const TradeoffSettings& settings)
    : prepared_(prepared), placement_(placement), placed_(std::move(placed)), settings_(settings) {
  half_ = shrink(prepared, 2);
  quarter_ = shrink(prepared, 4);
  Simulated reference;
  draw_in_camera(prepared_, placement_, placed_, hard_render(baseline_, settings.reference_samples, true),
                 reference);
  if (reference.rect.empty())
    throw InputError("tradeoff", "host", "does not show the object", "choose another vehicle");
  rect_ = grown(reference.rect, 1, prepared.frame.image);
  reference_ = crop(reference.image, rect_);
  make_mask(reference);
  make_upstream(reference.rect);

  RandomStream random(settings.seed, "trade-off directions");
  for (int k = 0; k < settings.directions; ++k) {
    std::vector<Vec3d> direction(placed_.mesh.vertices.size());
    for (Vec3d& d : direction)
      for (int c = 0; c < 3; ++c) d[c] = random.normal() / std::sqrt(3.0);
    directions_.push_back(std::move(direction));
  }
  differences_ = finite_differences(kStep);
  self_cosine_ = agreement(finite_differences(kStep / 2), differences_).cosine;
  sharp_ = draw(sharp(baseline_, settings.sharp_samples)).gradient;
  hard_ = draw(hard_render(baseline_, settings.reference_samples, false)).gradient;
  sharp_agreement_ = agreement(along_directions(sharp_.vertices), differences_);
}

std::vector<double> CameraStudy::along_directions(const std::vector<double>& gradient) const {
  std::vector<double> along;
  for (const auto& direction : directions_) {
    double sum = 0;
    for (std::size_t i = 0; i < direction.size(); ++i)
      for (int c = 0; c < 3; ++c) sum += gradient[3 * i + as_size(c)] * direction[i][c];
    along.push_back(sum);
  }
  return along;
}

const PreparedFrame& CameraStudy::shrunk(int factor) const {
  return factor == 1 ? prepared_ : factor == 2 ? half_ : quarter_;
}

void CameraStudy::make_upstream(const PixelRect& rect) {
  struct Wave {
    double x, y, phase, size;
  };
  RandomStream random(settings_.seed, "trade-off upstream");
  std::array<std::array<Wave, 6>, 3> waves;
  for (auto& channel : waves)
    for (Wave& wave : channel) {
      const double angle = random.uniform(0, 2 * std::numbers::pi);
      const double k = 2 * std::numbers::pi / random.uniform(6, 24);
      wave = {k * std::cos(angle), k * std::sin(angle), random.uniform(0, 2 * std::numbers::pi),
              random.normal()};
    }
  const ImageF& photograph = prepared_.frame.image;
  upstream_ = ImageF(photograph.width, photograph.height, 3);
  for (int v = std::max(0, rect.v0 - kReach); v < std::min(photograph.height, rect.v1 + kReach); ++v)
    for (int u = std::max(0, rect.u0 - kReach); u < std::min(photograph.width, rect.u1 + kReach); ++u)
      for (int c = 0; c < 3; ++c) {
        double sum = 0;
        for (const Wave& wave : waves[as_size(c)])
          sum += wave.size * std::cos(wave.x * u + wave.y * v + wave.phase);
        upstream_.at(u, v, c) = static_cast<float>(sum);
      }
}

void CameraStudy::make_mask(const Simulated& reference) {
  mask_ = ImageF(rect_.width(), rect_.height(), 1);
  const PixelRect& rect = reference.rect;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u) {
      if (!(reference.rgba.at(u - rect.u0, v - rect.v0, 3) > 0)) continue;
      ++pixels_;
      for (int y = std::max(rect_.v0, v - 1); y <= std::min(rect_.v1 - 1, v + 1); ++y)
        for (int x = std::max(rect_.u0, u - 1); x <= std::min(rect_.u1 - 1, u + 1); ++x)
          mask_.at(x - rect_.u0, y - rect_.v0) = 1;
    }
}

CameraStudy::Drawing CameraStudy::draw(const SimulationSettings& simulation, int shrink) const {
  const PreparedFrame& prepared = shrunk(shrink);
  const bool small = shrink != 1;
  Simulated result;
  const CameraTape tape = draw_in_camera(prepared, placement_, placed_, simulation, result);
  Drawing drawing;
  const ImageF& photograph = prepared.frame.image;
  if (small) {
    drawing.image = prepared_.frame.image;
    enlarge(result.rect, shrink, photograph.width, photograph.height, drawing.image.width,
            drawing.image.height, [&](int u, int v, int x, int y, float weight) {
              for (int c = 0; c < 3; ++c)
                drawing.image.at(u, v, c) += weight * (result.image.at(x, y, c) - photograph.at(x, y, c));
            });
  } else {
    drawing.image = std::move(result.image);
  }
  std::vector<Vec3d> d_vertices(placed_.mesh.vertices.size(), Vec3d::Zero()),
      d_texels(placed_.atlas.texels.size(), Vec3d::Zero());
  ImageF d_small;
  if (small) {
    d_small = ImageF(photograph.width, photograph.height, 3);
    enlarge(result.rect, shrink, photograph.width, photograph.height, upstream_.width, upstream_.height,
            [&](int u, int v, int x, int y, float weight) {
              for (int c = 0; c < 3; ++c) d_small.at(x, y, c) += weight * upstream_.at(u, v, c);
            });
  }
  draw_in_camera_vjp(tape, placed_, prepared.frame.calibration, result, (small ? d_small : upstream_).data,
                     d_vertices, d_texels);
  drawing.gradient = {flat(d_vertices), flat(d_texels)};
  return drawing;
}

double CameraStudy::loss(const SimulationSettings& simulation, const TexturedMesh& placed) const {
  Simulated result;
  draw_in_camera(prepared_, placement_, placed, simulation, result);
  const PixelRect& rect = result.rect;
  double sum = 0;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      for (int c = 0; c < 3; ++c)
        sum += upstream_.at(u, v, c) * (std::clamp(result.rgba.at(u - rect.u0, v - rect.v0, c), 0.0, 1.0) -
                                        prepared_.frame.image.at(u, v, c));
  return sum;
}

std::vector<double> CameraStudy::finite_differences(double step) const {
  const SimulationSettings hard = hard_render(baseline_, settings_.reference_samples, false);
  std::vector<double> differences(directions_.size());
  parallel_for(directions_.size(), [&](std::size_t k) {
    const auto at = [&](double move) {
      TexturedMesh moved = placed_;
      for (std::size_t i = 0; i < moved.mesh.vertices.size(); ++i)
        moved.mesh.vertices[i] += move * directions_[k][i];
      return loss(hard, moved);
    };
    differences[k] = (at(step) - at(-step)) / (2 * step);
  });
  return differences;
}

std::map<std::string, double> CameraStudy::errors(const CameraVariant& variant) const {
  const Drawing drawing = draw(variant.simulation, variant.shrink);
  const ImageF own = crop(drawing.image, rect_);
  const Agreement differences = agreement(along_directions(drawing.gradient.vertices), differences_),
                  sharply = agreement(drawing.gradient.vertices, sharp_.vertices),
                  texels = agreement(drawing.gradient.texels, hard_.texels);
  return {{"image_levels", 255 * mean_absolute_error(encoded(own), encoded(reference_), mask_)},
          {"image_mae", mean_absolute_error(own, reference_, mask_)},
          {"image_max", max_absolute_error(own, reference_, mask_)},
          {"gradient_cosine", differences.cosine},
          {"gradient_norm", differences.norm},
          {"gradient", 1 - differences.cosine},
          {"double_cosine", sharply.cosine},
          {"double_norm", sharply.norm},
          {"texel_cosine", texels.cosine},
          {"texel_norm", texels.norm}};
}

void CameraStudy::time(const CameraVariant& variant, TradeoffPoint& point) const {
  constexpr double kLong = 200;  // ms
  time_beside(
      point, settings_.repeats, [&] { draw(baseline_); }, [&] { draw(variant.simulation, variant.shrink); },
      kLong);
}

std::vector<TradeoffPoint> lidar_study(const PreparedFrame& prepared, const TexturedMesh& placed,
                                       const SimulationSettings& settings, int repeats) {
  const Study study(prepared, placed, settings);
  if (study.hits() < kMinCount) return {};
  std::vector<TradeoffPoint> all = {
      study.measure("arithmetic", "Embree's float range", Arithmetic::embree, 1, repeats),
      study.measure("arithmetic", "Embree's face, range in double", Arithmetic::face, 1, repeats),
      study.measure("arithmetic", "every face in double", Arithmetic::plain, 1, repeats)};
  for (const std::size_t stride : {1u, 2u, 4u, 8u})
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
