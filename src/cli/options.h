// Options that every command with a detector shares.
#pragma once

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <set>
#include <string>
#include <vector>

#include "attack/run.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "detection/detector.h"
#include "scene/data/data_rig.h"
#include "simulation/insertion.h"

namespace mirage::cli {

/// The detector's options for a data set, whose rig selects the shipped weights.
inline DetectorOptions with_common(const DetectorOptions& from, const Common& common,
                                   const FrameSource& source) {
  DetectorOptions options = for_data(from, source);
  take_common(options, common);
  return options;
}

/// --trust-run of the commands that read a run folder.
inline void add_trust_option(CLI::App& app, TrustRun& trust) {
  app.add_flag_callback(
      "--trust-run", [&trust] { trust = TrustRun::yes; },
      "load plugins and TorchScript models that the run names; their code runs with your permissions "
      "(default: refused)");
}

/// --score of the commands that judge detections.
inline void add_score_option(CLI::App& app, double& threshold) {
  add_defaulted(app, "--score", threshold, "lowest score at which a box counts as a detection")
      ->check(within(kShare));
}

/// --min-view of the commands that judge an object whose size they do not know.
inline void add_min_view_option(CLI::App& app, double& share) {
  add_defaulted(app, "--min-view", share,
                "a car is judged if at least this share of a reference object, which fills the volume of the "
                "placement, is in view")
      ->check(within(kShare));
}

// Options of the commands that prepare frames, and texts for their tables.

/// --quality, which stands for several other options.
struct QualityOption {
  std::string name;               ///< empty: none was asked for
  const CLI::App* app = nullptr;  ///< knows which options were given, on the command line or in a config file

  /// The present `name` is the default, unless `otherwise` names its source ("the run's").
  void add(CLI::App& command, const std::string& otherwise = "") {
    app = &command;
    auto* option = command.add_option(
        "--quality", name,
        with_default(
            "render quality: draft or default set σ, γ, cut-off and camera samples, unless given by their "
            "own options; exact computes every pixel's coverage exactly, with its derivative",
            otherwise));
    std::vector<std::string> names;
    for (const Quality& quality : qualities()) names.push_back(quality.name);
    option->check(one_of(names));
    if (otherwise.empty()) option->capture_default_str();
  }
  /// In place of a run's.
  void add_to(Overrides& overrides) const {
    if (!name.empty()) overrides["quality"] = name;
  }
  /// Whether the user gave the option.
  bool is_set(const char* option) const {
    const auto* known = app->get_option_no_throw(option);
    return known && known->count() > 0;
  }
  void apply(SimulationSettings& settings) const {
    apply_quality(name, settings, [this](const char* option) { return is_set(option); });
  }
};

/// --lidar-effects: sensor effects on the returns from the object.
struct LidarEffectsOption {
  std::string words;  ///< empty: none was asked for

  /// The present `words` are the default, unless `otherwise` names their source ("the run's").
  void add(CLI::App& command, const std::string& otherwise = "") {
    auto* option = command.add_option("--lidar-effects", words,
                                      with_default("sensor effects on the object's returns: ideal (none), "
                                                   "as-recorded (those of the rig that recorded the data), "
                                                   "unit (noise, drop-out, divergence), or some of "
                                                   "noise,drop-out,dark-loss,divergence,motion,albedo",
                                                   otherwise));
    if (otherwise.empty()) option->capture_default_str();
  }
  /// In place of a run's.
  void add_to(Overrides& overrides) const {
    if (!words.empty()) overrides["lidar_effects"] = words;
  }
  /// Sets the unit's effects, or `recorded` (scene/data/data_rig.h) if `words` ask for those of the sweeps.
  /// `seed` draws them.
  void apply(SimulationSettings& settings, const LidarModel& unit, const std::string& recorded,
             std::uint64_t seed) const {
    if (words.empty()) return;
    settings.lidar_effects = parse_lidar_effects(words == kAsRecorded ? recorded : words, unit.divergence);
    if (settings.lidar_effects.any()) settings.lidar_effects.seed = seed;
  }
  /// InputError for words that apply() would refuse.
  void check() const {
    if (!words.empty() && words != kAsRecorded) parse_lidar_effects(words, Vec2d::Zero());
  }
};

/// For the commands that cache prepared frames (frames/frame_cache.h).
inline void add_cache_note(CLI::App& app) {
  app.footer(
      "Completed depth, fitted roofs, visible host vehicles and detections are cached on disk, keyed by "
      "content. The environment variable MIRAGE_CACHE names the folder (default: $XDG_CACHE_HOME/mirage or "
      "~/.cache/mirage; off: no cache). The cache does not change results.");
}

/// How many roofs were fitted, for the commands' tables.
inline std::string roofs(int fitted, int from_box) {
  return fmt::format("{} fitted, {} from the labelled box", fitted, from_box);
}

/// The options of an insertion: one table for `mirage simulate` and for mirage.insert in Python.
struct InsertionOptions : FrameSource {
  QualityOption quality{"default"};
  LidarEffectsOption lidar_effects{"ideal"};
  SimulationSettings simulation;

  /// `skip`: fields without an option.
  void add(CLI::App& app, std::set<std::string> skip = {}) {
    add_fields(app, static_cast<FrameSource&>(*this), std::move(skip));
    quality.add(app);
    add_fields(app, simulation, {"lidar_gradient"});  // an insertion alone has no detector that knows
    lidar_effects.add(app);
  }
  /// Call it once the options are parsed.
  void apply() {
    quality.apply(simulation);
    lidar_effects.check();
  }
  /// The settings for a sweep of this unit, which has `recorded` effects, with noise drawn by `seed`.
  SimulationSettings for_unit(const LidarModel& unit, const std::string& recorded, std::uint64_t seed) const {
    SimulationSettings settings = simulation;
    lidar_effects.apply(settings, unit, recorded, seed);
    settings.camera_effects.seed = seed;
    return settings;
  }
};

}  // namespace mirage::cli
