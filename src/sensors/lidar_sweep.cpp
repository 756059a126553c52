#include "sensors/lidar_sweep.h"

#include <algorithm>
#include <cmath>

#include "base/parallel.h"
#include "base/random.h"
#include "base/sizes.h"

namespace mirage {
namespace {

constexpr int kGlassLayers = 4;
constexpr float kGlassEcho = 0.25f;  // share returned of the light that a pane does not pass

constexpr double kGlossLoss = 0.15;  // share that a clear coat or a polished surface reflects away

/// Random draws of a firing, independent of its target.
struct Draw {
  FiringChance chance;
  double reflectance = 0, pane = 0;
};

/// Reflectance as a unit reports it: weak signals fade to 0, as in recorded sweeps for dark paint at any
/// range and for the road beyond 30 m.
float reported(float reflectivity, double signal, const LidarEffects& effects, double deviation) {
  const double fade = effects.signal_floor > 0 ? 1 - std::exp(-signal / (2 * effects.signal_floor)) : 1;
  const double value = std::min(1.f, reflectivity) * fade - effects.dark_level + deviation;
  if (effects.reflectance_step > 0) {
    const double steps = std::round(1 / effects.reflectance_step);
    return static_cast<float>(std::round(steps * std::clamp(value, 0.0, 1 - effects.reflectance_step)) /
                              steps);
  }
  return static_cast<float>(std::clamp(value, 0.0, 1.0));
}

/// The return of a ray before the sensor's own noise.
struct Return {
  float range = 0;
  float reflectivity = 0;
  double signal = 0;  ///< reflectivity · cos^0.7 / range²
  bool glossy = false;
  int object = -1;
};

class SweepSimulator {
 public:
  SweepSimulator(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                 const LidarEffects& effects, const UnitMotion* motion)
      : parts_{{&scene}},
        model_(model),
        seed_(seed),
        effects_(effects),
        motion_(motion),
        pattern_(beam_pattern(effects)),
        columns_(as_size(model.azimuth_count())),
        rays_(model.beams.size() * pattern_.size(), columns_),
        axis_(model.beams.size(), columns_),
        draws_(model.beams.size() * columns_),
        bias_(model.beams.size()) {
    if (motion_) parts_.insert(parts_.end(), motion_->parts.begin(), motion_->parts.end());
    hits_.resize(parts_.size());
  }

  Firings run() {
    parallel_for(model_.beams.size(), [&](std::size_t beam) { fire(beam); });
    for (std::size_t part = 0; part < parts_.size(); ++part)
      parts_[part].scene->caster.intersect(part == 0 ? rays_ : rays_of(parts_[part]),
                                           static_cast<float>(model_.range_min),
                                           static_cast<float>(model_.range_max), hits_[part]);
    firings_.points.resize(model_.beams.size() * columns_);
    firings_.ranges.assign(firings_.points.size(), 0);
    firings_.objects.assign(firings_.points.size(), -1);
    parallel_for(model_.beams.size(), [&](std::size_t beam) { receive(beam); });
    return std::move(firings_);
  }

 private:
  /// The hit of one ray, and its part.
  struct Met {
    float t = -1;
    int mesh = -1, face = -1;
    std::size_t part = 0;
  };

  double time_of(std::size_t beam, std::size_t column) const {
    return model_.firing_time(static_cast<int>(beam), model_.firing_azimuth(static_cast<int>(column)));
  }
  /// A ray's origin relative to a moved part, as if the part had stayed.
  Vec3f started(const SweptPart& part, const Vec3f& origin, std::size_t row, std::size_t column) const {
    if (part.velocity.isZero(0)) return origin;
    return origin - (time_of(row / pattern_.size(), column) * part.velocity).cast<float>();
  }
  RayTable rays_of(const SweptPart& part) const {
    RayTable rays = rays_;
    parallel_for(rays.rows, [&](std::size_t row) {
      for (std::size_t column = 0; column < columns_; ++column) {
        const std::size_t i = rays.index(row, column);
        rays.set(row, column, started(part, rays_.origin_at(i), row, column), rays_.direction_at(i));
      }
    });
    return rays;
  }
  Met first_hit(std::size_t i) const {
    Met met;
    for (std::size_t part = 0; part < parts_.size(); ++part)
      if (hits_[part].mesh[i] >= 0 && (met.mesh < 0 || hits_[part].t[i] < met.t))
        met = {hits_[part].t[i], hits_[part].mesh[i], hits_[part].face[i], part};
    return met;
  }
  Met next_hit(const Ray& ray, std::size_t row, std::size_t column) const {
    Met met;
    for (std::size_t part = 0; part < parts_.size(); ++part) {
      Ray from = ray;
      from.origin = started(parts_[part], ray.origin, row, column);
      const Hit hit = parts_[part].scene->caster.intersect(from);
      if (hit.hit() && (met.mesh < 0 || hit.t < met.t)) met = {hit.t, hit.mesh, hit.face, part};
    }
    return met;
  }

  void fire(std::size_t beam) {
    RandomStream random(seed_, "lidar beam", beam);
    bias_[beam] = random.normal() * effects_.beam_bias_sigma;
    for (std::size_t column = 0; column < columns_; ++column) {
      Draw& draw = draws_[beam * columns_ + column];
      const double da = random.normal() * effects_.angle_sigma, de = random.normal() * effects_.angle_sigma;
      draw.chance.range_error = random.normal() * effects_.range_sigma;
      draw.reflectance = random.normal() * effects_.reflectance_sigma;
      draw.chance.lost = random.uniform(), draw.chance.weak = random.uniform();
      draw.pane = random.uniform();
      const double azimuth = model_.firing_azimuth(static_cast<int>(column));
      const LidarRay fired = model_.ray_at(static_cast<int>(beam), azimuth);
      const Vec3d d = turned(fired.direction, Vec2d(da, de));
      Transform pose = Transform::Identity(), believed = pose;
      if (motion_) {
        LidarEffects way;
        way.velocity = motion_->velocity, way.yaw_rate = motion_->yaw_rate;
        believed = start_from_moment(way, time_of(beam, column));
        pose = motion_->scene_from_velo * believed;
      } else if (effects_.moving()) {
        pose = start_from_moment(effects_, time_of(beam, column));
      }
      axis_.set(beam, column, (believed * fired.origin).cast<float>(), (believed.linear() * d).cast<float>());
      for (std::size_t k = 0; k < pattern_.size(); ++k) {
        const Vec3d sub = k == 0 ? d : turned(d, pattern_[k].angle);
        rays_.set(beam * pattern_.size() + k, column, (pose * fired.origin).cast<float>(),
                  (pose.linear() * sub).cast<float>());
      }
    }
  }

  /// Follows a ray through glass to the surface that returns its light; false if there is none.
  bool follow(std::size_t row, std::size_t column, double pane, Return& result) const {
    const std::size_t i = rays_.index(row, column);
    Ray ray{rays_.origin_at(i), rays_.direction_at(i), 0, static_cast<float>(model_.range_max)};
    Met met = first_hit(i);
    bool returned = false;
    for (int panes = 0; panes < kGlassLayers && met.mesh >= 0;) {
      const float through = parts_[met.part].scene->materials[as_size(met.mesh)].transparency;
      if (pane >= through) {
        returned = through == 0 || (pane - through) < (1 - through) * kGlassEcho;
        break;
      }
      panes += through < 1;  // otherwise only the camera sees it
      // The same number, stretched back to [0, 1), decides at the next pane.
      if (through > 0) pane /= through;
      ray.t_min = met.t + 1e-3f;
      met = next_hit(ray, row, column);
    }
    if (!returned) return false;
    const RayScene& scene = *parts_[met.part].scene;
    const auto mesh = as_size(met.mesh);
    const float t = met.t;
    ray.origin = started(parts_[met.part], ray.origin, row, column);
    const Vec3f n = scene.caster.normal(met.mesh, met.face).normalized();
    const float cosine = std::abs(n.dot(ray.direction));
    const Vec3f p0 = ray.origin + t * ray.direction;
    const Material& m = scene.materials[mesh];
    result.range = t;
    result.object = scene.objects[mesh];
    result.glossy = m.gloss > 0;
    if (effects_.albedo) {
      result.reflectivity = std::min(1.f, surface_albedo(m, p0, n, 0.02f * t / 10).mean());
    } else {
      // Near-infrared reflectivity follows the pattern's contrast, not its colour.
      result.reflectivity = m.lidar;
      if (m.pattern != Pattern::plain && !m.veiled) {
        const float mean = m.albedo.mean();
        if (mean > 0)
          result.reflectivity *=
              std::clamp(surface_albedo(m, p0, n, 0.02f * t / 10).mean() / mean, 0.3f, 1.8f);
      }
    }
    result.signal = returned_signal(result.reflectivity, cosine, t);
    if (effects_.albedo) result.reflectivity *= cosine;
    return true;
  }

  /// The beam's return: that of its one ray, or the strongest echo of its cone.
  bool gather(std::size_t beam, std::size_t column, double pane, Return& result) const {
    const std::size_t count = pattern_.size();
    if (count == 1) return follow(beam, column, pane, result);
    std::vector<Return> parts;
    std::vector<Reflection> reflections;
    std::vector<double> weights;
    for (std::size_t k = 0; k < count; ++k) {
      Return part;
      if (!follow(beam * count + k, column, pane, part)) continue;
      parts.push_back(part);
      weights.push_back(pattern_[k].weight);
      reflections.push_back({part.range, pattern_[k].weight * part.signal});
    }
    Echo echo;
    strongest_echo(reflections, effects_.pulse_length, echo);
    if (echo.strongest < 0) return false;
    result = parts[as_size(echo.strongest)];
    result.signal = 0;
    float reflectivity = 0;
    for (int i : echo.members) {
      const auto at = as_size(i);
      reflectivity += static_cast<float>(weights[at]) * parts[at].reflectivity;
      result.signal += reflections[at].strength;
    }
    result.reflectivity = reflectivity;
    return true;
  }

  void receive(std::size_t beam) {
    for (std::size_t column = 0; column < columns_; ++column) {
      const std::size_t place = beam * columns_ + column;
      const Draw& draw = draws_[place];
      Return back;
      if (!gather(beam, column, draw.pane, back)) continue;
      double arrives = arrival_probability(back.signal, effects_);
      if (effects_.signal_floor > 0 && back.glossy) arrives *= 1 - kGlossLoss;
      const auto range = reported_range(back.range + bias_[beam], arrives, draw.chance, effects_,
                                        model_.range_min, model_.range_max);
      if (!range) continue;
      const std::size_t i = axis_.index(beam, column);
      const Vec3f p = axis_.origin_at(i) + static_cast<float>(*range) * axis_.direction_at(i);
      firings_.points[place] = {p.x(), p.y(), p.z(),
                                reported(back.reflectivity, back.signal, effects_, draw.reflectance)};
      firings_.ranges[place] = *range;
      firings_.objects[place] = back.object;
    }
  }

  std::vector<SweptPart> parts_;  ///< the static scene first
  const LidarModel& model_;
  std::uint64_t seed_;
  const LidarEffects& effects_;
  const UnitMotion* motion_;
  std::vector<SubRay> pattern_;
  std::size_t columns_;
  RayTable rays_;               ///< a row a ray of the cone, as traced
  RayTable axis_;               ///< a row a beam, as the unit assumes
  std::vector<HitTable> hits_;  ///< one a part
  std::vector<Draw> draws_;
  std::vector<double> bias_;
  Firings firings_;
};

}  // namespace

LidarEffects generated_sweep_effects() {
  LidarEffects effects = parse_lidar_effects("noise,drop-out", Vec2d::Zero());
  effects.beam_bias_sigma = 0.008;
  effects.angle_sigma = 2.5e-4;
  effects.reflectance_sigma = 0.03;
  effects.dark_level = 0.06;
  effects.reflectance_step = 0.01;
  return effects;
}

Firings simulate_firings(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                         const LidarEffects& effects, const UnitMotion* motion) {
  check_effects(effects);
  return SweepSimulator(scene, model, seed, effects, motion).run();
}

Sweep simulate_sweep(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                     const LidarEffects& effects, std::vector<int>* objects, const UnitMotion* motion) {
  const Firings firings = simulate_firings(scene, model, seed, effects, motion);
  Sweep sweep;
  if (objects) objects->clear();
  for (std::size_t i = 0; i < firings.points.size(); ++i) {
    if (!(firings.ranges[i] > 0)) continue;
    sweep.push_back(firings.points[i]);
    if (objects) objects->push_back(firings.objects[i]);
  }
  return sweep;
}

}  // namespace mirage
