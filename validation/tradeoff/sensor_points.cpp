#include "validation/tradeoff/sensor_points.h"

#include <algorithm>
#include <cmath>
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
#include "validation/tradeoff/lidar_study.h"
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

/// A point as its means over hosts, in whatever order they come.
class PointMean {
 public:
  explicit PointMean(TradeoffPoint point) : point_(std::move(point)) {}
  void add(const std::map<std::string, double>& errors, double ratio, double baseline_ms) {
    for (const auto& [name, value] : errors) point_.errors[name] += value;
    log_ratio_ += std::log(std::max(ratio, 1e-9));
    point_.baseline_ms += baseline_ms;
    ++count_;
  }
  TradeoffPoint point() const {
    const double n = std::max(1, count_);
    TradeoffPoint mean = point_;
    for (auto& [name, value] : mean.errors) value /= n;
    mean.ratio = std::exp(log_ratio_ / n);
    mean.baseline_ms /= n;
    mean.ms = mean.ratio * mean.baseline_ms;
    return mean;
  }

 private:
  TradeoffPoint point_;  ///< its errors and baseline_ms: sums
  double log_ratio_ = 0;
  int count_ = 0;
};

std::map<std::string, double> errors_of(const CameraFigures& f) {
  return {{"image_levels", f.image_levels},   {"image_mae", f.image_mae},
          {"image_max", f.image_max},         {"gradient_cosine", f.gradient_cosine},
          {"gradient_norm", f.gradient_norm}, {"gradient", 1 - f.gradient_cosine},
          {"double_cosine", f.double_cosine}, {"double_norm", f.double_norm},
          {"texel_cosine", f.texel_cosine},   {"texel_norm", f.texel_norm}};
}

std::map<std::string, double> errors_of(const LidarFigures& f) {
  std::map<std::string, double> errors = {
      {"range_error_m", f.range_error}, {"range_max_m", f.range_max}, {"disagreements", f.disagreements}};
  if (f.has_gradient) {
    errors["gradient_cosine"] = f.gradient_cosine;
    errors["gradient_norm"] = f.gradient_norm;
    errors["gradient"] = 1 - f.gradient_cosine;
  }
  return errors;
}

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
  CameraStudySettings how;
  how.seed = settings.seed;
  how.repeats = settings.repeats;
  how.reference_samples = settings.reference_samples;
  how.sharp_samples = settings.sharp_samples;
  how.directions = settings.directions;
  std::vector<CameraVariant> variants = axis_variants(how.baseline);
  if (settings.grid)
    for (CameraVariant& variant : grid_variants(how.baseline)) variants.push_back(std::move(variant));
  SensorPoints out;
  std::vector<PointMean> camera, lidar;
  for (const CameraVariant& v : variants)
    camera.emplace_back(TradeoffPoint{"camera", v.axis, v.label, settings_json(v), v.simulation});
  Progress progress("trade-off", subjects.hosts.size() * (variants.size() + 2), settings.quiet);
  std::size_t done = 0;
  for (const HostId& id : subjects.hosts) {
    const auto held = store.get(id.frame);
    const PreparedFrame& prepared = *held;
    const Placement placement = store.placement(id);
    const TexturedMesh placed = place(subjects.adversary, placement);
    const CameraStudy study(prepared, placement, placed, how),
        plain(prepared, placement, in_plain_faces(placed), how);
    const double n = static_cast<double>(subjects.hosts.size());
    out.reference.self_cosine += study.self_cosine() / n;
    out.reference.sharp.cosine += study.sharp_agreement().cosine / n;
    out.reference.sharp.norm += study.sharp_agreement().norm / n;
    out.reference.pixels.push_back(study.pixels());
    progress.update(++done, host_name(id));
    const OneThread bound;
    for (std::size_t i = 0; i < variants.size(); ++i) {
      throw_if_interrupted("a study writes nothing until it is done; run it again");
      const CameraFigures figures = study.measure(variants[i]);
      auto errors = errors_of(figures);
      if (variants[i].axis != "grid") {
        const CameraFigures in_plain = plain.measure(variants[i], false);
        errors["plain_faces_cosine"] = in_plain.gradient_cosine;
        errors["plain_faces_norm"] = in_plain.gradient_norm;
      }
      camera[i].add(errors, figures.ratio, figures.baseline_ms);
      progress.update(++done, host_name(id) + " " + variants[i].label);
    }
    const auto traced = lidar_study(prepared, placed, how.baseline, settings.repeats);
    for (std::size_t i = 0; i < traced.size(); ++i) {
      const LidarFigures& t = traced[i];
      if (i == lidar.size()) lidar.emplace_back(TradeoffPoint{"lidar", t.axis, t.label, t.settings});
      lidar[i].add(errors_of(t), t.ratio, t.baseline_ms);
    }
    progress.update(++done, host_name(id) + " LiDAR");
  }
  for (const auto* means : {&camera, &lidar})
    for (const PointMean& mean : *means) out.points.push_back(mean.point());
  return out;
}

}  // namespace mirage
