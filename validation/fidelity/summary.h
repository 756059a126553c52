// What the results of all vehicles of a validation say together.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "base/intervals.h"
#include "frames/hosts.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

/// Rasteriser and rays against the reference's, light for light (MatchedResult), over the vehicles: errors
/// over all their pixels, or the largest.
struct MatchedSummary : MatchedResult {
  double mask_iou_worst = 1;  ///< of a vehicle
};

/// The same of one camera of frames with several; without rays of the LiDAR.
struct CameraSummary {
  std::string camera;
  int vehicles = 0;  ///< that it sees
  MatchedSummary matched;
};

/// What matched light is to reach.
struct Target {
  std::string place;   ///< of the figure in result.json
  std::string camera;  ///< empty: all together
  double bound = 0;
  bool met = false;
};

/// Means of a Change (ladders.h). `psnr`: of the pictures that differ; none where all are equal, or
/// where it is not measured.
struct MeanChange {
  double mae = 0, relative = 0, ssim = 0, flip = 0;
  std::optional<double> psnr;
};

/// What an interval is drawn over.
enum class DrawnOver { pixels, vehicles, clusters };
constexpr auto words_of(DrawnOver) {
  return std::to_array<const char*>({"pixels", "vehicles", "clusters"});
}

/// Squared errors (unbiased_error.h) over vehicles: their means, as roots, and the interval of the unbiased
/// one over clusters (base/intervals.h); of a single cluster over its vehicles, of a single
/// vehicle over its picture.
struct PooledError {
  double plain = 0, floor = 0, drawn = 0;
  Interval unbiased;
  DrawnOver over = DrawnOver::pixels;
};

/// The rasteriser's picture against full Cycles.
struct FullSummary {
  MeanChange change;
  double seconds = 0;                ///< of Cycles' picture
  std::optional<PooledError> error;  ///< none without vehicles
};

/// A rung over the vehicles that have it. What the detector says is of those found without the adversary;
/// `score_change` is the mean |Δ| from its score of the rasteriser's picture.
struct RungSummary {
  std::string effect;
  int vehicles = 0, detected = 0, hidden = 0, false_positive = 0;
  double fn_asr = 0, asr = 0, mean_score = 0, score_change = 0;
  double seconds = 0;
  std::optional<double> logit;  ///< mean; none where `detected` is 0
};
/// Of the ladder of light (LightRungResult).
struct LightRungSummary : RungSummary {
  std::string group, base;
  MeanChange change, crop, to_full;
  PooledError error;
};
/// Of the LiDAR's (LidarRungResult).
struct LidarRungSummary : RungSummary {
  double returns = 0, changed = 0, returns_change = 0;
};

/// How many vehicles the adversary fools, drawn by the rasteriser and by Cycles.
struct FooledSummary {
  int detected_clean = 0, hidden_raster = 0, hidden_cycles = 0, hidden_both = 0;
  int fooled_raster = 0, fooled_cycles = 0;
  /// Of those found without the adversary, in [0, 1].
  double share(int count) const { return count / (detected_clean > 0 ? double(detected_clean) : 1); }
};

/// Over the vehicles that show anything of the object.
struct ValidationSummary {
  int frames = 0, test_frames = 0, vehicles = 0;
  RoofCount rooftops;
  MatchedSummary matched;
  std::vector<CameraSummary> cameras;  ///< by name; none of frames with one camera
  FullSummary full;
  double noise = 0;  ///< of full Cycles, mean share of the object's radiance
  std::vector<LightRungSummary> ladder;
  std::vector<LidarRungSummary> lidar_ladder;
  FooledSummary attack, attack_train;  ///< held-back vehicles, and those that the attack saw
};

/// Each camera's mean error in matched light is to be within the bound, too.
std::vector<Target> targets_of(const ValidationSummary& summary);

/// `test_frames`: frames that the attack never saw. Rungs are in the order of the ladders.
ValidationSummary summarize_vehicles(const std::vector<VehicleResult>& vehicles,
                                     const std::set<std::string>& test_frames);

/// As result.json has it (src/README.md): an error's figures stand among the rung's, beside those of its
/// change.
nlohmann::json to_json(const ValidationSummary& summary);

}  // namespace mirage
