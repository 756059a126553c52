// The table of functions of --detector clusters.
#include <algorithm>
#include <cmath>
#include <iterator>
#include <memory>
#include <optional>
#include <vector>

#include "../../c_interface.h"
#include "base/types.h"
#include "cluster.h"
#include "detection/detector_abi.h"

namespace mirage::clusters {

/// Places in kTypes.
enum Type { kCar, kMisc };
inline constexpr const char* kTypes[] = {"Car", "Misc"};

/// x_min, x_max, y_min, y_max (m, ego).
inline constexpr float kRegion[4] = {-70, 70, -40, 40};

namespace {

/// The ego vehicle's own bonnet and roof.
bool is_own(float x, float y) {
  constexpr float kLength = 5, kWidth = 2;  // m
  return std::abs(x) < kLength / 2 && std::abs(y) < kWidth / 2;
}

/// All LiDAR returns of a frame that are finite and of its surroundings.
std::vector<Return> returns_of(const MirageFrame& frame) {
  std::vector<Return> returns;
  for (std::int64_t k = 0; k < frame.sensor_count; ++k) {
    const MirageSensor& sensor = frame.sensors[k];
    if (sensor.kind != MIRAGE_LIDAR) continue;
    for (std::int64_t i = 0; i < sensor.shape[0]; ++i) {
      const float* p = sensor.data + 4 * i;
      if (std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]) && !is_own(p[0], p[1]))
        returns.push_back({p[0], p[1], p[2]});
    }
  }
  return returns;
}

/// Returns of a solid thing at which thing_logit is 0.
constexpr double kEnough = 6;

/// Share of the rays into its outline that a thing stopped.
double solid_share(const Cluster& cluster) {
  return static_cast<double>(cluster.returns) / (cluster.returns + cluster.passed);
}

/// How surely a thing is there: each return that a ray would not have passed is evidence.
double thing_logit(const Cluster& cluster) {
  constexpr double kMax = 4;
  return std::min(std::log(cluster.returns * solid_share(cluster) / kEnough), kMax);
}

/// How far a height is from a usual car's, in deviations. Glass and dark roofs give few returns, so that the
/// top of a car is often not seen.
double unlike_height(double height) {
  constexpr double kLowest = 1.0, kHighest = 1.7, kBelow = 0.19, kAbove = 0.23;  // m
  return std::max({(kLowest - height) / kBelow, (height - kHighest) / kAbove, 0.0});
}

/// Returns from a metre of a solid box's height, as finely as the unit looks there.
double expected_returns(const Cluster& cluster, const BevBox& box) {
  const double middle = std::atan2(box.y, box.x), range = horizontal_distance(box);
  double right = 0, left = 0;
  for (const Vec2d& corner : corners(box)) {
    const double azimuth = wrap_angle(std::atan2(corner.y(), corner.x()) - middle);
    right = std::min(right, azimuth), left = std::max(left, azimuth);
  }
  return cluster.density * (left - right) / std::max(range, 1.0);
}

/// Weights of a logistic regression, rounded, on 20 KITTI frames with 49 cars; by its score then 92 % of the
/// boxes over 0.7 were cars, 52 % of those from 0.3 to 0.5 and 4 % of those below 0.1.
double car_logit(const Cluster& cluster, const BevBox& box) {
  const double shown = cluster.returns / std::max(expected_returns(cluster, box), 1.0),
               unlike = unlike_height(cluster.height);
  return std::log(std::min(shown, 1.0)) + 2 * std::log(solid_share(cluster)) +
         std::log(cluster.returns / kEnough) / 2 - unlike * unlike / 2 - 1;
}

double probability(double logit) {
  return 1 / (1 + std::exp(-logit));
}

/// The box of the car that a thing shows; nullopt if it is not a car. A mirror widens the rectangle.
std::optional<BevBox> car_of(const Cluster& cluster) {
  constexpr double kMinLength = 0.7, kTallest = 2.4, kWidest = 2.0, kMirror = 0.4;  // m
  if (cluster.height < kMinLength || cluster.height > kTallest) return std::nullopt;
  SeenRectangle seen = cluster.seen;
  SeenSide& across = seen.along.size() < seen.across.size() ? seen.along : seen.across;
  if (across.size() > kWidest && across.size() <= kWidest + kMirror) across = across.sized(kWidest);
  return car_seen_as(seen);
}

/// Adds an answer, unless it lies outside the region or its score is too low.
void add(const Cluster& cluster, const BevBox& box, Type type, double logit, float score_threshold,
         std::vector<MirageDetection>& found) {
  constexpr double kThinnest = 0.1;  // m, of a box
  if (!(probability(static_cast<float>(logit)) > score_threshold)) return;
  if (box.x < kRegion[0] || box.x > kRegion[1] || box.y < kRegion[2] || box.y > kRegion[3]) return;
  MirageDetection made{};
  made.x = static_cast<float>(box.x), made.y = static_cast<float>(box.y);
  made.z = static_cast<float>(cluster.ground + cluster.height / 2);
  made.length = static_cast<float>(std::max(box.length, kThinnest));
  made.width = static_cast<float>(std::max(box.width, kThinnest));
  made.height = static_cast<float>(cluster.height);
  made.yaw = static_cast<float>(box.yaw);
  made.type = type;
  made.logit = static_cast<float>(logit);
  made.identity = -1;
  std::fill(std::begin(made.velocity), std::end(made.velocity), std::nanf(""));
  found.push_back(made);
}

/// Detections in a frame's LiDAR returns, with a score over the threshold, in a fixed order.
std::vector<MirageDetection> detect(const MirageFrame& frame, float score_threshold) {
  std::vector<MirageDetection> found;
  for (const Cluster& cluster : clusters_of(returns_of(frame))) {
    double other = probability(thing_logit(cluster));
    if (const auto car = car_of(cluster)) {
      const double logit = car_logit(cluster, *car);
      add(cluster, *car, kCar, logit, score_threshold, found);
      other *= 1 - probability(logit);
    }
    add(cluster, cluster.seen.box(), kMisc, std::log(other / (1 - other)), score_threshold, found);
  }
  return found;
}

/// It has no state but its last answer.
class ClustersDetector {
 public:
  const std::vector<MirageDetection>& forward(const MiragePass& pass) {
    return found_ = detect(*pass.frame, pass.score_threshold);
  }
  std::unique_ptr<ClustersDetector> shared() const { return std::make_unique<ClustersDetector>(); }

 private:
  std::vector<MirageDetection> found_;
};

using Functions = CFunctions<ClustersDetector>;

void* create(const char* /*options_json*/, const char* weights, char* error, size_t error_size) {
  return Functions::made(error, error_size, [&] {
    if (weights) bad("weights", "clusters has none", "leave --weights out");
    return std::make_unique<ClustersDetector>();
  });
}

const MirageCapabilities* capabilities(void*) {
  static const MirageCapabilities all = [] {
    MirageCapabilities can{};
    can.flags = MIRAGE_FINDS_BEV | MIRAGE_FINDS_HEIGHTS;
    can.kinds = MIRAGE_LIDAR;
    can.types = kTypes, can.type_count = std::size(kTypes);
    std::copy(std::begin(kRegion), std::end(kRegion), can.region);
    return can;
  }();
  return &all;
}

const MirageDetectorApi kApi = {MIRAGE_DETECTOR_ABI,
                                "clusters",
                                create,
                                Functions::destroy,
                                capabilities,
                                Functions::forward,
                                nullptr,
                                nullptr,
                                Functions::share,
                                nullptr,
                                nullptr,
                                nullptr};

}  // namespace
}  // namespace mirage::clusters

extern "C" __attribute__((visibility("default"))) const MirageDetectorApi* mirage_detector_api(void) {
  return &mirage::clusters::kApi;
}
