#include "attack/portfolio.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <optional>
#include <set>

#include "attack/attack_hosts.h"
#include "attack/baseline.h"
#include "attack/checkpoint.h"
#include "attack/run.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/ranks.h"
#include "base/schedule.h"
#include "base/sizes.h"

namespace mirage {
namespace {

/// Largest share of the budget for the search: gradient steps reach lower objectives than warped shapes.
constexpr double kSearchShare = 0.25;

/// Factors on --vertex-rate and --texel-rate; each candidate has one factor for both.
constexpr double kRates[] = {1, 0.25};
/// Version of the rates, shares and choices in this file: a folder of another version cannot be resumed.
constexpr int kRecipe = 5;
constexpr const char* kAutoAgain = "delete the file to do its part of the run again";
constexpr std::size_t kMaxEvaluations = 1'000'000;

struct Candidate {
  std::string start;
  AttackSettings settings;
  RunIdentity identity = nlohmann::json::object();
  std::filesystem::path file;
  std::unique_ptr<AttackStepper> stepper;
  AttackState state;
  int rounds = 0;  // rounds that it entered
};

/// Lowest value of the checks up to `step` steps.
double best_until(const HeldOutRecord& record, long step) {
  double best = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < record.values.size() && record.iterations[i] <= step; ++i)
    best = std::min(best, record.values[i]);
  return best;
}

class Portfolio {
 public:
  explicit Portfolio(const SearchRun& run)
      : run_(run),
        settings_(run.settings),
        folder_(settings_.out / "auto"),
        part_(split_validation(run.train, settings_.seed, kSelectionHosts, "attack")),
        identity_(run.identity),
        timer_(settings_.checkpoint),
        progress_("attack", as_size(settings_.iterations), settings_.quiet) {
    identity_.json["iterations"] = settings_.iterations;
    identity_.json["recipe"] = kRecipe;
    identity_.json["validation"] = to_json(host_ids(part_.held_out));
  }

  SearchOutcome run() {
    plan();
    open();
    SearchOutcome outcome;
    search();
    judge_starts();
    enter();
    outcome.first = known_;
    for (const Candidate& candidate : candidates_) outcome.first += candidate.state.iteration;
    halve();
    const auto best =
        std::ranges::min_element(candidates_, {}, [](const Candidate& c) { return c.state.held_out.best; });
    outcome.state = best->state;
    outcome.state.adversary = best->state.held_out.mesh;
    outcome.automatic = report(as_size(best - candidates_.begin()));
    outcome.stages = stages_;
    outcome.steps = spent();
    spdlog::info("candidate {} is chosen: {}, {:.4f} on {} vehicles held out", best - candidates_.begin(),
                 best->start, best->state.held_out.best, part_.held_out.size());
    if (rank() == 0) write_losses(settings_.out / "loss.csv", outcome.state.losses);
    return outcome;
  }

 private:
  void plan() {
    targets_ = auto_targets(settings_.target, run_.detectors.front()->capabilities());
    search_hosts_ = search_hosts(part_.learn, settings_.seed);
    const long looks = kShapesAGeneration * static_cast<long>(search_hosts_.size());
    const std::size_t starts = learns_shape(settings_) ? 2 : 1;
    budget_ =
        auto_budget(settings_.iterations, starts * targets_.size() * std::size(kRates),
                    learns_shape(settings_) ? (looks + 2 * settings_.batch - 1) / (2 * settings_.batch) : 0);
    long end = 0;
    for (const AutoBudget::Round& round : budget_.rounds) ends_.insert(end += round.steps);
  }

  /// Restores the values of an earlier process, and writes run.json.
  void open() {
    const auto check = [&](const std::filesystem::path& file, const nlohmann::json& stored) {
      JsonFields(file, stored, kAutoAgain).object("identity");
      check_identity(file, stored.at("identity"), identity_);
    };
    const auto own = settings_.out / "checkpoint.json", file = folder_ / "looks.json";
    if (exists(own)) check(own, read_json(own));
    if (exists(file)) {
      const nlohmann::json stored = read_json(file);
      check(file, stored);
      const JsonFields json(file, stored, kAutoAgain);
      const auto read = [&](const char* key) {
        return json.numbers(key, json.list(key, kMaxEvaluations).size(), -std::numeric_limits<double>::max(),
                            std::numeric_limits<double>::max());
      };
      shapes_ = read("shapes");
      starts_ = read("starts");
    }
    require_one_file(file, std::ssize(shapes_) + std::ssize(starts_), "files");
    if (rank() > 0) return;
    std::filesystem::create_directories(folder_);
    write_json(settings_.out / "run.json", identity_.json);
    write_total();
  }

  void write_total() const {
    if (rank() > 0) return;
    write_json(settings_.out / "checkpoint.json", {{"identity", identity_.json}, {"iteration", spent()}});
  }
  void write_looks() const {
    if (rank() > 0) return;
    write_json(folder_ / "looks.json",
               {{"identity", identity_.json}, {"shapes", shapes_}, {"starts", starts_}});
  }
  long spent() const {
    long steps = spent_;
    for (const Candidate& candidate : candidates_) steps += candidate.state.iteration;
    return steps;
  }
  void stop_if_interrupted() const {
    if (!any_rank(interrupted())) return;
    throw Interrupted(fmt::format("interrupted after {} of {} steps; run the same command to go on", spent(),
                                  settings_.iterations));
  }

  /// The objective of an unchanged mesh on these vehicles; the same on every rank. --expect draws the worlds
  /// by the search's own seed, so candidates differ by their meshes alone.
  double judge(const TexturedMesh& mesh, const std::vector<Host>& hosts) const {
    return AttackStepper(settings_, run_.detectors, run_.store, part_.learn, mesh.mesh, run_.clean_cache)
        .held_out(mesh, hosts);
  }

  void search() {
    if (budget_.generations == 0) return;
    const TexturedMesh cuboid = filling_shape(Baseline::cuboid, settings_.limits, settings_.buildable);
    const MeshModes modes(cuboid, settings_.limits, AttackParts::shape, false);
    Evolution method(modes.size(), kShapesAGeneration, settings_.seed);
    const auto total = as_size(budget_.generations) * kShapesAGeneration;
    const auto shape = [&](const std::vector<double>& numbers) {
      TexturedMesh mesh = modes.mesh(numbers);
      if (settings_.buildable.on) keep_buildable(mesh, cuboid, settings_.buildable, settings_.limits);
      return mesh;
    };
    if (shapes_.size() > total) shapes_.resize(total);
    known_ = budget_.search * static_cast<long>(shapes_.size()) / static_cast<long>(total);
    double lowest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < total; ++i) {
      if (i == shapes_.size()) {
        stop_if_interrupted();
        shapes_.push_back(judge(shape(method.next()), search_hosts_));
        write_looks();
      }
      lowest = std::min(lowest, shapes_[i]);
      method.add(shapes_[i]);
      spent_ = budget_.search * static_cast<long>(i + 1) / static_cast<long>(total);
      progress_.update(as_size(spent_), fmt::format("search {:.4f}", lowest));
      if ((i + 1) % kShapesAGeneration == 0)
        spdlog::info("search, generation {} of {}: the lowest objective so far is {:.4f}",
                     (i + 1) / kShapesAGeneration, budget_.generations, lowest);
    }
    searched_shape_ = shape(method.centre());
  }

  void judge_starts() {
    named_ = search_starts(settings_);
    if (searched_shape_) named_.push_back({"searched", *searched_shape_});
    starts_.resize(std::min(starts_.size(), named_.size()));
    for (std::size_t i = 0; i < named_.size(); ++i) {
      if (i == starts_.size()) {
        stop_if_interrupted();
        starts_.push_back(judge(named_[i].mesh, part_.held_out));
        write_looks();
      }
      named_[i].value = starts_[i];
      spdlog::info("start {}: {:.4f} on {} vehicles held out", named_[i].name, named_[i].value,
                   part_.held_out.size());
    }
    // A start that fills the box is strong at once, but has little room to learn; the paper's is the
    // opposite.
    kept_ = {named_.front()};
    const auto other = std::ranges::min_element(named_.begin() + 1, named_.end(), {}, &NamedStart::value);
    if (other != named_.end()) kept_.push_back(*other);
  }

  /// Creates the candidates, from their checkpoints if they exist.
  void enter() {
    for (const NamedStart& start : kept_)
      for (const AttackTarget target : targets_)
        for (const double rate : kRates) {
          Candidate c;
          c.start = start.name;
          c.settings = settings_;
          c.settings.target = target;
          c.settings.vertex_rate *= rate;
          c.settings.texel_rate *= rate;
          c.settings.seed += candidates_.size();
          c.identity = identity_;
          c.identity.json["start"] = start.name;
          c.identity.json["target"] = to_word(target);
          c.identity.json["vertex_rate"] = c.settings.vertex_rate;
          c.identity.json["texel_rate"] = c.settings.texel_rate;
          c.identity.json["seed"] = c.settings.seed;
          c.file = folder_ / fmt::format("candidate-{}.json", candidates_.size());
          c.state = fresh_state(c.settings);
          c.state.adversary = start.mesh;
          if (exists(c.file)) c.state = read_checkpoint(c.file, c.identity, c.settings, start.mesh);
          candidates_.push_back(std::move(c));
        }
    for (Candidate& c : candidates_) {
      require_one_file(c.file, c.state.iteration, "checkpoints");
      c.stepper = std::make_unique<AttackStepper>(c.settings, run_.detectors, run_.store, part_.learn,
                                                  c.state.adversary.mesh, run_.clean_cache);
    }
  }

  void save(const Candidate& c) const {
    if (rank() == 0) write_checkpoint(c.file, c.state, c.identity.json);
    write_total();
  }

  void advance(Candidate& c, long until) {
    HeldOutRecord& record = c.state.held_out;
    for (;;) {
      const long at = c.state.iteration;
      if ((at % settings_.validation_every == 0 || ends_.contains(at)) &&
          (record.iterations.empty() || record.iterations.back() < at))
        record.add(at, judge(c.state.adversary, part_.held_out), c.state.adversary);
      if (at >= until) break;
      if (any_rank(interrupted())) {
        save(c);
        stop_if_interrupted();
      }
      const double share = static_cast<double>(at) / static_cast<double>(budget_.longest());
      const double decay = (1 + std::cos(std::numbers::pi * share)) / 2;
      c.state.vertices.learning_rate = decay * c.settings.vertex_rate;
      c.state.texels.learning_rate = decay * c.settings.texel_rate;
      const LossRow row = c.stepper->step(c.state, &stages_);
      progress_.update(as_size(spent()),
                       fmt::format("{} loss {:.3f} (hide {:.3f})", c.start, row.loss(), row.hide));
      if (timer_.due(c.state.iteration)) save(c);
    }
    save(c);
  }

  void halve() {
    std::vector<std::size_t> alive(candidates_.size());
    for (std::size_t i = 0; i < alive.size(); ++i) alive[i] = i;
    long until = 0;
    for (const AutoBudget::Round& round : budget_.rounds) {
      until += round.steps;
      alive.resize(round.candidates);
      for (const std::size_t i : alive) {
        Candidate& c = candidates_[i];
        advance(c, until);
        ++c.rounds;
        spdlog::info("candidate {} ({}, target {}, rates {:g} and {:g}): {:.4f} held out after {} steps", i,
                     c.start, to_word(c.settings.target), c.settings.vertex_rate, c.settings.texel_rate,
                     best_until(c.state.held_out, until), until);
      }
      std::ranges::stable_sort(
          alive, {}, [&](std::size_t i) { return best_until(candidates_[i].state.held_out, until); });
      if (&round == &budget_.rounds.front()) best_of_each_start_first(alive);
    }
  }

  /// Takes the starts' candidates in turn, each start's best first. So the first round keeps each start's
  /// better half: a start that fills the box leads before it has learned anything.
  void best_of_each_start_first(std::vector<std::size_t>& alive) const {
    std::map<std::string, int> before;
    std::vector<std::pair<int, std::size_t>> placed;
    for (const std::size_t i : alive) placed.emplace_back(before[candidates_[i].start]++, i);
    std::ranges::stable_sort(placed, {}, &std::pair<int, std::size_t>::first);
    for (std::size_t k = 0; k < alive.size(); ++k) alive[k] = placed[k].second;
  }

  AutoReport report(std::size_t chosen) const {
    AutoReport report;
    for (const Candidate& c : candidates_)
      report.candidates.push_back({c.start, c.settings.target, c.settings.vertex_rate, c.settings.texel_rate,
                                   c.settings.seed, c.state.iteration, c.rounds, c.state.held_out.best,
                                   c.state.held_out.best_iteration});
    for (const NamedStart& start : named_) report.starts.push_back({start.name, start.value});
    report.chosen = chosen;
    report.search = {budget_.generations, search_hosts_.size(), budget_.search, shapes_};
    report.vehicles = part_.held_out.size();
    report.steps = spent();
    return report;
  }

  const SearchRun& run_;
  const AttackSettings& settings_;
  std::filesystem::path folder_;
  ValidationPart part_;
  RunIdentity identity_;
  CheckpointTimer timer_;
  Progress progress_;
  AutoBudget budget_;
  std::set<long> ends_;  // ends of the rounds, in a candidate's steps
  std::vector<AttackTarget> targets_;
  std::vector<Host> search_hosts_;
  std::vector<double> shapes_, starts_;  // values judged so far
  std::optional<TexturedMesh> searched_shape_;
  std::vector<NamedStart> named_, kept_;
  std::vector<Candidate> candidates_;
  StepTimings stages_;
  long spent_ = 0, known_ = 0;  // steps of the search; those of earlier processes
};

}  // namespace

long AutoBudget::longest() const {
  long steps = 0;
  for (const Round& round : rounds) steps += round.steps;
  return steps;
}

AutoBudget auto_budget(long iterations, std::size_t candidates, long generation) {
  AutoBudget budget;
  for (std::size_t alive = candidates;; alive = (alive + 1) / 2) {
    budget.rounds.push_back({alive, 0});
    if (alive <= 1) break;
  }
  if (generation > 0)
    budget.generations =
        static_cast<int>(kSearchShare * static_cast<double>(iterations) / static_cast<double>(generation));
  const auto left = [&] { return iterations - budget.generations * generation; };
  const auto share = [&] { return left() / static_cast<long>(budget.rounds.size()); };
  while (budget.generations > 0 && share() < static_cast<long>(candidates)) --budget.generations;
  budget.search = budget.generations * generation;
  long used = 0;
  for (AutoBudget::Round& round : budget.rounds) {
    round.steps = share() / static_cast<long>(round.candidates);
    used += round.steps * static_cast<long>(round.candidates);
  }
  if (budget.rounds.front().steps == 0)
    throw FieldError(
        "iterations", std::to_string(iterations),
        fmt::format("--attack auto has {} candidates, and each needs a step in each round", candidates),
        fmt::format("use {} or more", candidates * budget.rounds.size()));
  budget.rounds.back().steps += left() - used;
  return budget;
}

std::vector<AttackTarget> auto_targets(AttackTarget requested, const Capabilities& detector) {
  std::vector<AttackTarget> targets{requested};
  if (requested == AttackTarget::both && detector.reads_points && detector.reads_image)
    targets.insert(targets.end(), {AttackTarget::lidar, AttackTarget::image});
  return targets;
}

SearchOutcome run_portfolio(const SearchRun& run) {
  return Portfolio(run).run();
}

}  // namespace mirage
