// mirage compare: whether one detector is easier to fool than another.

#include <set>

#include "attack/comparison.h"
#include "base/error.h"
#include "base/ranks.h"
#include "cli/command.h"
#include "cli/options.h"

namespace mirage::cli {
namespace {

struct CompareOptions {
  ComparisonRequest request;
  std::vector<std::string> detectors, weights, defenses;
  std::optional<double> fail_above;
  /// Set by run, read afterwards: how much worse the second is at least, points, and why nothing is known of
  /// that; empty: it is known.
  double worse = 0;
  std::string unknown;
};

/// The entry number `which` of a list that is empty or has one or two entries.
std::string of_two(const std::vector<std::string>& list, std::size_t which, const char* option,
                   const std::string& otherwise) {
  if (list.size() > 2)
    throw FieldError(option, std::to_string(list.size()), "is more than two", "name one for each detector");
  return list.empty() ? otherwise : list[std::min(which, list.size() - 1)];
}

void print_comparison(const Comparison& result) {
  const ComparedPart& all = result.parts.front();
  print_table({{"vehicles that both find", fmt::format("{} of {} (first: {}, second: {})", all.vehicles,
                                                       result.hosts, result.found[0], result.found[1])},
               {"intervals over", to_string(all.clusters)}});
  Columns parts = {{"vanished (95 %)", "vehicles", "first", "second", "points more in second (95 %)", "p"}};
  const auto show = [&](const ComparedPart& part) {
    parts.push_back({part.name.empty()                ? part.by
                     : part.name.starts_with(part.by) ? part.name  // "occlusion unknown"
                                                      : part.by + " " + part.name,
                     std::to_string(part.vehicles), percent(part.first), percent(part.second),
                     signed_points(part.difference), fmt::format("{:.3f}", part.p)});
  };
  for (const ComparedPart& part : result.parts) show(part);
  if (result.own) show(*result.own);
  print_columns(parts);
  Rows rows = {{"vehicles vanish under the second", to_word(classify(all.difference))},
               {"smallest detectable difference",
                result.detectable < 1 ? fmt::format("{:.1f} points (power 80 %)", 100 * result.detectable)
                                      : "none: too few vehicles"}};
  for (const auto& [difference, vehicles] : result.needed)
    if (result.detectable < 1)
      rows.push_back({fmt::format("vehicles needed to detect {:g} points", 100 * difference),
                      vehicles ? fmt::format("about {}", *vehicles) : "more than a million"});
  const char* any = result.objects.size() > 1 ? ", any object" : "";
  rows.push_back({std::string("first") + any, describe(result.bounds[0])});
  rows.push_back({std::string("second") + any, describe(result.bounds[1])});
  std::set<HostId> worse;
  for (const NewlyMissedVehicle& vehicle : result.worse) worse.insert(vehicle.id);
  rows.push_back({"vehicles that got worse", std::to_string(worse.size()) + any});
  std::fputs("\n", stdout);
  print_table(rows);
}

void add_options(CLI::App& app, CompareOptions& options) {
  ComparisonRequest& request = options.request;
  add_fields(app, as_base<FrameSource>(request));
  app.add_option("--detectors", options.detectors, "the old detector and the new one")
      ->expected(1, 2)
      ->required();
  app.add_option("--weights", options.weights, "weights of both, or of each (default: the shipped ones)")
      ->expected(1, 2);
  app.add_option("--defense", options.defenses, "defence of both, or of each (default: none)")
      ->expected(1, 2);
  app.add_option("--runs", request.runs, "finished mirage attacks, whose objects are put on the roofs");
  app.add_option("--mesh", request.meshes,
                 "objects, in metres (.glb, .gltf, .obj or .ply); zoo: all that ship in scenes/objects");
  app.add_flag("--adaptive", request.adaptive,
               "the first two --runs were learned against the first and the second detector: also compare "
               "each under its own object");
  add_defaulted(app, "--frames", request.frames, "only the first N frames (0: all)");
  add_min_view_option(app, request.min_view);
  add_score_option(app, request.settings.score_threshold);
  app.add_option(
         "--fail-above", options.fail_above,
         "exit code 1 if the interval's lower end has the second detector worse by more than this many "
         "points. Also if both find fewer than a tenth of the vehicles")
      ->check(within({0, 100}));
  add_trust_option(app, request.trust);
  add_cache_note(app);
}

nlohmann::json run(CompareOptions& options, const Common& common) {
  ComparisonRequest request = options.request;
  request.settings.quiet = common.quiet;
  for (const std::size_t which : {0u, 1u}) {
    DetectorOptions detector = with_common({}, common, request);
    detector.detector = of_two(options.detectors, which, "detectors", "");
    detector.weights = of_two(options.weights, which, "weights", "");
    detector.defense = of_two(options.defenses, which, "defense", "none");
    request.detectors.push_back(detector);
  }
  const Comparison result = compare(request, common.provenance.get());
  if (rank() > 0) return nlohmann::json::object();  // the first tells
  if (!common.quiet) print_comparison(result);
  options.worse = 100 * result.parts.front().difference.low;
  if (result.few())
    options.unknown =
        fmt::format("both detectors find {} of {} vehicles as recorded (first: {}, second: {})",
                    result.parts.front().vehicles, result.hosts, result.found[0], result.found[1]);
  return {{"compare", to_json(result)}};
}

void afterwards(const CompareOptions& options, const Common& common) {
  write_page(common.out);
  if (options.fail_above && !options.unknown.empty())
    throw Failure("--fail-above", options.unknown + ": over so few nothing is known of the second",
                  "look at its boxes with mirage detect, or give more frames");
  if (options.fail_above && options.worse > *options.fail_above)
    throw Failure("--fail-above",
                  fmt::format("the second detector is worse by at least {:.1f} points", options.worse),
                  "see worse in result.json");
}

}  // namespace

Command compare_command() {
  return command_of<CompareOptions>({
      .name = "compare",
      .help = "tells whether one detector is easier to fool than another, on the same vehicles and objects",
      .example = "mirage compare --detectors fusion refined --runs out/attack --data path/to/kitti",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
