// mirage depth: scores depth completion back-ends side by side.
#include <memory>

#include "attack/adversary.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/names.h"
#include "cli/command.h"
#include "cli/options.h"
#include "frames/data_check.h"
#include "scene/data/data_rig.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "simulation/depth_score.h"

namespace mirage::cli {
namespace {

struct DepthOptions {
  DepthScoreOptions score;
  std::string backends =
      "ip-basic,ip-basic-bilateral,ip-basic-multiscale,ip-basic-multiscale-bilateral,ip-basic-extrapolated,"
      "guided";
  std::filesystem::path weights;
  std::string rig;
  double hide = -1;
};

/// Null for a figure without pixels.
nlohmann::json to_json(const DepthErrors& e) {
  const auto of = [&](double error) { return e.pixels ? nlohmann::json(error) : nlohmann::json(); };
  return {{"rmse_mm", of(e.rmse)},
          {"mae_mm", of(e.mae)},
          {"irmse_per_km", of(e.irmse)},
          {"imae_per_km", of(e.imae)},
          {"pixels", e.pixels}};
}

nlohmann::json to_json(const RoofPixels& r) {
  const auto share = [&](std::size_t count) {
    return r.pixels ? nlohmann::json(static_cast<double>(count) / static_cast<double>(r.pixels))
                    : nlohmann::json();
  };
  return {{"pixels", r.pixels},
          {"wrongly_kept", share(r.wrongly_kept)},
          {"wrongly_dropped", share(r.wrongly_dropped)}};
}

std::string shares(const RoofPixels& r) {
  if (r.pixels == 0) return "-";
  const double n = static_cast<double>(r.pixels) / 100;
  return fmt::format("{:.2f} | {:.2f}", static_cast<double>(r.wrongly_kept) / n,
                     static_cast<double>(r.wrongly_dropped) / n);
}

void print_scores(const std::vector<DepthScore>& scores, bool by_returns) {
  const auto row = [](const auto&... cells) {
    fmt::print("{:<30} {:>7} {:>7} {:>7}  {:>6} {:>6} {:>6} {:>6}  {:>6} {:>6}  {:>13} {:>13} {:>13}\n",
               cells...);
  };
  row("", "cover %", "sky %", "s/frame", "RMSE", "MAE", "iRMSE", "iMAE", "RMSE", "MAE",
      by_returns ? "RMSE | MAE" : "roof k|d %", by_returns ? "" : "sky k|d %",
      by_returns ? "" : "border k|d %");
  const auto cell = [](const DepthErrors& of, double error, int digits) {
    return of.pixels ? fmt::format("{:.{}f}", error, digits) : std::string("-");
  };
  for (const DepthScore& s : scores)
    row(s.name, fmt::format("{:.1f}", 100 * s.coverage),
        by_returns ? std::string("-") : fmt::format("{:.1f}", 100 * s.sky_filled),
        fmt::format("{:.3f}", s.seconds), cell(s.common, s.common.rmse, 0), cell(s.common, s.common.mae, 0),
        cell(s.common, s.common.irmse, 2), cell(s.common, s.common.imae, 2), cell(s.filled, s.filled.rmse, 0),
        cell(s.filled, s.filled.mae, 0),
        by_returns
            ? cell(s.consistent, s.consistent.rmse, 0) + " | " + cell(s.consistent, s.consistent.mae, 0)
            : shares(s.roof),
        by_returns ? std::string() : shares(s.sky), by_returns ? std::string() : shares(s.border));
  fmt::print(
      "RMSE, MAE in mm, iRMSE, iMAE in 1/km: first where every back-end has a value, then on all pixels with "
      "gaps filled as KITTI's benchmark does.\n{}",
      by_returns ? "Last column: without hidden returns that have a nearer visible return within 3 pixels.\n"
                 : "k|d: shares of an object's pixels on car roofs wrongly kept | dropped: all, over the "
                   "sky, and at the skyline.\n");
}

void add_options(CLI::App& app, DepthOptions& options) {
  app.add_option("--data", options.score.data,
                 "data set: generated with true depth (mirage generate --depth), or recorded")
      ->required();
  app.add_option("--rig", options.rig, kRigHelp);
  app.add_option("--backends", options.backends, "separated by commas")
      ->default_str("ip-basic in five variants, guided");
  app.add_option("--weights", options.weights,
                 "weights of learned depth completion (default: the shipped ones)");
  app.add_option("--hide", options.hide,
                 "hold back this share of the returns and score on it (default: 0.2 without true depth)")
      ->check(within({0, 0.99}));
  add_defaulted(app, "--farthest", options.score.farthest, "score up to this true depth, m")
      ->check(within({0.1, 1000}));
  add_defaulted(app, "--frames", options.score.frames, "only the first N frames (0: all)");
}

nlohmann::json run(const DepthOptions& options, const Common& common) {
  DepthScoreOptions score = options.score;
  score.seed = common.seed;
  check_data(score.data, options.rig, UnitUse::reads_sweeps);
  const bool has_truth =
      std::filesystem::exists(true_depth_file(score.data, list_frames(score.data).front()));
  score.hidden = options.hide >= 0 ? options.hide : has_truth ? 0 : 0.2;
  std::vector<std::unique_ptr<DepthCompletion>> backends;
  for (const std::string& name : listed_words(options.backends)) {
    const mirage::DepthOptions one{name, options.weights, false, common.seed, common.threads};
    backends.push_back(load_depth_completion(one));
    common.provenance->input("backend_" + escape_name(name), depth_identity(one));
  }
  if (backends.empty()) throw InputError("--backends", "", "names none", "try ip-basic,guided");
  const auto scores = score_depth(score, backends, initial_adversary(), progress_of("depth", common.quiet));
  if (!common.quiet) print_scores(scores, score.hidden > 0);
  nlohmann::json list = nlohmann::json::array();
  for (const DepthScore& s : scores) {
    nlohmann::json entry = {{"name", s.name},
                            {"seconds_per_frame", s.seconds},
                            {"coverage", s.coverage},
                            {"common", to_json(s.common)},
                            {"filled", to_json(s.filled)}};
    if (score.hidden > 0) {
      entry["consistent"] = to_json(s.consistent);
    } else {
      entry["sky_filled"] = s.sky_filled;
      entry["roof"] = to_json(s.roof);
      entry["sky"] = to_json(s.sky);
      entry["border"] = to_json(s.border);
    }
    list.push_back(std::move(entry));
  }
  return {{"hidden", score.hidden}, {"farthest_m", score.farthest}, {"backends", list}};
}

}  // namespace

Command depth_command() {
  return command_of<DepthOptions>({
      .name = "depth",
      .help = "scores depth completion: against true depth, or on returns held back",
      .example = "mirage depth --data generated --backends ip-basic,guided",
  });
}

}  // namespace mirage::cli
