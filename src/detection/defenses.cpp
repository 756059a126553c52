#include "detection/defenses.h"

#include <turbojpeg.h>

#include <deque>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "base/error.h"
#include "base/image.h"
#include "base/sizes.h"
#include "detection/detector_settings.h"

namespace mirage {
namespace {

/// Zeroes the pixels of `image` that see nothing below z = `plane` (m, `velo`) up to `reach` m along the
/// level unit vector `ahead`: on a line of sight o + t d the height at that distance is above the plane where
/// (o_z − plane) d·ahead + (reach − o·ahead) d_z is positive.
void hide_above(ImageF& image, const Calibration& calibration, const Vec3d& ahead, double plane,
                double reach) {
  const Transform velo_from_camera = calibration.camera_from_velo.inverse();
  const Vec3d o = velo_from_camera.translation(),
              above = velo_from_camera.linear().transpose() *
                      ((o.z() - plane) * ahead + Vec3d(0, 0, reach - o.dot(ahead)));
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u) {
      if (above.dot(calibration.camera.unproject(u, v, 1)) <= 0) continue;
      for (int c = 0; c < image.channels; ++c) image.at(u, v, c) = 0;
    }
}

/// The same for another camera, along its own level heading.
void hide_above(ImageF& image, const SensorData& camera, double plane, double reach) {
  Calibration calibration;
  calibration.camera = camera.camera, calibration.camera_from_velo = camera.sensor_from_ego;
  const Vec3d axis = camera.sensor_from_ego.linear().row(2).transpose();
  hide_above(image, calibration, Vec3d(axis.x(), axis.y(), 0).normalized(), plane, reach);
}

/// Adds to the view each camera beside the first that the detector names, and applies change(picture, sensor)
/// to a copy in `kept` of each of their pictures. Cameras missing in the view would be read as recorded.
template <class Change>
void change_beside(SensorView& view, const Capabilities& can, std::deque<ImageF>& kept,
                   const Change& change) {
  for (std::size_t k = 0; view.frame && k < view.frame->others.size(); ++k) {
    const std::string& name = view.frame->others[k].name;
    if (can.names(name) && std::none_of(view.others.begin(), view.others.end(),
                                        [&](const SensorData& sensor) { return sensor.name == name; }))
      view.others.push_back(sensor_beside(*view.frame, k));
  }
  for (SensorData& sensor : view.others) {
    if (sensor.kind != SensorData::Kind::camera || !sensor.image || sensor.image->empty()) continue;
    change(kept.emplace_back(*sensor.image), sensor);
    sensor.image = &kept.back();
  }
}

/// The visible part of a frame, with indices into it.
struct Below {
  ImageF image;
  std::deque<ImageF> beside;       ///< of its cameras beside the first
  std::vector<SensorData> others;  ///< the view's, with those pictures
  std::vector<LidarPoint> points, watched;
  std::vector<std::size_t> kept, kept_watched;  ///< their indices in the frame
};

class CeilingDetector : public DetectorWrapper {
 public:
  CeilingDetector(std::unique_ptr<Detector> inner, double height, double unit_height)
      : DetectorWrapper(std::move(inner)), height_(height), unit_height_(unit_height) {}

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    below_ = {}, clean_below_ = {};
    SensorView seen = lowered(view, below_);
    if (view.clean) {
      const SensorView lower =
          lowered({view.clean->image, view.clean->points, view.calibration}, clean_below_);
      clean_ = {lower.image, lower.points, view.clean->key, view.clean->changed};
      seen.clean = &clean_;
    }
    count_ = view.points.size(), watched_count_ = view.watched.size();
    calibration_.reset();
    if (seen.image && view.calibration) calibration_ = *view.calibration;
    return inner_->forward(seen, score_threshold, keep_graph);
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient below = inner_->backward(d_logits), all;
    if (calibration_) hide_above(below.image, *calibration_, Vec3d::UnitX(), plane(), reach());
    all.image = std::move(below.image);
    all.others = std::move(below.others);
    for (const SensorData& sensor : below_.others) {
      const auto its = all.others.find(sensor.name);
      if (its == all.others.end() || sensor.kind != SensorData::Kind::camera || !sensor.image) continue;
      ImageF pixels(sensor.image->width, sensor.image->height, 3);
      if (its->second.size() != pixels.data.size()) continue;  // it gave none
      pixels.data.swap(its->second);
      hide_above(pixels, sensor, plane(), reach());
      pixels.data.swap(its->second);
    }
    all.points.resize(count_);
    for (std::size_t i = 0; i < below.points.size(); ++i) all.points[below_.kept.at(i)] = below.points[i];
    if (!below.presence.empty()) all.presence.resize(watched_count_);
    for (std::size_t i = 0; i < below.presence.size(); ++i)
      all.presence[below_.kept_watched.at(i)] = below.presence[i];
    return all;
  }

  TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) override {
    std::vector<Below> below(samples.size());
    std::vector<TrainingSample> seen(samples.begin(), samples.end());
    for (std::size_t i = 0; i < seen.size(); ++i) seen[i].input = lowered(samples[i].input, below[i]);
    return inner_->train_step(seen, learning_rate);
  }
  std::unique_ptr<Detector> share() override {
    auto other = inner_->share();
    return other ? under_ceiling(std::move(other), height_, unit_height_) : nullptr;
  }
  ImageFeatures image_features(const SensorView& input) override {
    Below below;
    return inner_->image_features(lowered(input, below));
  }

 private:
  double plane() const { return height_ - unit_height_; }
  double reach() const { return inner_->region()[1]; }

  /// The view below the ceiling, whose data live in `below`; without a clean one.
  SensorView lowered(SensorView view, Below& below) const {
    const RoadSurface road(view.points);
    const auto keep = [&](std::span<const LidarPoint> points, auto& kept, auto& indices) {
      for (std::size_t i = 0; i < points.size(); ++i) {
        if (points[i].z > road.height(points[i].x, points[i].y) + height_) continue;
        kept.push_back(points[i]);
        indices.push_back(i);
      }
    };
    keep(view.points, below.points, below.kept);
    keep(view.watched, below.watched, below.kept_watched);
    view.points = below.points, view.watched = below.watched, view.clean = nullptr;
    if (view.image && !view.image->empty() && view.calibration) {
      below.image = *view.image;
      hide_above(below.image, *view.calibration, Vec3d::UnitX(), plane(), reach());
      view.image = &below.image;
    }
    change_beside(view, inner_->capabilities(), below.beside, [&](ImageF& picture, const SensorData& sensor) {
      hide_above(picture, sensor, plane(), reach());
    });
    below.others = view.others;
    return view;
  }

  double height_, unit_height_;
  // Of the last forward: the inner detector's input, until its backward pass is done.
  Below below_, clean_below_;
  UnchangedInput clean_;
  std::size_t count_ = 0, watched_count_ = 0;
  std::optional<Calibration> calibration_;  ///< if it had a picture
};

/// An answer's logit and its derivative by that of the detector's proposal `from`.
struct Answer {
  std::size_t from = 0;
  double logit = 0, slope = 1;
};

/// A logit raised by a body: continuous and rising.
Answer raised(std::size_t from, double logit) {
  if (logit >= kBodyLogit) return {from, logit, 1};
  const double lifted = logit + kBodyLift, level = kBodyLogit + kSaturatedSlope * (logit - kBodyLogit);
  return lifted < level ? Answer{from, lifted, 1} : Answer{from, level, kSaturatedSlope};
}

Answer sunk(std::size_t from, double logit) {
  if (logit <= kThroughLogit) return {from, logit, 1};
  return {from, kThroughLogit + kSaturatedSlope * (logit - kThroughLogit), kSaturatedSlope};
}

class ShadowDetector : public DetectorWrapper {
 public:
  using DetectorWrapper::DetectorWrapper;

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    const auto found = inner_->forward(view, reporting_threshold(score_threshold), keep_graph);
    count_ = found.size();
    const BodyEvidence evidence(view.points);
    const std::vector<BevBox> bodies = evidence.bodies();
    std::vector<std::ptrdiff_t> loudest(bodies.size(), -1);  // proposal at each body
    std::vector<Detection> result;
    answers_.clear();
    const auto add = [&](Detection proposal, const Answer& answer) {
      proposal.logit = answer.logit;
      if (!(proposal.score() > score_threshold)) return;
      result.push_back(proposal);
      answers_.push_back(answer);
    };
    for (std::size_t i = 0; i < count_; ++i) {
      const Detection& proposal = found[i];
      bool stands = false;
      for (std::size_t b = 0; b < bodies.size(); ++b)
        if (same_place(proposal.box.bev, bodies[b])) {
          stands = true;
          if (loudest[b] < 0 || found[as_size(loudest[b])].logit < proposal.logit)
            loudest[b] = static_cast<std::ptrdiff_t>(i);
        }
      if (stands) {
        add(proposal, raised(i, proposal.logit));
      } else if (proposal.logit > kThroughLogit) {
        const RayCount rays = evidence.rays(proposal.box.bev);
        const bool empty = rays.passed >= kThroughRays && rays.passed > rays.stopped;
        add(proposal, empty ? sunk(i, proposal.logit) : Answer{i, proposal.logit, 1});
      } else {
        add(proposal, {i, proposal.logit, 1});
      }
    }
    for (std::size_t b = 0; b < bodies.size(); ++b) {
      if (loudest[b] < 0) continue;
      const auto i = as_size(loudest[b]);
      if (found[i].logit >= kBodyLogit) continue;  // is found as it is
      Detection own = found[i];
      own.box.bev = bodies[b];
      Answer answer = raised(i, found[i].logit);
      answer.logit += 1e-3;  // before the proposals, whose boxes the hiding object may have turned
      add(own, answer);
    }
    return result;
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    std::vector<double> parts(count_, 0.0);
    for (std::size_t k = 0; k < d_logits.size(); ++k)
      parts[answers_.at(k).from] += answers_[k].slope * d_logits[k];
    return inner_->backward(parts);
  }

  std::unique_ptr<Detector> share() override {
    auto other = inner_->share();
    return other ? std::make_unique<ShadowDetector>(std::move(other)) : nullptr;
  }

 private:
  std::size_t count_ = 0;        ///< of the last forward's proposals
  std::vector<Answer> answers_;  ///< one for each box of the last forward
};

using TurboJpeg = std::unique_ptr<void, int (*)(tjhandle)>;

/// `handle`: of tjInitCompress or tjInitDecompress.
TurboJpeg started(tjhandle handle) {
  if (!handle) throw Failure("libjpeg-turbo", "could not start", "check the free memory");
  return {handle, tjDestroy};
}

void check(int status, const TurboJpeg& handle) {
  if (status != 0)
    throw Failure("libjpeg-turbo", tjGetErrorStr2(handle.get()), "check the picture and the free memory");
}

class JpegDetector : public DetectorWrapper {
 public:
  JpegDetector(std::unique_ptr<Detector> inner, int quality)
      : DetectorWrapper(std::move(inner)), quality_(quality) {}

  Capabilities capabilities() const override {
    Capabilities combined = inner_->capabilities();
    combined.why_whole = "the pictures that it sees are compressed";
    return combined;
  }

  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    std::deque<ImageF> images;
    return inner_->forward(compressed(input, images), score_threshold, keep_graph);
  }

  TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) override {
    std::deque<ImageF> images;
    std::vector<TrainingSample> seen(samples.begin(), samples.end());
    for (std::size_t i = 0; i < seen.size(); ++i) seen[i].input = compressed(samples[i].input, images);
    return inner_->train_step(seen, learning_rate);
  }
  std::unique_ptr<Detector> share() override {
    auto other = inner_->share();
    return other ? behind_jpeg(std::move(other), quality_) : nullptr;
  }
  ImageFeatures image_features(const SensorView& input) override {
    std::deque<ImageF> images;
    return inner_->image_features(compressed(input, images));
  }

 private:
  /// The view with compressed pictures, which live in `images`.
  SensorView compressed(SensorView view, std::deque<ImageF>& images) const {
    view.clean = nullptr;
    if (view.image != nullptr && !view.image->empty())
      view.image = &images.emplace_back(jpeg_round_trip(*view.image, quality_));
    change_beside(view, inner_->capabilities(), images,
                  [&](ImageF& picture, const SensorData&) { picture = jpeg_round_trip(picture, quality_); });
    return view;
  }

  int quality_;
};

constexpr int kRows = LowestReturns::kRows, kColumns = LowestReturns::kColumns;

}  // namespace

std::unique_ptr<Detector> under_ceiling(std::unique_ptr<Detector> inner, double height, double unit_height) {
  return std::make_unique<CeilingDetector>(std::move(inner), height, unit_height);
}

std::unique_ptr<Detector> with_shadows(std::unique_ptr<Detector> detector) {
  const Capabilities can = detector->capabilities();
  if (!can.finds_bev || !can.reads_points)
    throw FieldError("defense", kShadows,
                     detector->name() + " finds no boxes from above, or reads no returns",
                     "use it with lidar, painted, fusion, late or refined");
  return std::make_unique<ShadowDetector>(std::move(detector));
}

std::string encode_jpeg(const ImageF& linear, int quality) {
  const TurboJpeg compressor = started(tjInitCompress());
  const std::vector<std::uint8_t> bytes = srgb_bytes(linear);
  unsigned char* encoded = nullptr;
  unsigned long size = 0;
  const int status = tjCompress2(compressor.get(), bytes.data(), linear.width, 0, linear.height, TJPF_RGB,
                                 &encoded, &size, TJSAMP_420, quality, TJFLAG_ACCURATEDCT);
  const std::unique_ptr<unsigned char, void (*)(unsigned char*)> owner(encoded, tjFree);
  check(status, compressor);
  return {reinterpret_cast<const char*>(owner.get()), size};
}

ImageF jpeg_round_trip(const ImageF& linear, int quality) {
  const std::string file = encode_jpeg(linear, quality);
  const TurboJpeg decompressor = started(tjInitDecompress());
  std::vector<std::uint8_t> bytes(linear.data.size());
  check(tjDecompress2(decompressor.get(), reinterpret_cast<const unsigned char*>(file.data()), file.size(),
                      bytes.data(), linear.width, 0, linear.height, TJPF_RGB, TJFLAG_ACCURATEDCT),
        decompressor);
  return linear_image(bytes, linear.width, linear.height);
}

std::unique_ptr<Detector> behind_jpeg(std::unique_ptr<Detector> inner, int quality) {
  return std::make_unique<JpegDetector>(std::move(inner), quality);
}

RoadSurface::RoadSurface(std::span<const LidarPoint> points)
    : lowest_(floats_of(points), -4) {  // m; below it mirrored returns
  // Least squares over the returns near the previous plane, with a wider margin below than above.
  for (const double reach : {1.0, 0.5, 0.3, 0.3, 0.3}) {
    constexpr int kMinCount = 20;
    Eigen::Matrix3d squares = Vec3d(1e-3, 10, 10).asDiagonal();  // level where little is seen
    Vec3d products = Vec3d::Zero();
    int used = 0;
    for (int row = 0; row < kRows; ++row)
      for (int column = 0; column < kColumns; ++column) {
        const double z = lowest_.at(row, column);
        const Vec3d at(1, row + 0.5, column + 0.5 - kColumns / 2.0);
        const double over = z - at.dot(plane_);
        if (!(over < reach && over > -2 * reach)) continue;
        squares += at * at.transpose();
        products += at * z;
        ++used;
      }
    if (used < kMinCount) break;
    plane_ = squares.ldlt().solve(products);
  }
}

double RoadSurface::height(double x, double y) const {
  constexpr double kStep = 0.4;  // m
  const int row = static_cast<int>(std::clamp(x, 0.0, kRows - 1.0)),
            column = static_cast<int>(std::clamp(y + kColumns / 2.0, 0.0, kColumns - 1.0));
  float lowest = LowestReturns::kNone;
  for (int r = std::max(row - 1, 0); r <= std::min(row + 1, kRows - 1); ++r)
    for (int c = std::max(column - 1, 0); c <= std::min(column + 1, kColumns - 1); ++c)
      lowest = std::min(lowest, lowest_.at(r, c));
  const double road = plane(x, y);
  return std::abs(lowest - road) < kStep ? lowest : road;
}

BodyEvidence::BodyEvidence(std::span<const LidarPoint> points) : points_(points), road_(points) {}

RayCount BodyEvidence::rays(const BevBox& box) const {
  constexpr double kInner = 0.7, kBehind = 0.5;                                  // share; m
  constexpr double kLow = 0.25, kHigh = 1.4, kBodyLow = 0.35, kBodyHigh = 0.95;  // m: below windows
  const double c = std::cos(box.yaw), s = std::sin(box.yaw), road = road_.height(box.x, box.y);
  const auto local = [&](double x, double y) {
    return Vec2d(c * (x - box.x) + s * (y - box.y), c * (y - box.y) - s * (x - box.x));
  };
  const Vec2d half(box.length / 2, box.width / 2), unit = local(0, 0);
  RayCount count;
  for (const LidarPoint& p : points_) {
    const Vec2d end = local(p.x, p.y);
    const double over = p.z - road;
    if (std::abs(end.x()) < half.x() && std::abs(end.y()) < half.y() && over > kLow && over < kHigh)
      ++count.stopped;
    // The share of the ray that lies within the inner rectangle.
    const Vec2d way = end - unit;
    double enters = 0, leaves = 1 - kBehind / std::max(way.norm(), 1e-6);
    const double last = leaves;
    bool meets = true;
    for (int k = 0; k < 2 && meets; ++k) {
      const double inner = kInner * half[k];
      if (std::abs(way[k]) < 1e-12) {
        meets = std::abs(unit[k]) < inner;
        continue;
      }
      const double a = (-inner - unit[k]) / way[k], b = (inner - unit[k]) / way[k];
      enters = std::max(enters, std::min(a, b));
      leaves = std::min(leaves, std::max(a, b));
    }
    if (!meets || !(leaves > enters) || !(leaves < last)) continue;
    const double at = p.z * (enters + leaves) / 2 - road;
    count.passed += at > kBodyLow && at < kBodyHigh;
  }
  return count;
}

std::vector<BevBox> BodyEvidence::bodies() const {
  constexpr double kCell = 0.25, kLow = 0.3, kHigh = 1.4, kTall = 1.0, kFar = 45;  // m
  constexpr double kMaxSize = 6.5, kMinSize = 0.9;                                 // m, of a joined region
  constexpr std::size_t kMinCount = 10;
  constexpr int kMinStopped = 20, kPassedShare = 10;  // nine of ten are stopped
  // Cells that returns touch, joined where they are neighbours but one.
  cv::Mat1b touched(static_cast<int>(kRows / kCell), static_cast<int>(kColumns / kCell), std::uint8_t{0});
  cv::Mat1i number;
  const auto cell_of = [&](const Vec2d& p) {
    return cv::Point(std::clamp(static_cast<int>((p.y() + kColumns / 2.0) / kCell), 0, touched.cols - 1),
                     std::clamp(static_cast<int>(p.x() / kCell), 0, touched.rows - 1));
  };
  std::vector<std::pair<Vec2d, double>> low;  // place, height
  for (const LidarPoint& p : points_) {
    if (!(p.x >= 1 && p.x < kRows && std::abs(p.y) < kColumns / 2.0)) continue;
    const double over = p.z - road_.height(p.x, p.y);
    if (over <= kLow || over >= kHigh) continue;
    low.emplace_back(Vec2d(p.x, p.y), over);
    touched(cell_of(low.back().first)) = 1;
  }
  cv::dilate(touched, touched, cv::Mat());
  struct Region {
    std::vector<Vec2d> places;
    double tallest = 0;
    Eigen::AlignedBox2d around;
  };
  // By number, in the order of their first cells; 0: cells without returns.
  std::vector<Region> regions(as_size(cv::connectedComponents(touched, number, 8, CV_32S, cv::CCL_WU)));
  for (const auto& [place, over] : low) {
    Region& its = regions[as_size(number(cell_of(place)))];
    its.places.push_back(place);
    its.tallest = std::max(its.tallest, over);
    its.around.extend(place);
  }
  std::vector<BevBox> found;
  for (const Region& one : regions) {
    const double across = one.around.isEmpty() ? 0 : one.around.diagonal().norm();
    if (one.places.size() < kMinCount || one.tallest < kTall || across > kMaxSize || across < kMinSize)
      continue;
    const auto box = car_seen_as(closest_rectangle(one.places));
    if (!box || horizontal_distance(*box) > kFar) continue;
    const RayCount count = rays(*box);
    if (count.stopped > kMinStopped && kPassedShare * count.passed <= count.stopped + count.passed)
      found.push_back(*box);
  }
  return found;
}

}  // namespace mirage
