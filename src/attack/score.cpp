#include "attack/score.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <iterator>
#include <map>
#include <set>

#include "base/fields.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/sizes.h"
#include "detection/audit.h"
#include "generator/dataset.h"
#include "scene/data/data_rig.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char *kGrades = "CBA", *kNotHeld = "D";  // of the levels, from loads on
constexpr std::size_t kGradedBands = 2;
static_assert(kScoreBands[kGradedBands] == kBoundRange);

/// The empty roof treated as an object: a car not found as recorded counts as vanished.
std::vector<HostOutcome> as_recorded(std::span<const HostOutcome> hosts) {
  std::vector<HostOutcome> bare;
  for (const HostOutcome& host : hosts) {
    if (host.mesh != hosts.front().mesh) continue;
    bare.push_back(host);
    bare.back().attacked_iou = host.clean_iou;
    bare.back().clean_iou = 1;
  }
  return bare;
}

ScoreCell cell_of(std::span<const HostOutcome> hosts, double nearest, double farthest) {
  ScoreCell cell{hidden_bound(hosts, nearest, farthest), CellStatus::open, {}};
  const auto& [value, low, high, clusters, single] = cell.bound.share;
  if (high <= kScoreLimit)
    cell.status = CellStatus::holds;
  else if (low > kScoreLimit)
    cell.status = CellStatus::fails;
  else if (value != kScoreLimit)  // needed on either side of the limit
    cell.needed = rounded_up(
        (value < kScoreLimit ? clusters_for(kScoreLimit, value, single)
                             : clusters_for(1 - kScoreLimit, 1 - value, single)) *
        (clusters > 0 ? static_cast<double>(cell.bound.vehicles) / static_cast<double>(clusters) : 1));
  return cell;
}

ScoreRow row_of(ObjectLevel level, const std::string& name, std::span<const HostOutcome> hosts) {
  ScoreRow row{level, name, {}, {}, {}};
  for (std::size_t band = 0; band + 1 < kScoreBands.size(); ++band)
    row.cells.push_back(cell_of(hosts, kScoreBands[band], kScoreBands[band + 1]));
  return row;
}

/// Whether a level holds in a band; false if it was not judged. The level `recorded` only must not fail.
bool holds(const std::vector<ScoreRow>& rows, std::size_t band, ObjectLevel level) {
  bool any = false;
  for (const ScoreRow& row : rows)
    if (row.level == level) {
      any = true;
      const CellStatus status = row.cells[band].status;
      if (level == ObjectLevel::recorded ? status == CellStatus::fails : status != CellStatus::holds)
        return false;
    }
  return any;
}

/// Number of consecutive levels that hold in a band, from the first one.
std::size_t levels_passed(const std::vector<ScoreRow>& rows, std::size_t band) {
  std::size_t level = 0;
  while (level < words_of(ObjectLevel()).size() && holds(rows, band, static_cast<ObjectLevel>(level)))
    ++level;
  return level;
}

std::string grade_of(std::size_t levels) {
  return levels < 2 ? kNotHeld : std::string(1, kGrades[levels - 2]);
}

std::string grade_words(std::size_t levels) {
  const std::string most = fmt::format("{:g} % of cars", 100 * kScoreLimit);
  if (levels == 0)
    return fmt::format("more than {} are missed as recorded, without an object (95 %, exact)", most);
  if (levels == 1)
    return fmt::format("it is not proven that at most {} vanish, even under loads that people carry", most);
  const char* under[] = {"loads that people carry", "large shapes that nobody learned",
                         "objects learned against it"};
  return fmt::format("at most {} vanish under {} (95 %, exact)", most, under[levels - 2]);
}

/// "loads, 20–40 m: cannot be told: 1.2 % vanish, at most 6.3 %; about 240 cars would tell"
std::string cell_words(const ScoreRow& row, std::size_t band) {
  const ScoreCell& cell = row.cells[band];
  const char* lost = row.level == ObjectLevel::recorded ? "are missed" : "vanish";
  std::string text = fmt::format("{}, {:g}–{:g} m: {}", row.name, kScoreBands[band], kScoreBands[band + 1],
                                 to_word(cell.status));
  if (cell.bound.vehicles == 0)
    text += ": no car was found there as recorded";
  else
    text += fmt::format(
        ": of {} cars {:.1f} % {}, {} {:.1f} %", cell.bound.vehicles, 100 * cell.bound.share.value, lost,
        cell.status == CellStatus::fails ? "at least" : "at most",
        100 * (cell.status == CellStatus::fails ? cell.bound.share.low : cell.bound.share.high));
  if (cell.needed) text += fmt::format("; about {} cars would settle it", *cell.needed);
  text.front() = static_cast<char>(std::toupper(text.front()));
  return text + ".";
}

std::vector<std::string> answer_of(const Score& score, std::size_t levels) {
  std::vector<std::string> answer;
  const std::string words = fmt::format("within {:g} m {}.", kBoundRange, grade_words(levels));
  answer.push_back(score.grade.empty()
                       ? "No grade: no object was learned against this detector. Of known objects: " + words
                       : "Grade " + score.grade + ": " + words);
  for (const ScoreRow& row : score.rows)
    if (row.level == static_cast<ObjectLevel>(levels))
      for (std::size_t band = 0; band < kGradedBands; ++band)
        if (row.cells[band].status != CellStatus::holds) answer.push_back(cell_words(row, band));
  if (score.frames_needed)
    answer.push_back(fmt::format("About {} frames like these would settle every open cell within {:g} m.",
                                 *score.frames_needed, kBoundRange));
  return answer;
}

/// Generates the frames of the folder if they are missing.
void generate(const std::string& rig, std::uint64_t seed, int frames, const char* field,
              const ScoreRequest& request, const fs::path& folder) {
  if (frames < 2) throw FieldError(field, std::to_string(frames), "is too few", "use at least 2");
  Progress progress("generate", as_size(frames), request.quiet);
  generate_dataset(read_rig(rig_file(rig)), seed, 0, frames, folder,
                   [&](std::size_t done) { progress.update(done); });
  if (const std::size_t there = list_frames(folder).size(); there != as_size(frames))
    throw FieldError(field, std::to_string(frames), fmt::format("but {} holds {}", folder.string(), there),
                     "ask for as many, or use another --out");
}

/// The rig of the judged frames.
std::string rig_of(const ScoreRequest& request) {
  const auto rig = request.overrides.find("rig"), data = request.overrides.find("data");
  if (rig != request.overrides.end() && !rig->second.empty()) return rig->second;
  if (data == request.overrides.end()) return DetectorOptions().rig;
  const fs::path own = fs::path(data->second) / "rig.toml";
  return fs::exists(own) ? own.string() : data_rig(data->second);
}

/// Settings of every attack on these frames; each has its own folder and limits.
AttackSettings learning_settings(const ScoreRequest& request, const fs::path& data) {
  AttackSettings settings;
  apply_quality("draft", settings.simulation);
  Overrides overrides = request.overrides;
  overrides["data"] = data.string();
  override_settings(settings, overrides, request.seed);
  settings.detector = for_data(request.detector, settings);
  settings.attack = load_detector(settings.detector)->capabilities().has_gradients ? AttackSearch::plain
                                                                                   : AttackSearch::black_box;
  settings.iterations = request.iterations;
  settings.queries = request.queries;
  settings.seed = request.seed;
  settings.quiet = request.quiet;
  return settings;
}

/// Files of the zoo's objects that are judged on a rig's frames: "load", "shape" or "learned". Of the learned
/// objects, only the solids by both sensors on that rig: the others are variants of them.
std::map<fs::path, std::string> zoo_kinds(const std::string& rig) {
  std::map<fs::path, std::string> kinds;
  const nlohmann::json zoo = read_json(shipped_file("scenes/objects/zoo.json"));
  for (const nlohmann::json& about : zoo.at("objects")) {
    const std::string name = about.at("name");
    if (const auto learned = about.find("learned"); learned != about.end()) {
      const std::string detector = learned->at("detector");
      if (learned->at("rig") != rig || (name != detector && name != fmt::format("{}-{}", detector, rig)))
        continue;
    }
    kinds[shipped_file("scenes/objects/" + name + ".glb")] = about.at("kind");
  }
  return kinds;
}

/// Audit of the sweep's use, on the frames on which the gate was measured.
Audit use_of_points(const RunEvaluation& evaluation) {
  if (!evaluation.detectors.front()->capabilities().reads_points) return {};
  const std::vector<Detector*> detectors = instances(evaluation.detectors);
  const AttackSettings& judged = evaluation.target_run.settings;
  const std::vector<std::string> ids = spread_evenly(list_frames(judged.data), kAuditFrames);
  Progress progress("use of the sweep", ids.size(), evaluation.settings.quiet);
  return run_audit(detectors, recorded_frames(judged), ids, {{AuditChange::Kind::other_sweep}}, {}, 0,
                   [&](std::size_t done, std::size_t) { progress.update(done); });
}

ScoredObject scored_object(const NamedObject& object, const std::map<fs::path, std::string>& kinds) {
  const auto kind = kinds.find(object.file);
  const std::string name = kind == kinds.end() ? object.name : object.file.stem().string();
  if (kind == kinds.end() || kind->second == "shape")
    return {name, ObjectLevel::shapes, "shapes that nobody learned", false};
  if (kind->second == "load") return {name, ObjectLevel::loads, "loads that people carry", false};
  return {name, ObjectLevel::learned, "learned against detectors that ship", false};
}

}  // namespace

Score score_outcomes(std::span<const HostOutcome> hosts, const std::vector<ScoredObject>& objects,
                     std::size_t frames) {
  Score score;
  score.rows.push_back(row_of(ObjectLevel::recorded, "no object, as recorded", as_recorded(hosts)));
  bool adaptive = false;
  std::vector<std::string> names;
  for (const ScoredObject& object : objects) {
    adaptive = adaptive || object.against_it;
    if (std::ranges::find(names, object.row) != names.end()) continue;
    names.push_back(object.row);
    std::vector<HostOutcome> of_row;
    std::ranges::copy_if(hosts, std::back_inserter(of_row), [&](const HostOutcome& host) {
      return objects.at(as_size(host.mesh)).row == object.row;
    });
    ScoreRow row = row_of(object.level, object.row, of_row);
    row.phantoms = success_rates(of_row).fp_asr;
    for (const ScoredObject& other : objects)
      if (other.row == object.row) row.objects.push_back(other.name);
    score.rows.push_back(std::move(row));
  }
  std::ranges::stable_sort(score.rows, {}, &ScoreRow::level);

  std::size_t levels = words_of(ObjectLevel()).size();
  double more = 0;  // factor on the number of frames
  for (std::size_t band = 0; band < score.by_band.size(); ++band) {
    const std::size_t passed = levels_passed(score.rows, band);
    if (adaptive) score.by_band[band] = grade_of(passed);
    if (band >= kGradedBands) continue;
    levels = std::min(levels, passed);
    for (const ScoreRow& row : score.rows)
      if (const ScoreCell& cell = row.cells[band];
          row.level != ObjectLevel::recorded && cell.needed && cell.bound.vehicles > 0)
        more = std::max(more, static_cast<double>(*cell.needed) / cell.bound.vehicles);
  }
  if (more > 0) score.frames_needed = rounded_up(more * static_cast<double>(frames));
  if (!adaptive) levels = std::min<std::size_t>(levels, as_size(ObjectLevel::learned));
  if (adaptive) score.grade = grade_of(levels);
  score.answer = answer_of(score, levels);
  return score;
}

ScoreResult score(const ScoreRequest& request) {
  if (request.adaptive && request.sizes.empty())
    throw FieldError("sizes", "", "names none, and a grade needs an object learned against the detector",
                     "name a size, or use --no-adaptive");
  constexpr double kLeast = 8.0 / 5 * kMinAdversarySize, kMost = kMaxAdversarySize;  // height: 5/8 L
  std::set<double> sizes;
  for (const double size : request.sizes)
    if (!(size >= kLeast && size <= kMost) || !sizes.insert(size).second)
      throw FieldError("sizes", fmt::format("{:g}", size), "is out of range or named twice",
                       fmt::format("use each once, {:g} to {:g} m", kLeast, kMost));
  EvaluationRequest evaluation;
  evaluation.detector = request.detector;
  evaluation.overrides = request.overrides;
  evaluation.settings.quiet = request.quiet;
  evaluation.trust = TrustRun::yes;  // the runs are made here
  const std::string rig = rig_of(request);
  if (!request.overrides.contains("data")) {
    const fs::path judged = request.out / "judged";
    generate(rig, request.seed + 90002, request.frames, "frames", request, judged);
    evaluation.overrides["data"] = judged.string();
  }
  const fs::path data = evaluation.overrides.at("data");
  const auto named = request.overrides.find("rig");
  const auto kinds = zoo_kinds(data_rig(data, named == request.overrides.end() ? "" : named->second));
  for (const fs::path& mesh : request.meshes)
    if (mesh != kZoo)
      evaluation.meshes.push_back(mesh);
    else
      for (const auto& [file, kind] : kinds) evaluation.meshes.push_back(file);
  ScoreResult result;
  if (request.adaptive) {
    fs::path learn_data = request.learn_data;
    if (learn_data.empty()) {
      learn_data = request.out / "learn";
      generate(rig, request.seed + 90001, request.learn_frames, "learn_frames", request, learn_data);
    }
    const bool own = fs::weakly_canonical(learn_data) == fs::weakly_canonical(data);
    if (const auto frames = list_frames(learn_data); !own)
      if (const auto shared = frames_shared(data, learn_data, frames); !shared.empty())
        throw FieldError(
            "learn_data", learn_data.string(),
            fmt::format("holds {} of the frames that are judged, {} first", shared.size(), *shared.begin()),
            "give frames of other drives, or the same folder, whose test frames are judged");
    AttackSettings settings = learning_settings(request, learn_data);
    for (const double size : request.sizes) {
      settings.out = request.out / fmt::format("learned-{:g}", size);
      settings.limits = limits_of_size(size);
      result.learned.push_back({size, settings, run_attack(settings)});
      evaluation.meshes.push_back(settings.out / "adversary.glb");
      if (!own) continue;
      evaluation.hosts_of = settings.out;
      evaluation.overrides.emplace("quality", "default");  // not the quality used for learning
    }
  }
  result.evaluation = evaluate_run(evaluation);
  if (!result.evaluation.settings.reports_outcomes) return result;
  result.points = use_of_points(result.evaluation);
  std::vector<ScoredObject> objects;
  const std::size_t unlearned = result.evaluation.objects.size() - result.learned.size();
  for (std::size_t i = 0; i < unlearned; ++i)
    objects.push_back(scored_object(result.evaluation.objects[i], kinds));
  for (const LearnedObject& learned : result.learned) {
    const Vec3d box = 2 * learned.settings.limits.half;
    objects.push_back({fmt::format("learned-{:g}", learned.size), ObjectLevel::learned,
                       fmt::format("learned against it, {:g} × {:g} × {:g} m", box.x(), box.y(), box.z()),
                       true});
  }
  result.score =
      score_outcomes(result.evaluation.learned.hosts, objects, host_frames(result.evaluation.hosts).size());
  return result;
}

nlohmann::json to_json(const ScoreResult& result) {
  const RunEvaluation& evaluation = result.evaluation;
  const Score& score = result.score;
  const nlohmann::json points = to_json(result.points);
  nlohmann::json uses = points.at("uses");
  if (const Reliance& picture = evaluation.reliance; picture.reads_picture)
    uses["image"] =
        picture.use() == InputUse::unclear ? nlohmann::json() : nlohmann::json(picture.uses_picture());
  nlohmann::json json = {
      {"detector", evaluation.detectors.front()->name()},
      {"weights", evaluation.detector.weights.string()},
      {"defense", evaluation.detector.defense},
      {"grade", score.grade.empty() ? nlohmann::json() : nlohmann::json(score.grade)},
      {"answer", score.answer},
      {"limit", kScoreLimit},
      {"within_m", kBoundRange},
      {"bands", kScoreBands},
      {"by_band", score.by_band},
      {"rows", list_json(score.rows, fields_json<ScoreRow>)},
      {"frames", host_frames(evaluation.hosts).size()},
      {"frames_needed", score.frames_needed ? nlohmann::json(*score.frames_needed) : nlohmann::json()},
      {"hosts", evaluation.hosts.size()},
      {"vehicles", evaluation.learned.hiding.vanished.vehicles},
      {"clusters", to_json(evaluation.learned.clusters)},
      {"reliance", to_json(evaluation.reliance)},
      {"reliance_words", describe(evaluation.reliance)},
      {"uses", uses},
      {"learned", list_json(result.learned, fields_json<LearnedObject>)}};
  if (!result.points.rows.empty())
    json.update({{"points", points.at("audit").front()}, {"points_words", points.at("answer").front()}});
  return json;
}

nlohmann::json read_scores(const std::vector<fs::path>& files) {
  nlohmann::json scores = nlohmann::json::array();
  for (const fs::path& argument : files) {
    const fs::path file = fs::is_directory(argument) ? argument / "result.json" : argument;
    const nlohmann::json whole = read_json(file, kMaxRecordBytes);
    const JsonFields json(file, whole, "give what mirage score wrote");
    const JsonFields score = json.object("score"), provenance = json.object("provenance");
    score.text("detector");
    provenance.text("identity");
    if (!score.is_null("grade")) score.text("grade");
    score.object("reliance");
    const std::vector<double> bands = score.numbers("bands", kScoreBands.size(), 0, 1e3);
    for (const nlohmann::json& entry : score.list("rows", 100)) {
      const JsonFields row = score.inner("rows", entry);
      row.text("name");
      parse_word<ObjectLevel>(row.text("level"), "level");
      const nlohmann::json& cells = row.list("cells", bands.size());
      if (cells.size() + 1 != bands.size()) row.fail("cells", "are not one a band");
      for (const nlohmann::json& inner : cells) {
        const JsonFields cell = row.inner("cells", inner);
        cell.text("held");
        cell.number("value", 0, 1);
        cell.number("at_most", 0, 1);
        cell.count("vehicles");
      }
    }
    scores.push_back({{"score", whole.at("score")}, {"provenance", whole.at("provenance")}});
  }
  return scores;
}

}  // namespace mirage
