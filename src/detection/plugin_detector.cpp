#include "detection/plugin_detector.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <deque>
#include <utility>
#include <vector>

#include "base/files.h"
#include "base/plugins.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "detection/detector_abi.h"
#include "detection/detector_abi3.h"
#include "detection/process_detector.h"
#include "scene/data/data_set.h"

namespace mirage {
namespace {

constexpr const char* kEntry = "mirage_detector_api";
constexpr const char* kRebuild = "rebuild the plugin";

/// An instance of a plugin with its weights, by the table of one version.
template <class Api>
struct PluginInstance {
  std::filesystem::path file;
  const Api* api = nullptr;
  std::string name;
  std::filesystem::path weights;  ///< that the user gave; empty for fresh ones
  void* instance = nullptr;
};

/// A detector of either version. Functions that its table lacks are a Failure.
template <class Api>
class PluginDetectorBase : public Detector {
 public:
  /// Takes the instance over, and destroys it at the end.
  explicit PluginDetectorBase(PluginInstance<Api> plugin) : plugin_(std::move(plugin)) {}
  PluginDetectorBase(const PluginDetectorBase&) = delete;
  PluginDetectorBase& operator=(const PluginDetectorBase&) = delete;
  ~PluginDetectorBase() override { plugin_.api->destroy(plugin_.instance); }

  std::string name() const override { return plugin_.name; }
  Capabilities capabilities() const override { return capabilities_; }
  std::uint64_t weights_version() const override { return *version_; }

  void save(const std::filesystem::path& file, bool with_optimiser) override {
    demand(plugin_.api->save, "save");
    const std::filesystem::path temporary = file.string() + ".part";
    if (file.has_parent_path()) make_output_folder(file.parent_path());
    call("save", plugin_.api->save, temporary.c_str(), with_optimiser);
    replace_file(temporary, file);
  }

 protected:
  /// function(instance, given…, error, its size), called `name`. Failure, or InputError naming the weights.
  template <class Function, class... Given>
  void call(const char* name, Function* function, Given... given) {
    const auto work = [&](char* error) {
      return function(plugin_.instance, given..., error, kPluginErrorSize);
    };
    run_plugin(plugin_.file, name, work, plugin_.weights);
  }
  /// Failure naming `what` if the table lacks the function.
  template <class Function>
  void demand(Function* function, const char* what) const {
    if (!function)
      throw Failure(plugin_.file.string(), std::string("has no ") + what, "use another detector for that");
  }
  /// One training step on samples as the interface has them.
  template <class Sample>
  TrainingLoss trained(const std::vector<Sample>& raw, double learning_rate) {
    std::array<float, 3> loss{};
    call("train_step", plugin_.api->train_step, raw.data(), static_cast<std::int64_t>(raw.size()),
         static_cast<float>(learning_rate), loss.data());
    ++*version_;
    return {loss[0], loss[1], loss[2]};
  }
  /// One more instance, on the same weights and with their count of training steps; null if it cannot.
  template <class Self>
  std::unique_ptr<Detector> with_shared_weights() {
    if (!plugin_.api->share) return nullptr;
    PluginInstance<Api> other = plugin_;
    const auto share = [&](char* error) {
      other.instance = plugin_.api->share(plugin_.instance, error, kPluginErrorSize);
      return other.instance ? 0 : 1;
    };
    run_plugin(plugin_.file, "share", share, plugin_.weights);
    auto shared = std::make_unique<Self>(std::move(other));
    shared->version_ = version_;
    return shared;
  }
  /// To be called with each input, to which backward() then refers.
  void keep(const SensorView& view, bool keep_graph) {
    kept_width_ = view.image ? view.image->width : 0, kept_height_ = view.image ? view.image->height : 0;
    kept_points_ = view.points.size();
    kept_watched_ = capabilities_.knows_presence && keep_graph ? view.watched.size() : 0;
  }
  SensorGradient zero_gradient() const {
    SensorGradient gradient;
    if (kept_width_ > 0 && kept_height_ > 0) gradient.image = ImageF(kept_width_, kept_height_, 3);
    gradient.points.resize(kept_points_);
    gradient.presence.resize(kept_watched_);
    return gradient;
  }
  /// The file that errors name: the weights, or without weights the plugin.
  std::string who() const { return (plugin_.weights.empty() ? plugin_.file : plugin_.weights).string(); }

  PluginInstance<Api> plugin_;
  Capabilities capabilities_;
  BoxRows rows_;                          ///< of the last forward: a plugin need not keep to the threshold
  int kept_width_ = 0, kept_height_ = 0;  // of the last input
  std::size_t kept_points_ = 0, kept_watched_ = 0;
  std::shared_ptr<std::atomic<std::uint64_t>> version_ = std::make_shared<std::atomic<std::uint64_t>>(0);
};

void copy_matrix(const Eigen::Affine3d& transform, double (&out)[12]) {
  Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> matrix(out);
  matrix = transform.matrix().topRows<3>();
}

/// Memory for the gradients of the first camera and the first LiDAR; null for a sensor without data.
std::array<float*, 2> places_of_first(SensorGradient& gradient) {
  return {gradient.image.empty() ? nullptr : gradient.image.data.data(),
          gradient.points.empty() ? nullptr : gradient.points.front().data()};
}

ImageF feature_map(const float* values, std::int64_t columns, std::int64_t rows) {
  ImageF image(static_cast<int>(columns), static_cast<int>(rows), 1);
  std::copy_n(values, image.data.size(), image.data.begin());
  return image;
}

/// A view as the plugin gets it: the sensors that it reads. Lives as long as the pass.
class RawFrame {
 public:
  /// InputError where the plugin reads a sensor by name that the view lacks.
  RawFrame(const SensorView& view, const Capabilities& can, const std::string& who,
           const Eigen::Affine3d& ego_from_given = Eigen::Affine3d::Identity())
      : sensors_(sensors(view, can, who)) {
    const auto reads = [&](const SensorData& sensor) {
      const bool named = can.names(sensor.name);
      if (sensor.kind == SensorData::Kind::other) return named;
      if (!(sensor.kind == SensorData::Kind::camera ? can.reads_image : can.reads_points)) return false;
      return can.reads.empty() || named;
    };
    for (std::size_t i = 0; i < sensors_.size(); ++i) {
      if (!reads(sensors_[i])) continue;
      places_.push_back(i);
      raw_.push_back(raw(sensors_[i], ego_from_given));
    }
    if (view.frame) id_ = view.frame->id;
    frame_ = {id_.c_str(), "", 0, {}, raw_.data(), static_cast<std::int64_t>(raw_.size())};
    Transform world_from_ego = Transform::Identity();
    if (view.frame && view.frame->moment) {
      sequence_ = view.frame->moment->sequence;
      frame_.sequence = sequence_.c_str();
      frame_.time = view.frame->moment->time;
      world_from_ego = view.frame->moment->world_from_ego;
    }
    copy_matrix(world_from_ego, frame_.world_from_ego);
  }
  RawFrame(const RawFrame&) = delete;
  RawFrame& operator=(const RawFrame&) = delete;

  const MirageFrame& frame() const { return frame_; }
  const std::string& sequence() const { return sequence_; }
  /// The place in sensors() of each sensor that the plugin reads.
  const std::vector<std::size_t>& places() const { return places_; }
  const MirageSensor& at(std::size_t i) const { return raw_.at(i); }
  std::size_t values(std::size_t i) const {
    const auto& shape = raw_.at(i).shape;
    return as_size(shape[0] * shape[1] * shape[2]);
  }

 private:
  static MirageSensor raw(const SensorData& sensor, const Eigen::Affine3d& ego_from_given) {
    MirageSensor raw{};
    raw.name = sensor.name.c_str();
    raw.time = sensor.time;
    copy_matrix(Eigen::Affine3d(sensor.sensor_from_ego.matrix()) * ego_from_given, raw.sensor_from_ego);
    if (sensor.kind == SensorData::Kind::lidar) {
      raw.kind = MIRAGE_LIDAR;
      raw.data = floats_of(sensor.points).data();
      raw.shape[0] = static_cast<std::int64_t>(sensor.points.size()), raw.shape[1] = 4, raw.shape[2] = 1;
      return raw;
    }
    if (sensor.kind == SensorData::Kind::other) {
      raw.kind = MIRAGE_OTHER;
      raw.data = sensor.values.data();
      std::copy(sensor.shape.begin(), sensor.shape.end(), std::begin(raw.shape));
      return raw;
    }
    raw.kind = MIRAGE_CAMERA;
    raw.shape[2] = 3;
    if (sensor.image && !sensor.image->empty()) {
      raw.data = sensor.image->data.data();
      raw.shape[0] = sensor.image->height, raw.shape[1] = sensor.image->width;
    }
    const PinholeCamera& camera = sensor.camera;
    const double intrinsics[9] = {camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1};
    std::copy(std::begin(intrinsics), std::end(intrinsics), raw.intrinsics);
    return raw;
  }

  std::vector<SensorData> sensors_;
  std::vector<std::size_t> places_;
  std::vector<MirageSensor> raw_;
  std::string id_, sequence_;
  MirageFrame frame_{};
};

MirageLabel raw_label(const BevBox& box, bool counts) {
  MirageLabel label{};
  label.x = static_cast<float>(box.x), label.y = static_cast<float>(box.y);
  label.length = static_cast<float>(box.length), label.width = static_cast<float>(box.width);
  label.yaw = static_cast<float>(box.yaw), label.counts = counts;
  return label;
}

MirageLabel raw_label(const PictureBox& box, bool counts) {
  MirageLabel label{};
  label.left = static_cast<float>(box.left), label.top = static_cast<float>(box.top);
  label.right = static_cast<float>(box.right), label.bottom = static_cast<float>(box.bottom);
  label.counts = counts;
  return label;
}

class PluginDetector : public PluginDetectorBase<MirageDetectorApi> {
 public:
  explicit PluginDetector(PluginInstance<MirageDetectorApi> plugin) : PluginDetectorBase(std::move(plugin)) {
    const MirageCapabilities* raw = nullptr;
    call_plugin(plugin_.file, "capabilities", [&] { raw = plugin_.api->capabilities(plugin_.instance); });
    if (!raw || raw->type_count < 1 || !raw->types || (raw->sensor_count > 0 && !raw->sensors))
      throw InputError(plugin_.file.string(), "capabilities", "tells no class, or nothing at all", kRebuild);
    if (!(raw->region[0] < raw->region[1] && raw->region[2] < raw->region[3]))
      throw InputError(plugin_.file.string(), "region", "is not x_min, x_max, y_min, y_max", kRebuild);
    const auto has = [&](std::uint32_t flag) { return (raw->flags & flag) != 0; };
    Capabilities& can = capabilities_;
    can.reads_image = (raw->kinds & MIRAGE_CAMERA) != 0, can.reads_points = (raw->kinds & MIRAGE_LIDAR) != 0;
    can.finds_bev = has(MIRAGE_FINDS_BEV), can.finds_picture = has(MIRAGE_FINDS_PICTURE);
    can.finds_heights = can.finds_bev && has(MIRAGE_FINDS_HEIGHTS);
    can.has_gradients = has(MIRAGE_HAS_GRADIENTS), can.remembers = has(MIRAGE_REMEMBERS);
    can.knows_presence = has(MIRAGE_KNOWS_PRESENCE);
    if (has(MIRAGE_HAS_LOCAL_PASSES)) can.why_whole = raw->why_whole ? raw->why_whole : "";
    can.reads.assign(raw->sensors, raw->sensors + std::max<std::int64_t>(0, raw->sensor_count));
    can.types.clear();
    for (std::int64_t i = 0; i < raw->type_count; ++i) can.types.push_back(kitti_type(raw->types[i]));
    std::copy(std::begin(raw->region), std::end(raw->region), region_.begin());
    if ((can.has_gradients && !plugin_.api->backward) || (can.remembers && !plugin_.api->reset))
      throw InputError(plugin_.file.string(), kEntry, "a function that its flags promise is missing",
                       kRebuild);
  }

  std::array<double, 4> region() const override { return region_; }

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    const RawFrame raw(view, capabilities_, who());
    if (capabilities_.remembers && !view.continues) call("reset", plugin_.api->reset, raw.sequence().c_str());
    MiragePass pass{&raw.frame(), static_cast<float>(score_threshold), keep_graph, nullptr, nullptr, 0};
    keep(view, keep_graph);
    if (kept_watched_ > 0) {
      pass.watched = floats_of(view.watched).data();
      pass.watched_count = static_cast<std::int64_t>(kept_watched_);
    }
    std::unique_ptr<RawFrame> clean;
    std::vector<std::int32_t> changed(4 * raw.places().size());
    MirageClean as_recorded{};
    // The changes of other sensors are unknown.
    if (view.clean && view.others.empty() && capabilities_.why_whole.empty()) {
      SensorView before = view;
      before.image = view.clean->image, before.points = view.clean->points;
      clean = std::make_unique<RawFrame>(before, capabilities_, who());
      const PixelRect& rect = view.clean->changed;
      for (std::size_t i = 0; i < changed.size(); i += 4)
        changed[i] = rect.u0, changed[i + 1] = rect.v0, changed[i + 2] = rect.u1, changed[i + 3] = rect.v1;
      as_recorded = {&clean->frame(), view.clean->key, changed.data()};
      pass.clean = &as_recorded;
    }
    const MirageDetection* found = nullptr;
    std::int64_t count = 0;
    call("forward", plugin_.api->forward, &pass, &found, &count);
    kept_sensors_.clear(), kept_others_.clear();
    for (const SensorData& other : view.others) kept_others_.push_back(other.name);
    for (std::size_t i = 0; i < raw.places().size(); ++i)
      kept_sensors_.push_back({raw.at(i).name, raw.places()[i], raw.values(i)});
    std::vector<Detection> detections;
    for (std::int64_t i = 0; i < count; ++i) detections.push_back(detection(found[i], raw, i));
    check_proposals(detections, capabilities_.matching(), who());
    detections = rows_.proposals(std::move(detections), score_threshold);
    // Labels are clipped at the picture's border, and so must detections be.
    for (std::size_t i = 0; i < raw.places().size(); ++i)
      for (Detection& detection : detections)
        if (detection.camera == static_cast<int>(raw.places()[i]))
          detection.picture = within(detection.picture, static_cast<int>(raw.at(i).shape[1]),
                                     static_cast<int>(raw.at(i).shape[0]));
    return detections;
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    if (!capabilities_.has_gradients)
      throw Failure(plugin_.file.string(), "has no gradients", "use another detector to attack");
    const std::vector<float> raw = rows_.of_rows(d_logits);
    SensorGradient gradient = zero_gradient();
    const auto first = places_of_first(gradient);
    std::vector<MirageGradient> named;
    for (const KeptSensor& sensor : kept_sensors_) {
      float* data = nullptr;
      if (sensor.place < first.size()) {
        data = first[sensor.place];
      } else if (std::ranges::find(kept_others_, sensor.name) != kept_others_.end()) {
        auto& other = gradient.others[sensor.name];  // the view's, not its frame's as recorded
        other.resize(sensor.values);
        data = other.empty() ? nullptr : other.data();
      }
      if (data) named.push_back({sensor.name.c_str(), data});
    }
    call("backward", plugin_.api->backward, raw.data(), static_cast<std::int64_t>(raw.size()), named.data(),
         static_cast<std::int64_t>(named.size()),
         gradient.presence.empty() ? nullptr : gradient.presence.data());
    return gradient;
  }

  TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) override {
    demand(plugin_.api->train_step, "train_step");
    std::vector<std::unique_ptr<RawFrame>> frames;
    std::vector<std::vector<MirageLabel>> labels;
    std::vector<MirageTrainingFrame> raw;
    for (const TrainingSample& sample : samples) {
      frames.push_back(
          std::make_unique<RawFrame>(sample.input, capabilities_, who(), sample.recorded_from_augmented));
      std::vector<MirageLabel>& of = labels.emplace_back();
      const auto add = [&](const auto& boxes, bool counts) {
        for (const auto& box : boxes) of.push_back(raw_label(box, counts));
      };
      add(sample.boxes, true), add(sample.ignore, false);
      add(sample.picture_boxes, true), add(sample.picture_ignore, false);
      raw.push_back({frames.back()->frame(), of.data(), static_cast<std::int64_t>(of.size()),
                     sample.vehicle_mask.empty() ? nullptr : sample.vehicle_mask.data(), sample.picture_key});
    }
    return trained(raw, learning_rate);
  }

  std::unique_ptr<Detector> share() override { return with_shared_weights<PluginDetector>(); }

  ImageFeatures image_features(const SensorView& view) override {
    if (!plugin_.api->image_features || !capabilities_.reads_image) return {};
    const RawFrame frame(view, capabilities_, who());
    MirageFeatureMaps raw{};
    call("image_features", plugin_.api->image_features, &frame.frame(), &raw);
    return {feature_map(raw.map, raw.columns, raw.rows), raw.stride,
            feature_map(raw.bev, raw.bev_columns, raw.bev_rows), raw.cell};
  }

 private:
  /// InputError for a class or a camera that does not exist.
  Detection detection(const MirageDetection& found, const RawFrame& frame, std::int64_t place) const {
    Detection made;
    made.box = {{found.x, found.y, found.length, found.width, found.yaw},
                static_cast<double>(found.z) - found.height / 2.0,
                found.height};
    made.logit = found.logit;
    made.type = found.type, made.identity = found.identity;
    if (!std::isnan(found.velocity[0]))
      made.velocity = Vec3d(found.velocity[0], found.velocity[1], found.velocity[2]);
    const auto bad = [&](const std::string& problem, const char* fix) {
      return InputError(who(), fmt::format("box {}", place), problem, fix);
    };
    if (found.type < 0 || found.type >= static_cast<std::int32_t>(capabilities_.types.size()))
      throw bad(fmt::format("class {} is not one of {}", found.type, capabilities_.types.size()),
                "give an index into the classes of its capabilities");
    made.picture = {found.left, found.top, found.right, found.bottom};
    if (!capabilities_.finds_picture || area(made.picture) == 0) return made;
    const auto camera = as_size(found.camera);
    if (found.camera < 0 || camera >= frame.places().size() || frame.at(camera).kind != MIRAGE_CAMERA)
      throw bad(fmt::format("sensor {} is not a camera", found.camera),
                "give an index into the frame's sensors");
    made.camera = static_cast<int>(frame.places()[camera]);
    return made;
  }

  struct KeptSensor {
    std::string name;
    std::size_t place, values;
  };
  std::vector<KeptSensor> kept_sensors_;  ///< of the last input
  std::vector<std::string> kept_others_;  ///< of its view
  std::array<double, 4> region_{};
};

/// Makes an instance by the table of its version.
template <class Made, class Api>
std::unique_ptr<Detector> instance_of(const std::filesystem::path& file, const Api* api,
                                      const std::string& name, const std::string& options_json,
                                      const std::filesystem::path& weights) {
  PluginInstance<Api> plugin{file, api, name.empty() ? api->name : name, weights, nullptr};
  char error[kPluginErrorSize] = "";
  plugin.instance = call_plugin(file, "create", [&] {
    return api->create(options_json.c_str(), weights.empty() ? nullptr : weights.c_str(), error,
                       kPluginErrorSize);
  });
  if (!plugin.instance) {
    const std::string why = error[0] ? error : "the plugin gave no reason";
    throw InputError((weights.empty() ? file : weights).string(), "", why,
                     weights.empty() ? "check the detector's options" : "check --weights and --detector");
  }
  return std::make_unique<Made>(std::move(plugin));
}

/// The first field of both versions' tables.
struct AnyVersion {
  std::uint32_t abi_version;
};

// The adapter of plugins of version 3 (detector_abi3.h): one picture, one sweep, boxes of cars without
// heights.

MirageSensorInput raw_input(const SensorView& view) {
  MirageSensorInput input{};
  if (view.image && !view.image->empty()) {
    input.image = view.image->data.data();
    input.width = view.image->width;
    input.height = view.image->height;
  }
  input.points = floats_of(view.points).data();
  input.point_count = static_cast<std::int64_t>(view.points.size());
  if (view.calibration) {
    const auto matrix = pixel_from_velo(*view.calibration);
    std::copy(matrix.begin(), matrix.end(), input.pixel_from_velo);
  }
  return input;
}

MirageBox raw_box(const BevBox& box) {
  return {static_cast<float>(box.x), static_cast<float>(box.y), static_cast<float>(box.length),
          static_cast<float>(box.width), static_cast<float>(box.yaw)};
}

MiragePictureBox raw_box(const PictureBox& box) {
  return {static_cast<float>(box.left), static_cast<float>(box.top), static_cast<float>(box.right),
          static_cast<float>(box.bottom)};
}

class Version3Detector : public PluginDetectorBase<MirageDetectorApi3> {
 public:
  explicit Version3Detector(PluginInstance<MirageDetectorApi3> plugin)
      : PluginDetectorBase(std::move(plugin)) {
    const auto* api = plugin_.api;
    std::uint32_t flags = 0;
    call_plugin(plugin_.file, "capabilities", [&] { flags = api->capabilities(plugin_.instance); });
    capabilities_ = {(flags & MIRAGE_READS_IMAGE) != 0, (flags & MIRAGE_READS_POINTS) != 0,
                     (flags & MIRAGE_FINDS_BEV) != 0, (flags & MIRAGE_FINDS_PICTURE) != 0,
                     (flags & MIRAGE_KNOWS_PRESENCE) != 0};
    if (((flags & MIRAGE_KNOWS_CHANGES) && (!api->why_whole || !api->forward_changed)) ||
        ((flags & MIRAGE_KNOWS_PRESENCE) && (!api->watch || !api->presence)))
      throw InputError(plugin_.file.string(), kEntry, "a function that its flags promise is missing",
                       kRebuild);
    if (flags & MIRAGE_KNOWS_CHANGES)
      call_plugin(plugin_.file, "why_whole",
                  [&] { capabilities_.why_whole = api->why_whole(plugin_.instance); });
  }

  std::array<double, 4> region() const override {
    std::array<float, 4> raw{};
    call_plugin(plugin_.file, "region", [&] { plugin_.api->region(plugin_.instance, raw.data()); });
    return {raw[0], raw[1], raw[2], raw[3]};
  }

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    const MirageSensorInput input = raw_input(view);
    const MirageProposal* raw_proposals = nullptr;
    std::int64_t count = 0;
    keep(view, keep_graph);
    if (capabilities_.knows_presence && keep_graph)
      call("watch", plugin_.api->watch, floats_of(view.watched).data(),
           static_cast<std::int64_t>(kept_watched_));
    const auto least = static_cast<float>(score_threshold);
    if (view.clean && capabilities_.why_whole.empty()) {
      const MirageSensorInput clean = raw_input({view.clean->image, view.clean->points, view.calibration});
      const PixelRect& rect = view.clean->changed;
      const MirageChange change = {&clean, view.clean->key, rect.u0, rect.v0, rect.u1, rect.v1};
      call("forward_changed", plugin_.api->forward_changed, &input, &change, least, keep_graph,
           &raw_proposals, &count);
    } else {
      call("forward", plugin_.api->forward, &input, least, keep_graph, &raw_proposals, &count);
    }
    std::vector<Detection> proposals;
    for (std::int64_t i = 0; i < count; ++i) {
      const MirageBox& b = raw_proposals[i].box;
      const MiragePictureBox& p = raw_proposals[i].picture;
      proposals.push_back(
          {{b.x, b.y, b.length, b.width, b.yaw}, raw_proposals[i].logit, {p.left, p.top, p.right, p.bottom}});
    }
    check_proposals(proposals, capabilities_.matching(), who());
    proposals = rows_.proposals(std::move(proposals), score_threshold);
    // Labels are clipped at the picture's border, and so must detections be.
    for (Detection& proposal : proposals)
      proposal.picture = within(proposal.picture, kept_width_, kept_height_);
    return proposals;
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    const std::vector<float> raw = rows_.of_rows(d_logits);
    SensorGradient gradient = zero_gradient();
    const auto [d_image, d_points] = places_of_first(gradient);
    call("backward", plugin_.api->backward, raw.data(), static_cast<std::int64_t>(raw.size()), d_image,
         d_points);
    if (kept_watched_ > 0)
      call("presence", plugin_.api->presence, gradient.presence.data(),
           static_cast<std::int64_t>(kept_watched_));
    return gradient;
  }

  TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) override {
    std::vector<MirageSample> raw(samples.size());
    std::deque<std::vector<MirageBox>> boxes;
    std::deque<std::vector<MiragePictureBox>> in_pictures;
    const auto give = [](const auto& from, auto& kept, auto*& values, std::int64_t& count) {
      auto& its = kept.emplace_back();
      for (const auto& box : from) its.push_back(raw_box(box));
      values = its.data(), count = static_cast<std::int64_t>(its.size());
    };
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const TrainingSample& sample = samples[i];
      raw[i].input = raw_input(sample.input);
      Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> matrix(raw[i].input.pixel_from_velo);
      matrix = (matrix * sample.recorded_from_augmented.matrix()).eval();
      give(sample.boxes, boxes, raw[i].boxes, raw[i].box_count);
      give(sample.ignore, boxes, raw[i].ignore, raw[i].ignore_count);
      give(sample.picture_boxes, in_pictures, raw[i].picture_boxes, raw[i].picture_box_count);
      give(sample.picture_ignore, in_pictures, raw[i].picture_ignore, raw[i].picture_ignore_count);
      raw[i].vehicle_mask = sample.vehicle_mask.empty() ? nullptr : sample.vehicle_mask.data();
      raw[i].picture_key = sample.picture_key;
    }
    return trained(raw, learning_rate);
  }

  std::unique_ptr<Detector> share() override { return with_shared_weights<Version3Detector>(); }

  ImageFeatures image_features(const SensorView& view) override {
    if (!plugin_.api->image_features || !capabilities_.reads_image) return {};
    const MirageSensorInput input = raw_input(view);
    MirageImageFeatures raw{};
    call("image_features", plugin_.api->image_features, &input, &raw);
    return {feature_map(raw.map, raw.columns, raw.rows), raw.stride,
            feature_map(raw.bev, raw.bev_columns, raw.bev_rows), raw.cell};
  }
};

}  // namespace

std::unique_ptr<Detector> open_detector(const std::filesystem::path& file, const std::string& name,
                                        const std::string& options_json,
                                        const std::filesystem::path& weights) {
  const auto* any = open_plugin<AnyVersion>(file, kEntry, "detection/detector_abi.h",
                                            {MIRAGE_DETECTOR_ABI, MIRAGE_DETECTOR_ABI_3});
  const InputError missing(file.string(), kEntry, "a function is missing", kRebuild);
  if (any->abi_version == MIRAGE_DETECTOR_ABI_3) {
    const auto* api = reinterpret_cast<const MirageDetectorApi3*>(any);
    if (!api->create || !api->destroy || !api->region || !api->forward || !api->backward ||
        !api->train_step || !api->save || !api->capabilities)
      throw missing;
    return instance_of<Version3Detector>(file, api, name, options_json, weights);
  }
  const auto* api = reinterpret_cast<const MirageDetectorApi*>(any);
  if (!api->create || !api->destroy || !api->capabilities || !api->forward) throw missing;
  return instance_of<PluginDetector>(file, api, name, options_json, weights);
}

}  // namespace mirage
