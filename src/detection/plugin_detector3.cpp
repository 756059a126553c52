// The adapter of plugins of version 3 (detector_abi3.h): one picture, one sweep, boxes of cars without
// heights.
#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "detection/plugin_detector.h"
#include "detection/points_in_view.h"

namespace mirage {
namespace {

MirageSensorInput raw_input(const SensorView& view) {
  static_assert(sizeof(LidarPoint) == 4 * sizeof(float));
  MirageSensorInput input{};
  if (view.image && !view.image->empty()) {
    input.image = view.image->data.data();
    input.width = view.image->width;
    input.height = view.image->height;
  }
  input.points = reinterpret_cast<const float*>(view.points.data());
  input.point_count = static_cast<std::int64_t>(view.points.size());
  if (view.calibration) {
    const auto matrix = pixel_from_velo(*view.calibration);
    std::copy(matrix.begin(), matrix.end(), input.pixel_from_velo);
  }
  return input;
}

std::vector<MirageBox> raw_boxes(const std::vector<BevBox>& boxes) {
  std::vector<MirageBox> raw;
  raw.reserve(boxes.size());
  for (const BevBox& box : boxes)
    raw.push_back({static_cast<float>(box.x), static_cast<float>(box.y), static_cast<float>(box.length),
                   static_cast<float>(box.width), static_cast<float>(box.yaw)});
  return raw;
}

std::vector<MiragePictureBox> raw_boxes(const std::vector<PictureBox>& boxes) {
  std::vector<MiragePictureBox> raw;
  raw.reserve(boxes.size());
  for (const PictureBox& box : boxes)
    raw.push_back({static_cast<float>(box.left), static_cast<float>(box.top), static_cast<float>(box.right),
                   static_cast<float>(box.bottom)});
  return raw;
}

/// The ground truth of one sample as the plugin gets it; the input is the caller's to fill in.
struct RawTruth {
  explicit RawTruth(const TrainingSample& sample)
      : boxes(raw_boxes(sample.boxes)),
        ignore(raw_boxes(sample.ignore)),
        picture_boxes(raw_boxes(sample.picture_boxes)),
        picture_ignore(raw_boxes(sample.picture_ignore)) {}
  void give(MirageSample& sample) const {
    const auto set = [](const auto& from, auto*& values, std::int64_t& count) {
      values = from.data();
      count = static_cast<std::int64_t>(from.size());
    };
    set(boxes, sample.boxes, sample.box_count);
    set(ignore, sample.ignore, sample.ignore_count);
    set(picture_boxes, sample.picture_boxes, sample.picture_box_count);
    set(picture_ignore, sample.picture_ignore, sample.picture_ignore_count);
  }
  std::vector<MirageBox> boxes, ignore;
  std::vector<MiragePictureBox> picture_boxes, picture_ignore;
};

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
      throw InputError(plugin_.file.string(), "mirage_detector_api",
                       "a function that its flags promise is missing", "rebuild the plugin");
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
    const bool watches = capabilities_.knows_presence && keep_graph;
    kept_watched_ = watches ? view.watched.size() : 0;
    if (watches)
      run("watch", [&](char* error) {
        return plugin_.api->watch(plugin_.instance, reinterpret_cast<const float*>(view.watched.data()),
                                  static_cast<std::int64_t>(kept_watched_), error, kPluginErrorSize);
      });
    if (view.clean && capabilities_.why_whole.empty()) {
      const MirageSensorInput clean = raw_input({view.clean->image, view.clean->points, view.calibration});
      const PixelRect& rect = view.clean->changed;
      const MirageChange change = {&clean, view.clean->key, rect.u0, rect.v0, rect.u1, rect.v1};
      run("forward_changed", [&](char* error) {
        return plugin_.api->forward_changed(plugin_.instance, &input, &change,
                                            static_cast<float>(score_threshold), keep_graph, &raw_proposals,
                                            &count, error, kPluginErrorSize);
      });
    } else {
      run("forward", [&](char* error) {
        return plugin_.api->forward(plugin_.instance, &input, static_cast<float>(score_threshold), keep_graph,
                                    &raw_proposals, &count, error, kPluginErrorSize);
      });
    }
    kept_width_ = view.image ? view.image->width : 0;
    kept_height_ = view.image ? view.image->height : 0;
    kept_points_ = view.points.size();
    std::vector<Detection> proposals;
    for (std::int64_t i = 0; i < count; ++i) {
      const MirageBox& b = raw_proposals[i].box;
      const MiragePictureBox& p = raw_proposals[i].picture;
      proposals.push_back(
          {{b.x, b.y, b.length, b.width, b.yaw}, raw_proposals[i].logit, {p.left, p.top, p.right, p.bottom}});
    }
    check_proposals(proposals, capabilities_.matching(),
                    (plugin_.weights.empty() ? plugin_.file : plugin_.weights).string());
    // Labels end at the picture's border, and what they are compared with must, too.
    for (Detection& proposal : proposals)
      proposal.picture = within(proposal.picture, kept_width_, kept_height_);
    return proposals;
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    const std::vector<float> raw(d_logits.begin(), d_logits.end());
    SensorGradient gradient;
    if (kept_width_ > 0 && kept_height_ > 0) gradient.image = ImageF(kept_width_, kept_height_, 3);
    gradient.points.resize(kept_points_);
    float* d_image = gradient.image.empty() ? nullptr : gradient.image.data.data();
    float* d_points = gradient.points.empty() ? nullptr : gradient.points.data()->data();
    run("backward", [&](char* error) {
      return plugin_.api->backward(plugin_.instance, raw.data(), static_cast<std::int64_t>(raw.size()),
                                   d_image, d_points, error, kPluginErrorSize);
    });
    gradient.presence.resize(kept_watched_);
    if (kept_watched_ > 0)
      run("presence", [&](char* error) {
        return plugin_.api->presence(plugin_.instance, gradient.presence.data(),
                                     static_cast<std::int64_t>(kept_watched_), error, kPluginErrorSize);
      });
    return gradient;
  }

  TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) override {
    std::vector<MirageSample> raw(samples.size());
    std::vector<RawTruth> truths;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const TrainingSample& sample = samples[i];
      raw[i].input = raw_input(sample.input);
      Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> matrix(raw[i].input.pixel_from_velo);
      matrix = (matrix * sample.data_from_sample.matrix()).eval();
      truths.emplace_back(sample);  // moved with its vectors when the list grows: their memory stays
      truths.back().give(raw[i]);
      raw[i].vehicle_mask = sample.vehicle_mask.empty() ? nullptr : sample.vehicle_mask.data();
      raw[i].picture_key = sample.picture_key;
    }
    return trained(raw, learning_rate);
  }

  std::unique_ptr<Detector> share() override { return shared<Version3Detector>(); }

  ImageFeatures image_features(const SensorView& view) override {
    if (!plugin_.api->image_features || !capabilities_.reads_image) return {};
    const MirageSensorInput input = raw_input(view);
    MirageImageFeatures raw{};
    run("image_features", [&](char* error) {
      return plugin_.api->image_features(plugin_.instance, &input, &raw, error, kPluginErrorSize);
    });
    ImageFeatures features{ImageF(raw.columns, raw.rows, 1), raw.stride,
                           ImageF(raw.bev_columns, raw.bev_rows, 1), raw.cell};
    std::copy_n(raw.map, features.map.data.size(), features.map.data.begin());
    std::copy_n(raw.bev, features.bev.data.size(), features.bev.data.begin());
    return features;
  }

 private:
  int kept_width_ = 0, kept_height_ = 0;  // of the last input
  std::size_t kept_points_ = 0, kept_watched_ = 0;
};

}  // namespace

std::unique_ptr<Detector> plugin_detector(PluginInstance<MirageDetectorApi3> plugin) {
  return std::make_unique<Version3Detector>(std::move(plugin));
}

}  // namespace mirage
