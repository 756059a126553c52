#include <memory>

#include "attack/adversary.h"
#include "attack/evaluation.h"
#include "base/error.h"
#include "cli/command.h"
#include "cli/detector_options.h"
#include "cli/frame_options.h"
#include "cli/table.h"
#include "scene/kitti.h"

namespace mirage::cli {
namespace {

struct Options {
  std::filesystem::path run, data;
  DetectorOptions detector;
  EvaluationSettings evaluation;
  std::string hosts = "test", depth, rooftop, sun;
  QualityOption quality;
  LightOption light;

  Options() { detector.detector.clear(); }  // empty: the run's
};

std::vector<HostId> chosen_hosts(const Run& run, const std::string& which) {
  if (which == "test") return run.test;
  if (which == "train") return run.train;
  if (which != "all") throw InputError("--hosts", which, "unknown choice", "use test, train or all");
  auto all = run.train;
  all.insert(all.end(), run.test.begin(), run.test.end());
  return all;
}

}  // namespace

Command evaluate_command() {
  auto options = std::make_shared<Options>();
  Command command{
      "evaluate", "attack success of a run against a detector and a data set", "out/evaluate", {}, {}};
  command.options = [options](CLI::App& app) {
    app.add_option("--run", options->run, "run folder of mirage attack")->required();
    app.add_option("--data", options->data, "data set (default: the run's)");
    add_detector_options(app, options->detector);
    app.add_option("--depth", options->depth, "ip-basic, guided or a plugin (*.so); default: the run's");
    add_rooftop_option_of_run(app, options->rooftop);
    options->quality.add(app, "the run's settings");
    options->light.add(app, "the run's");
    add_sun_option_of_run(app, options->sun);
    app.add_option("--hosts", options->hosts, "test, train or all hosts of the run")->capture_default_str();
    app.add_option("--score", options->evaluation.score_threshold, "score of a detection")
        ->capture_default_str();
    app.add_option("--iou", options->evaluation.detected_iou, "IoU at which a vehicle counts as detected")
        ->capture_default_str();
  };
  command.run = [options](const Common& common) -> nlohmann::json {
    Run run = read_run(options->run);
    options->quality.apply(run.simulation);
    options->light.apply(run.simulation);
    const std::string sun = options->sun.empty() ? run.sun : options->sun;
    use_detector_of(run, options->detector);
    const auto data = options->data.empty() ? run.data : options->data;
    FrameStore store(data, options->depth.empty() ? run.depth : options->depth,
                     options->rooftop.empty() ? run.rooftop : options->rooftop, sun);
    options->evaluation.quiet = common.quiet;
    const auto list = [&] {
      if (!is_other_data(run, data)) return chosen_hosts(run, options->hosts);
      // Another data set than the run's: all its usable vehicles are unseen ones.
      const auto region = load_detector(with_common(options->detector, common, data))->region();
      std::vector<HostId> found;
      for (const Host& host : find_all_hosts(store, list_frames(data), region, run.simulation, run.min_view))
        found.push_back(host.id);
      return found;
    };
    const std::vector<HostId> hosts = list();
    if (hosts.empty())
      throw InputError((options->run / "run.json").string(), options->hosts, "has no host vehicles",
                       "use --hosts all or a larger data set");
    const DetectorPool detectors =
        load_detector_pool(with_common(options->detector, common, data), static_cast<int>(hosts.size()));
    const auto judged = [&](const TexturedMesh& mesh) {
      return evaluate(detectors, store, hosts, mesh, run.simulation, options->evaluation);
    };
    const Evaluation learned = judged(run.adversary), random = judged(run.random);
    const auto shares = [&](Interval Evaluation::*of) {
      const Interval &a = learned.*of, &b = random.*of;
      return percent(a.value, a.low, a.high) + " | " + percent(b.value, b.low, b.high);
    };
    print_table({{"hosts", std::to_string(hosts.size())},
                 {"roofs", roofs(learned.rooftops.fitted, learned.rooftops.from_box)},
                 {"vehicles detected without adversary", std::to_string(learned.vehicles)},
                 {"FN ASR, learned | random mesh (95 %)", shares(&Evaluation::fn_interval)},
                 {"FP ASR, learned | random mesh (95 %)", shares(&Evaluation::fp_interval)},
                 {"ASR, learned | random mesh (95 %)", shares(&Evaluation::asr_interval)}});
    nlohmann::json result = to_json(learned);
    result["random"] = to_json(random);
    result["simulation"] = to_json(run.simulation);
    result["sun"] = sun;
    result["score_threshold"] = options->evaluation.score_threshold;
    result["detected_iou"] = options->evaluation.detected_iou;
    return result;
  };
  return command;
}

}  // namespace mirage::cli
