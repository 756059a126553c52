#include "detection/training_data.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/angles.h"
#include "base/color.h"
#include "base/hash.h"
#include "base/random.h"
#include "detection/points_in_view.h"
#include "scene/data/data_rig.h"
#include "scene/data/read_frames.h"
#include "scene/data/truth_files.h"
#include "scene/occlusion.h"

namespace mirage {
namespace {

constexpr double kObjects = 0.3;               // share of the cars that lose returns
constexpr double kLeast = 0.7;                 // share of its returns that such a car loses at least
constexpr double kGround = 0.2;                // m over the lowest return around: still the road's
constexpr double kAround = 0.5, kGrown = 0.1;  // m: returns scatter around a surface

void keep(std::vector<LidarPoint>& points, const std::vector<char>& kept) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (kept[i]) points[count++] = points[i];
  points.resize(count);
}

bool over(const BevBox& box, const LidarPoint& point, double grown) {
  return contains(Box3{box, -1e6, 2e6}, point.position().cast<double>(), grown);
}

void lose_returns(const std::vector<LidarPoint>& points, const BevBox& box, std::vector<char>& kept,
                  RandomStream& random) {
  const double lost = random.uniform(kLeast, 1);
  double ground = 1e9;
  for (const LidarPoint& p : points)
    if (over(box, p, kAround)) ground = std::min<double>(ground, p.z);
  for (std::size_t i = 0; i < points.size(); ++i)
    if (points[i].z > ground + kGround && over(box, points[i], kGrown) && random.uniform() < lost)
      kept[i] = 0;
}

}  // namespace

void thin_lidar(CompactFrame& frame, const LidarModel& lidar, double share, std::uint64_t seed,
                std::uint64_t index) {
  RandomStream random(seed, "lidar thinning", index);
  if (random.uniform() >= share) return;
  std::vector<char> kept(frame.points.size(), 1);
  if (random.uniform() < 0.5) {
    const int step = 2 << random.below(3), first = random.below(step);
    const std::vector<int> beams = beams_of(frame.points, lidar);
    for (std::size_t i = 0; i < beams.size(); ++i) kept[i] = beams[i] >= 0 && beams[i] % step == first;
  } else {
    // What looks like a car loses as much: a gap in the sweep must not mean a car.
    for (const auto* boxes : {&frame.truth.space.boxes, &frame.truth.space.look_alikes})
      for (const ObjectBoxes& object : *boxes)
        if (random.uniform() < kObjects) lose_returns(frame.points, object.box.bev, kept, random);
  }
  keep(frame.points, kept);
}

namespace {

constexpr std::size_t kFrameMemory = std::size_t{3} << 30;  // bytes for frames kept between epochs

}  // namespace

CompactFrame compact(const Frame& frame, const std::array<double, 4>& region) {
  CompactFrame small;
  small.width = frame.image.width;
  small.height = frame.image.height;
  small.srgb = srgb_bytes(frame.image);
  small.points = points_in_view(frame.sweep, frame.calibration);
  small.calibration = frame.calibration;
  small.truth = ground_truth(frame, region);
  return small;
}

CompactFrame read_compact(const std::filesystem::path& data, const std::string& id,
                          const std::array<double, 4>& region) {
  const Frame frame = read_frame(data, id);
  CompactFrame small = compact(frame, region);
  const std::string name = std::filesystem::absolute(data).lexically_normal().string() + "\n" + id;
  small.picture_key = std::max<std::uint64_t>(1, fnv1a(name));
  if (!std::filesystem::exists(instance_file(data, id))) return small;
  const Image<std::uint16_t> instances = read_instances(data, id, small.width, small.height);
  small.vehicle_mask.reserve(instances.data.size());
  for (const std::uint16_t k : instances.data)
    small.vehicle_mask.push_back(k >= 1 && k <= frame.labels.size() && is_vehicle(frame.labels[k - 1]));
  return small;
}

TrainingSample PreparedSample::view() const {
  return {{&image, points, &calibration},
          data_from_sample,
          boxes,
          ignore,
          picture_boxes,
          picture_ignore,
          vehicle_mask,
          picture_key};
}

std::vector<TrainingSample> views_of(const std::vector<PreparedSample>& samples) {
  std::vector<TrainingSample> views;
  views.reserve(samples.size());
  for (const PreparedSample& sample : samples) views.push_back(sample.view());
  return views;
}

Eigen::Affine3d random_pose(std::uint64_t seed, std::uint64_t index) {
  RandomStream random(seed, "training pose", index);
  const bool flip = random.uniform() < 0.5;
  const double turn = random.uniform(-10, 10) * kDegree;
  const double scale = random.uniform(0.95, 1.05), lift = random.uniform(-0.15, 0.15);
  Eigen::Affine3d pose = Eigen::Affine3d::Identity();
  pose.linear() = scale * Eigen::AngleAxisd(turn, Vec3d::UnitZ()).toRotationMatrix() *
                  Eigen::DiagonalMatrix<double, 3>(1, flip ? -1 : 1, 1);
  pose.translation().z() = lift;
  return pose;
}

BevBox moved(const BevBox& box, const Eigen::Affine3d& sample_from_data) {
  const Vec3d centre = sample_from_data * Vec3d(box.x, box.y, 0);
  const Vec3d heading = sample_from_data.linear() * Vec3d(std::cos(box.yaw), std::sin(box.yaw), 0);
  const double scale = heading.norm();
  return {centre.x(), centre.y(), box.length * scale, box.width * scale,
          std::atan2(heading.y(), heading.x())};
}

PreparedSample prepared_sample(const CompactFrame& small, const Eigen::Affine3d& sample_from_data,
                               const std::array<double, 4>& region) {
  PreparedSample sample;
  sample.image = linear_image(small.srgb, small.width, small.height);
  sample.calibration = small.calibration;
  sample.data_from_sample = sample_from_data.inverse();
  const Eigen::Affine3f move = sample_from_data.cast<float>();
  for (const LidarPoint& point : small.points) {
    const Vec3f p = move * point.position();
    sample.points.push_back({p.x(), p.y(), p.z(), point.reflectance});
  }
  for (const ObjectBoxes& object : small.truth.space.boxes) {
    const BevBox there = moved(object.box.bev, sample_from_data);
    const bool inside =
        there.x >= region[0] && there.x < region[1] && there.y >= region[2] && there.y < region[3];
    (inside ? sample.boxes : sample.ignore).push_back(there);
  }
  for (const ObjectBoxes& object : small.truth.space.ignore)
    sample.ignore.push_back(moved(object.box.bev, sample_from_data));
  for (const ObjectBoxes& object : small.truth.picture.boxes) sample.picture_boxes.push_back(object.picture);
  for (const ObjectBoxes& object : small.truth.picture.ignore)
    sample.picture_ignore.push_back(object.picture);
  sample.vehicle_mask.assign(small.vehicle_mask.begin(), small.vehicle_mask.end());
  sample.picture_key = small.picture_key;
  return sample;
}

TrainingData::TrainingData(const std::filesystem::path& data, std::size_t limit,
                           const std::array<double, 4>& region, std::uint64_t seed, double pasted,
                           bool with_picture, double thinned, const std::string& rig)
    : data_(data), ids_(list_frames(data)), region_(region), seed_(seed), thinned_(thinned) {
  if (thinned > 0) lidar_ = lidar_of(data, rig);
  if (limit > 0 && ids_.size() > limit) ids_.resize(limit);
  frames_.resize(ids_.size());
  if (pasted > 0)
    sampler_ = std::make_unique<GroundTruthSampler>(data_, ids_, region_, seed_, pasted, with_picture, rig);
}

std::size_t TrainingData::frame_of(std::uint64_t index) const {
  const std::uint64_t count = ids_.size(), epoch = index / count;
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  RandomStream random(seed_, "training order", epoch);
  for (std::size_t i = count; i-- > 1;) std::swap(order[i], order[random.below(static_cast<int>(i) + 1)]);
  return order[index % count];
}

const CompactFrame& TrainingData::frame(std::size_t number) {
  if (!frames_[number].srgb.empty()) return frames_[number];
  CompactFrame small = read_compact(data_, ids_[number], region_);
  const std::size_t bytes =
      small.srgb.size() + small.points.size() * sizeof(LidarPoint) + small.vehicle_mask.size() / 8;
  if (bytes_ + bytes > kFrameMemory) return passing_ = std::move(small);
  bytes_ += bytes;
  return frames_[number] = std::move(small);
}

std::vector<PreparedSample> TrainingData::prepare(std::int64_t step, int batch) {
  std::vector<PreparedSample> samples;
  for (int i = 0; i < batch; ++i) {
    const auto index = static_cast<std::uint64_t>(step) * batch + i;
    const CompactFrame& kept = frame(frame_of(index));
    CompactFrame changed;  // a copy: the frame in memory stays as it was
    const bool changes = sampler_ || thinned_ > 0;
    if (changes) changed = kept;
    if (sampler_) sampler_->augment(changed, index);
    if (thinned_ > 0) thin_lidar(changed, lidar_, thinned_, seed_, index);
    const CompactFrame& small = changes ? changed : kept;
    samples.push_back(prepared_sample(small, random_pose(seed_, index), region_));
  }
  return samples;
}

}  // namespace mirage
