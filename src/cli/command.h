// The subcommands of `mirage`: their options and what they run. Commands hold no logic of their own.
#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/provenance.h"
#include "base/schedule.h"

namespace mirage::cli {

/// Options that every command takes.
struct Common {
  std::uint64_t seed = 0;
  int threads = 0;
  std::filesystem::path out;
  bool quiet = false;
  /// What the result is made of: options are in it; commands add what these stand for.
  std::shared_ptr<Provenance> made_of = std::make_shared<Provenance>();
};

/// Every x_command() returns command_of<XOptions>({.name = …, .help = …, .default_out = …, .example = …}).
/// What is done stands above it in the anonymous namespace.
struct Command {
  /// `example`: a command line of it, for its help.
  std::string name = {}, help = {}, default_out = {}, example = {};
  /// Adds the command's own options; the referenced variables live as long as the command.
  std::function<void(CLI::App&)> options = {};
  /// Does the work, prints a short table on standard output and returns what result.json shall hold.
  std::function<nlohmann::json(const Common&)> run = {};
  /// After result.json is written: what is made from it, a page.
  std::function<void(const Common&)> afterwards = {};
  bool many_ranks = false;  ///< may run under mpirun (base/ranks.h)
  /// Of a command whose result is one file (a page, a rig): its name in the output folder. Common::out is
  /// then that file; --out may name a folder or a file of its kind, beside which the result goes as
  /// *.result.json.
  std::string page = {}, one_file = "the page";
};

/// A command whose options are a struct. Beside that stand add_options(CLI::App&, Options&), run(Options&,
/// const Common&) and, where there is one, afterwards(const Options&, const Common&): overloads, in a unity
/// build.
template <class Options>
Command command_of(Command told) {
  const auto options = std::make_shared<Options>();  // lives as long as the command
  told.options = [options](CLI::App& app) { add_options(app, *options); };
  told.run = [options](const Common& common) -> nlohmann::json { return run(*options, common); };
  if constexpr (requires(const Common& common) { afterwards(*options, common); })
    told.afterwards = [options](const Common& common) { afterwards(*options, common); };
  return told;
}

/// What these options say of a training.
inline void take_common(TrainingSchedule& schedule, const Common& common) {
  schedule.out = common.out;
  schedule.seed = common.seed;
  schedule.threads = common.threads;
  schedule.quiet = common.quiet;
}

Command audit_command();
Command compare_command();
Command generate_command();
Command simulate_command();
Command fit_command();
Command train_command();
Command detect_command();
Command attack_command();
Command evaluate_command();
Command export_command();
Command validate_command();
Command tradeoff_command();
Command defend_command();
Command certify_command();
Command demo_command();
Command drive_command();
Command depth_command();
Command render_command();
Command reproduce_command();
Command rig_command();
Command score_command();
Command view_command();
Command zoo_command();

/// Parses `mirage <command> …`, runs the command, and turns errors into an exit code: 0 done, 1 failed, 2 bad
/// arguments or bad input. Errors print one line on standard error.
int dispatch(std::vector<std::string> arguments);

}  // namespace mirage::cli
