#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/memory.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "detection/consistent_detector.h"
#include "detection/defenses.h"
#include "detection/detector.h"
#include "detection/detector_settings.h"
#include "detection/plugin_detector.h"
#include "detection/process_detector.h"
#include "detection/roi_fusion.h"
#include "scene/frame_source.h"
#include "sensors/lidar_model.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// Weights that a branch starts from, for create's options. InputError if there is no such file.
std::string branch_weights(const fs::path& file, const char* option) {
  if (!file.empty() && !fs::is_regular_file(file))
    throw InputError(file.string(), "", "no such weights file", std::string("check ") + option);
  return file.string();
}

void log_licence_of_real_weights() {
  static std::once_flag warned;
  std::call_once(warned, [] {
    spdlog::warn("weights \"{}\" were fine-tuned on KITTI (CC BY-NC-SA 3.0): for non-commercial use only",
                 kRealWeights);
  });
}

void log_missing_weights(const fs::path& plugin) {
  static std::once_flag said;
  std::call_once(said, [&] {
    spdlog::info("{} is loaded without weights: --weights names none, and there are none for it in {}",
                 plugin.string(), (plugin.parent_path() / "weights").string());
  });
}

/// The in-process detector, or a program. InputError if there is none, or for options that only plugins have.
std::unique_ptr<Detector> load_outside_detector(const DetectorOptions& options) {
  const InProcessDetector* in_process = in_process_detector(options);
  const bool program = is_program(options.detector);
  if (!in_process && !program)
    throw FieldError(
        "detector", options.detector, "stands for a network inside a Python program",
        "call mirage.attack or mirage.evaluate there, with detector=…, or name another detector");
  if (!options.weights.empty())
    throw FieldError("weights", options.weights.string(), "a detector of your own has no weights file here",
                     program ? "leave it out, or name the file in the command" : "leave it out");
  const Defense defense = read_defense(options.defense);
  if (!defense.weights.empty() || defense.has(kConsistency))
    throw FieldError("defense", options.defense,
                     "chooses shipped weights, which a detector of your own does not have",
                     "use none, jpeg:QUALITY, ceiling:HEIGHT or shadows");
  return program ? start_program(options) : in_process->make();
}

/// A detector with the requested matching, restricted to those of its classes that answer for the sought
/// ones.
class MatchingOverride : public DetectorWrapper {
 public:
  MatchingOverride(std::unique_ptr<Detector> inner, MatchBy matching, std::vector<std::string> classes)
      : DetectorWrapper(std::move(inner)), by_(matching), classes_(std::move(classes)) {
    for (const std::string& type : inner_->capabilities().types) {
      const auto place = std::find(classes_.begin(), classes_.end(), type);
      types_.push_back(place == classes_.end() ? -1 : static_cast<int>(place - classes_.begin()));
    }
  }

  Capabilities capabilities() const override {
    Capabilities can = inner_->capabilities();
    can.judged_by = by_;
    can.types = classes_;
    return can;
  }
  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    const std::vector<Detection> found = inner_->forward(view, score_threshold, keep_graph);
    std::vector<Detection> renamed;
    places_.clear();
    count_ = found.size();
    for (std::size_t i = 0; i < count_; ++i) {
      const int type = types_.at(as_size(found[i].type));
      if (type < 0) continue;
      places_.push_back(i);
      renamed.push_back(found[i]);
      renamed.back().type = type;
    }
    return renamed;
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    std::vector<double> all(count_, 0.0);
    for (std::size_t i = 0; i < d_logits.size(); ++i) all[places_.at(i)] = d_logits[i];
    return inner_->backward(all);
  }
  std::unique_ptr<Detector> share() override {
    auto other = inner_->share();
    return other ? std::make_unique<MatchingOverride>(std::move(other), by_, classes_) : nullptr;
  }

 private:
  MatchBy by_;
  std::vector<std::string> classes_;
  std::vector<int> types_;           ///< place in classes_ of each inner class, -1: none
  std::vector<std::size_t> places_;  ///< of the last forward's answers
  std::size_t count_ = 0;            ///< number of the inner detector's answers
};

/// FieldError for a matching that the detector's boxes do not allow, and for a detector without a sought
/// class.
std::unique_ptr<Detector> judged_by(std::unique_ptr<Detector> detector, MatchBy by,
                                    const std::string& classes) {
  const Capabilities can = detector->capabilities();
  const std::vector<std::string> types =
      classes == kEveryClass ? can.types : answering_types(can.types, classes_of(classes));
  if (types.empty())
    throw FieldError("detector", detector->name(), "finds nothing of class " + classes,
                     fmt::format("use one that does; it finds {}", fmt::join(can.types, ", ")));
  if (by == MatchBy::own && can.types == types) return detector;
  const auto demand = [&](bool finds, const char* what, const char* fix) {
    if (!finds)
      throw FieldError("matching", Matching{by}.name(), detector->name() + " finds no " + what, fix);
  };
  if (by == MatchBy::picture) {
    demand(can.finds_picture, "boxes in the picture", "use bev, or leave it out");
  } else if (by != MatchBy::own) {
    demand(can.finds_bev, "boxes in space", "use picture, or leave it out");
    if (by == MatchBy::space) demand(can.finds_heights, "heights of its boxes", "use bev or centre");
  }
  return std::make_unique<MatchingOverride>(std::move(detector), by, types);
}

/// The picture network of a detector without weights of its own.
std::optional<DetectorOptions> picture_of(const DetectorOptions& options) {
  if (options.weights.empty() || !needs_no_weights(options.detector)) return std::nullopt;
  DetectorOptions its = options;
  its.detector = options.weights == kRealWeights ? "camera" : picture_network(options.weights);
  its.defense = "none";
  its.matching = MatchBy::own;
  its.classes = kCars;
  its.clean_memory_mb = 0;  // it gets whole pictures
  return its;
}

/// The detector inside the wrappers that its options name.
std::unique_ptr<Detector> wrap_in_defenses(std::unique_ptr<Detector> detector,
                                           const DetectorOptions& options) {
  for (const std::string& word : read_defense(options.defense).around) {
    if (word == kShadows) {
      detector = with_shadows(std::move(detector));
    } else if (word == kConsistency) {
      const auto others = auxiliary_detectors(options);
      detector = with_consistency(std::move(detector), load_detector(others[0]), load_detector(others[1]));
    } else if (const double height = ceiling_height(word); height > 0) {
      detector = under_ceiling(std::move(detector), height, unit_height_of(options));
    } else {
      detector = behind_jpeg(std::move(detector), jpeg_quality(word));
    }
  }
  return judged_by(std::move(detector), options.matching, options.classes);
}

// The weights of a detector, and of its auxiliary detectors.

/// "-" and the word that shipped weights of a trained defence carry, or those fine-tuned on real frames;
/// empty for the plain ones. InputError for an invalid word.
std::string weights_word(const DetectorOptions& options) {
  const std::string word = read_defense(options.defense).weights;
  if (word.empty()) return options.weights == kRealWeights ? std::string("-") + kRealWeights : "";
  if (word == kRealWeights)  // a family of weights
    throw FieldError("defense", word, "is not a defence", "use --weights real, or name a defence");
  if (!options.weights.empty())
    throw FieldError("defense", word, "chooses weights, and so does --weights", "give one of the two");
  return "-" + word;
}

/// The detector's part in the names of its weights files.
std::string weights_name(const DetectorOptions& options) {
  return is_plugin_path(options.detector) ? fs::path(options.detector).stem().string() : options.detector;
}

/// Path of the weights that ship beside the plugin, by the options' words; the file may be missing.
fs::path shipped_weights(const DetectorOptions& options, const fs::path& plugin) {
  return plugin.parent_path() / "weights" /
         (weights_name(options) + "-" + options.rig + weights_word(options) + ".weights");
}

/// The rest, after `start`, of the names of weights files beside the plugin.
std::vector<std::string> weights_beside(const fs::path& plugin, const std::string& start) {
  std::vector<std::string> words;
  std::error_code none;
  for (const auto& file : fs::directory_iterator(plugin.parent_path() / "weights", none))
    if (const std::string name = file.path().stem().string();
        file.path().extension() == ".weights" && name.starts_with(start))
      words.push_back(name.substr(start.size()));
  std::sort(words.begin(), words.end());
  return words;
}

/// Words of the defences whose weights for this detector and rig ship beside the plugin.
std::vector<std::string> shipped_defenses(const DetectorOptions& options, const fs::path& plugin) {
  std::vector<std::string> words = weights_beside(plugin, weights_name(options) + "-" + options.rig + "-");
  std::erase(words, kRealWeights);  // a family of weights
  return words;
}

fs::path find_weights(const DetectorOptions& options, const fs::path& plugin) {
  const bool real = options.weights == kRealWeights;
  const std::string word = weights_word(options);
  if (needs_no_weights(options.detector)) {  // --weights is a picture network's (roi_fusion.h)
    if (!word.empty() && !real)
      throw FieldError("defense", options.defense,
                       "chooses shipped weights, and the detector " + options.detector + " has none",
                       "use none, ceiling:HEIGHT or shadows");
    return {};
  }
  fs::path file = real || options.weights.empty() ? shipped_weights(options, plugin) : options.weights;
  if (fs::is_regular_file(file)) return file;
  // If there are weights for another rig, one of these may be meant.
  if (is_plugin_path(options.detector) && options.weights.empty() && word.empty() &&
      weights_beside(plugin, weights_name(options) + "-").empty())
    return {};
  if (real)
    throw InputError(file.string(), "",
                     "there are no shipped weights of " + weights_name(options) + " for the rig " +
                         options.rig + " that were fine-tuned on real frames",
                     "leave --weights out, or give a file (one named real as ./real)");
  if (options.weights.empty() && is_shipped_detector(options.detector) && weights_are_code(options.detector))
    throw FieldError("weights", "", "the detector " + options.detector + " is a model of yours",
                     "name the file that you exported: --weights MODEL");
  const std::string missing =
      "no shipped weights of " + weights_name(options) + " for the rig " + options.rig;
  if (options.weights.empty() && word.empty())
    throw InputError(
        file.string(), "", "there are " + missing,
        fs::exists(file.parent_path())
            ? "name a weights file with --weights (one of another rig may do), or train one with mirage train"
            : "install mirage_weights, the wheel beside this one, or name a file with --weights");
  if (options.weights.empty()) {
    const std::string defense = word.substr(1);
    std::vector<std::string> defenses = untrained_defenses();
    for (const std::string& trained : shipped_defenses(options, plugin)) defenses.push_back(trained);
    throw FieldError("defense", options.defense, missing + " with the defence " + defense,
                     use_one_of(defense, defenses, "--weights with a file of mirage defend"));
  }
  const std::string name = options.weights.string();
  throw InputError(file.string(), "", "no such weights file",
                   use_one_of(name, {kRealWeights}, "a file, or leave --weights out"));
}

bool is_consistent(const DetectorOptions& options) {
  return read_defense(options.defense).has(kConsistency);
}

}  // namespace

DetectorOptions for_data(DetectorOptions options, const FrameSource& source) {
  options.rig = data_rig(source.data, source.rig);
  const std::vector<std::string> around = read_defense(options.defense).around;
  if (std::ranges::any_of(around, [](const std::string& word) { return ceiling_height(word) > 0; }))
    options.unit_height = lidar_of(source.data, source.rig).height;
  options.classes = source.placement.victim == Victim::object ? kEveryClass : source.classes;
  return options;
}

double unit_height_of(const DetectorOptions& options) {
  if (options.unit_height > 0) return options.unit_height;
  return read_lidar_model(shipped_file("scenes/rigs/" + options.rig + ".toml")).height;
}

std::vector<std::string> answering_types(const std::vector<std::string>& types,
                                         const std::vector<std::string>& sought) {
  constexpr const char *kCar = "Car", *kThing = "Misc";
  const auto has = [&](const std::vector<std::string>& list, const std::string& type) {
    return std::find(list.begin(), list.end(), type) != list.end();
  };
  std::vector<std::string> answering;
  for (const std::string& type : sought) {
    const bool as_car = is_vehicle_type(type) || !has(types, kThing);
    const std::string word = has(types, type) ? type : as_car ? kCar : kThing;
    if (has(types, word) && !has(answering, word)) answering.push_back(word);
  }
  return answering;
}

fs::path plugin_file(const DetectorOptions& options) {
  if (is_plugin_path(options.detector)) {
    if (!fs::exists(options.detector))
      throw InputError(options.detector, "", "no such detector plugin", "check --detector");
    return fs::absolute(options.detector);
  }
  const ShippedPlugin* plugin = shipped_plugin(kDetectorPlugins, options.detector);
  if (plugin && fs::exists(plugin->file)) return plugin->file;
  std::vector<std::string> words;
  for (const ShippedPlugin& shipped : shipped_plugins(kDetectorPlugins))
    words.insert(words.end(), shipped.words.begin(), shipped.words.end());
  if (plugin || words.empty())
    throw InputError(
        plugin ? plugin->file.string() : built_file("plugins").string(), "", "the detector plugin is missing",
        "build it with MIRAGE_DETECTORS=ON (make build); onnx takes Debian 13's libonnxruntime-dev");
  throw unknown_word("detector", options.detector, words, "a plugin (*.so)");
}

int default_clean_memory() {
  return static_cast<int>(std::min<std::size_t>(machine_memory() / ranks_here() / 64 >> 20, 2048));
}

std::unique_ptr<Detector> load_detector(const DetectorOptions& given_options) {
  DetectorOptions options = given_options;
  if (options.clean_memory_mb < 0) options.clean_memory_mb = default_clean_memory();
  options.clean_memory_mb /= 1 + static_cast<int>(auxiliary_detectors(options).size());
  if (is_outside(options)) return wrap_in_defenses(load_outside_detector(options), options);
  const fs::path plugin = plugin_file(options);
  const bool by_path = is_plugin_path(options.detector);
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
  if (!options.fresh && options.weights == kRealWeights) log_licence_of_real_weights();
  if (!options.fresh && by_path && weights.empty()) {
    if (options.start)
      throw FieldError("weights", "", "the training starts from some, and " + options.detector + " has none",
                       "name a file with --weights");
    log_missing_weights(plugin);
  }
  auto detector = open_detector(plugin, by_path ? "" : options.detector, settings.dump(), weights);
  if (const Capabilities can = detector->capabilities(); !can.finds_bev && !can.finds_picture)
    throw InputError(plugin.string(), "capabilities", "the detector finds no boxes",
                     "let it tell MIRAGE_FINDS_BEV or MIRAGE_FINDS_PICTURE");
  if (const auto picture = picture_of(options))
    detector = with_picture(std::move(detector), load_detector(*picture));
  return wrap_in_defenses(std::move(detector), options);
}

fs::path weights_file(const DetectorOptions& options) {
  return options.fresh ? fs::path() : find_weights(options, plugin_file(options));
}

std::vector<DetectorOptions> auxiliary_detectors(const DetectorOptions& options) {
  std::vector<DetectorOptions> all;
  const auto picture = picture_of(options);
  if (!is_consistent(options)) return picture ? std::vector{*picture} : all;
  for (const char* word : {"lidar", "camera"}) {
    DetectorOptions& its = all.emplace_back();
    its.detector = word;
    its.seed = options.seed;
    its.threads = options.threads;
    its.rig = options.rig;
    its.precision = options.precision;
    its.locality = options.locality;
    its.clean_memory_mb = options.clean_memory_mb;
    if (options.weights != kRealWeights) continue;
    its.weights = kRealWeights;  // if there are any
    if (!fs::exists(shipped_weights(its, plugin_file(its)))) its.weights.clear();
  }
  if (picture) all.push_back(*picture);
  return all;
}

void check_known_options(const DetectorOptions& options, bool has_clean) {
  const auto knows = [](const DetectorOptions& its) {
    return !is_outside(its) && !(is_shipped_detector(its.detector) &&
                                 (weights_are_code(its.detector) || needs_no_weights(its.detector)));
  };
  const bool acts = knows(options) || std::ranges::any_of(auxiliary_detectors(options), knows);
  const std::string why = "has no effect on the detector " + options.detector;
  if (!acts && options.precision != kFloat)
    throw FieldError("precision", options.precision, why, "leave it out");
  if (options.locality > 0 && !(acts && has_clean))
    throw FieldError("locality", fmt::format("{:g}", options.locality),
                     acts ? "has no effect here: each frame is looked at as a whole" : why, "leave it out");
}

std::string weights_hash(const DetectorOptions& options) {
  const fs::path weights = weights_file(options);
  std::string hash = file_hash(weights.empty() ? plugin_file(options) : weights);
  const std::vector<DetectorOptions> others = auxiliary_detectors(options);
  for (const DetectorOptions& other : others) hash += file_hash(weights_file(other));
  return others.empty() ? hash : content_hash(hash);
}

}  // namespace mirage
