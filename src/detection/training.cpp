#include "detection/training.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/files.h"
#include "base/image.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/random.h"
#include "base/training_loop.h"
#include "base/types.h"
#include "detection/car_in_picture.h"
#include "detection/detector_settings.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
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

constexpr std::size_t kFrameMemory = std::size_t{3} << 30;  // bytes for frames kept between epochs

/// Identifies the rig by content, as lidar_of takes it; "" if no sample needs it.
std::string rig_hash(const TrainingOptions& options) {
  if (options.thin_lidar == 0 && options.ground_truth_sampling == 0) return "";
  if (!options.rig.empty()) return file_hash(rig_file(options.rig));
  const std::filesystem::path own = options.data / "rig.toml";
  return std::filesystem::exists(own) ? file_hash(own) : data_rig(options.data);
}

/// The settings that must agree for a run to resume.
RunIdentity identity(const TrainingOptions& options, std::span<const std::string> frames) {
  nlohmann::json fields = fields_json(options), lacking = lacking_json<TrainingOptions>();
  fields["bfloat16"] = options.precision == kBfloat16;
  fields["frames"] = frames.size();
  fields["frames_hash"] = training_frames_hash(options.data, frames);
  fields["rig_hash"] = rig_hash(options);
  if (is_plugin_path(options.detector)) fields["plugin_hash"] = file_hash(options.detector);
  for (const char* key : {"frames_hash", "rig_hash", "plugin_hash"})
    if (fields.contains(key)) lacking[key] = fields[key];  // older runs lack it
  for (const auto& [key, file] : {std::pair("start", options.start), std::pair("camera", options.camera),
                                  std::pair("lidar", options.lidar)}) {
    fields[key] = file.empty() ? "" : file_hash(file);
    lacking[key] = "";
  }
  return {fields, lacking};
}

/// FieldError for options that a shipped network does not have, or that have nothing to act on.
void check_network_options(const TrainingOptions& options) {
  struct NetworkOption {
    const char* name;
    bool given;
    std::vector<std::string> detectors;  ///< that have it
  };
  const std::vector<std::string> ours = {"lidar", "camera", "painted", "fusion", "late", "refined"},
                                 joined(ours.begin() + 2, ours.end()),
                                 with_camera(ours.begin() + 1, ours.end());
  if (std::ranges::find(ours, options.detector) == ours.end()) return;  // a plugin's own matter
  for (const NetworkOption& option : {NetworkOption{"camera", !options.camera.empty(), joined},
                                      {"lidar", !options.lidar.empty(), joined},
                                      {"joint", options.joint, with_camera},
                                      {"heads", options.heads, {"camera"}}})
    if (option.given && std::ranges::find(option.detectors, options.detector) == option.detectors.end())
      throw FieldError(option.name, "", "has no effect on the detector " + options.detector,
                       fmt::format("leave it out, or train {}", fmt::join(option.detectors, ", ")));
  if (options.joint && options.start.empty() && options.camera.empty() && options.lidar.empty())
    throw FieldError("joint", "", "trains what other weights gave, and none are named",
                     "name them with --start, --camera or --lidar, or leave it out");
  if (options.heads && options.start.empty())
    throw FieldError("heads", "", "trains a part of weights that are there, and none are named",
                     "name them with --start, or leave it out");
}

void check_options(const TrainingOptions& options) {
  check_fields(options);
  if (options.validate_every > 0 && options.validation.empty())
    throw FieldError("validate_every", "", "needs a data set to validate on", "name it with --validation");
  if (options.joint && options.heads)
    throw FieldError("heads", "", "trains less than --joint does", "give one of the two");
  if (options.keep_start > 0 && options.start.empty())
    throw FieldError("keep_start", "", "needs weights to start from", "name them with --start");
  check_network_options(options);
}

/// The detector that a new training starts with.
DetectorOptions starting_detector(const TrainingOptions& options) {
  DetectorOptions load{options.detector, options.start, options.start.empty(), options.seed, options.threads};
  load.start = !options.start.empty();
  load.precision = options.precision;
  load.camera = options.camera;
  load.lidar = options.lidar;
  if (options.joint) load.parts = {"joint"};
  if (options.heads) load.parts = {"heads"};
  if (options.keep_start > 0) load.parts.push_back(fmt::format("keep-start={}", options.keep_start));
  return load;
}

/// The same with the weights of a checkpoint.
DetectorOptions resumed_detector(DetectorOptions load, const std::filesystem::path& weights) {
  load.fresh = load.start = false;
  load.camera = load.lidar = "";
  load.weights = weights;
  return load;
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
    // Look-alikes lose as much: a gap in the sweep must not mean a car.
    const auto thin = [&](const ObjectBoxes& object) {
      if (random.uniform() < kObjects) lose_returns(frame.points, object.box.bev, kept, random);
    };
    std::ranges::for_each(frame.truth.space.boxes, thin);
    std::ranges::for_each(frame.truth.space.look_alikes, thin);
  }
  keep(frame.points, kept);
}

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
    small.vehicle_mask.push_back(k >= 1 && k <= frame.labels.size() &&
                                 is_vehicle_type(frame.labels[k - 1].type));
  return small;
}

TrainingSample PreparedSample::view() const {
  TrainingSample sample = truth;
  sample.input = {&image, points, &calibration};
  sample.vehicle_mask = vehicle_mask;
  return sample;
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

BevBox moved(const BevBox& box, const Eigen::Affine3d& augmented_from_recorded) {
  const Vec3d centre = augmented_from_recorded * Vec3d(box.x, box.y, 0);
  const Vec3d heading = augmented_from_recorded.linear() * Vec3d(std::cos(box.yaw), std::sin(box.yaw), 0);
  const double scale = heading.norm();
  return {centre.x(), centre.y(), box.length * scale, box.width * scale,
          std::atan2(heading.y(), heading.x())};
}

PreparedSample prepared_sample(const CompactFrame& small, const Eigen::Affine3d& augmented_from_recorded,
                               const std::array<double, 4>& region) {
  PreparedSample sample;
  sample.image = linear_image(small.srgb, small.width, small.height);
  sample.calibration = small.calibration;
  TrainingSample& truth = sample.truth;
  truth.recorded_from_augmented = augmented_from_recorded.inverse();
  const Eigen::Affine3f move = augmented_from_recorded.cast<float>();
  for (const LidarPoint& point : small.points) {
    const Vec3f p = move * point.position();
    sample.points.push_back({p.x(), p.y(), p.z(), point.reflectance});
  }
  for (const ObjectBoxes& object : small.truth.space.boxes) {
    const BevBox there = moved(object.box.bev, augmented_from_recorded);
    const bool inside =
        there.x >= region[0] && there.x < region[1] && there.y >= region[2] && there.y < region[3];
    (inside ? truth.boxes : truth.ignore).push_back(there);
  }
  for (const ObjectBoxes& object : small.truth.space.ignore)
    truth.ignore.push_back(moved(object.box.bev, augmented_from_recorded));
  for (const ObjectBoxes& object : small.truth.picture.boxes) truth.picture_boxes.push_back(object.picture);
  for (const ObjectBoxes& object : small.truth.picture.ignore) truth.picture_ignore.push_back(object.picture);
  sample.vehicle_mask.assign(small.vehicle_mask.begin(), small.vehicle_mask.end());
  truth.picture_key = small.picture_key;
  return sample;
}

TrainingData::TrainingData(const std::filesystem::path& data, std::size_t limit,
                           const std::array<double, 4>& region, std::uint64_t seed, double pasted,
                           bool with_picture, double thinned, const std::string& rig)
    : data_(data),
      ids_(list_frames(data, limit)),
      region_(region),
      seed_(seed),
      frames_(ids_.size()),
      thinned_(thinned) {
  if (thinned > 0) lidar_ = lidar_of(data, rig);
  if (pasted > 0)
    sampler_ = std::make_unique<GroundTruthSampler>(data_, ids_, region_, seed_, pasted, with_picture, rig);
}

std::size_t TrainingData::frame_of(std::uint64_t index) const {
  const std::uint64_t count = ids_.size(), epoch = index / count;
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  RandomStream random(seed_, "training order", epoch);
  shuffle(order, random);
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
    const auto index = static_cast<std::uint64_t>(step) * as_size(batch) + as_size(i);
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

TrainingResult train_detector(const TrainingOptions& options) {
  check_options(options);
  make_output_folder(options.out);
  const std::vector<std::string> frames = list_frames(options.data, options.frames);
  check_labels(options.data, frames, "training");
  const DetectorOptions load = starting_detector(options);
  auto detector = load_detector(load);
  TrainingData data(options.data, options.frames, detector->region(), options.seed,
                    options.ground_truth_sampling, detector->capabilities().reads_image, options.thin_lidar,
                    options.rig);
  TrainingLoop loop(options, identity(options, frames));
  if (loop.goes_on()) detector = load_detector(resumed_detector(load, loop.state().weights));
  const auto& losses = loop.state().losses;  // total, score, box

  const auto validate = [&] {
    Detector* const judge = detector.get();
    DetectionRun run = detect_data_set({&judge, 1}, options.validation, options.validation_frames);
    loop.log({{"ap50", run.at50.average_precision},
              {"ap70", run.at70.average_precision},
              {"recall50", run.at50.recall}});
    spdlog::info("step {} validation AP 0.5 {:.1f} % AP 0.7 {:.1f} % recall 0.5 {:.1f} %", loop.state().step,
                 100 * run.at50.average_precision, 100 * run.at70.average_precision, 100 * run.at50.recall);
    return run;
  };
  SamplePrefetcher<std::vector<PreparedSample>> ahead(
      [&](std::int64_t step) { return data.prepare(step, options.batch); });
  TrainingWork work;
  work.learn = [&](std::int64_t step, double rate) {
    const std::vector<PreparedSample> samples = ahead.take(step);
    const TrainingLoss loss = detector->train_step(views_of(samples), rate);
    return std::array{loss.total, loss.score, loss.box};
  };
  work.save = [&](const std::filesystem::path& file) { detector->save(file, true); };
  work.note = [&] {
    return fmt::format("loss {:.3f} (score {:.3f}, box {:.3f})", losses[0], losses[1], losses[2]);
  };
  work.report = [&](double rate) {
    loop.log({{"rate", rate}, {"loss", losses[0]}, {"score_loss", losses[1]}, {"box_loss", losses[2]}});
    spdlog::info("step {} rate {:.2e} loss {:.4f} score {:.4f} box {:.4f} {:.0f} s", loop.state().step, rate,
                 losses[0], losses[1], losses[2], loop.state().seconds);
  };
  work.validate_every = options.validate_every;
  work.validate = validate;

  TrainingResult result;
  result.seconds_per_step = loop.run(work);
  result.steps = loop.state().step;
  result.seconds = loop.state().seconds;
  result.loss = {losses[0], losses[1], losses[2]};
  result.weights = options.out / (options.detector + ".weights");
  detector->save(result.weights, false);
  if (!options.validation.empty()) {
    if (options.keep_start > 0) detector = load_detector(resumed_detector(load, result.weights));
    const DetectionRun run = validate();
    result.validated = true;
    result.at50 = run.at50;
    result.at70 = run.at70;
  }
  return result;
}

}  // namespace mirage
