// mirage score: a detector's grade, and a board of several.
#include "attack/score.h"

#include "base/error.h"
#include "base/ranks.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "cli/options.h"
#include "defense/certificate.h"
#include "frames/frame_provenance.h"

namespace mirage::cli {
namespace {

struct ScoreOptions {
  ScoreRequest request;
  std::vector<std::filesystem::path> board;
  bool no_adaptive = false, certify = false;
};

void add_options(CLI::App& app, ScoreOptions& options) {
  ScoreRequest& request = options.request;
  add_overrides<FrameSource>(app, request.overrides, {"data"}, "generated frames");
  add_overrides<FrameSource>(app, request.overrides, {"rig", "depth", "rooftop", "placement", "sun"},
                             "that of mirage attack");
  add_fields(app, request.detector);
  add_defaulted(app, "--frames", request.frames, "generated frames to judge on");
  app.add_option("--learn-data", request.learn_data,
                 "data set to learn objects on. If it is that of --data, seven tenths of its frames are for "
                 "learning and the rest are judged (default: generated frames)");
  add_defaulted(app, "--learn-frames", request.learn_frames, "generated frames to learn on");
  add_defaulted(app, "--sizes", request.sizes,
                "half lengths L of the objects to learn, m (height 5/4 L), with commas")
      ->delimiter(',');
  add_defaulted(app, "--iterations", request.iterations, "optimisation steps of each attack")
      ->check(within(kFromOne));
  add_defaulted(app, "--queries", request.queries,
                "for a detector without gradients: detector passes that each black-box attack may make")
      ->check(within(kFromOne));
  app.add_flag("--no-adaptive", options.no_adaptive,
               "do not learn an object against the detector; the result then has no grade");
  app.add_flag("--certify", options.certify,
               "also bracket the share of cars that no object of these sizes can hide (mirage certify)");
  app.add_option("--board", options.board,
                 "in place of scoring: OUT/board.html of these results of mirage score");
  add_cache_note(app);
}

std::string cell_text(const ScoreCell& cell) {
  const HiddenBound& bound = cell.bound;
  if (bound.vehicles == 0) return "no cars";
  if (cell.status == CellStatus::fails) return "does not hold: ≥ " + percent(bound.share.low);
  if (cell.status == CellStatus::holds) return "holds: ≤ " + percent(bound.share.high);
  return "≤ " + percent(bound.share.high) + (cell.needed ? fmt::format(", needs {} cars", *cell.needed) : "");
}

void print_score(const ScoreResult& result) {
  Rows head = {
      {"cars found as recorded", fmt::format("{} of {}", result.evaluation.learned.hiding.vanished.vehicles,
                                             result.evaluation.hosts.size())}};
  for (auto& row : picture_rows(result.evaluation.reliance)) head.push_back(std::move(row));
  for (const std::string& line : describe(result.points)) head.push_back({"use of the sweep", line});
  for (const std::string& line : result.score.answer) head.push_back({"answer", line});
  print_table(head);
  Columns table = {{"cars that vanish"}};
  for (std::size_t band = 0; band + 1 < kScoreBands.size(); ++band)
    table.front().push_back(fmt::format("{:g}–{:g} m", kScoreBands[band], kScoreBands[band + 1]));
  table.front().push_back("phantoms");
  for (const ScoreRow& row : result.score.rows) {
    table.push_back({row.name});
    for (const ScoreCell& cell : row.cells) table.back().push_back(cell_text(cell));
    table.back().push_back(row.phantoms ? percent(*row.phantoms) : "");
  }
  if (!result.score.grade.empty()) {
    table.push_back({"grade"});
    for (const std::string& grade : result.score.by_band) table.back().push_back(grade);
  }
  print_columns(table);
}

/// Certificates of the same cars, beside what the objects left of them: their shares, one a size.
nlohmann::json certified(const ScoreRequest& request, const RunEvaluation& evaluation) {
  const AttackSettings& judged = evaluation.target_run.settings;
  CertificateSettings settings;
  settings.sizes = request.sizes;
  settings.with_lattice = true;
  settings.objects = 0;
  settings.seed = request.seed;
  settings.simulation = judged.simulation;
  for (const NamedObject& object : evaluation.objects) settings.adversaries.push_back(object.mesh);
  settings.attacked = evaluation.learned.hosts;
  settings.evaluation = evaluation.settings;
  const CertificateResult result = certify(evaluation.detectors, *evaluation.store, evaluation.hosts,
                                           lidar_of(judged.data, judged.rig), settings);
  return to_json(result, settings).at("sizes");
}

nlohmann::json make_board(const ScoreOptions& options, const Common& common) {
  for (const std::filesystem::path& file : options.board) {
    std::error_code missing;  // of either: no two files then
    if (std::filesystem::equivalent(std::filesystem::is_directory(file) ? file / "result.json" : file,
                                    common.out / "result.json", missing))
      throw InputError("--out", common.out.string(),
                       "holds one of the results, which the board's would replace", "use another folder");
  }
  const nlohmann::json board = read_scores(options.board);
  Columns rows = {{"detector", "grade", "0–20 m", "20–40 m", "40–70 m"}};
  for (const nlohmann::json& entry : board) {
    const nlohmann::json& score = entry.at("score");
    rows.push_back({score.at("detector"), score.at("grade").is_null() ? "none" : score.at("grade")});
    for (const nlohmann::json& grade : score.at("by_band")) rows.back().push_back(grade);
  }
  print_columns(rows);
  return {{"board", board}};
}

nlohmann::json run(const ScoreOptions& options, const Common& common) {
  if (!options.board.empty()) return make_board(options, common);
  ScoreRequest request = options.request;
  request.adaptive = !options.no_adaptive;
  take_common(request, common);
  take_common(request.detector, common);
  if (options.certify && request.detector.locality > 0)
    throw InputError("--locality", fmt::format("{}", request.detector.locality),
                     "is an approximation, and proves nothing", "leave it or --certify out");
  const ScoreResult result = score(request);
  nlohmann::json certificates;
  if (options.certify) certificates = certified(request, result.evaluation);
  if (rank() > 0) return nlohmann::json::object();  // the first tells
  Provenance& provenance = *common.provenance;
  const AttackSettings& judged = result.evaluation.target_run.settings;
  add_frames(provenance, judged, result.evaluation.hosts);
  add_objects(provenance, result.evaluation.objects);
  add_detector(provenance, result.evaluation.detector);
  provenance.set("simulation", fields_json(judged.simulation));
  nlohmann::json json = to_json(result);
  if (options.certify) json["certified"] = certificates;
  print_score(result);
  return {{"score", json}};
}

}  // namespace

Command score_command() {
  return command_of<ScoreOptions>({
      .name = "score",
      .help = "grades a detector: which objects it holds against, at which distances",
      .example = "mirage score --detector fusion --out out/score",
      .afterwards = [](const Common& common) { write_page(common.out); },
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
