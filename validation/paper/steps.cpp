#include "validation/paper/steps.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <list>
#include <optional>
#include <set>
#include <thread>

#include "base/clock.h"
#include "base/error.h"
#include "base/files.h"
#include "base/folder_lock.h"
#include "base/interrupt.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/ranks.h"
#include "base/unused_memory.h"
#include "detection/detector.h"
#include "scene/data/data_rig.h"

namespace mirage::paper {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

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

/// What the case's result is made of: settings, other cases by their names so that OUT may be moved, and
/// hashes of the files that may change under the same settings.
json made_of(const Case& command, const fs::path& out) {
  json read = json::object();
  if (command.kind == Case::Kind::evaluate) {
    read["adversary"] = file_hash(out / command.run() / "adversary.glb");
    read["hosts"] = file_hash(out / command.hosts_of() / "run.json");
  } else if (command.kind != Case::Kind::generate) {
    read["weights"] = "";  // without the file the command itself says what is missing
    try {
      DetectorOptions detector;
      detector.detector = command.setting("detector");
      detector.rig = data_rig(command.settings_in(out).at("data"));
      detector.defense = command.setting("defense", "none");
      read["weights"] = weights_hash(detector);
    } catch (const InputError&) {
    }
  }
  return {{"command", to_word(command.kind)},
          {"settings", command.settings},
          {"needs", command.needs},
          {"read", read}};
}

/// Seconds that the finished case took. InputError naming file and field.
double recorded_seconds(const fs::path& file) {
  const json record = read_json(file);
  return JsonFields(file, record, kMakeAgain).number("seconds", 0, Range::kMost);
}

/// This rank's part of the work.
class Steps {
 public:
  Steps(const Experiments& experiments, const ReproduceSettings& settings, const Execute& run)
      : cases_(experiments.cases), settings_(settings), run_(run), among_others_(rank_count() > 1) {}

  std::map<std::string, Step> run_all() {
    if (rank() == 0)
      for (const Case& command : cases_) fs::remove(failure_file(command, settings_.out));
    any_rank(false);  // nobody reads those of an earlier run
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
  /// Sees the case through. False if it must wait for another, or is another rank's.
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
    const json told = read_json(failure);
    fail(step, JsonFields(failure, told, kMakeAgain).text("error"));
    return true;
  }

  void run_case(const Case& command) {
    NamedSettings named = command.settings_in(settings_.out);
    named["out"] = (settings_.out / command.name).string();
    named["threads"] = std::to_string(settings_.threads);
    named["quiet"] = fmt::format("{}", settings_.quiet);
    fs::remove(record_file(command, settings_.out));
    const auto start = Clock::now();
    {
      const AloneAmongRanks alone;
      run_(to_word(command.kind), named);
    }
    return_unused_memory();
    write_json(record_file(command, settings_.out), {{"case", command.name},
                                                     {"made_of", made_of(command, settings_.out)},
                                                     {"seconds", seconds_since(start)}});
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

}  // namespace

bool is_finished(const Case& command, const fs::path& out) {
  const fs::path record = record_file(command, out);
  if (!fs::exists(record) || !fs::exists(out / command.name / "result.json")) return false;
  try {
    return read_json(record).value("made_of", json()) == made_of(command, out);
  } catch (const std::exception&) {
    return false;  // the command itself will say what is wrong
  }
}

std::map<std::string, Step> execute(const Experiments& experiments, const ReproduceSettings& settings,
                                    const Execute& run) {
  return Steps(experiments, settings, run).run_all();
}

}  // namespace mirage::paper
