// Which weights a detector is loaded with, and those of the witnesses beside it.
#include <algorithm>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/words.h"
#include "detection/defense_words.h"
#include "detection/detector.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// "-" and the word that shipped weights of a trained defence carry, or those fine-tuned on real frames;
/// empty for the plain ones. InputError for what can be no such word.
std::string weights_word(const DetectorOptions& options) {
  const std::string word = read_defense(options.defense).weights;
  if (word.empty()) return options.weights == kRealWeights ? std::string("-") + kRealWeights : "";
  if (word == kRealWeights)  // a family of weights
    throw FieldError("defense", word, "is no defence", "use --weights real, or name a defence");
  if (!options.weights.empty())
    throw FieldError("defense", word, "chooses weights, and so does --weights", "give one of the two");
  return "-" + word;
}

/// The detector's part of its weights' names.
std::string weights_name(const DetectorOptions& options) {
  return fs::path(options.detector).extension() == ".so" ? fs::path(options.detector).stem().string()
                                                         : options.detector;
}

/// Where weights that ship beside the plugin lie, by the options' words; whether they are there or not.
fs::path shipped_weights(const DetectorOptions& options, const fs::path& plugin) {
  return plugin.parent_path() / "weights" /
         (weights_name(options) + "-" + options.rig + weights_word(options) + ".weights");
}

/// Words of the defences that weights ship for beside the plugin: the detector's on this rig.
std::vector<std::string> shipped_defenses(const DetectorOptions& options, const fs::path& plugin) {
  const std::string start = weights_name(options) + "-" + options.rig + "-";
  std::vector<std::string> words;
  std::error_code none;
  for (const auto& file : fs::directory_iterator(plugin.parent_path() / "weights", none))
    if (const std::string name = file.path().stem().string();
        file.path().extension() == ".weights" && name.starts_with(start))
      words.push_back(name.substr(start.size()));
  std::erase(words, kRealWeights);  // a family of weights
  std::sort(words.begin(), words.end());
  return words;
}

fs::path find_weights(const DetectorOptions& options, const fs::path& plugin) {
  const bool real = options.weights == kRealWeights;
  const std::string word = weights_word(options);
  fs::path file = real || options.weights.empty() ? shipped_weights(options, plugin) : options.weights;
  if (fs::is_regular_file(file)) return file;
  if (real)
    throw InputError(file.string(), "",
                     "there are no shipped weights of " + weights_name(options) + " for the rig " +
                         options.rig + " that were fine-tuned on real frames",
                     "leave --weights out, or give a file (one named real as ./real)");
  if (options.weights.empty() && options.detector == "torchscript")
    throw FieldError("weights", "", "a torchscript detector has no shipped weights",
                     "name the model that you exported: --weights MODEL.pt");
  const std::string missing =
      "no shipped weights of " + weights_name(options) + " for the rig " + options.rig;
  if (options.weights.empty() && word.empty())
    throw InputError(
        file.string(), "", "there are " + missing,
        "name a weights file with --weights (one of another rig may do), or train one with mirage train");
  if (options.weights.empty()) {
    const std::string defense = word.substr(1);
    std::vector<std::string> known = untrained_defenses();
    for (const std::string& trained : shipped_defenses(options, plugin)) known.push_back(trained);
    throw FieldError("defense", options.defense, missing + " with the defence " + defense,
                     use_one_of(defense, known, "--weights with a file of mirage defend"));
  }
  const std::string name = options.weights.string();
  throw InputError(file.string(), "", "no such weights file",
                   use_one_of(name, {kRealWeights}, "a file, or leave --weights out"));
}

}  // namespace

fs::path weights_file(const DetectorOptions& options) {
  return options.fresh ? fs::path() : find_weights(options, plugin_file(options));
}

namespace {

bool is_consistent(const DetectorOptions& options) {
  return read_defense(options.defense).has(kConsistency);
}

}  // namespace

std::vector<DetectorOptions> witnesses(const DetectorOptions& options) {
  std::vector<DetectorOptions> all;
  if (!is_consistent(options)) return all;
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
    its.weights = kRealWeights;  // where there are any
    if (!fs::exists(shipped_weights(its, plugin_file(its)))) its.weights.clear();
  }
  return all;
}

std::string weights_hash(const DetectorOptions& options) {
  std::string hash = file_hash(weights_file(options));
  for (const DetectorOptions& other : witnesses(options)) hash += file_hash(weights_file(other));
  return is_consistent(options) ? content_hash(hash) : hash;
}

}  // namespace mirage
