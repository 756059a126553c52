#include "simulation/depth_score.h"

#include <fmt/format.h>

#include <algorithm>
#include <opencv2/imgproc.hpp>

#include "base/error.h"
#include "base/fields.h"
#include "base/image.h"
#include "base/random.h"
#include "base/schedule.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

using Mask = Image<std::uint8_t>;

/// Pixels of held-back returns that no nearer kept return in the neighbourhood contradicts.
Mask consistent_pixels(const ImageF& withheld, const ImageF& remaining) {
  constexpr int kNearBand = 3;      // pixels
  constexpr double kClearBy = 1.0;  // m
  Mask fine(withheld.width, withheld.height, 1);
  for (int v = 0; v < withheld.height; ++v)
    for (int u = 0; u < withheld.width; ++u) {
      if (!(withheld.at(u, v) > 0)) continue;
      bool contradicted = false;
      for (int y = std::max(0, v - kNearBand); y <= std::min(withheld.height - 1, v + kNearBand); ++y)
        for (int x = std::max(0, u - kNearBand); x <= std::min(withheld.width - 1, u + kNearBand); ++x)
          contradicted |= remaining.at(x, y) > 0 && remaining.at(x, y) < withheld.at(u, v) - kClearBy;
      fine.at(u, v) = !contradicted;
    }
  return fine;
}

/// Pixels without depth within `reach` pixels of one with depth.
Mask skyline(const ImageF& truth, int reach) {
  cv::Mat present(truth.height, truth.width, CV_8U), wide;
  for (int v = 0; v < truth.height; ++v)
    for (int u = 0; u < truth.width; ++u) present.at<std::uint8_t>(v, u) = truth.at(u, v) > 0;
  cv::dilate(present, wide, cv::Mat::ones(2 * reach + 1, 2 * reach + 1, CV_8U));
  Mask line(truth.width, truth.height, 1);
  for (int v = 0; v < truth.height; ++v)
    for (int u = 0; u < truth.width; ++u)
      line.at(u, v) = wide.at<std::uint8_t>(v, u) && !present.at<std::uint8_t>(v, u);
  return line;
}

/// Mask of the whole picture: 1 where the object shows (S > 1/2) with this depth image.
Mask shown(PreparedFrame& prepared, const ImageF& depth, const Placement& roof,
           const TexturedMesh& adversary) {
  prepared.depth = depth;
  const Simulated simulated = simulate(prepared, roof, adversary);
  Mask mask(depth.width, depth.height, 1);
  const PixelRect& rect = simulated.rect;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      mask.at(u, v) = simulated.rgba.at(u - rect.u0, v - rect.v0, 3) > 0.5;
  return mask;
}

void check_roofs(const Frame& frame, const ImageF& truth, const std::vector<ImageF>& dense, int border,
                 const TexturedMesh& adversary, std::vector<DepthScore>& scores) {
  PreparedFrame prepared;
  prepared.frame = frame;
  ImageF far_truth = truth;
  for (float& depth : far_truth.data)
    if (!(depth > 0)) depth = kFarDepth;
  const ImageF nothing(truth.width, truth.height, 1, kFarDepth);
  const Mask line = skyline(truth, border);
  for (const Label& label : frame.labels) {
    if (label.type != "Car" || !has_box(label)) continue;
    const Placement roof = on_roof(BoxRoofFinder().find(frame, label));
    const Mask whole = shown(prepared, nothing, roof, adversary);
    if (std::none_of(whole.data.begin(), whole.data.end(), [](auto x) { return x; })) continue;
    const Mask right = shown(prepared, far_truth, roof, adversary);
    for (std::size_t b = 0; b < dense.size(); ++b) {
      const Mask mask = shown(prepared, dense[b], roof, adversary);
      for (std::size_t i = 0; i < whole.data.size(); ++i) {
        if (!whole.data[i]) continue;
        scores[b].roof.add(mask.data[i], right.data[i]);
        if (!(truth.data[i] > 0)) scores[b].sky.add(mask.data[i], right.data[i]);
        if (line.data[i]) scores[b].border.add(mask.data[i], right.data[i]);
      }
    }
  }
}

}  // namespace

void RoofPixels::add(bool kept, bool rightly_kept) {
  ++pixels;
  wrongly_kept += kept && !rightly_kept;
  wrongly_dropped += !kept && rightly_kept;
}

void withhold(const Sweep& sweep, double share, std::uint64_t seed, const std::string& id, Sweep& remaining,
              Sweep& withheld) {
  RandomStream random(seed, "held-back returns", fnv1a(id));
  for (const LidarPoint& point : sweep) (random.uniform() < share ? withheld : remaining).push_back(point);
}

std::vector<DepthScore> score_depth(const DepthScoreOptions& options,
                                    std::span<const std::unique_ptr<DepthCompletion>> backends,
                                    const TexturedMesh& adversary,
                                    const std::function<void(std::size_t, std::size_t)>& progress) {
  if (options.hidden < 0 || options.hidden >= 1)
    throw FieldError("hide", "", "must be a share in [0, 1)", "try 0.2");
  const std::vector<std::string> ids = list_frames(options.data, options.frames);
  const std::size_t n = backends.size();
  std::vector<DepthScore> scores(n);
  std::vector<MeanDepthErrors> common(n), filled(n), consistent(n);
  std::vector<std::size_t> covered(n), sky_filled(n);
  std::size_t scored = 0, sky = 0;
  for (std::size_t f = 0; f < ids.size(); ++f) {
    throw_if_interrupted("nothing was written: scores come at the end");
    const Frame frame = read_frame(options.data, ids[f]);
    Sweep remaining, withheld;
    withhold(frame.sweep, options.hidden, options.seed, ids[f], remaining, withheld);
    const ImageF sparse = sparse_depth(remaining, frame.calibration);
    const bool by_returns = options.hidden > 0;
    const auto file = true_depth_file(options.data, ids[f]);
    if (!by_returns && !std::filesystem::exists(file))
      throw InputError(file.string(), "", "missing (the frame's true depth)",
                       "make the set with mirage generate --depth, or hold returns back with --hide 0.2");
    const ImageF truth = by_returns ? sparse_depth(withheld, frame.calibration) : read_depth_png(file);
    if (truth.data.size() != sparse.data.size())
      throw InputError(file.string(), "size", "differs from the picture's", "make the data set anew");

    std::vector<ImageF> dense;
    for (std::size_t b = 0; b < n; ++b) {
      const Clock::time_point start = Clock::now();
      dense.push_back(backends[b]->complete(frame.image, sparse));
      scores[b].seconds += seconds_since(start);
    }
    Mask everywhere(truth.width, truth.height, 1, 1);
    for (std::size_t i = 0; i < truth.data.size(); ++i) {
      const bool counts = truth.data[i] > 0 && truth.data[i] <= options.farthest;
      const bool empty = !by_returns && !(truth.data[i] > 0);
      scored += counts;
      sky += empty;
      for (std::size_t b = 0; b < n; ++b) {
        const bool value = dense[b].data[i] < kFarDepth;
        covered[b] += counts && value;
        sky_filled[b] += empty && value;
        everywhere.data[i] &= value;
      }
    }
    Mask fine;
    if (by_returns) {
      fine = consistent_pixels(truth, sparse);
      for (std::size_t i = 0; i < fine.data.size(); ++i) fine.data[i] &= everywhere.data[i];
    }
    for (std::size_t b = 0; b < n; ++b) {
      common[b].add(depth_errors(truth, dense[b], options.farthest, everywhere));
      filled[b].add(depth_errors(truth, fill_as_benchmark(dense[b]), options.farthest));
      if (by_returns) consistent[b].add(depth_errors(truth, dense[b], options.farthest, fine));
    }
    if (!by_returns) check_roofs(frame, truth, dense, options.border, adversary, scores);
    progress(f + 1, ids.size());
  }
  if (scored == 0)
    throw InputError(options.data.string(), "depth",
                     fmt::format("no pixel has a depth to score on, up to {:g} m", options.farthest),
                     "raise --farthest, or hold more returns back with --hide");
  for (std::size_t b = 0; b < n; ++b) {
    scores[b].name = backends[b]->name();
    scores[b].seconds /= static_cast<double>(ids.size());
    scores[b].coverage =
        static_cast<double>(covered[b]) / static_cast<double>(std::max<std::size_t>(1, scored));
    scores[b].sky_filled =
        static_cast<double>(sky_filled[b]) / static_cast<double>(std::max<std::size_t>(1, sky));
    scores[b].common = common[b].mean();
    scores[b].filled = filled[b].mean();
    scores[b].consistent = consistent[b].mean();
  }
  return scores;
}

}  // namespace mirage
