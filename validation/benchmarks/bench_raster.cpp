// The soft rasteriser: forward and VJP of the adversary's start in a 1242 × 375 picture, one core.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "base/parallel.h"
#include "base/random.h"
#include "bench.h"
#include "geometry/mesh.h"
#include "sensors/exact_coverage.h"
#include "sensors/projection.h"
#include "sensors/raster_batch.h"

namespace mirage {
namespace {

constexpr int kRasterRounds = 41;
const PinholeCamera kCamera{721, 721, 609, 172, 1242, 375};

/// A ball of 20 · 4^subdivisions faces in the adversary's box, `distance` ahead, coloured at random.
struct Scene {
  ScreenMesh<double> mesh;
  SoftRasterSettings<double> settings;
  RasterTarget<float> target;
  ImageF upstream;

  /// rough: up to which share of its radius a vertex is moved in as well.
  Scene(int subdivisions, double distance, double sigma, int supersampling = 1, double rough = 0) {
    RandomStream random(1, "raster benchmark");
    const Mesh shape = icosphere(subdivisions);
    std::vector<Vec3d> p_camera;
    for (const Vec3d& v : shape.vertices)
      p_camera.push_back(random.uniform(.8 - rough, 1) * Vec3d(.8 * v.x(), -.5 * v.z(), .8 * v.y()) +
                         Vec3d(0, -.5, distance));
    std::vector<Vec3d> texels(shape.faces.size() * 25);
    for (Vec3d& t : texels) t = Vec3d{random.uniform(), random.uniform(), random.uniform()};
    mesh = project_mesh(p_camera, shape.faces, kCamera, .1, Texture::atlas, 5, texels).screen;
    settings.sigma = sigma;
    settings.near = distance - 1.5;
    settings.far = distance + 1.5;
    window({0, 0, kCamera.width, kCamera.height}, supersampling);
  }
  void window(const PixelRect& clip, int supersampling) {
    target.width = kCamera.width;
    target.height = kCamera.height;
    target.supersampling = supersampling;
    target.rect = touched_pixels(mesh, settings, kCamera.width, kCamera.height, clip);
    resize();
  }
  void resize() {
    target.background = ImageF(target.rect.width(), target.rect.height(), 3, .4f);
    upstream = ImageF(target.rect.width(), target.rect.height(), 4, .3f);
  }
};

/// "forward", "backward" and "both", ms.
Rounds fast(const std::vector<Scene>& scenes) {
  std::vector<RasterJob> jobs;
  std::vector<ImageF> upstream;
  for (const Scene& s : scenes) {
    jobs.push_back({&s.mesh, &s.settings, &s.target});
    upstream.push_back(s.upstream);
  }
  std::vector<RasterTape> tapes(scenes.size());
  std::vector<ScreenGradient<double>> gradients(scenes.size());
  Rounds rounds;
  for (int round = 0; round < kRasterRounds; ++round) {
    const double forward = rounds.time("forward", [&] { rasterize_batch(jobs, tapes); });
    rounds.add("both", forward + rounds.time("backward",
                                             [&] { rasterize_batch_vjp(jobs, upstream, tapes, gradients); }));
  }
  return rounds;
}

double plain(const Scene& s, int count) {
  const auto target = to_double(s.target);
  const auto upstream = to_double(s.upstream);
  Rounds rounds;
  for (int round = 0; round < count; ++round)
    rounds.time("", [&] {
      benchmark::DoNotOptimize(rasterize(s.mesh, s.settings, target));
      benchmark::DoNotOptimize(rasterize_vjp(s.mesh, s.settings, target, upstream));
    });
  return rounds[""];
}

/// (sample, face) pairs within the cut-off: the work that the definition asks for.
long pairs(const Scene& s) {
  const double cut = cut_off(s.settings);
  long count = 0;
  for (int v = s.target.rect.v0; v < s.target.rect.v1; ++v)
    for (int u = s.target.rect.u0; u < s.target.rect.u1; ++u) {
      const Vec2d p = ndc_from_pixel<double>(u, v, s.target.width, s.target.height);
      for (const auto& face : s.mesh.faces) {
        double nearest = cut, side[3];
        for (std::size_t k = 0; k < 3; ++k) {
          const Vec2d a = face[k].head<2>(), e = face[(k + 1) % 3].head<2>() - a, d = p - a;
          nearest = std::min(nearest, (d - std::clamp(d.dot(e) / e.squaredNorm(), 0., 1.) * e).squaredNorm());
          side[k] = e.x() * d.y() - e.y() * d.x();
        }
        const bool inside = (side[0] >= 0) == (side[1] >= 0) && (side[1] >= 0) == (side[2] >= 0);
        count += inside || nearest < cut;
      }
    }
  return count;
}

#if defined(__x86_64__)
// Peak of fused multiply-adds in registers: 12 independent chains of the widest vectors there are.
template <class V>
[[gnu::always_inline]] inline float multiply_adds(long rounds) {
  V x[12];
  for (int i = 0; i < 12; ++i) x[i] = V{} + (0.5f + 0.01f * static_cast<float>(i));
  const V a = x[0] * 0 + 0.999f, b = x[0] * 0 + 0.001f;
  for (long round = 0; round < rounds; ++round)
    for (int i = 0; i < 12; ++i) x[i] = x[i] * a + b;
  float sum = 0;
  for (int i = 0; i < 12; ++i) sum += x[i][0];
  return sum;
}
using Wide = float __attribute__((vector_size(64)));
using Half = float __attribute__((vector_size(32)));
using Quarter = float __attribute__((vector_size(16)));
[[gnu::target("avx512f")]] float peak_512(long rounds) {
  return multiply_adds<Wide>(rounds);
}
[[gnu::target("avx2,fma")]] float peak_256(long rounds) {
  return multiply_adds<Half>(rounds);
}
float peak_128(long rounds) {
  return multiply_adds<Quarter>(rounds);
}

double peak_gflops() {
  constexpr long rounds = 2'000'000;
  const bool has_512 = __builtin_cpu_supports("avx512f"), has_256 = __builtin_cpu_supports("fma");
  Rounds times;
  for (int i = 0; i < 9; ++i)
    times.time("", [&] {
      benchmark::DoNotOptimize(has_512 ? peak_512(rounds) : has_256 ? peak_256(rounds) : peak_128(rounds));
    });
  const double lanes = has_512 ? 16 : has_256 ? 8 : 4;
  return 2 * 12 * lanes * rounds / times[""] / 1e6;
}
#else
double peak_gflops() {
  return 0;
}
#endif

// Floating-point operations a pair in src/sensors/raster (a multiply-add counts two, a comparison or
// selection one): forward and backward of a pair that has weight.
constexpr double kOperations = 154 + 266;

void softras_by_distance(benchmark::State& state) {
  const double peak = peak_gflops();
  figures()["peak_gflops_one_core"] = peak;
  for (auto _ : state)
    for (const double distance : {5., 10., 20., 40.})
      for (const auto& [name, sigma, samples] :
           {std::tuple{"1e-5", 1e-5, 1}, {"1e-4", 1e-4, 1}, {"5e-7", 5e-7, 1}, {"5e-7_2x2", 5e-7, 2}}) {
        std::vector<Scene> scenes;
        scenes.emplace_back(2, distance, sigma, samples);
        const Rounds times = fast(scenes);
        const std::string at = fmt::format("{:.0f}m_sigma_{}", distance, name);
        figures()["softras_ms_" + at] = times["both"];
        figures()["softras_forward_ms_" + at] = times["forward"];
        if (samples > 1) continue;
        const long count = pairs(scenes[0]);
        figures()["softras_pairs_" + at] = count;
        if (distance == 10)
          figures()["softras_share_of_peak_" + at] =
              kOperations * static_cast<double>(count) / times["both"] / 1e6 / peak;
      }
}
ONCE(BENCHMARK(softras_by_distance));

/// Exact areas and the default's soft edges, in alternation, CPU time of one thread; `rough`: a mesh whose
/// faces hide and cross each other, as learned ones do.
void exact_coverage(benchmark::State& state) {
  for (auto _ : state)
    for (const double rough : {0., .5})
      for (const double distance : {5., 10., 20., 40.}) {
        const Scene soft(2, distance, 5e-7, 2, rough), hard(2, distance, 1e-12, 1, rough);
        const RasterJob job{&soft.mesh, &soft.settings, &soft.target};
        const Image<double> upstream = to_double(hard.upstream);
        RasterTape soft_tape;
        ScreenGradient<double> gradient;
        ExactTape tape;
        Rounds rounds;
        for (int round = 0; round < kRasterRounds; ++round) {
          double exact =
              rounds.cpu("exact_coverage_forward_ms_", [&] { draw_exact(hard.mesh, hard.target, tape); });
          exact += cpu_ms(
              [&] { benchmark::DoNotOptimize(draw_exact_vjp(hard.mesh, hard.target, upstream, tape)); });
          const double standard = cpu_ms([&] {
            rasterize_batch({&job, 1}, {&soft_tape, 1});
            rasterize_batch_vjp({&job, 1}, {&soft.upstream, 1}, {&soft_tape, 1}, {&gradient, 1});
          });
          rounds.add("exact_coverage_ms_", exact);
          rounds.add("exact_coverage_over_default_", exact / standard);
        }
        rounds.record(fmt::format("{:.0f}m{}", distance, rough > 0 ? "_crumpled" : ""));
      }
}
ONCE(BENCHMARK(exact_coverage));

void softras_by_faces(benchmark::State& state) {
  for (auto _ : state)
    for (const int subdivisions : {2, 3, 4})
      for (const auto& [name, sigma] : {std::pair{"1e-5", 1e-5}, {"1e-4", 1e-4}}) {
        std::vector<Scene> scenes;
        scenes.emplace_back(subdivisions, 10., sigma);
        figures()[fmt::format("softras_ms_{}_faces_sigma_{}", scenes[0].mesh.faces.size(), name)] =
            fast(scenes)["both"];
      }
}
ONCE(BENCHMARK(softras_by_faces));

void softras_against_plain_loop(benchmark::State& state) {
  for (auto _ : state)
    for (const auto& [name, sigma] : {std::pair{"1e-5", 1e-5}, {"1e-4", 1e-4}}) {
      std::vector<Scene> scenes;
      scenes.emplace_back(2, 10., sigma);
      const double ours = fast(scenes)["both"], window = plain(scenes[0], 3);
      Scene whole = scenes[0];
      whole.target.rect = {0, 0, kCamera.width, kCamera.height};
      whole.resize();
      const double all = plain(whole, 1);
      figures()[fmt::format("softras_plain_loop_ms_sigma_{}", name)] = all;
      figures()[fmt::format("softras_speedup_over_plain_loop_sigma_{}", name)] = all / ours;
      figures()[fmt::format("softras_speedup_over_plain_loop_in_window_sigma_{}", name)] = window / ours;
      if (sigma == 1e-5) figures()["softras_speedup_over_plain_loop"] = all / ours;
    }
}
ONCE(BENCHMARK(softras_against_plain_loop));

void softras_by_threads(benchmark::State& state) {
  std::vector<Scene> batch;
  for (int i = 0; i < 16; ++i) batch.emplace_back(2, 6. + 2 * i, 1e-5);
  for (auto _ : state) {
    Rounds rounds;
    for (int round = 0; round < 3; ++round)
      for (const int threads : {2, 1}) {
        set_thread_count(threads);
        rounds.add(threads == 1 ? "one" : "two", fast(batch)["both"]);
      }
    figures()["softras_batch16_ms"] = rounds["one"];
    figures()["softras_two_threads_speedup"] = rounds["one"] / rounds["two"];
  }
}
ONCE(BENCHMARK(softras_by_threads));

}  // namespace
}  // namespace mirage
