// Rays of one pencil against Embree's packets: the rays of a light on an object, those of one direction
// together, in alternation within one run.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <vector>

#include "base/random.h"
#include "bench.h"
#include "geometry/shapes.h"
#include "sensors/ray_caster.h"
#include "sensors/ray_pencil.h"

namespace mirage {
namespace {

constexpr int kRounds = 21, kDirections = 32;
constexpr std::size_t kRays = 250;  // along each direction

/// With an icosphere's faces, crumpled.
void compare(int subdivisions) {
  RandomStream random(1, "bench pencil");
  Mesh mesh = icosphere(subdivisions);
  for (Vec3d& v : mesh.vertices) v *= random.uniform(0.3, 1);
  std::vector<Vec3f> directions, starts;
  for (int k = 0; k < kDirections; ++k)
    directions.push_back(Vec3f(static_cast<float>(random.uniform(-1, 1)),
                               static_cast<float>(random.uniform(-1, 1)),
                               static_cast<float>(random.uniform(-1, 1))));
  for (std::size_t i = 0; i < kRays; ++i) {
    const Face& face = mesh.faces[i * mesh.faces.size() / kRays];
    const auto corner = [&](int k) { return mesh.vertices[static_cast<std::size_t>(face[k])]; };
    starts.push_back(((corner(0) + corner(1) + corner(2)) * (1.0001 / 3)).cast<float>());
  }
  std::vector<double> embree, pencil;
  for (int round = 0; round < kRounds; ++round) {
    embree.push_back(milliseconds([&] {
      const RayCaster caster(std::span(&mesh, 1));
      RayTable rays(1, kRays * kDirections);
      for (std::size_t i = 0; i < rays.columns; ++i) rays.set(0, i, starts[i % kRays], directions[i / kRays]);
      HitTable hits;
      caster.intersect(rays, 0, 1e30f, hits);
      benchmark::DoNotOptimize(hits.face.data());
    }));
    pencil.push_back(milliseconds([&] {
      RayPencil rays(mesh, Vec3d::Zero());
      std::vector<RayPencil::Met> met(kRays);
      for (const Vec3f& direction : directions) {
        rays.along(direction);
        rays.intersect(starts, met);
        benchmark::DoNotOptimize(met.data());
      }
    }));
  }
  const double per_ray = 1e6 / (static_cast<double>(kRays) * kDirections);
  extra_figures()[fmt::format("ray_pencil_{}_faces_ns", mesh.faces.size())] = per_ray * median(pencil);
  extra_figures()[fmt::format("embree_over_pencil_{}_faces", mesh.faces.size())] =
      median(embree) / median(pencil);
  std::printf("  %zu faces, %d directions of %zu rays: pencil %.0f ns a ray, Embree %.0f: %.1f times\n",
              mesh.faces.size(), kDirections, kRays, per_ray * median(pencil), per_ray * median(embree),
              median(embree) / median(pencil));
}

void ray_pencil(benchmark::State& state) {
  while (state.KeepRunning()) compare(static_cast<int>(state.range(0)));
}
BENCHMARK(ray_pencil)->Arg(2)->Arg(3)->Arg(4)->Iterations(1)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace mirage
