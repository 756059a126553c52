#include "validation/tradeoff/depth_points.h"

#include <algorithm>
#include <memory>

#include "base/error.h"
#include "base/logging.h"
#include "base/progress.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "simulation/depth_score.h"
#include "validation/tradeoff/one_thread.h"

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

}  // namespace mirage
