#include "detection/ground_truth_sampling.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/files.h"
#include "base/image.h"
#include "base/intervals.h"
#include "base/logging.h"
#include "base/random.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "scene/data/data_rig.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

void cut_pixels(CutOut& car, const ImageF& image, const Image<std::uint16_t>& instances, int instance) {
  PixelRect rect{image.width, image.height, 0, 0};
  const auto is_car = [&](int u, int v) { return instances.at(u, v) == instance; };
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u)
      if (is_car(u, v))
        rect = {std::min(rect.u0, u), std::min(rect.v0, v), std::max(rect.u1, u + 1),
                std::max(rect.v1, v + 1)};
  if (rect.empty()) return;
  car.rect = rect;
  car.mask = Image<std::uint8_t>(rect.width(), rect.height(), 1);
  car.srgb = Image<std::uint8_t>(rect.width(), rect.height(), 3);
  for (int y = 0; y < rect.height(); ++y) {
    for (int x = 0; x < rect.width(); ++x) car.mask.at(x, y) = is_car(rect.u0 + x, rect.v0 + y);
    write_srgb_bytes({image.pixel(rect.u0, rect.v0 + y), 3 * as_size(rect.width())}, car.srgb.pixel(0, y));
  }
}

constexpr std::size_t kCutOutMemory = std::size_t{256} << 20;  // bytes of cut-outs kept
constexpr int kAttempts = 8;                                   // for each vehicle wanted
constexpr double kMaxHiddenShare = 0.3;                        // share of the car's points
constexpr double kMinLift = 0.05, kMaxLift = 0.2;              // m
constexpr double kClearance = 0.3;                             // m between boxes
constexpr double kNearer = 0.3;                                // m by which a return must be nearer to hide
constexpr double kMaxCoveredShare = 0.5;                       // share of another car's box in the picture
constexpr double kOffGround = 0.15;  // m: lower returns are the road's and hide nothing

/// A direction seen from the unit's origin: rad, m.
struct Seen {
  double azimuth, elevation, range;
};

Seen seen_from(const Vec3d& origin, const LidarPoint& point) {
  const Vec3d d = point.position().cast<double>() - origin;
  const double flat = std::hypot(d.x(), d.y());
  return {std::atan2(d.y(), d.x()), std::atan2(d.z(), flat), d.norm()};
}

/// Azimuth columns a firing wide or a little more, over the whole turn.
class Columns {
 public:
  explicit Columns(double azimuth_step)
      : count_(std::max(8, static_cast<int>(2 * std::numbers::pi / (1.2 * azimuth_step)))) {}
  int count() const { return count_; }
  int of(double azimuth) const {
    const double turn = azimuth / (2 * std::numbers::pi) + 0.5;
    return std::clamp(static_cast<int>(turn * count_), 0, count_ - 1);
  }

 private:
  int count_;
};

/// The span of the car's returns in one azimuth column.
struct Span {
  double low = 1e9, high = -1e9, range = 1e9;
  bool empty() const { return low > high; }
  void add(const Span& other) {
    low = std::min(low, other.low);
    high = std::max(high, other.high);
    range = std::min(range, other.range);
  }
};

/// Spans by column; gaps of up to two columns between spans are closed.
std::vector<Span> car_spans(const std::vector<Seen>& car, const Columns& columns) {
  std::vector<Span> spans(as_size(columns.count()));
  for (const Seen& p : car) spans[as_size(columns.of(p.azimuth))].add({p.elevation, p.elevation, p.range});
  std::vector<Span> closed = spans;
  for (int c = 1; c + 1 < columns.count(); ++c) {
    if (!spans[as_size(c)].empty()) continue;
    for (int left = 1; left <= 2; ++left)
      for (int right = 1; right <= 2; ++right) {
        if (c - left < 0 || c + right >= columns.count() || left + right > 3) continue;
        if (spans[as_size(c - left)].empty() || spans[as_size(c + right)].empty() ||
            !closed[as_size(c)].empty())
          continue;
        closed[as_size(c)].add(spans[as_size(c - left)]);
        closed[as_size(c)].add(spans[as_size(c + right)]);
      }
  }
  return closed;
}

/// Whether more than a few points stand where the car would; and the height of the ground there, if known.
struct Site {
  bool known = false, blocked = false;
  double ground = 0;
};

Site look_at_site(const std::vector<LidarPoint>& points, const Box3& box) {
  Box3 column = box;
  column.bottom -= 1;
  column.height += 1;
  std::vector<double> heights;
  for (const LidarPoint& point : points)
    if (contains(column, point.position().cast<double>(), 0.5)) heights.push_back(point.z);
  Site site;
  if (heights.size() >= 5) {
    site.known = true;
    site.ground = lower_quantile(heights, 0.1);
  }
  Box3 body = box;
  if (site.known && std::abs(site.ground - box.bottom) <= kMaxLift) body.bottom = site.ground;
  body.bottom += 0.3;
  body.height -= 0.3;
  int inside = 0;
  for (const LidarPoint& point : points) inside += contains(body, point.position().cast<double>(), 0.05);
  site.blocked = inside > 2;
  return site;
}

bool same_camera(const CompactFrame& frame, const CutOut& car) {
  if (car.rect.empty()) return true;
  const Vec3d centre(car.box.bev.x, car.box.bev.y, car.box.bottom + car.box.height / 2);
  const Vec2d here = frame.calibration.camera.project<double>(frame.calibration.camera_from_velo * centre);
  const Vec2d there = car.camera.project<double>(car.camera_from_velo * centre);
  return frame.width == car.camera.width && frame.height == car.camera.height && (here - there).norm() < 1;
}

/// Whether each present car keeps enough of its returns.
bool others_stay(const CompactFrame& frame, const std::vector<char>& removed, double bottom) {
  for (const ObjectBoxes& present : frame.truth.space.boxes) {
    const Box3 body{present.box.bev, bottom + kOffGround, 3};
    int before = 0, after = 0;
    for (std::size_t i = 0; i < frame.points.size(); ++i)
      if (contains(body, frame.points[i].position().cast<double>(), 0.1)) {
        ++before;
        after += !removed[i];
      }
    if (after < before && (after < 3 || 2 * after < before)) return false;
  }
  return true;
}

/// 1 where a nearer return, spread over the gaps between firings and beams, hides the pixel of the car's
/// rect.
Image<std::uint8_t> hidden_pixels(const CompactFrame& frame, const PixelRect& rect,
                                  const std::vector<char>& nearer, const SamplingUnit& unit) {
  Image<std::uint8_t> hidden(rect.width(), rect.height(), 1);
  const PinholeCamera& camera = frame.calibration.camera;
  const int across = static_cast<int>(std::ceil(camera.fx * unit.azimuth_step / 2)) + 1;
  const int down = static_cast<int>(std::ceil(camera.fy * unit.beam_gap / 2)) + 1;
  for (std::size_t i = 0; i < frame.points.size(); ++i) {
    if (!nearer[i]) continue;
    const Vec2d pixel = camera.project<double>(frame.calibration.camera_from_velo *
                                               frame.points[i].position().cast<double>());
    const int u = static_cast<int>(std::lround(pixel.x())) - rect.u0;
    const int v = static_cast<int>(std::lround(pixel.y())) - rect.v0;
    for (int y = std::max(0, v - down); y <= std::min(rect.height() - 1, v + down); ++y)
      for (int x = std::max(0, u - across); x <= std::min(rect.width() - 1, u + across); ++x)
        hidden.at(x, y) = 1;
  }
  // Panes give no returns: short gaps in a column are closed.
  for (int x = 0; x < rect.width(); ++x) {
    int last = -1000;
    for (int y = 0; y < rect.height(); ++y) {
      if (!hidden.at(x, y)) continue;
      if (y - last > 1 && y - last <= 4 * down)
        for (int k = last + 1; k < y; ++k) hidden.at(x, k) = 1;
      last = y;
    }
  }
  return hidden;
}

TruthBox pasted(const CutOut& car, const PictureBox& picture) {
  TruthBox truth(car.box, picture);
  truth.label = TruthBox::kPasted;
  truth.difficulty = car.difficulty;
  truth.distance = horizontal_distance(car.box.bev);
  return truth;
}

/// Adds the car's box, `rows` lower than it was, to the picture's truth.
void paste_picture_box(CompactFrame& frame, const CutOut& car, int rows) {
  PictureBox box = car.picture;
  box.top = std::clamp<double>(box.top + rows, 0, frame.height - 1);
  box.bottom = std::clamp<double>(box.bottom + rows, 0, frame.height - 1);
  TruthBoxes& truth = frame.truth.picture;
  const auto covered = [&](const TruthBox& other) {
    return intersection_area(other.picture, box) > kMaxCoveredShare * area(other.picture);
  };
  std::ranges::copy_if(truth.boxes, std::back_inserter(truth.ignore), covered);
  std::erase_if(truth.boxes, covered);
  truth.boxes.push_back(pasted(car, box));
}

/// Pastes the car's pixels, its part of the mask and its box in the picture.
void paste_picture(CompactFrame& frame, const CutOut& car, const std::vector<char>& nearer,
                   const SamplingUnit& unit, double lift) {
  const Vec3d centre(car.box.bev.x, car.box.bev.y, car.box.bottom);
  const double depth = (frame.calibration.camera_from_velo * centre).z();
  const int rows = static_cast<int>(std::lround(-lift * frame.calibration.camera.fy / std::max(depth, 1.0)));
  PixelRect rect = car.rect;
  rect.v0 += rows;
  rect.v1 += rows;
  paste_picture_box(frame, car, rows);
  frame.picture_key = 0;
  const Image<std::uint8_t> hidden = hidden_pixels(frame, rect, nearer, unit);
  const auto is_car = [&](int x, int y) {
    return x >= 0 && y >= 0 && x < rect.width() && y < rect.height() && car.mask.at(x, y) != 0;
  };
  for (int y = 0; y < rect.height(); ++y)
    for (int x = 0; x < rect.width(); ++x) {
      const int u = rect.u0 + x, v = rect.v0 + y;
      if (!is_car(x, y) || hidden.at(x, y) || u < 0 || v < 0 || u >= frame.width || v >= frame.height)
        continue;
      // The outline is mixed with the background, as an anti-aliased one is.
      int around = 0;
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) around += is_car(x + dx, y + dy);
      const std::size_t pixel = as_size(v) * as_size(frame.width) + as_size(u);
      if (!frame.vehicle_mask.empty()) frame.vehicle_mask[pixel] = true;
      std::uint8_t* to = &frame.srgb[pixel * 3];
      for (int c = 0; c < 3; ++c)
        to[c] = static_cast<std::uint8_t>((car.srgb.at(x, y, c) * around + to[c] * (9 - around)) / 9);
    }
}

/// Whether a label may name a car that is cut out.
bool may_be_cut_out(const Label& label, const std::array<double, 4>& region) {
  return label.occluded == 0 && counts_by_label(label, region);
}

}  // namespace

std::vector<CutOut> cut_out_cars(const fs::path& data, const std::string& id,
                                 const std::array<double, 4>& region, bool with_picture) {
  const Frame frame = read_frame(data, id);
  const fs::path label_file = point_label_file(data, id);
  std::vector<std::uint32_t> owner;
  if (fs::exists(label_file)) owner = read_point_labels(label_file, frame.sweep.size());
  Image<std::uint16_t> instances;
  if (with_picture) instances = read_instances(data, id, frame.image.width, frame.image.height);
  std::vector<CutOut> cars;
  for (std::size_t k = 0; k < frame.labels.size(); ++k) {
    const Label& label = frame.labels[k];
    if (!may_be_cut_out(label, region)) continue;
    CutOut car;
    car.box = label.box;
    car.difficulty = easiest_level(label);
    car.picture = picture_box(label);
    car.camera = frame.calibration.camera;
    car.camera_from_velo = frame.calibration.camera_from_velo;
    Box3 body = label.box;
    body.bottom += 0.2;  // with the margin: all but the lowest 0.1 m
    body.height -= 0.2;
    for (std::size_t i = 0; i < frame.sweep.size(); ++i)
      if (owner.empty() ? contains(body, frame.sweep[i].position().cast<double>(), 0.1)
                        : owner[i] >> 16 == k + 1)
        car.points.push_back(frame.sweep[i]);
    if (with_picture) cut_pixels(car, frame.image, instances, static_cast<int>(k) + 1);
    if (car.points.size() >= kMinPoints && !(with_picture && car.rect.empty()))
      cars.push_back(std::move(car));
  }
  return cars;
}

SamplingUnit sampling_unit(const LidarModel& lidar) {
  SamplingUnit unit;
  std::vector<double> elevations;
  double height = 0;
  for (const LidarBeam& beam : lidar.beams) {
    height += beam.height / static_cast<double>(lidar.beams.size());
    elevations.push_back(beam.elevation);
  }
  unit.origin = lidar.velo_from_lidar * Vec3d(0, 0, height);
  unit.azimuth_step = lidar.azimuth_step;
  std::sort(elevations.begin(), elevations.end());
  std::vector<double> gaps;
  for (std::size_t i = 1; i < elevations.size(); ++i) gaps.push_back(elevations[i] - elevations[i - 1]);
  if (gaps.empty()) gaps.push_back(unit.azimuth_step);
  unit.beam_gap = lower_quantile(gaps, 0.5);
  return unit;
}

bool paste(CompactFrame& frame, const CutOut& car, const SamplingUnit& unit) {
  if (!same_camera(frame, car)) return false;
  BevBox grown = car.box.bev;
  grown.length += 2 * kClearance;
  grown.width += 2 * kClearance;
  TruthBoxes& truth = frame.truth.space;
  const auto meets = [&](const ObjectBoxes& other) { return intersection_area(grown, other.box.bev) > 0; };
  if (std::any_of(truth.boxes.begin(), truth.boxes.end(), meets) ||
      std::any_of(truth.ignore.begin(), truth.ignore.end(), meets))
    return false;
  const Site site = look_at_site(frame.points, car.box);
  double lift = site.known ? site.ground - car.box.bottom : 0;
  if (site.blocked || std::abs(lift) > kMaxLift) return false;
  if (std::abs(lift) < kMinLift) lift = 0;
  const double bottom = car.box.bottom + lift;

  std::vector<LidarPoint> points = car.points;
  std::vector<Seen> directions;
  for (LidarPoint& point : points) {
    point.z += static_cast<float>(lift);
    directions.push_back(seen_from(unit.origin, point));
  }
  const Columns columns(unit.azimuth_step);
  const std::vector<Span> spans = car_spans(directions, columns);
  Span whole;
  for (const Span& span : spans) whole.add(span);

  std::vector<char> behind(frame.points.size(), 0), nearer(frame.points.size(), 0);
  std::vector<std::vector<Seen>> nearer_by_column(as_size(columns.count()));
  for (std::size_t i = 0; i < frame.points.size(); ++i) {
    const Seen p = seen_from(unit.origin, frame.points[i]);
    const int c = columns.of(p.azimuth);
    const Span& span = spans[as_size(c)];
    const double reach = span.empty() ? whole.range : span.range;
    if (p.range < reach - kNearer && frame.points[i].z > bottom + kOffGround) {
      nearer[i] = 1;
      nearer_by_column[as_size(c)].push_back(p);
    } else if (!span.empty() && p.range > reach && p.elevation > span.low - unit.beam_gap / 2 &&
               p.elevation < span.high + unit.beam_gap / 2) {
      behind[i] = 1;
    }
  }
  std::vector<LidarPoint> visible;
  for (std::size_t k = 0; k < points.size(); ++k) {
    const Seen& p = directions[k];
    const int column = columns.of(p.azimuth);
    bool hidden = false;
    for (int c = std::max(0, column - 1); c <= std::min(columns.count() - 1, column + 1) && !hidden; ++c)
      hidden = std::any_of(nearer_by_column[as_size(c)].begin(), nearer_by_column[as_size(c)].end(),
                           [&](const Seen& s) {
                             return s.range < p.range - kNearer &&
                                    std::abs(s.azimuth - p.azimuth) < 0.75 * unit.azimuth_step &&
                                    std::abs(s.elevation - p.elevation) < 0.6 * unit.beam_gap;
                           });
    if (!hidden) visible.push_back(points[k]);
  }
  const double most_hidden = kMaxHiddenShare * static_cast<double>(points.size());
  if (visible.size() < kMinPoints || static_cast<double>(points.size() - visible.size()) > most_hidden ||
      !others_stay(frame, behind, bottom))
    return false;

  if (!car.rect.empty()) paste_picture(frame, car, nearer, unit, lift);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < frame.points.size(); ++i)
    if (!behind[i]) frame.points[kept++] = frame.points[i];
  frame.points.resize(kept);
  const std::vector<LidarPoint> in_view = points_in_view(visible, frame.calibration);
  frame.points.insert(frame.points.end(), in_view.begin(), in_view.end());
  truth.boxes.push_back(pasted(car, {}));
  return true;
}

GroundTruthSampler::GroundTruthSampler(const fs::path& data, const std::vector<std::string>& ids,
                                       const std::array<double, 4>& region, std::uint64_t seed, double mean,
                                       bool with_picture, const std::string& rig)
    : data_(data),
      ids_(ids),
      region_(region),
      seed_(seed),
      mean_(mean),
      with_picture_(with_picture),
      unit_(sampling_unit(lidar_of(data, rig))),
      donors_(ids.size()) {
  if (with_picture && !fs::is_directory(data / "training" / "instance_2")) {
    spdlog::warn("{}: no training/instance_2, so no vehicles are pasted; generate the set with --truth",
                 data.string());
    return;
  }
  for (std::size_t f = 0; f < ids_.size(); ++f)
    for (const Label& label : read_annotations(data, ids_[f]).labels)
      if (may_be_cut_out(label, region_)) candidates_.push_back(f);
}

const std::vector<CutOut>& GroundTruthSampler::cars_of(std::size_t frame) {
  if (donors_[frame].read) return donors_[frame].cars;
  Donor donor{true, cut_out_cars(data_, ids_[frame], region_, with_picture_)};
  std::size_t bytes = 0;
  for (const CutOut& car : donor.cars)
    bytes +=
        sizeof car + car.points.size() * sizeof(LidarPoint) + car.srgb.data.size() + car.mask.data.size();
  if (bytes_ + bytes > kCutOutMemory) return (passing_ = std::move(donor)).cars;
  bytes_ += bytes;
  return (donors_[frame] = std::move(donor)).cars;
}

int GroundTruthSampler::augment(CompactFrame& frame, std::uint64_t index) {
  if (candidates_.empty()) return 0;
  RandomStream random(seed_, "ground-truth sampling", index);
  int goal = -1;  // Knuth's algorithm for a Poisson number
  for (double product = 1; product > std::exp(-mean_); ++goal) product *= random.uniform();
  int pasted = 0;
  for (int attempt = 0; pasted < goal && attempt < kAttempts * goal; ++attempt) {
    const auto& cars = cars_of(candidates_[as_size(random.below(static_cast<int>(candidates_.size())))]);
    const double choice = random.uniform();
    if (cars.empty()) continue;
    pasted += paste(frame, cars[static_cast<std::size_t>(choice * static_cast<double>(cars.size()))], unit_);
  }
  return pasted;
}

}  // namespace mirage
