#include <cstdio>

#include "attack/eot.h"
#include "attack/evaluate_run.h"
#include "attack/host_outcome.h"
#include "base/fields.h"
#include "base/ranks.h"
#include "cli/command.h"
#include "cli/options.h"
#include "frames/frame_provenance.h"
#include "validation/report/pages.h"

namespace mirage::cli {
namespace {

struct EvaluateOptions {
  EvaluationRequest request;
  QualityOption quality;
  LidarEffectsOption effects;
  Overrides computed;  ///< how the detector computes
  int pictures = 0;
  std::string expect = "none";
};

void print_head(const RunEvaluation& evaluation) {
  const Evaluation& learned = evaluation.learned;
  Rows rows = {{"hosts", std::to_string(evaluation.hosts.size())},
               {"roofs", roofs(learned.rooftops.fitted, learned.rooftops.from_box)},
               {"vehicles detected without adversary", std::to_string(learned.rates.vehicles)}};
  rows.push_back({"intervals over", to_string(learned.clusters)});
  if (evaluation.settings.matching.in_picture())
    rows.push_back({"vehicles detected without adversary, IoU 0.5", std::to_string(learned.at50.vehicles)});
  for (auto& row : picture_rows(evaluation.reliance)) rows.push_back(std::move(row));
  print_table(rows);
}

/// The headline: whether the box is gone, beside the seed's rule, with every control and net of it.
void print_arms(const RunEvaluation& evaluation) {
  const bool picture = evaluation.settings.matching.in_picture(),
             by_centre = evaluation.settings.matching.by == MatchBy::centre;
  Columns rows = {
      {"share of vehicles (95 %)", "vanished",
       fmt::format("FN ASR, {} {:g}", by_centre ? "overlap" : "IoU", evaluation.settings.detected_iou),
       picture ? "missed at IoU 0.5" : "no box within 2 m", "FP ASR", "ASR (FN or FP)"}};
  const auto shares = [&](const std::string& name, const Evaluation& of) {
    const MissRates& hidden = of.hiding;
    rows.push_back({of.meshes > 1 ? fmt::format("{} × {}", of.meshes, name) : name,
                    percent(hidden.vanished.share), percent(of.rates.fn_asr),
                    percent(picture ? hidden.iou50.share : hidden.distance2m->share),
                    percent(of.rates.fp_asr), percent(of.rates.asr)});
  };
  std::vector<std::pair<std::string, const Evaluation*>> arms;
  if (evaluation.each.empty()) arms.emplace_back("learned mesh", &evaluation.learned);
  for (const ObjectEvaluation& entry : evaluation.each) arms.emplace_back(entry.name, &entry.evaluation);
  for (const BaselineEvaluation& entry : evaluation.baselines)
    arms.emplace_back(describe(entry.kind), &entry.evaluation);
  for (const auto& [name, of] : arms) shares(name, *of);
  for (const auto& [name, of] : arms)
    if (!of->against_grown.empty()) shares(name + ", grown box", summarize(of->against_grown, of->meshes));
  if (!evaluation.baselines.empty())
    rows.push_back(
        {evaluation.each.empty() ? "learned mesh minus control, points:" : "object minus control, points:"});
  for (const BaselineEvaluation& entry : evaluation.baselines) {
    const GainOverControl& net = entry.net;
    rows.push_back({"  " + describe(entry.kind), signed_points(net.vanished), signed_points(net.fn),
                    signed_points(picture ? net.iou50 : *net.distance2m), signed_points(net.false_positive),
                    signed_points(net.asr)});
  }
  print_columns(rows);
}

/// Prints the bound on the hidden share for each object, and for all together.
void print_bounds(const RunEvaluation& evaluation) {
  Rows rows;
  for (const ObjectEvaluation& entry : evaluation.each)
    rows.push_back({entry.name, describe(hidden_bound(entry.evaluation.hosts))});
  if (evaluation.each.size() != 1)
    rows.push_back({evaluation.each.empty() ? "learned mesh" : "any of them",
                    describe(hidden_bound(evaluation.learned.hosts))});
  std::fputs("\n", stdout);
  print_table(rows);
}

/// Victim::object: how many of the objects have any box on them.
void print_seen(const std::vector<StratumSuccess>& parts) {
  Columns rows = {{"part", "places", "plain object seen", "object seen"}};
  for (const StratumSuccess& part : parts)
    if (part.by == "range" && part.hosts > 0)
      rows.push_back({part.by + " " + part.name, std::to_string(part.hosts), percent(part.seen.clean),
                      percent(part.seen.attacked)});
  print_columns(rows);
}

/// Only the parts that hold vehicles.
void print_strata(const RunEvaluation& evaluation) {
  if (evaluation.target_run.settings.placement.victim == Victim::object)
    return print_seen(evaluation.learned.strata);
  const BaselineEvaluation* control = evaluation.baselines.empty() ? nullptr : &evaluation.baselines.back();
  if (const BaselineEvaluation* sized = evaluation.baseline(Baseline::sized)) control = sized;
  Columns rows = {{"part", "vehicles", "FN ASR", "FP ASR", "ASR (95 %)"}};
  if (control) rows.front().push_back(describe(control->kind) + "'s ASR");
  const auto& parts = evaluation.learned.strata;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const StratumSuccess& part = parts[i];
    if (part.rates.vehicles == 0) continue;
    rows.push_back({part.by + " " + part.name, std::to_string(part.rates.vehicles),
                    percent(part.rates.fn_asr.value), percent(part.rates.fp_asr.value),
                    percent(part.rates.asr)});
    if (control) rows.back().push_back(percent(control->evaluation.strata[i].rates.asr));
  }
  print_columns(rows);
}

void add_options(CLI::App& app, EvaluateOptions& options) {
  EvaluationRequest& request = options.request;
  app.add_option("--run", request.run, "run folder of mirage attack: its adversary is judged");
  app.add_option(
      "--mesh", request.meshes,
      "in place of a run: objects on every usable vehicle of --data, in metres (.glb, .gltf, .obj or "
      ".ply); zoo: all that ship in scenes/objects");
  app.add_option("--hosts-of", request.hosts_of,
                 "another run folder: judge on its test hosts, data set and detector (black-box "
                 "transfer)");
  add_overrides<FrameSource>(app, request.overrides);
  add_fields(app, request.detector, {"precision", "locality"}, "the run's");
  add_overrides<DetectorOptions>(app, options.computed, {"precision", "locality"});
  options.quality.add(app, "the run's settings");
  add_overrides<SimulationSettings>(app, request.overrides, {"light", "camera_effects"});
  add_overrides<AttackSettings>(app, request.overrides, {"min_view"});
  options.effects.add(app, "the run's");
  add_defaulted(
      app, "--expect", options.expect,
      "what to vary at random for each vehicle, alike for every object on it. Values as in mirage attack "
      "--expect, e.g. shape:0.02,colour for manufacturing tolerances");
  add_trust_option(app, request.trust);
  add_cache_note(app);
  app.add_option(
      "--hosts", request.hosts,
      "which of the run's hosts to judge on: test, train or all (default: test; on other data, hosts in "
      "frames that it was not trained on)");
  add_defaulted(app, "--random-meshes", request.random_meshes,
                "random meshes for each baseline, results pooled (seeds count up from the run's). 0: none");
  app.add_option(
      "--baseline", request.baseline,
      "controls: all, none, or some of start,sized,ellipsoid,cuboid. start: a random mesh of 0.75 of "
      "the box; sized: one with the learned extents; ellipsoid, cuboid: filling the box (default: "
      "start,sized; with --mesh: none)");
  add_defaulted(app, "--pictures", options.pictures,
                "draw up to N hidden vehicles and N with false positives, with image features, "
                "into OUT/pictures")
      ->check(within(kNotNegative));
  add_score_option(app, request.settings.score_threshold);
  add_defaulted(app, "--iou", request.settings.detected_iou, "IoU at which a vehicle counts as detected")
      ->check(within(kShare));
}

nlohmann::json run(const EvaluateOptions& options, const Common& common) {
  EvaluationRequest request = options.request;
  take_common(request.detector, common);
  for (const auto& [name, text] : options.computed) set_field(request.detector, name, text);
  request.settings.quiet = common.quiet;
  request.settings.expectation = parse_expectation(options.expect);
  require_judged(request.settings.expectation);
  request.settings.expectation_seed = common.seed;
  options.effects.check();
  options.quality.add_to(request.overrides);
  options.effects.add_to(request.overrides);
  const RunEvaluation evaluation = evaluate_run(request);
  if (rank() > 0) return nlohmann::json::object();  // the first tells
  common.provenance->add(evaluation.target_run.settings);
  add_frames(*common.provenance, evaluation.target_run.settings, evaluation.hosts);
  if (!evaluation.objects.empty()) add_objects(*common.provenance, evaluation.objects);
  add_detector(*common.provenance, evaluation.detector);
  common.provenance->set("expect", options.expect);
  print_head(evaluation);
  print_arms(evaluation);
  print_bounds(evaluation);
  print_strata(evaluation);
  nlohmann::json result = to_json(evaluation);
  if (options.pictures > 0)
    result["pictures"] = draw_evaluation_pictures(evaluation, options.pictures, common.out / "pictures");
  return result;
}

}  // namespace

Command evaluate_command() {
  return command_of<EvaluateOptions>({
      .name = "evaluate",
      .help = "judges a run or objects: attack success against a detector and a data set",
      .example = "mirage evaluate --run out/attack --baseline all",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
