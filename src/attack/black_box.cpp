#include "attack/black_box.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "attack/evolution.h"
#include "attack/mesh_modes.h"
#include "attack/run.h"
#include "attack/search.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/json_fields.h"
#include "base/progress.h"
#include "base/provenance.h"
#include "base/ranks.h"
#include "base/schedule.h"

namespace mirage {
namespace {

/// Of what makes meshes in this folder and in mesh_modes.cpp: a folder of another one is not gone on with.
constexpr int kBlackBoxRecipe = 1;
/// Worlds of the whole sample are beyond those of any generation.
constexpr std::uint64_t kSampleWorlds = std::uint64_t{1} << 61;

class BlackBox {
 public:
  explicit BlackBox(const SearchRun& run)
      : run_(run),
        settings_(run.settings),
        file_(settings_.out / "checkpoint.json"),
        sample_(search_hosts(run.train, settings_.seed)),
        starts_(search_starts(settings_)),
        identity_(run.identity),
        timer_(settings_.checkpoint),
        progress_("attack", static_cast<std::size_t>(settings_.queries), settings_.quiet) {
    identity_.json["recipe"] = kBlackBoxRecipe;
  }

  BlackBoxOutcome run() {
    plan();
    open();
    BlackBoxOutcome outcome;
    outcome.first = std::ssize(rows_);
    NamedStart& start = judge_starts();
    const MeshModes modes = modes_of(start.mesh);
    const auto made = [&](std::span<const double> numbers) {
      TexturedMesh mesh = modes.mesh(numbers);
      if (settings_.buildable.on) keep_buildable(mesh, start.mesh, settings_.buildable, settings_.limits);
      return mesh;
    };
    const AttackStepper stepper = stepper_of(start.mesh);
    Evolution evolution(modes.size(), plan_.samples, settings_.seed);
    const HostOrder order(sample_, settings_.batch, settings_.seed);
    const auto known = std::ssize(rows_) - std::ssize(starts_);
    const long meshes = std::max(plan_.generations, known / plan_.samples) * plan_.samples;
    for (long i = 0; i < meshes; ++i) {
      const long generation = i / plan_.samples;
      if (i == std::ssize(rows_) - std::ssize(starts_)) {
        std::vector<Host> hosts;
        for (const std::size_t k : order.batch(generation)) hosts.push_back(sample_[k]);
        look(stepper, made(evolution.next()), hosts,
             static_cast<std::uint64_t>(generation) * static_cast<std::uint64_t>(settings_.batch),
             fmt::format("generation {} of {}", generation + 1, meshes / plan_.samples));
      }
      evolution.add(rows_[starts_.size() + static_cast<std::size_t>(i)].loss());
    }
    TexturedMesh arrived = made(evolution.centre());
    const double value = stepper.judge(arrived, sample_, kSampleWorlds, &stages_).loss();
    spdlog::info("searched from {}: {:.4f} after {} generations, {:.4f} at the start, on {} vehicles",
                 start.name, value, meshes / plan_.samples, start.value, sample_.size());
    save();
    outcome.state.adversary = value < start.value ? arrived : start.mesh;
    outcome.state.losses = rows_;
    outcome.state.iteration = std::ssize(rows_);
    outcome.stages = stages_;
    BlackBoxReport& report = outcome.report;
    report.vehicles = sample_.size();
    report.queries = queries(std::ssize(rows_)) + std::ssize(sample_);
    report.numbers = modes.size();
    report.samples = plan_.samples;
    report.generations = meshes / plan_.samples;
    for (const NamedStart& each : starts_) report.starts.push_back({each.name, each.value});
    report.start = start.name;
    report.loss = std::min(value, start.value);
    return outcome;
  }

 private:
  MeshModes modes_of(const TexturedMesh& mesh) const {
    return {mesh, settings_.limits, settings_.parts, run_.detectors.front()->capabilities().reads_image};
  }
  AttackStepper stepper_of(const TexturedMesh& mesh) const {
    return {settings_, run_.detectors, run_.store, sample_, mesh.mesh, run_.sights};
  }
  /// Of the first so many meshes.
  long queries(long meshes) const {
    const long starts = std::min(meshes, std::ssize(starts_));
    return starts * std::ssize(sample_) + (meshes - starts) * settings_.batch;
  }

  void plan() {
    plan_ = black_box_plan(settings_, starts_.size(), modes_of(starts_.front().mesh).size(), sample_.size());
  }

  void open() {
    if (exists(file_)) {
      constexpr const char* kAgain = "delete the file to start the run again";
      const nlohmann::json known = read_json(file_);
      const JsonFields json(file_, known, kAgain);
      json.object("identity");
      check_identity(file_, known.at("identity"), identity_);
      rows_ = read_losses(json, static_cast<std::size_t>(json.count("iteration", kMostIterations)));
      if (known.value("program", nlohmann::json()) != program_identity())
        spdlog::warn("{}: {} meshes were looked at by another program or on another processor",
                     file_.string(), rows_.size());
    }
    if (any_rank(std::ssize(rows_) != first_rank_value(std::ssize(rows_))))
      throw Failure(file_.string(), "processes see different files",
                    "give --out a folder that all machines share");
    if (rank() == 0) write_json(settings_.out / "run.json", identity_.json);
  }

  void save() const {
    if (rank() > 0) return;
    nlohmann::json json = losses_json(rows_);
    json["identity"] = identity_.json;
    json["program"] = program_identity();
    json["iteration"] = rows_.size();
    write_json(file_, json);
    write_losses(settings_.out / "loss.csv", rows_);
  }

  void look(const AttackStepper& stepper, const TexturedMesh& mesh, const std::vector<Host>& hosts,
            std::uint64_t first_world, const std::string& what) {
    if (any_rank(interrupted())) {
      save();
      throw Interrupted(fmt::format("interrupted after {} of {} queries; run the same command to go on",
                                    queries(std::ssize(rows_)), settings_.queries));
    }
    rows_.push_back(stepper.judge(mesh, hosts, first_world, &stages_));
    const LossRow& row = rows_.back();
    progress_.update(
        static_cast<std::size_t>(queries(std::ssize(rows_))),
        fmt::format("{}  loss {:.3f}  hidden {} of {} found", what, row.loss(), row.hidden, row.found));
    if (timer_.due(std::ssize(rows_))) save();
  }

  /// The best of them.
  NamedStart& judge_starts() {
    for (std::size_t i = 0; i < starts_.size(); ++i) {
      NamedStart& start = starts_[i];
      if (i == rows_.size())
        look(stepper_of(start.mesh), start.mesh, sample_, kSampleWorlds, "start " + start.name);
      start.value = rows_[i].loss();
      spdlog::info("start {}: {:.4f} on {} vehicles", start.name, start.value, sample_.size());
    }
    return *std::min_element(starts_.begin(), starts_.end(),
                             [](const NamedStart& a, const NamedStart& b) { return a.value < b.value; });
  }

  const SearchRun& run_;
  const AttackSettings& settings_;
  std::filesystem::path file_;
  std::vector<Host> sample_;
  std::vector<NamedStart> starts_;
  RunIdentity identity_;
  CheckpointTimer timer_;
  Progress progress_;
  BlackBoxPlan plan_;
  std::vector<LossRow> rows_;  // of the meshes looked at: first the starts
  StageSeconds stages_;
};

}  // namespace

BlackBoxPlan black_box_plan(const AttackSettings& settings, std::size_t starts, std::size_t numbers,
                            std::size_t vehicles) {
  BlackBoxPlan plan;
  plan.samples = 4 + static_cast<int>(3 * std::log(static_cast<double>(numbers)));  // Hansen's default
  plan.samples = std::max(plan.samples, 5);
  const long generation = static_cast<long>(plan.samples) * settings.batch;
  const long beside = static_cast<long>((starts + 1) * vehicles);  // the starts, and where it arrives
  plan.generations = (settings.queries - beside) / generation;
  if (settings.queries < beside + generation)
    throw FieldError("queries", std::to_string(settings.queries),
                     fmt::format("starts and end take {}, a generation {}", beside, generation),
                     fmt::format("use {} or more, or a smaller --batch", beside + generation));
  return plan;
}

BlackBoxOutcome run_black_box(const SearchRun& run) {
  return BlackBox(run).run();
}

}  // namespace mirage
