// The vehicle fit, by stage, over the cars within 30 m of a few generated streets. One thread.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <vector>

#include "base/files.h"
#include "bench.h"
#include "generator/street.h"
#include "scene/shape/shape_fit.h"
#include "sensors/lidar_sweep.h"

namespace mirage {
namespace {

constexpr int kStreets = 6;
constexpr double kFarthest = 30;  // m

double quantile(std::vector<double> values, double p) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0 : values[static_cast<std::size_t>(p * static_cast<double>(values.size() - 1))];
}

void fit(benchmark::State& state) {
  const LidarModel lidar = read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"));
  const ShapeModel model = read_shape_model(shipped_file("scenes/shapes/cars.shape"));
  std::vector<double> evidence_ms, fit_ms, mesh_ms, roof_ms, whole_ms;
  for (auto _ : state)
    for (int index = 0; index < kStreets; ++index) {
      const auto street = generator::make_street(12, static_cast<std::uint64_t>(index), lidar.height);
      const SweepIndex sweep(simulate_sweep(RayScene(street.surfaces), lidar, 1), lidar);
      for (const auto& thing : street.placed) {
        if (thing.type != "Car" || std::hypot(thing.box.bev.x, thing.box.bev.y) > kFarthest) continue;
        VehicleEvidence evidence;
        const double gather = milliseconds([&] { evidence = gather_evidence(sweep, thing.box); });
        ShapeFit fit;
        const double solve = milliseconds([&] { fit = fit_shape(model, evidence, thing.box); });
        if (!fit.fitted) continue;
        Mesh mesh;
        mesh_ms.push_back(milliseconds([&] { mesh = model.mesh(fit.shape); }));
        roof_ms.push_back(milliseconds([&] { benchmark::DoNotOptimize(roof_point(mesh)); }));
        evidence_ms.push_back(gather);
        fit_ms.push_back(solve);
        whole_ms.push_back(gather + solve);
      }
    }
  auto& figures = extra_figures();
  figures["fit_vehicles"] = whole_ms.size();
  figures["fit_ms"] = quantile(whole_ms, 0.5);
  figures["fit_ms_p95"] = quantile(whole_ms, 0.95);
  figures["fit_evidence_ms"] = quantile(evidence_ms, 0.5);
  figures["fit_marching_cubes_ms"] = quantile(mesh_ms, 0.5);
  figures["fit_roof_ms"] = quantile(roof_ms, 0.5);
  // What fit_shape takes besides its mesh and rooftop.
  figures["fit_solve_ms"] =
      std::max(0.0, quantile(fit_ms, 0.5) - quantile(mesh_ms, 0.5) - quantile(roof_ms, 0.5));
}

}  // namespace

void register_fit_benchmarks() {
  benchmark::RegisterBenchmark("fit", fit)->Iterations(1)->Unit(benchmark::kMillisecond);
}

}  // namespace mirage
