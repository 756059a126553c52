#include "validation/paper/evidence.h"

#include <fmt/format.h>

#include <exception>
#include <limits>

#include "base/fields.h"
#include "base/files.h"
#include "base/json_fields.h"

namespace mirage::paper {
namespace {

constexpr char kMark = '+';

bool is_repeated(const Case& command) {
  return command.kind == Case::Kind::attack || command.kind == Case::Kind::evaluate;
}

/// With another seed, and on the runs of that; pictures are made once.
Case repeated(const Case& command, int number, const ReproduceSettings& settings) {
  Case rerun = command;
  rerun.name = repetition(command.name, number);
  if (command.kind == Case::Kind::evaluate)
    for (auto& [folder, need] : rerun.needs)
      if (folder != "data") need = repetition(need, number);
  rerun.settings.erase("pictures");
  rerun.settings["seed"] = std::to_string(settings.seed + static_cast<std::uint64_t>(number));
  return rerun;
}

}  // namespace

std::string repetition(const std::string& name, int number) {
  return number == 0 ? name : fmt::format("{}{}{}", name, kMark, number);
}

bool is_repetition(const std::string& name) {
  return name.find(kMark) != std::string::npos;
}

void repeat(Experiments& experiments, const ReproduceSettings& settings) {
  experiments.seeds = settings.seeds;
  const std::size_t once = experiments.cases.size();
  for (int number = 1; number < settings.seeds; ++number)
    for (std::size_t i = 0; i < once; ++i)
      if (is_repeated(experiments.cases[i]))
        experiments.cases.push_back(repeated(experiments.cases[i], number, settings));
}

namespace {

/// Files hold null for what is infinite.
double read_bound(const JsonFields& fields, const char* key, double infinite) {
  return fields.is_null(key) ? infinite : fields.number(key, -Range::kMost, Range::kMost);
}

std::optional<Share> read_precision(const JsonFields& fields, const std::string& key) {
  const auto value = [](const JsonFields& from, const std::string& name) {
    return from.number(name, 0, Range::kMost);
  };
  if (fields.has(key + "_interval")) {
    const JsonFields interval = fields.object(key + "_interval");
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    return Share{{value(interval, "value"), read_bound(interval, "low", -kInfinity),
                  read_bound(interval, "high", kInfinity)}};
  }
  if (fields.has(key)) return Share{{value(fields, key), 0, 0}, false};
  return std::nullopt;
}

}  // namespace

nlohmann::json to_json(const Step& step) {
  const char* words[] = {"missing", "done", "failed"};
  nlohmann::json entry = {{"status", words[static_cast<int>(step.status)]}};
  if (!step.error.empty()) entry["error"] = step.error;
  if (step.seconds > 0) entry["seconds"] = step.seconds;
  return entry;
}

nlohmann::json to_json(const Share& share) {
  if (share.bounded) return to_json(share.interval);
  return {{"value", share.interval.value}};
}

Detection read_detection(const std::filesystem::path& file) {
  const nlohmann::json json = read_json(file);
  const JsonFields fields(file, json, kMakeAgain);
  return {read_precision(fields, "ap50"), read_precision(fields, "ap70")};
}

const Outcomes* Evidence::of(const std::string& evaluation,
                             std::shared_ptr<const Outcomes> Judged::*mesh) const {
  const auto judged = evaluations.find(evaluation);
  return judged == evaluations.end() ? nullptr : (judged->second.*mesh).get();
}

Evidence gather(const Experiments& experiments, const std::filesystem::path& out,
                std::map<std::string, Step> steps) {
  Evidence evidence;
  std::map<std::string, Judged> judged_runs;
  for (const Case& command : experiments.cases) {
    Step& step = steps[command.name];
    if (step.status != Step::Status::done) continue;
    const auto file = out / command.name / "result.json";
    try {
      if (command.kind == Case::Kind::detect) evidence.detections[command.name] = read_detection(file);
      if (command.kind != Case::Kind::evaluate) continue;
      // Hosts are those of the data that were asked for, or else of the run that is judged or named for it.
      const NamedSettings own = command.settings_in(out);
      const auto data = own.find("data");
      judged_runs[command.name] = read_evaluation(
          file,
          data != own.end() ? data->second : experiments.at(command.hosts_of()).settings_in(out).at("data"));
    } catch (const std::exception& error) {
      step.status = Step::Status::failed;
      step.error = error.what();
    }
  }
  // A repetition that failed is missing; what stands in for its experiment is the first, which has the name.
  for (const auto& [name, first] : judged_runs) {
    std::vector<Judged> runs{first};
    for (int number = 1; number < experiments.seeds; ++number)
      if (const auto more = judged_runs.find(repetition(name, number)); more != judged_runs.end())
        runs.push_back(more->second);
    if (!is_repetition(name)) evidence.evaluations[name] = pooled(runs);
  }
  evidence.steps = std::move(steps);
  return evidence;
}

}  // namespace mirage::paper
