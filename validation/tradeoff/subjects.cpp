#include "validation/tradeoff/subjects.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "attack/adversary.h"
#include "base/error.h"
#include "base/sizes.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

constexpr std::array<double, 4> kRegion = {0, 70, -40, 40};  // m, of the hosts: ahead, left
constexpr double kInView = 0.7;                              // share of the object that a host leaves in view

/// `values` with `own` among them, rising.
std::vector<double> with(std::vector<double> values, double own) {
  if (std::find(values.begin(), values.end(), own) == values.end()) values.push_back(own);
  std::sort(values.begin(), values.end());
  return values;
}

std::string grid_label(const SimulationSettings& s) {
  if (s.exact_coverage) return "exact areas";
  return fmt::format("σ {:g}, γ {:g}, cut-off {:g}, {}×{} samples", s.raster.sigma, s.raster.gamma,
                     s.raster.dist_eps, s.supersampling, s.supersampling);
}

}  // namespace

Subjects choose_subjects(const TradeoffSettings& settings, const Run* run, FrameStore& store) {
  Subjects subjects;
  subjects.adversary = run ? run->adversary : random_adversary(settings.seed);
  std::vector<HostId> all;
  if (run) {
    all = run->test;
    all.insert(all.end(), run->train.begin(), run->train.end());
    all = evenly(all, as_size(4 * settings.hosts));
  } else {
    const auto frames = evenly(list_frames(settings.source.data), as_size(settings.frames));
    check_labels(settings.source.data, frames, "a trade-off");
    for (const Host& host : find_all_hosts(store, frames, kRegion, {}, kInView)) all.push_back(host.id);
  }
  if (all.empty())
    throw InputError(
        settings.source.data.string(), "label_2",
        fmt::format("no car with {:.0f} % of the object in view in the frames looked at", 100 * kInView),
        "give --frames 0 or another data set");
  const auto distance = [&](const HostId& id) {
    const auto frame_handle = store.get(id.frame);
    const BevBox& box = label_of(frame_handle->frame, id).box.bev;
    return horizontal_distance(box);
  };
  std::stable_sort(all.begin(), all.end(),
                   [&](const HostId& a, const HostId& b) { return distance(a) < distance(b); });
  subjects.hosts = evenly(all, as_size(settings.hosts));
  return subjects;
}

SimulationSettings hard_render(SimulationSettings settings, int samples, bool in_double) {
  settings.raster.coverage = Coverage::hard;
  settings.raster.color = ColorBlend::hard;
  settings.raster.silhouette = SilhouetteBlend::hard;
  settings.raster.sigma = 1e-12;  // bounds the window only
  settings.supersampling = samples;
  settings.reference = in_double;
  settings.exact_coverage = false;
  return settings;
}

std::vector<CameraVariant> axis_variants(const SimulationSettings& baseline) {
  std::vector<CameraVariant> all;
  const auto add = [&](const char* axis, std::string label, const auto& change) {
    CameraVariant variant{axis, std::move(label), baseline};
    change(variant);
    all.push_back(std::move(variant));
  };
  for (double sigma : with({1e-9, 1e-8, 1e-7, 2e-6, 1e-5, 1e-4}, baseline.raster.sigma))
    add("sigma", fmt::format("σ {:g}", sigma), [&](auto& v) { v.simulation.raster.sigma = sigma; });
  for (double gamma : with({1e-4, 1e-3, 3e-3, 3e-2, 1e-1}, baseline.raster.gamma))
    add("gamma", fmt::format("γ {:g}", gamma), [&](auto& v) { v.simulation.raster.gamma = gamma; });
  for (double eps : with({1e-6, 1e-3, 1e-2, 1e-1}, baseline.raster.dist_eps))
    add("cut_off", fmt::format("cut-off {:g}", eps), [&](auto& v) { v.simulation.raster.dist_eps = eps; });
  for (int samples : {1, 2, 3, 4, 6, 8})
    add("samples", fmt::format("{}×{} samples", samples, samples),
        [&](auto& v) { v.simulation.supersampling = samples; });
  add("edges", "soft", [](auto&) {});
  for (int samples : {1, 2, 4})
    add("edges", fmt::format("hard, {}×{} samples", samples, samples),
        [&](auto& v) { v.simulation = hard_render(baseline, samples, false); });
  add("edges", "exact areas", [](auto& v) { v.simulation.exact_coverage = true; });
  for (int shrink : {1, 2, 4})
    add("image_scale", shrink == 1 ? "whole size" : fmt::format("1/{} size", shrink),
        [&](auto& v) { v.shrink = shrink; });
  for (bool in_double : {false, true})
    add("arithmetic", in_double ? "double, plain loop" : "float, vectorised",
        [&](auto& v) { v.simulation.reference = in_double; });
  for (const Quality& quality : qualities())
    add("quality", quality.name, [&](auto& v) { apply_quality(quality.name, v.simulation); });
  return all;
}

std::vector<CameraVariant> grid_variants(const SimulationSettings& baseline) {
  std::vector<CameraVariant> all;
  const auto add = [&](const SimulationSettings& simulation) {
    if (simulation.reference) return;
    const CameraVariant variant{"grid", grid_label(simulation), simulation};
    if (std::ranges::find(all, settings_json(variant), settings_json) == all.end()) all.push_back(variant);
  };
  for (double sigma : with({1e-8, 3e-8, 1e-7, 2e-6}, baseline.raster.sigma))
    for (double gamma : with({1e-3, 3e-3, 3e-2}, baseline.raster.gamma))
      for (double eps : with({1e-2}, baseline.raster.dist_eps))
        for (int samples : {1, 2, 3, 4, 6, 8}) {
          SimulationSettings simulation = baseline;
          simulation.raster.sigma = sigma;
          simulation.raster.gamma = gamma;
          simulation.raster.dist_eps = eps;
          simulation.supersampling = samples;
          add(simulation);
        }
  add(baseline);
  for (const Quality& quality : qualities()) {
    SimulationSettings simulation = baseline;
    apply_quality(quality.name, simulation);
    add(simulation);
  }
  return all;
}

nlohmann::json settings_json(const CameraVariant& variant) {
  const SimulationSettings& s = variant.simulation;
  return {{"sigma", s.raster.sigma},
          {"gamma", s.raster.gamma},
          {"dist_eps", s.raster.dist_eps},
          {"supersampling", s.supersampling},
          {"hard", s.raster.coverage == Coverage::hard},
          {"double", s.reference},
          {"exact_coverage", s.exact_coverage},
          {"image_scale", 1.0 / variant.shrink}};
}

}  // namespace mirage
