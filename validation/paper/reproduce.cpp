#include "validation/paper/reproduce.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <list>
#include <mutex>
#include <optional>
#include <set>
#include <thread>

#include "attack/attack_settings.h"
#include "base/child_process.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/memory.h"
#include "base/ranks.h"
#include "base/schedule.h"
#include "base/sizes.h"
#include "frames/frame_provenance.h"
#include "scene/data/data_rig.h"
#include "scene/data/read_frames.h"
#include "validation/paper/finding.h"

namespace mirage::paper {
namespace {

using nlohmann::json;

/// Why the row has no numbers: the case that failed by itself, rather than those left out because of it.
std::string why_missing(const std::set<std::string>& names, const Evidence& evidence) {
  std::string why;
  for (const std::string& name : names) {
    const auto step = evidence.steps.find(name);
    if (step == evidence.steps.end() || step->second.status == Step::Status::missing) {
      if (why.empty()) why = name + ": not run";
    } else if (step->second.status == Step::Status::failed) {
      why = name + ": " + step->second.error;
      if (!step->second.error.starts_with("needs ")) return why;
    }
  }
  return why;
}

/// The figure of the row's mesh, or net of its control; null for a column of another kind.
json value_of(const std::string& key, const Row& row, const Outcomes& outcomes, const Outcomes* sized) {
  if (key == "recall_mean") return to_json(mean_recall(outcomes, row.mesh == "none"));
  if (key.starts_with("recall"))
    return to_json(share(outcomes, question((row.mesh == "none" ? "clean_" : "") + key)));
  if (key.starts_with("ap")) return nullptr;
  if (!key.starts_with("net")) return to_json(share(outcomes, question(key)));
  const Question asked = question(key.substr(std::string_view("net_").size()));
  return sized ? to_json(difference(outcomes, *sized, asked)) : json();
}

/// Adds the outcomes of the row's meshes; `sized`: their control, if they have one.
void add_outcomes(json& entry, const Table& table, const Row& row, const Outcomes& outcomes,
                  const Outcomes* sized) {
  const ClusterCount clusters = outcomes.clusters();
  entry.update({{"vehicles", outcomes.vehicles},
                {"hosts", outcomes.hosts.size() / as_size(std::max(1, outcomes.meshes * outcomes.runs))},
                {"frames", outcomes.frames()},
                {"meshes", outcomes.meshes},
                {"runs", outcomes.runs},
                {"clusters", to_json(clusters)}});
  if (clusters.count < kFewClusters) entry["few_clusters"] = to_string(clusters);
  if (row.image && !outcomes.note().empty()) entry["note"] = outcomes.note();
  for (const Column& column : table.columns)
    if (json value = value_of(column.key, row, outcomes, sized); !value.is_null())
      entry["values"][column.key] = std::move(value);
  if (table.name == "fig3") {
    entry["curve"] = recall_curve(outcomes, row.mesh == "none");
  } else if (!table.matrix) {
    json& list = entry["false_positive_distances"] = json::array();
    int looks = 0;  // of every mesh and run: a vehicle may be held back in some of these
    for (const Outcome& host : outcomes.hosts) {
      if (!host.detected) continue;
      ++looks;
      for (const double distance : host.distances()) list.push_back(distance);
    }
    entry["false_positives_of"] = looks;
  }
}

/// Minutes of the cases that are not data; empty if none of them knows.
std::optional<double> minutes(const std::set<std::string>& names, const Experiments& experiments,
                              const Evidence& evidence) {
  double seconds = 0;
  for (const std::string& name : names)
    if (const auto step = evidence.steps.find(name);
        step != evidence.steps.end() && experiments.at(name).kind != Case::Kind::generate)
      seconds += step->second.seconds;
  return seconds > 0 ? std::optional(seconds / 60) : std::nullopt;
}

json row_json(const Table& table, const Row& row, const Experiments& experiments, const Evidence& evidence) {
  std::set<std::string> names;
  if (!row.evaluation.empty())
    for (int number = 0; number < experiments.seeds; ++number)
      experiments.add_closure(repetition(row.evaluation, number), names);
  json entry = {{"label", row.label}, {"rig", row.rig}, {"case", row.evaluation}};
  json& values = entry["values"] = json::object();
  json& paper = entry["paper"] = json::object();
  for (const auto& [key, percent] : row.paper) paper[key] = percent / 100;
  if (row.size > 0) entry["size"] = row.size;
  if (!row.source.empty()) entry.update({{"source", row.source}, {"target", row.target}});
  const bool control = row.mesh == "start" || row.mesh == "sized";
  std::string why;
  if (const Outcomes* outcomes =
          evidence.of(row.evaluation, control || row.mesh == "cuboid" ? row.mesh : "learned")) {
    add_outcomes(entry, table, row, *outcomes, control ? nullptr : evidence.of(row.evaluation, "sized"));
  } else {
    why = why_missing(names, evidence);
    if (why.empty())
      why = row.evaluation + (row.mesh == "cuboid" ? ": judged no cuboid" : ": judged no random mesh");
  }
  if (!row.detection.empty()) {
    experiments.add_closure(row.detection, names);
    if (const auto clean = evidence.detections.find(row.detection); clean != evidence.detections.end())
      values.update(clean->second);
    else if (why.empty())
      why = why_missing(names, evidence);
  }
  if (!why.empty()) entry["error"] = why;
  if (const auto spent = minutes(names, experiments, evidence)) entry["minutes"] = *spent;
  return entry;
}

/// "kitti64" of "kitti64-fusion-both--on--xenith-fusion-both": "xenith", whose frames they are.
std::string rig_of(const std::string& arm) {
  const std::size_t on = arm.find("--on--");
  const std::string judged = on == std::string::npos ? arm : arm.substr(on + 6);
  return judged.substr(0, judged.find('-'));
}

/// By each rule; null where it asks for metres and there are none. `control`: the net of it, if it is not
/// null.
json hidden_json(const Outcomes& outcomes, const Outcomes* control) {
  json rates = json::object();
  for (const MissCriterion& rule : kMissCriteria) {
    const Question asked = question(rule.name);
    json& rate = rates[rule.name];
    if (rule.distance > 0 && !has_metres(outcomes)) continue;
    rate = to_json(control ? difference(outcomes, *control, asked) : share(outcomes, asked));
    if (!control) rate["vehicles"] = vehicles(outcomes, asked);
  }
  return rates;
}

namespace fs = std::filesystem;

/// OUT/steps/NAME and the ending.
fs::path step_file(const Case& command, const fs::path& out, const char* ending) {
  std::string name = command.name;
  std::replace(name.begin(), name.end(), '/', '_');
  return out / "steps" / (name + ending);
}

fs::path record_file(const Case& command, const fs::path& out) {
  return step_file(command, out, ".json");
}

fs::path failure_file(const Case& command, const fs::path& out) {
  return step_file(command, out, ".failed.json");
}

/// The recorded provenance of a case that was begun; null without a readable record.
json recorded(const Case& command, const fs::path& out) {
  try {
    return read_json(record_file(command, out)).value("made_of", json());
  } catch (const std::exception&) {
    return {};
  }
}

/// Hash of all frames of a data set that no case makes; each set is looked at once.
std::string data_hash(const fs::path& data) {
  static std::mutex mutex;
  static std::map<fs::path, std::string> known;
  const std::lock_guard lock(mutex);
  std::string& hash = known[fs::absolute(data)];
  if (hash.empty()) hash = frames_hash(data, list_frames(data));
  return hash;
}

/// The detector that the case names, on its data's rig.
DetectorOptions detector_of(const Case& command, const fs::path& out) {
  const NamedSettings settings = command.settings_in(out);
  DetectorOptions detector;
  detector.detector = command.setting("detector");
  detector.defense = command.setting("defense", "none");
  fs::path data = settings.contains("data") ? settings.at("data") : "";
  if (data.empty() && command.kind == Case::Kind::evaluate)
    data = read_json(out / command.hosts_of() / "run.json").value("data", "");
  detector.rig = data_rig(data);
  return detector;
}

/// The provenance of the case's result (base/provenance.h): cases that it needs count by their provenance, so
/// that OUT may be moved.
json provenance(const Case& command, const fs::path& out) {
  Provenance provenance;
  provenance.set("command", to_word(command.kind));
  for (const auto& [name, value] : command.settings) provenance.set(name, value);
  for (const auto& [folder, need] : command.needs) {
    provenance.set(folder, need);
    // Frames are what they were generated from; of a run its mesh and hosts count (below).
    if (folder == "data")
      provenance.input(folder, content_hash(recorded(Case{need, {}, {}, {}}, out).dump()));
  }
  // Missing or unreadable data: the command itself says so.
  if (const std::string data = command.setting("data"); !data.empty()) try {
      provenance.input("data", data_hash(data));
    } catch (const InputError&) {
    }
  if (!command.setting("detector").empty()) try {
      add_detector(provenance, detector_of(command, out));
    } catch (const InputError&) {
    }
  if (command.kind == Case::Kind::evaluate) {
    provenance.file("adversary", out / command.run() / "adversary.glb");
    provenance.file("hosts", out / command.hosts_of() / "run.json");
  }
  return provenance.provenance();
}

/// Seconds that the finished case took. InputError naming file and field.
double recorded_seconds(const fs::path& file) {
  const json record = read_json(file);
  return JsonFields(file, record, kMakeAgain).number("seconds", 0, Range::kMax);
}

/// This rank's part of the work.
class Steps {
 public:
  Steps(const Experiments& experiments, const ReproduceSettings& settings, const Execute& run)
      : cases_(experiments.cases), settings_(settings), run_(run), among_others_(rank_count() > 1) {}

  std::map<std::string, Step> run_all() {
    if (rank() == 0)
      for (const Case& command : cases_) fs::remove(failure_file(command, settings_.out));
    await_ranks();  // nobody reads those of an earlier run
    std::list<const Case*> open;
    for (const Case& command : cases_) open.push_back(&command);
    while (!open.empty()) {
      bool ended_one = false;
      for (auto next = open.begin(); next != open.end();) {
        throw_if_interrupted("finished steps are kept; run the same command to go on");
        const bool ended = end(**next, steps_[(*next)->name]);
        if (ended)
          ended_one = true;
        else
          awaited_.insert((*next)->name);
        next = ended ? open.erase(next) : std::next(next);
      }
      if (!ended_one) std::this_thread::sleep_for(std::chrono::milliseconds(200));
    }
    return steps_;
  }

 private:
  /// Brings the case to its end. False if it must wait for another case or belongs to another rank.
  bool end(const Case& command, Step& step) {
    for (const auto& [folder, need] : command.needs) {
      const Step::Status of_need = steps_[need].status;
      if (of_need == Step::Status::done) continue;
      if (among_others_ && of_need == Step::Status::missing) return false;
      say(command, ": left out, it needs what failed");
      fail(step, "needs " + need);
      return true;
    }
    std::optional<FolderLock> claim;
    try {
      if (is_over(command, step)) return true;
      if (among_others_) {
        if (!take(command, claim)) return false;
        if (is_over(command, step)) return true;  // another's until now
      }
      say(command, "");
      run_case(command);
      succeed(command, step);
    } catch (const Interrupted&) {
      throw;
    } catch (const std::exception& error) {
      fail(step, error.what());
      spdlog::warn("{}: {}", command.name, error.what());
      if (among_others_) write_json(failure_file(command, settings_.out), {{"error", step.error}});
    }
    return true;
  }

  /// Whether no other rank has it.
  bool take(const Case& command, std::optional<FolderLock>& claim) {
    make_output_folder(settings_.out / command.name);
    try {
      claim.emplace(settings_.out / command.name);
    } catch (const FolderInUse&) {
      return false;
    }
    return true;
  }

  /// Whether it need not be run any more: finished, or failed on another rank.
  bool is_over(const Case& command, Step& step) {
    if (is_finished(command, settings_.out)) {
      say(command, awaited_.contains(command.name) ? ": by another process" : ": kept");
      succeed(command, step);
      return true;
    }
    const fs::path failure = failure_file(command, settings_.out);
    if (!among_others_ || !fs::exists(failure)) return false;
    const json failure_record = read_json(failure);
    fail(step, JsonFields(failure, failure_record, kMakeAgain).text("error"));
    return true;
  }

  /// Empties the folder of a case that was begun with other settings: no command may resume from it.
  void start_afresh(const Case& command, const json& now) const {
    const json before = recorded(command, settings_.out);
    if (before.is_null() || before == now) return;
    for (const auto& entry : fs::directory_iterator(settings_.out / command.name))
      if (!entry.path().filename().native().starts_with('.')) fs::remove_all(entry.path());  // but the lock
  }

  void run_case(const Case& command) {
    const json now = provenance(command, settings_.out);
    make_output_folder(settings_.out / command.name);
    start_afresh(command, now);
    NamedSettings named = command.settings_in(settings_.out);
    named["out"] = (settings_.out / command.name).string();
    named["threads"] = std::to_string(settings_.threads);
    named["quiet"] = fmt::format("{}", settings_.quiet);
    write_json(record_file(command, settings_.out), {{"case", command.name}, {"made_of", now}});
    const auto start = Clock::now();
    {
      const SingleRankScope alone;
      run_(to_word(command.kind), named);
    }
    return_unused_memory();
    write_json(record_file(command, settings_.out),
               {{"case", command.name}, {"made_of", now}, {"seconds", seconds_since(start)}});
  }

  void succeed(const Case& command, Step& step) const {
    step.status = Step::Status::done;
    step.seconds = recorded_seconds(record_file(command, settings_.out));
  }

  static void fail(Step& step, const std::string& why) {
    step.status = Step::Status::failed;
    step.error = why;
  }

  void say(const Case& command, const char* what) const {
    if (settings_.quiet) return;
    std::fputs(
        fmt::format("\n== {}/{} {}{} ==\n", &command - cases_.data() + 1, cases_.size(), command.name, what)
            .c_str(),
        stdout);
    std::fflush(stdout);
  }

  const std::vector<Case>& cases_;
  const ReproduceSettings& settings_;
  const Execute& run_;
  bool among_others_;
  std::map<std::string, Step> steps_;
  std::set<std::string> awaited_;  ///< not ended at first sight
};

/// Texts and page. The page's file; empty if it could not be written.
fs::path write_page(const fs::path& out, const json& tables) {
  // If Python is missing, no page of an earlier run stays.
  fs::remove(out / "reproduce.html");
  fs::remove(text_file(out, "reproduce"));
  for (const json& table : tables) fs::remove(text_file(out, table.at("name")));
  std::string why;
  if (run_script("validation/paper/paper_page.py", out, &why) == 0) return out / "reproduce.html";
  spdlog::warn("no page: {} (all figures are in {})",
               why.empty() ? "install python3-jinja2 and python3-pil" : why,
               (out / "reproduce.json").string());
  return {};
}

/// Each attacked detector on its data once.
json reliance_json(const Evidence& evidence) {
  json list = json::array();
  std::set<std::string> seen;
  for (const bool own : {true, false})  // a detector's own runs name it best
    for (const auto& [name, judged] : evidence.evaluations) {
      if (own == (name.find("--on--") != std::string::npos)) continue;
      const Outcomes& learned = judged.at("learned");
      if (!learned.reliance || !seen.insert(learned.data + to_json(*learned.reliance).dump()).second)
        continue;
      json entry = to_json(*learned.reliance);
      entry["case"] = name.substr(name.find('/') + 1);
      entry["words"] = describe(*learned.reliance) + (learned.note().empty() ? "" : "; " + learned.note());
      list.push_back(std::move(entry));
    }
  return list;
}

}  // namespace

json table_json(const Table& table, const Experiments& experiments, const Evidence& evidence) {
  json columns = json::array(), rows = json::array();
  for (const Column& column : table.columns)
    columns.push_back({{"key", column.key}, {"title", column.title}});
  for (const Row& row : table.rows) rows.push_back(row_json(table, row, experiments, evidence));
  return {{"name", table.name},     {"title", table.title}, {"note", table.note},
          {"matrix", table.matrix}, {"columns", columns},   {"rows", rows}};
}

json arms_json(const Experiments& experiments, const ReproduceSettings& settings, const Evidence& evidence) {
  json list = json::array();
  for (const Case& command : experiments.cases) {
    if (command.kind != Case::Kind::evaluate || is_repetition(command.name)) continue;
    const Case &attack = experiments.at(command.run()), &stage = experiments.at(command.hosts_of());
    for (const std::string mesh : {"learned", "start", "sized", "cuboid"}) {
      const Outcomes *outcomes = evidence.of(command.name, mesh), *sized = evidence.of(command.name, "sized");
      if (!outcomes) continue;
      const std::string name = command.name.substr(command.name.find('/') + 1);
      json arm = {
          {"name", name},
          {"detector", attack.setting("detector")},
          {"target", attack.setting("target")},
          {"rig", rig_of(name)},
          {"judge", command.setting("detector", stage.setting("detector"))},
          {"mesh", mesh},
          {"seeds", json::array()},
          {"vehicles", outcomes->vehicles},
          {"frames", outcomes->frames()},
          {"hidden", hidden_json(*outcomes, nullptr)},
          {"fp_asr", to_json(share(*outcomes, question("fp_asr")))},
          {"interval",
           {{"confidence", kConfidence}, {"drawn", outcomes->runs > 1 ? "runs and clusters" : "clusters"}}}};
      std::set<int> runs;
      for (const Outcome& host : outcomes->hosts) runs.insert(host.run);
      for (const int run : runs) arm["seeds"].push_back(settings.seed + static_cast<std::uint64_t>(run));
      for (const char* varied : {"defense", "parts"})
        if (const std::string word = attack.setting(varied); !word.empty()) arm[varied] = word;
      if (mesh == "learned" && sized) arm["net"] = hidden_json(*outcomes, sized);
      list.push_back(std::move(arm));
    }
  }
  return list;
}

bool is_finished(const Case& command, const fs::path& out) {
  const fs::path record = record_file(command, out);
  if (!fs::exists(record) || !fs::exists(out / command.name / "result.json")) return false;
  try {
    return read_json(record).contains("seconds") && recorded(command, out) == provenance(command, out);
  } catch (const std::exception&) {
    return false;  // the command itself will say what is wrong
  }
}

std::map<std::string, Step> execute(const Experiments& experiments, const ReproduceSettings& settings,
                                    const Execute& run) {
  return Steps(experiments, settings, run).run_all();
}

fs::path text_file(const fs::path& out, const std::string& table) {
  return out / (table + ".md");
}

json reproduce(const ReproduceSettings& requested, const Execute& run) {
  ReproduceSettings settings = requested;
  const fs::path out = settings.out = fs::absolute(requested.out).lexically_normal();
  const Experiments list = experiments(settings);
  const std::map<std::string, Step> steps = execute(list, settings, run);
  if (rank() > 0) return json::object();
  const Evidence evidence = gather(list, out, steps);
  const AttackSettings recipe;  // CaseList takes these from it
  json result = {{"what", settings.what},
                 {"settings",
                  {{"iterations", settings.iterations},
                   {"batch", recipe.batch},
                   {"vertex_rate", recipe.vertex_rate},
                   {"texel_rate", recipe.texel_rate},
                   {"seed", settings.seed},
                   {"seeds", settings.seeds},
                   {"random_meshes", settings.random_meshes},
                   {"frames", settings.frames},
                   {"judge_frames", settings.judge_frames},
                   {"quick", settings.quick},
                   {"kitti64", data_folder(settings, "kitti64").filename().string()},
                   {"xenith", data_folder(settings, "xenith").filename().string()},
                   {"real", settings.real.filename().string()},
                   {"confidence", kConfidence}}},
                 {"tables", list_json(list.tables,
                                      [&](const Table& table) { return table_json(table, list, evidence); })},
                 {"arms", arms_json(list, settings, evidence)},
                 {"findings", list_json(findings(evidence))},
                 {"reliance", reliance_json(evidence)},
                 {"steps", json::object()}};
  for (const auto& [name, step] : steps) result["steps"][name] = to_json(step);
  write_json(out / "reproduce.json", result);
  if (const fs::path page = write_page(out, result.at("tables")); !page.empty())
    result["page"] = page.string();
  return result;
}

}  // namespace mirage::paper
