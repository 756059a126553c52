#include "validation/tradeoff/detector_study.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "attack/attack_step.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "detection/precision.h"
#include "validation/thread_clock.h"
#include "validation/tradeoff/camera_study.h"

namespace mirage {
namespace {

constexpr std::array<double, 4> kLocalities = {1, 2, 4, 8};  // m

struct PassVariant {
  std::string axis, label;
  DetectorOptions options;
};

std::vector<PassVariant> pass_variants(DetectorOptions options) {
  options.threads = 1;
  options.precision = kFloat;
  options.locality = 0;
  std::vector<PassVariant> list = {{"passes", "what the object changes", options}};
  const auto add = [&](const char* axis, std::string label, const auto& change) {
    list.push_back({axis, std::move(label), options});
    change(list.back().options);
  };
  add("passes", "the whole frame", [](DetectorOptions& o) { o.clean_memory_mb = 0; });
  if (multiplies_bfloat16()) add("precision", kBfloat16, [](DetectorOptions& o) { o.precision = kBfloat16; });
  for (const double metres : kLocalities)
    add("locality", fmt::format("{:g} m", metres), [&](DetectorOptions& o) { o.locality = metres; });
  return list;
}

std::vector<double> flat(const AdversaryGradient& gradient) {
  std::vector<double> values;
  for (const auto* list : {&gradient.vertices, &gradient.texels})
    for (const Vec3d& v : *list) values.insert(values.end(), {v.x(), v.y(), v.z()});
  return values;
}

}  // namespace

std::vector<TradeoffPoint> detector_points(const DetectorOptions& options, const std::vector<StepHost>& hosts,
                                           const TexturedMesh& adversary, int repeats) {
  const AttackSettings settings;
  const auto step = [&](Detector& detector, const StepHost& at) {
    return attack_host(detector, at, adversary, settings);
  };
  const auto variants = pass_variants(options);
  std::vector<std::vector<double>> references;
  {
    DetectorOptions slow = variants.front().options;
    slow.precision = kDouble;
    slow.clean_memory_mb = 0;
    const auto detector = load_detector(slow);
    for (const StepHost& at : hosts) references.push_back(flat(step(*detector, at).gradient));
  }
  const auto baseline = load_detector(variants.front().options);
  std::vector<TradeoffPoint> points;
  for (const PassVariant& variant : variants) {
    throw_if_interrupted("a study writes nothing until it is done; run it again");
    const auto detector = load_detector(variant.options);
    TradeoffPoint point{"detector",
                        variant.axis,
                        variant.label,
                        {{"detector", options.detector},
                         {"precision", variant.options.precision},
                         {"locality", variant.options.locality},
                         {"clean_memory_mb", variant.options.clean_memory_mb}}};
    double n = 0, cosine = 0, norm = 0, least = 1, log_ratio = 0, baseline_ms = 0;
    for (std::size_t h = 0; h < hosts.size(); ++h) {
      std::vector<double> own, theirs, ratios;
      HostStep taken = step(*detector, hosts[h]);  // and keeps the clean frame
      step(*baseline, hosts[h]);
      for (int k = 0; k < repeats; ++k) {
        theirs.push_back(cpu_ms([&] { step(*baseline, hosts[h]); }));
        own.push_back(cpu_ms([&] { taken = step(*detector, hosts[h]); }));
        ratios.push_back(own.back() / theirs.back());
      }
      const Agreement with = agreement(flat(taken.gradient), references[h]);
      if (std::all_of(references[h].begin(), references[h].end(), [](double d) { return d == 0; })) continue;
      cosine += with.cosine, norm += with.norm;
      least = std::min(least, with.cosine);
      log_ratio += std::log(std::max(median_of(ratios), 1e-9));
      baseline_ms += median_of(theirs);
      ++n;
    }
    if (n == 0) {
      spdlog::warn("the detector's passes are left out: no host has a gradient");
      return {};
    }
    point.ratio = std::exp(log_ratio / n);
    point.baseline_ms = baseline_ms / n;
    point.ms = point.ratio * point.baseline_ms;
    point.errors = {{"gradient_cosine", cosine / n},
                    {"gradient_norm", norm / n},
                    {"gradient", 1 - cosine / n},
                    {"gradient_cosine_least", least}};
    points.push_back(std::move(point));
  }
  return points;
}

}  // namespace mirage
