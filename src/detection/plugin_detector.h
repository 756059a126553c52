// Detectors from shared libraries: what those of both versions of the interface share, and how they are
// opened.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "base/files.h"
#include "base/plugins.h"
#include "detection/detector.h"
#include "detection/detector_abi.h"
#include "detection/detector_abi3.h"

namespace mirage {

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
    run("save", [&](char* error) {
      return plugin_.api->save(plugin_.instance, temporary.c_str(), with_optimiser, error, kPluginErrorSize);
    });
    replace_file(temporary, file);
  }

 protected:
  /// run_plugin with this library and its weights; messages name `function`.
  template <class Work>
  void run(const char* function, const Work& work) {
    run_plugin(plugin_.file, function, work, plugin_.weights);
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
    run("train_step", [&](char* error) {
      return plugin_.api->train_step(plugin_.instance, raw.data(), static_cast<std::int64_t>(raw.size()),
                                     static_cast<float>(learning_rate), loss.data(), error, kPluginErrorSize);
    });
    ++*version_;
    return {loss[0], loss[1], loss[2]};
  }
  /// One more instance, on the same weights and with their count of training steps; null if it cannot.
  template <class Self>
  std::unique_ptr<Detector> shared() {
    if (!plugin_.api->share) return nullptr;
    PluginInstance<Api> other = plugin_;
    run("share", [&](char* error) {
      other.instance = plugin_.api->share(plugin_.instance, error, kPluginErrorSize);
      return other.instance ? 0 : 1;
    });
    auto shared = std::make_unique<Self>(std::move(other));
    shared->version_ = version_;
    return shared;
  }

  PluginInstance<Api> plugin_;
  Capabilities capabilities_;
  std::shared_ptr<std::atomic<std::uint64_t>> version_ = std::make_shared<std::atomic<std::uint64_t>>(0);
};

/// The detector of an instance. InputError for a table, or an instance, that breaks its interface.
std::unique_ptr<Detector> plugin_detector(PluginInstance<MirageDetectorApi> plugin);
/// The adapter of plugins of version 3.
std::unique_ptr<Detector> plugin_detector(PluginInstance<MirageDetectorApi3> plugin);

/// Opens the plugin of either version and makes an instance. `name`: empty for the plugin's own; `weights`:
/// empty for fresh ones. Errors as load_detector's.
std::unique_ptr<Detector> open_detector(const std::filesystem::path& file, const std::string& name,
                                        const std::string& options_json,
                                        const std::filesystem::path& weights);

}  // namespace mirage
