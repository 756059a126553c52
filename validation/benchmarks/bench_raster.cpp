// The soft rasteriser: forward and VJP of the adversary's start in a 1242 × 375 picture, one core.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "attack/adversary.h"
#include "base/parallel.h"
#include "base/random.h"
#include "bench.h"
#include "geometry/shapes.h"
#include "sensors/exact_coverage.h"
#include "sensors/projection.h"
#include "sensors/raster_batch.h"
#include "validation/thread_clock.h"

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
    for (Vec3d& t : texels) t = Vec3d(random.uniform(), random.uniform(), random.uniform());
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

struct Times {
  double forward = 0, backward = 0, both = 0;  ///< medians, ms
};

Times fast(const std::vector<Scene>& scenes) {
  std::vector<RasterJob> jobs;
  std::vector<ImageF> upstream;
  for (const Scene& s : scenes) {
    jobs.push_back({&s.mesh, &s.settings, &s.target});
    upstream.push_back(s.upstream);
  }
  std::vector<RasterTape> tapes(scenes.size());
  std::vector<ScreenGradient<double>> gradients(scenes.size());
  std::vector<double> forward, backward, both;
  for (int round = 0; round < kRasterRounds; ++round) {
    forward.push_back(milliseconds([&] { rasterize_batch(jobs, tapes); }));
    backward.push_back(milliseconds([&] { rasterize_batch_vjp(jobs, upstream, tapes, gradients); }));
    both.push_back(forward.back() + backward.back());
  }
  return {median(forward), median(backward), median(both)};
}

double plain(const Scene& s, int rounds) {
  const auto target = to_double(s.target);
  const auto upstream = to_double(s.upstream);
  std::vector<double> times;
  for (int round = 0; round < rounds; ++round)
    times.push_back(milliseconds([&] {
      benchmark::DoNotOptimize(rasterize(s.mesh, s.settings, target));
      benchmark::DoNotOptimize(rasterize_vjp(s.mesh, s.settings, target, upstream));
    }));
  return median(times);
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
        for (int k = 0; k < 3; ++k) {
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
  for (int i = 0; i < 12; ++i)
    for (std::size_t lane = 0; lane < sizeof(V) / 4; ++lane) x[i][lane] = 0.5f + 0.01f * float(i);
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
  std::vector<double> times;
  for (int i = 0; i < 9; ++i)
    times.push_back(milliseconds([&] {
      benchmark::DoNotOptimize(has_512 ? peak_512(rounds) : has_256 ? peak_256(rounds) : peak_128(rounds));
    }));
  const double lanes = has_512 ? 16 : has_256 ? 8 : 4;
  return 2 * 12 * lanes * rounds / median(times) / 1e6;
}
#else
double peak_gflops() {
  return 0;
}
#endif

// Floating-point operations a pair in src/sensors/raster (a multiply-add counts two, a comparison or
// selection one): forward and backward of a pair that has weight.
constexpr double kOperations = 150 + 290;

void by_distance(benchmark::State& state) {
  nlohmann::json& figures = extra_figures();
  const double peak = peak_gflops();
  figures["peak_gflops_one_core"] = peak;
  for (auto _ : state)
    for (const double distance : {5., 10., 20., 40.})
      for (const auto& [name, sigma, samples] :
           {std::tuple{"1e-5", 1e-5, 1}, {"1e-4", 1e-4, 1}, {"5e-7", 5e-7, 1}, {"5e-7_2x2", 5e-7, 2}}) {
        std::vector<Scene> scenes;
        scenes.emplace_back(2, distance, sigma, samples);
        const Times t = fast(scenes);
        const std::string at = fmt::format("{:.0f}m_sigma_{}", distance, name);
        figures["softras_ms_" + at] = t.both;
        figures["softras_forward_ms_" + at] = t.forward;
        const long count = samples == 1 ? pairs(scenes[0]) : 0;
        if (samples == 1) figures["softras_pairs_" + at] = count;
        const double gflops = kOperations * static_cast<double>(count) / t.both / 1e6;
        if (distance == 10 && samples == 1) figures["softras_share_of_peak_" + at] = gflops / peak;
        std::printf("  320 faces %4.0f m  sigma %-9s forward %.3f  backward %.3f  both %.3f ms", distance,
                    name, t.forward, t.backward, t.both);
        if (samples == 1)
          std::printf("   %7ld pairs, %.1f ns each, %.0f GFLOP/s of %.0f", count,
                      1e6 * t.both / static_cast<double>(count), gflops, peak);
        std::printf("\n");
      }
}

/// Exact areas and the default's soft edges, in alternation, CPU time of one thread; `rough`: a mesh whose
/// faces hide and cross each other, as learned ones do.
void exact_coverage(benchmark::State& state) {
  nlohmann::json& figures = extra_figures();
  for (auto _ : state)
    for (const double rough : {0., .5})
      for (const double distance : {5., 10., 20., 40.}) {
        const Scene soft(2, distance, 5e-7, 2, rough), hard(2, distance, 1e-12, 1, rough);
        const RasterJob job{&soft.mesh, &soft.settings, &soft.target};
        const Image<double> upstream = to_double(hard.upstream);
        RasterTape soft_tape;
        ScreenGradient<double> gradient;
        ExactTape tape;
        std::vector<double> forward, both, standard, ratio;
        for (int round = 0; round < kRasterRounds; ++round) {
          forward.push_back(cpu_ms([&] { draw_exact(hard.mesh, hard.target, tape); }));
          both.push_back(forward.back() + cpu_ms([&] {
                           benchmark::DoNotOptimize(draw_exact_vjp(hard.mesh, hard.target, upstream, tape));
                         }));
          standard.push_back(cpu_ms([&] {
            rasterize_batch({&job, 1}, {&soft_tape, 1});
            rasterize_batch_vjp({&job, 1}, {&soft.upstream, 1}, {&soft_tape, 1}, {&gradient, 1});
          }));
          ratio.push_back(both.back() / standard.back());
        }
        const std::string at = fmt::format("{:.0f}m{}", distance, rough > 0 ? "_crumpled" : "");
        figures["exact_coverage_ms_" + at] = median(both);
        figures["exact_coverage_forward_ms_" + at] = median(forward);
        figures["exact_coverage_over_default_" + at] = median(ratio);
        std::printf("  exact areas, %-8s %4.0f m: forward %.3f  both %.3f ms; default %.3f ms, ratio %.2f\n",
                    rough > 0 ? "crumpled" : "smooth", distance, median(forward), median(both),
                    median(standard), median(ratio));
      }
}

void by_faces(benchmark::State& state) {
  for (auto _ : state)
    for (const int subdivisions : {2, 3, 4})
      for (const auto& [name, sigma] : {std::pair{"1e-5", 1e-5}, {"1e-4", 1e-4}}) {
        std::vector<Scene> scenes;
        scenes.emplace_back(subdivisions, 10., sigma);
        const Times t = fast(scenes);
        const auto faces = scenes[0].mesh.faces.size();
        extra_figures()[fmt::format("softras_ms_{}_faces_sigma_{}", faces, name)] = t.both;
        std::printf("  %4zu faces 10 m  sigma %s  forward %.3f  both %.3f ms\n", faces, name, t.forward,
                    t.both);
      }
}

void against_plain_loop(benchmark::State& state) {
  for (auto _ : state)
    for (const auto& [name, sigma] : {std::pair{"1e-5", 1e-5}, {"1e-4", 1e-4}}) {
      std::vector<Scene> scenes;
      scenes.emplace_back(2, 10., sigma);
      const double ours = fast(scenes).both, window = plain(scenes[0], 3);
      Scene whole = scenes[0];
      whole.target.rect = {0, 0, kCamera.width, kCamera.height};
      whole.resize();
      const double all = plain(whole, 1);
      nlohmann::json& figures = extra_figures();
      figures[fmt::format("softras_plain_loop_ms_sigma_{}", name)] = all;
      figures[fmt::format("softras_speedup_over_plain_loop_sigma_{}", name)] = all / ours;
      figures[fmt::format("softras_speedup_over_plain_loop_in_window_sigma_{}", name)] = window / ours;
      if (sigma == 1e-5) figures["softras_speedup_over_plain_loop"] = all / ours;
      std::printf(
          "  sigma %s: %.3f ms; plain loop over image %.0f ms (%.0f times), over the window %.1f ms (%.0f "
          "times)\n",
          name, ours, all, all / ours, window, window / ours);
    }
}

void by_threads(benchmark::State& state) {
  std::vector<Scene> batch;
  for (int i = 0; i < 16; ++i) batch.emplace_back(2, 6. + 2 * i, 1e-5);
  for (auto _ : state) {
    std::vector<double> one_thread, two_threads;
    for (int round = 0; round < 3; ++round) {
      set_thread_count(1);
      one_thread.push_back(fast(batch).both);
      set_thread_count(2);
      two_threads.push_back(fast(batch).both);
    }
    set_thread_count(1);
    extra_figures()["softras_batch16_ms"] = median(one_thread);
    extra_figures()["softras_two_threads_speedup"] = median(one_thread) / median(two_threads);
    std::printf("  batch of 16: %.2f ms on one thread, %.2f on two: %.2f times faster\n", median(one_thread),
                median(two_threads), median(one_thread) / median(two_threads));
  }
}

}  // namespace

void register_raster_benchmarks() {
  std::printf("instruction set: %s\n", raster_instruction_set());
  for (const auto& [name, work] :
       {std::pair{"softras_by_distance", &by_distance}, std::pair{"exact_coverage", &exact_coverage},
        std::pair{"softras_by_faces", &by_faces},
        std::pair{"softras_against_plain_loop", &against_plain_loop},
        std::pair{"softras_by_threads", &by_threads}})
    benchmark::RegisterBenchmark(name, work)->Unit(benchmark::kMillisecond)->Iterations(1);
}

}  // namespace mirage
