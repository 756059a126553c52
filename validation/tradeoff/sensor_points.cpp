#include "validation/tradeoff/sensor_points.h"

#include <algorithm>
#include <map>
#include <memory>

#include "base/error.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/progress.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "simulation/depth_score.h"
#include "validation/tradeoff/subjects.h"

namespace mirage {

DepthPoints depth_points(const TradeoffSettings& settings, const TexturedMesh& adversary) {
  if (settings.depth_frames == 0) return {};
  std::vector<std::unique_ptr<DepthCompletion>> backends;
  for (const char* name : {"ip-basic", "ip-basic-bilateral", "ip-basic-multiscale",
                           "ip-basic-multiscale-bilateral", "ip-basic-extrapolated", "guided"}) {
    try {
      DepthOptions options;
      options.backend = name;
      backends.push_back(load_depth_completion(options));
    } catch (const InputError& error) {
      spdlog::warn("depth completion {} is left out: {}", name, error.what());
    }
  }
  DepthScoreOptions options;
  options.data = settings.source.data;
  options.frames = static_cast<std::size_t>(settings.depth_frames);
  options.seed = settings.seed;
  auto ids = list_frames(settings.source.data);
  if (ids.size() > options.frames) ids.resize(options.frames);
  const bool truth = std::all_of(ids.begin(), ids.end(), [&](const std::string& id) {
    return std::filesystem::exists(true_depth_file(settings.source.data, id));
  });
  options.hidden = truth ? 0 : 0.2;
  DepthPoints out{{}, truth ? "true depth" : "a fifth of the returns, held back"};
  Progress progress("depth completion", ids.size(), settings.quiet);
  const OneThread bound;
  const auto scores = score_depth(options, backends, adversary,
                                  [&](std::size_t done, std::size_t) { progress.update(done); });
  for (const DepthScore& score : scores) {
    TradeoffPoint point{"depth", "back_end", score.name, {{"depth", score.name}}};
    point.ms = 1e3 * score.seconds;
    point.baseline_ms = 1e3 * scores.front().seconds;
    point.ratio = point.ms / point.baseline_ms;
    const DepthErrors& e = truth ? score.common : score.consistent;
    point.errors = {{"rmse_mm", e.rmse}, {"mae_mm", e.mae}, {"coverage", score.coverage}};
    if (truth && score.roof.pixels > 0) {
      const double pixels = static_cast<double>(score.roof.pixels);
      point.errors["wrongly_kept"] = static_cast<double>(score.roof.wrongly_kept) / pixels;
      point.errors["wrongly_dropped"] = static_cast<double>(score.roof.wrongly_dropped) / pixels;
    }
    out.points.push_back(std::move(point));
  }
  return out;
}

namespace {

/// Every face in the mean of its colours: what the gradient would be without a texture that moves.
TexturedMesh in_plain_faces(TexturedMesh textured) {
  const std::size_t texels = textured.atlas.per_face();
  for (auto first = textured.atlas.texels.begin(); first != textured.atlas.texels.end();) {
    const auto end = first + static_cast<std::ptrdiff_t>(texels);
    Vec3d sum = Vec3d::Zero();
    for (auto t = first; t != end; ++t) sum += *t;
    std::fill(first, end, Vec3d(sum / static_cast<double>(texels)));
    first = end;
  }
  return textured;
}

}  // namespace

SensorPoints sensor_points(const TradeoffSettings& settings, const Subjects& subjects, FrameStore& store) {
  const SimulationSettings baseline;
  std::vector<CameraVariant> variants = axis_variants(baseline);
  if (settings.grid)
    for (CameraVariant& variant : grid_variants(baseline)) variants.push_back(std::move(variant));
  SensorPoints out;
  std::vector<std::vector<TradeoffPoint>> camera(variants.size()), lidar;  // by setting and host
  Progress progress("trade-off", subjects.hosts.size() * (variants.size() + 2), settings.quiet);
  std::size_t done = 0;
  for (const HostId& id : subjects.hosts) {
    const auto held = store.get(id.frame);
    const PreparedFrame& prepared = *held;
    const Placement placement = store.placement(id);
    const TexturedMesh placed = place(subjects.adversary, placement);
    const CameraStudy study(prepared, placement, placed, settings),
        plain(prepared, placement, in_plain_faces(placed), settings);
    const double n = static_cast<double>(subjects.hosts.size());
    out.reference.self_cosine += study.self_cosine() / n;
    out.reference.sharp.cosine += study.sharp_agreement().cosine / n;
    out.reference.sharp.norm += study.sharp_agreement().norm / n;
    out.reference.pixels.push_back(study.pixels());
    progress.update(++done, host_name(id));
    const OneThread bound;
    for (std::size_t i = 0; i < variants.size(); ++i) {
      throw_if_interrupted("a study writes nothing until it is done; run it again");
      const CameraVariant& v = variants[i];
      TradeoffPoint point{"camera", v.axis, v.label, settings_json(v), v.simulation};
      point.errors = study.errors(v);
      if (v.axis != "grid") {
        const auto in_plain = plain.errors(v);
        point.errors["plain_faces_cosine"] = in_plain.at("gradient_cosine");
        point.errors["plain_faces_norm"] = in_plain.at("gradient_norm");
      }
      study.time(v, point);
      camera[i].push_back(std::move(point));
      progress.update(++done, host_name(id) + " " + v.label);
    }
    std::vector<TradeoffPoint> traced = lidar_study(prepared, placed, baseline, settings.repeats);
    lidar.resize(std::max(lidar.size(), traced.size()));
    for (std::size_t i = 0; i < traced.size(); ++i) lidar[i].push_back(std::move(traced[i]));
    progress.update(++done, host_name(id) + " LiDAR");
  }
  for (const auto* settings_of : {&camera, &lidar})
    for (const std::vector<TradeoffPoint>& hosts : *settings_of) out.points.push_back(mean_over(hosts));
  return out;
}

}  // namespace mirage
