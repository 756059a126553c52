#include "scene/depth/learned_depth.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <nlohmann/json.hpp>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/installation.h"
#include "base/parallel.h"
#include "base/plugins.h"
#include "base/words.h"
#include "scene/depth/depth_abi.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char* kDepthPlugins = "depth";

bool is_path(const std::string& backend) {
  return fs::path(backend).extension() == ".so";
}

fs::path find_plugin(const std::string& backend) {
  if (is_path(backend)) {
    if (!fs::exists(backend))
      throw InputError(backend, "", "no such depth completion plugin", "check --depth");
    return fs::absolute(backend);
  }
  const ShippedPlugin* plugin = shipped_plugin(kDepthPlugins, backend);
  if (plugin && fs::exists(plugin->file)) return plugin->file;
  std::vector<std::string> known{kDefaultDepth};
  for (const ShippedPlugin& shipped : shipped_plugins(kDepthPlugins))
    known.insert(known.end(), shipped.words.begin(), shipped.words.end());
  if (plugin || known.size() == 1)
    throw InputError(plugin ? plugin->file.string() : built_file("plugins").string(), "",
                     "the depth completion plugin is missing",
                     "build it with MIRAGE_DETECTORS=ON (make build), or use --depth ip-basic");
  throw unknown_word("depth", backend, known, "a plugin (*.so)");
}

fs::path find_weights(const DepthOptions& options, const fs::path& plugin) {
  const fs::path file = options.weights.empty()
                            ? plugin.parent_path() / "weights" / (plugin.stem().string() + "-depth.weights")
                            : options.weights;
  if (fs::is_regular_file(file)) return file;
  throw InputError(file.string(), "",
                   options.weights.empty() ? "the shipped weights are missing" : "no such weights file",
                   "name others, or train some with mirage train depth");
}

/// Returns that are no positive finite number become none.
ImageF cleaned(const ImageF& sparse) {
  ImageF clean = sparse;
  for (float& value : clean.data)
    if (!(value > 0) || !std::isfinite(value)) value = 0;
  return clean;
}

void check_pixels(const ImageF& image, const ImageF& sparse) {
  if (image.width != sparse.width || image.height != sparse.height || image.channels != 3 ||
      sparse.channels != 1)
    throw InputError("depth completion", "image", "is not an RGB picture of the sparse depth's size",
                     "give both of one frame");
  for (std::size_t i = 0; i < image.data.size(); ++i)
    if (!std::isfinite(image.data[i])) {
      const auto pixel = static_cast<long>(i / 3);
      throw InputError("depth completion",
                       "image, pixel (" + std::to_string(pixel % image.width) + ", " +
                           std::to_string(pixel / image.width) + ")",
                       "not a finite number", "check the picture's source");
    }
}

MirageDepthInput raw_input(const ImageF& image, const ImageF& sparse) {
  return {image.data.data(), sparse.data.data(), sparse.width, sparse.height};
}

class PluginDepth : public LearnedDepth {
 public:
  PluginDepth(fs::path file, const MirageDepthApi* api, void* instance)
      : file_(std::move(file)), api_(api), instance_(instance) {}
  PluginDepth(const PluginDepth&) = delete;
  PluginDepth& operator=(const PluginDepth&) = delete;
  ~PluginDepth() override { api_->destroy(instance_); }

  std::string name() const override { return api_->name; }

  ImageF complete(const ImageF& image, const ImageF& sparse) const override {
    if (sparse.empty()) return {};
    check_pixels(image, sparse);
    const ImageF clean = cleaned(sparse);
    const MirageDepthInput input = raw_input(image, clean);
    ImageF dense(sparse.width, sparse.height, 1);
    {
      const std::scoped_lock lock(mutex_);
      run_plugin(file_, "complete", [&](char* error) {
        return api_->complete(instance_, &input, dense.data.data(), error, kPluginErrorSize);
      });
    }
    for (float& value : dense.data) {
      if (!std::isfinite(value))
        throw Failure(file_.string(), "complete gave a depth that is not finite",
                      "check the weights and the input");
      if (!(value > 0)) value = kFarDepth;
    }
    return dense;
  }

  std::array<float, 3> train_step(std::span<const DepthSample> samples, double learning_rate) override {
    std::vector<MirageDepthSample> raw;
    for (const DepthSample& sample : samples) {
      check_pixels(sample.image, sample.sparse);
      if (sample.truth.data.size() != sample.sparse.data.size())
        throw InputError("depth completion", "truth", "is not of the sparse depth's size",
                         "give both of one frame");
      raw.push_back({raw_input(sample.image, sample.sparse), sample.truth.data.data()});
    }
    std::array<float, 3> loss{};
    const std::scoped_lock lock(mutex_);
    run_plugin(file_, "train_step", [&](char* error) {
      return api_->train_step(instance_, raw.data(), static_cast<std::int64_t>(raw.size()),
                              static_cast<float>(learning_rate), loss.data(), error, kPluginErrorSize);
    });
    return loss;
  }

  void save(const fs::path& file, bool with_optimiser) override {
    const fs::path temporary = file.string() + ".part";
    if (file.has_parent_path()) make_output_folder(file.parent_path());
    run_plugin(file_, "save", [&](char* error) {
      return api_->save(instance_, temporary.c_str(), with_optimiser, error, kPluginErrorSize);
    });
    replace_file(temporary, file);
  }

 private:
  fs::path file_;
  const MirageDepthApi* api_;
  void* instance_;
  mutable std::mutex mutex_;  // an instance is used by one thread at a time
};

std::unique_ptr<DepthCompletion> classical(const std::string& backend) {
  for (const bool multi_scale : {false, true})
    for (const auto blur : {IpBasicOptions::Blur::gaussian, IpBasicOptions::Blur::bilateral})
      for (const bool extrapolate : {false, true}) {
        auto completion = std::make_unique<IpBasic>(IpBasicOptions{multi_scale, blur, extrapolate});
        if (completion->name() == backend) return completion;
      }
  return nullptr;
}

}  // namespace

bool is_shipped_depth(const std::string& backend) {
  return shipped_plugin(kDepthPlugins, backend) != nullptr || classical(backend) != nullptr;
}

std::unique_ptr<LearnedDepth> load_learned_depth(const DepthOptions& options) {
  const fs::path file = find_plugin(options.backend);
  const auto* api =
      open_plugin<MirageDepthApi>(file, "mirage_depth_api", "scene/depth/depth_abi.h", {MIRAGE_DEPTH_ABI});
  if (!api->create || !api->destroy || !api->complete || !api->train_step || !api->save)
    throw InputError(file.string(), "mirage_depth_api", "a function is missing", "rebuild the plugin");
  const fs::path weights = options.fresh ? fs::path() : find_weights(options, file);
  const nlohmann::json settings = {{"seed", options.seed},
                                   {"threads", options.threads > 0 ? options.threads : thread_count()}};
  const std::string text = settings.dump();
  char error[kPluginErrorSize] = "";
  void* instance = call_plugin(file, "create", [&] {
    return api->create(text.c_str(), options.fresh ? nullptr : weights.c_str(), error, kPluginErrorSize);
  });
  if (!instance)
    throw InputError(options.fresh ? file.string() : weights.string(), "",
                     error[0] ? error : "the plugin gave no reason",
                     options.fresh ? "check the plugin's options" : "check the weights");
  return std::make_unique<PluginDepth>(file, api, instance);
}

std::string depth_identity(const DepthOptions& options) {
  if (classical(options.backend)) return options.backend;
  const fs::path plugin = find_plugin(options.backend);
  const std::string weights =
      options.fresh ? "fresh " + std::to_string(options.seed) : file_hash(find_weights(options, plugin));
  return file_hash(plugin) + " " + weights + " " +
         std::to_string(options.threads > 0 ? options.threads : thread_count());
}

std::unique_ptr<DepthCompletion> load_depth_completion(const DepthOptions& options) {
  if (auto completion = classical(options.backend)) return completion;
  return load_learned_depth(options);
}

}  // namespace mirage
