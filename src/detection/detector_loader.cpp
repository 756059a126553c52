#include <algorithm>
#include <atomic>
#include <cmath>
#include <mutex>
#include <nlohmann/json.hpp>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/installation.h"
#include "base/logging.h"
#include "base/parallel.h"
#include "base/shared_library.h"
#include "base/words.h"
#include "detection/ceiling_detector.h"
#include "detection/consistent_detector.h"
#include "detection/defense_words.h"
#include "detection/detector.h"
#include "detection/detector_abi.h"
#include "detection/detector_words.h"
#include "detection/given_detector.h"
#include "detection/jpeg_detector.h"
#include "detection/points_in_view.h"
#include "detection/precision.h"
#include "detection/shadow_detector.h"
#include "sensors/lidar_model.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

struct Plugin {
  fs::path file;
  const MirageDetectorApi* api = nullptr;
};

}  // namespace

fs::path plugin_file(const DetectorOptions& options) {
  if (fs::path(options.detector).extension() == ".so") {
    if (!fs::exists(options.detector))
      throw InputError(options.detector, "", "no such detector plugin", "check --detector");
    return fs::absolute(options.detector);
  }
  const ShippedPlugin* plugin = shipped_plugin(kDetectorPlugins, options.detector);
  if (plugin && fs::exists(plugin->file)) return plugin->file;
  std::vector<std::string> known;
  for (const ShippedPlugin& shipped : shipped_plugins(kDetectorPlugins))
    known.insert(known.end(), shipped.words.begin(), shipped.words.end());
  if (plugin || known.empty())
    throw InputError(plugin ? plugin->file.string() : built_file("plugins").string(), "",
                     "the detector plugin is missing", "build it with MIRAGE_DETECTORS=ON (make build)");
  throw unknown_word("detector", options.detector, known, "a plugin (*.so)");
}

namespace {

Plugin open_detector(const fs::path& file) {
  const auto* api = open_plugin<MirageDetectorApi>(file, "mirage_detector_api", "detection/detector_abi.h",
                                                   MIRAGE_DETECTOR_ABI);
  if (!api->create || !api->destroy || !api->region || !api->forward || !api->backward || !api->train_step ||
      !api->save || !api->capabilities)
    throw InputError(file.string(), "mirage_detector_api", "a function is missing", "rebuild the plugin");
  return {file, api};
}

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

class PluginDetector : public Detector {
 public:
  /// `given`: the weights file, empty for fresh weights.
  PluginDetector(Plugin plugin, std::string name, void* instance, fs::path given)
      : plugin_(std::move(plugin)), name_(std::move(name)), instance_(instance), given_(std::move(given)) {
    std::uint32_t flags = 0;
    call_plugin(plugin_.file, "capabilities", [&] { flags = plugin_.api->capabilities(instance_); });
    capabilities_ = {(flags & MIRAGE_READS_IMAGE) != 0, (flags & MIRAGE_READS_POINTS) != 0,
                     (flags & MIRAGE_FINDS_BEV) != 0, (flags & MIRAGE_FINDS_PICTURE) != 0,
                     (flags & MIRAGE_KNOWS_PRESENCE) != 0};
    const auto* api = plugin_.api;
    if (((flags & MIRAGE_KNOWS_CHANGES) && (!api->why_whole || !api->forward_changed)) ||
        ((flags & MIRAGE_KNOWS_PRESENCE) && (!api->watch || !api->presence)))
      throw InputError(plugin_.file.string(), "mirage_detector_api",
                       "a function that its flags promise is missing", "rebuild the plugin");
    if (flags & MIRAGE_KNOWS_CHANGES)
      call_plugin(plugin_.file, "why_whole",
                  [&] { capabilities_.why_whole = plugin_.api->why_whole(instance_); });
  }
  PluginDetector(const PluginDetector&) = delete;
  PluginDetector& operator=(const PluginDetector&) = delete;
  ~PluginDetector() override { plugin_.api->destroy(instance_); }

  std::string name() const override { return name_; }
  Capabilities capabilities() const override { return capabilities_; }

  std::array<double, 4> region() const override {
    std::array<float, 4> raw{};
    call_plugin(plugin_.file, "region", [&] { plugin_.api->region(instance_, raw.data()); });
    return {raw[0], raw[1], raw[2], raw[3]};
  }

  std::vector<Proposal> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    const MirageSensorInput input = raw_input(view);
    const MirageProposal* raw_proposals = nullptr;
    std::int64_t count = 0;
    const bool watches = capabilities_.knows_presence && keep_graph;
    kept_watched_ = watches ? view.watched.size() : 0;
    if (watches)
      run("watch", [&](char* error) {
        return plugin_.api->watch(instance_, reinterpret_cast<const float*>(view.watched.data()),
                                  static_cast<std::int64_t>(kept_watched_), error, kPluginErrorSize);
      });
    if (view.clean && capabilities_.why_whole.empty()) {
      const MirageSensorInput clean = raw_input({view.clean->image, view.clean->points, view.calibration});
      const PixelRect& rect = view.clean->changed;
      const MirageChange change = {&clean, view.clean->key, rect.u0, rect.v0, rect.u1, rect.v1};
      run("forward_changed", [&](char* error) {
        return plugin_.api->forward_changed(instance_, &input, &change, static_cast<float>(score_threshold),
                                            keep_graph, &raw_proposals, &count, error, kPluginErrorSize);
      });
    } else {
      run("forward", [&](char* error) {
        return plugin_.api->forward(instance_, &input, static_cast<float>(score_threshold), keep_graph,
                                    &raw_proposals, &count, error, kPluginErrorSize);
      });
    }
    kept_width_ = view.image ? view.image->width : 0;
    kept_height_ = view.image ? view.image->height : 0;
    kept_points_ = view.points.size();
    std::vector<Proposal> proposals;
    for (std::int64_t i = 0; i < count; ++i) {
      const MirageBox& b = raw_proposals[i].box;
      const MiragePictureBox& p = raw_proposals[i].picture;
      proposals.push_back(
          {{b.x, b.y, b.length, b.width, b.yaw}, raw_proposals[i].logit, {p.left, p.top, p.right, p.bottom}});
    }
    check_proposals(proposals, capabilities_.plane(), (given_.empty() ? plugin_.file : given_).string());
    // Labels end at the picture's border, and what they are compared with must, too.
    for (Proposal& proposal : proposals)
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
      return plugin_.api->backward(instance_, raw.data(), static_cast<std::int64_t>(raw.size()), d_image,
                                   d_points, error, kPluginErrorSize);
    });
    gradient.presence.resize(kept_watched_);
    if (kept_watched_ > 0)
      run("presence", [&](char* error) {
        return plugin_.api->presence(instance_, gradient.presence.data(),
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
    std::array<float, 3> loss{};
    run("train_step", [&](char* error) {
      return plugin_.api->train_step(instance_, raw.data(), static_cast<std::int64_t>(raw.size()),
                                     static_cast<float>(learning_rate), loss.data(), error, kPluginErrorSize);
    });
    ++*version_;
    return {loss[0], loss[1], loss[2]};
  }

  std::uint64_t weights_version() const override { return *version_; }

  std::unique_ptr<Detector> share() override {
    if (!plugin_.api->share) return nullptr;
    void* other = nullptr;
    run("share", [&](char* error) {
      other = plugin_.api->share(instance_, error, kPluginErrorSize);
      return other ? 0 : 1;
    });
    auto shared = std::make_unique<PluginDetector>(plugin_, name_, other, given_);
    shared->version_ = version_;
    return shared;
  }

  ImageFeatures image_features(const SensorView& view) override {
    if (!plugin_.api->image_features || !capabilities_.reads_image) return {};
    const MirageSensorInput input = raw_input(view);
    MirageImageFeatures raw{};
    run("image_features", [&](char* error) {
      return plugin_.api->image_features(instance_, &input, &raw, error, kPluginErrorSize);
    });
    ImageFeatures features{ImageF(raw.columns, raw.rows, 1), raw.stride,
                           ImageF(raw.bev_columns, raw.bev_rows, 1), raw.cell};
    std::copy_n(raw.map, features.map.data.size(), features.map.data.begin());
    std::copy_n(raw.bev, features.bev.data.size(), features.bev.data.begin());
    return features;
  }

  void save(const fs::path& file, bool with_optimiser) override {
    const fs::path temporary = file.string() + ".part";
    if (file.has_parent_path()) make_output_folder(file.parent_path());
    run("save", [&](char* error) {
      return plugin_.api->save(instance_, temporary.c_str(), with_optimiser, error, kPluginErrorSize);
    });
    replace_file(temporary, file);
  }

 private:
  template <class Work>
  void run(const char* function, const Work& work) {
    run_plugin(plugin_.file, function, work, given_);
  }

  Plugin plugin_;
  std::string name_;
  void* instance_;
  Capabilities capabilities_;
  fs::path given_;
  std::shared_ptr<std::atomic<std::uint64_t>> version_ = std::make_shared<std::atomic<std::uint64_t>>(0);
  int kept_width_ = 0, kept_height_ = 0;  // of the last input
  std::size_t kept_points_ = 0, kept_watched_ = 0;
};

}  // namespace

namespace {

/// Weights that a branch starts from, for create's options. InputError if there is no such file.
std::string branch_weights(const fs::path& file, const char* option) {
  if (!file.empty() && !fs::is_regular_file(file))
    throw InputError(file.string(), "", "no such weights file", std::string("check ") + option);
  return file.string();
}

void tell_licence_of_real_weights() {
  static std::once_flag told;
  std::call_once(told, [] {
    spdlog::warn("weights \"{}\" were fine-tuned on KITTI (CC BY-NC-SA 3.0): for non-commercial use only",
                 kRealWeights);
  });
}

}  // namespace

namespace {

/// The host program's own detector. InputError where there is none, or for what only plugins have.
std::unique_ptr<Detector> load_given_detector(const DetectorOptions& options) {
  const GivenDetector* given = given_detector();
  if (!given)
    throw FieldError(
        "detector", options.detector, "stands for a network inside a Python program",
        "call mirage.attack or mirage.evaluate there, with detector=…, or name another detector");
  if (!options.weights.empty())
    throw FieldError("weights", options.weights.string(), "a detector given in Python has no weights file",
                     "leave it out");
  const Defense defense = read_defense(options.defense);
  if (!defense.weights.empty() || defense.has(kConsistency))
    throw FieldError("defense", options.defense, "chooses shipped weights, which a given detector has not",
                     "use none, jpeg:QUALITY, ceiling:HEIGHT or shadows");
  return given->make();
}

/// The detector within what its options name to stand around it.
std::unique_ptr<Detector> defended(std::unique_ptr<Detector> detector, const DetectorOptions& options) {
  for (const std::string& word : read_defense(options.defense).around) {
    if (word == kShadows) {
      detector = with_shadows(std::move(detector));
    } else if (word == kConsistency) {
      const auto others = witnesses(options);
      detector = with_witnesses(std::move(detector), load_detector(others[0]), load_detector(others[1]));
    } else if (const double height = ceiling_height(word); height > 0) {
      const LidarModel unit = read_lidar_model(shipped_file("scenes/rigs/" + options.rig + ".toml"));
      detector = under_ceiling(std::move(detector), height, unit.height);
    } else {
      detector = behind_jpeg(std::move(detector), jpeg_quality(word));
    }
  }
  return detector;
}

}  // namespace

std::unique_ptr<Detector> load_detector(const DetectorOptions& given_options) {
  DetectorOptions options = given_options;
  options.clean_memory_mb /= 1 + static_cast<int>(witnesses(options).size());
  if (is_given(options)) {
    auto detector = load_given_detector(options);
    return defended(std::move(detector), options);
  }
  const Plugin plugin = open_detector(plugin_file(options));
  const bool by_path = fs::path(options.detector).extension() == ".so";
  nlohmann::json settings = {{"seed", options.seed},
                             {"start", options.start},
                             {"precision", usable_precision(options.precision)},
                             {"locality", options.locality},
                             {"parts", options.parts},
                             {"clean_memory_mb", options.clean_memory_mb},
                             {"threads", options.threads > 0 ? options.threads : thread_count()}};
  if (!by_path) settings["modality"] = options.detector;
  if (const auto file = branch_weights(options.camera, "--camera"); !file.empty()) settings["camera"] = file;
  if (const auto file = branch_weights(options.lidar, "--lidar"); !file.empty()) settings["lidar"] = file;
  const fs::path weights = weights_file(options);
  if (!options.fresh && options.weights == kRealWeights) tell_licence_of_real_weights();
  char error[kPluginErrorSize] = "";
  const std::string text = settings.dump();
  void* instance = call_plugin(plugin.file, "create", [&] {
    return plugin.api->create(text.c_str(), options.fresh ? nullptr : weights.c_str(), error,
                              kPluginErrorSize);
  });
  if (!instance) {
    const std::string why = error[0] ? error : "the plugin gave no reason";
    throw InputError(options.fresh ? plugin.file.string() : weights.string(), "", why,
                     options.fresh ? "check the detector's options" : "check --weights and --detector");
  }
  std::unique_ptr<Detector> detector = std::make_unique<PluginDetector>(
      plugin, by_path ? plugin.api->name : options.detector, instance, weights);
  if (const Capabilities can = detector->capabilities(); !can.finds_bev && !can.finds_picture)
    throw InputError(plugin.file.string(), "capabilities", "the detector finds no boxes",
                     "let it tell MIRAGE_FINDS_BEV or MIRAGE_FINDS_PICTURE");
  return defended(std::move(detector), options);
}

}  // namespace mirage
