#include "sensors/lidar_sweep.h"

#include <algorithm>
#include <cmath>

#include "base/parallel.h"
#include "base/random.h"

namespace mirage {
namespace {

constexpr int kGlassLayers = 4;
constexpr float kGlassEcho = 0.25f;  // of the light that a pane does not pass, the share that comes back

constexpr double kGlossLoss = 0.15;  // share that a clear coat or a polished surface throws elsewhere

// Reflectance as an HDL-64E reports it, in hundredths: weak signals fade to 0, as recorded sweeps show for
// dark paint at any range and for the road beyond 30 m.
float reported(float reflectivity, double signal, const SweepNoise& noise, double deviation) {
  const double fade = 1 - std::exp(-signal / (2 * noise.signal_floor));
  const double value = std::min(1.f, reflectivity) * fade - noise.dark_level + deviation;
  return static_cast<float>(std::round(100 * std::clamp(value, 0.0, 0.99)) / 100);
}

}  // namespace

Sweep simulate_sweep(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                     const SweepNoise& noise) {
  const int columns = model.azimuth_count();
  std::vector<Sweep> beams(model.beams.size());

  parallel_for(beams.size(), [&](std::size_t b) {
    RandomStream random(seed, "lidar beam", b);
    const double bias = random.normal() * noise.beam_bias_sigma;
    for (int column = 0; column < columns; ++column) {
      // Every firing draws the same count of numbers, whatever it meets.
      const double da = random.normal() * noise.angle_sigma, de = random.normal() * noise.angle_sigma;
      const double dr = random.normal() * noise.range_sigma, di = random.normal() * noise.reflectance_sigma;
      const double lost = random.uniform(), weak = random.uniform();
      double pane = random.uniform();

      const LidarRay fired = model.ray(static_cast<int>(b), column);
      const Vec3d left = Vec3d(-fired.direction.y(), fired.direction.x(), 0).normalized();
      const Vec3d d = (fired.direction + da * left + de * fired.direction.cross(left)).normalized();
      Ray ray{fired.origin.cast<float>(), d.cast<float>(), static_cast<float>(model.range_min),
              static_cast<float>(model.range_max)};
      Hit hit;
      bool returned = false;
      for (int layer = 0; layer < kGlassLayers; ++layer) {
        hit = scene.caster.intersect(ray);
        if (!hit.hit()) break;
        const float through = scene.materials[hit.mesh].transparency;
        if (pane >= through) {
          returned = through == 0 || (pane - through) < (1 - through) * kGlassEcho;
          break;
        }
        // The same number, stretched back to [0, 1), decides at the next pane.
        if (through > 0) pane /= through;
        ray.t_min = hit.t + 1e-3f;
      }
      if (!returned || lost < noise.drop_out) continue;
      const float cosine = std::abs(hit.normal.normalized().dot(ray.direction));
      const Vec3f p0 = ray.origin + hit.t * ray.direction;
      Vec3f n = hit.normal.normalized();
      const Material& m = scene.materials[hit.mesh];
      // Near-infrared reflectivity follows the pattern's contrast, not its colour.
      float reflectivity = m.lidar;
      if (m.pattern != Pattern::plain) {
        const float mean = m.albedo.mean();
        if (mean > 0)
          reflectivity *= std::clamp(surface_albedo(m, p0, n, 0.02f * hit.t / 10).mean() / mean, 0.3f, 1.8f);
      }
      const double signal = reflectivity * std::pow(cosine, 0.7f) / (hit.t * hit.t);
      const double kept = (1 - std::exp(-signal / noise.signal_floor)) * (m.gloss > 0 ? 1 - kGlossLoss : 1);
      if (weak > kept) continue;
      const double range = hit.t + bias + dr;
      if (range < model.range_min || range > model.range_max) continue;
      const Vec3f p = ray.origin + static_cast<float>(range) * ray.direction;
      beams[b].push_back({p.x(), p.y(), p.z(), reported(reflectivity, signal, noise, di)});
    }
  });
  Sweep sweep;
  for (const Sweep& beam : beams) sweep.insert(sweep.end(), beam.begin(), beam.end());
  return sweep;
}

}  // namespace mirage
