// The subcommands of `mirage`: their options and what they run. Commands hold no logic of their own.
#pragma once

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "base/child_process.h"
#include "base/error.h"
#include "base/files.h"
#include "base/intervals.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/provenance.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "detection/reliance.h"

namespace mirage::cli {

/// Options that every command takes.
struct Common {
  std::uint64_t seed = 0;
  int threads = 0;
  std::filesystem::path out;
  bool quiet = false;
  /// The result's provenance: it holds the options; commands add the inputs that these name.
  std::shared_ptr<Provenance> provenance = std::make_shared<Provenance>();
};

/// Every x_command() returns command_of<XOptions>({.name = …, .help = …, .example = …}). The code that does
/// the work stands above it in the anonymous namespace.
struct Command {
  /// `default_out`: "" is out/NAME. `example`: an example command line for its help.
  std::string name = {}, help = {}, default_out = {}, example = {};
  /// Adds the command's own options; the referenced variables live as long as the command.
  std::function<void(CLI::App&)> options = {};
  /// Does the work, prints a short table on standard output and returns the content of result.json.
  std::function<nlohmann::json(const Common&)> run = {};
  /// Runs after result.json is written, and makes output from it, such as a page.
  std::function<void(const Common&)> afterwards = {};
  bool many_ranks = false;  ///< may run under mpirun (base/ranks.h)
  /// For a command whose result is one file (a page, a rig): its name in the output folder. Common::out is
  /// then that file; --out may name a folder or a file of its kind, beside which the result goes as
  /// *.result.json.
  std::string page = {}, one_file = "the page";
};

/// The folder's result.json before this command writes its own; null if it is missing or unreadable.
inline nlohmann::json earlier_result(const std::filesystem::path& out) {
  try {
    return std::filesystem::exists(out / "result.json") ? read_json(out / "result.json") : nlohmann::json();
  } catch (const InputError&) {
    return {};
  }
}

/// The names under a result's `key`: a list's strings or an object's keys, if they are plain file names.
inline std::vector<std::string> listed_names(const nlohmann::json& result, const char* key) {
  std::vector<std::string> names;
  const auto add = [&](const std::string& name) {
    if (std::filesystem::path(name).filename() == name) names.push_back(name);
  };
  if (!result.is_object() || !result.contains(key)) return names;
  for (const auto& item : result.at(key).items())
    if (result.at(key).is_object())
      add(item.key());
    else if (item.value().is_string())
      add(item.value().get<std::string>());
  return names;
}

/// Removes the pictures that the folder's earlier result lists and `result`, the one to be written, does not:
/// they would pass for its own. Names under `plots` are of files in `out`, under `pictures` in the folder of
/// that name.
inline void remove_unlisted_pictures(const std::filesystem::path& out, const nlohmann::json& result) {
  const nlohmann::json before = earlier_result(out);
  for (const auto& [list, folder] : {std::pair("plots", out), std::pair("pictures", out / "pictures")}) {
    const std::vector<std::string> kept = listed_names(result, list);
    for (const std::string& name : listed_names(before, list))
      if (std::find(kept.begin(), kept.end(), name) == kept.end() &&
          std::filesystem::is_regular_file(folder / name))
        std::filesystem::remove(folder / name);
  }
}

/// A command whose options are a struct. Beside the struct stand add_options(CLI::App&, Options&),
/// run(Options&, const Common&) and, optionally, afterwards(const Options&, const Common&): overloads, in a
/// unity build. Pictures in --out stay only if run()'s result lists them (remove_unlisted_pictures).
template <class Options>
Command command_of(Command command) {
  const auto options = std::make_shared<Options>();  // lives as long as the command
  if (command.default_out.empty()) command.default_out = "out/" + command.name;
  command.options = [options](CLI::App& app) { add_options(app, *options); };
  command.run = [options](const Common& common) {
    nlohmann::json result = run(*options, common);
    if (rank() == 0) remove_unlisted_pictures(common.out, result);
    return result;
  };
  if constexpr (requires(const Common& common) { afterwards(*options, common); })
    command.afterwards = [options](const Common& common) { afterwards(*options, common); };
  return command;
}

/// Adds an option whose help shows its default: the present `value`.
template <class T>
CLI::Option* add_defaulted(CLI::App& app, const std::string& name, T& value, const std::string& help) {
  return app.add_option(name, value, help)->capture_default_str();
}

/// Copies the options of every command into a library's settings.
template <class Settings>
void take_common(Settings& settings, const Common& common) {
  if constexpr (requires { settings.out; }) settings.out = common.out;
  if constexpr (requires { settings.seed; }) settings.seed = common.seed;
  if constexpr (requires { settings.threads; }) settings.threads = common.threads;
  if constexpr (requires { settings.quiet; }) settings.quiet = common.quiet;
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

// Output of commands: short tables on standard output, and pages.

using Rows = std::vector<std::pair<std::string, std::string>>;

inline void print_table(const Rows& rows) {
  std::size_t widest = 0;
  for (const auto& [name, value] : rows) widest = std::max(widest, name.size());
  for (const auto& [name, value] : rows)
    std::fputs(fmt::format("{:<{}}  {}\n", name, widest, printable(value)).c_str(), stdout);
  std::fflush(stdout);
}

/// Columns of a UTF-8 text, one for each character.
inline std::size_t columns(const std::string& text) {
  return as_size(std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xC0) != 0x80; }));
}

/// Rows of cells; the first row holds the headings.
using Columns = std::vector<std::vector<std::string>>;

/// Prints them after an empty line; a row may have fewer cells than the others.
inline void print_columns(const Columns& rows) {
  std::vector<std::size_t> widest;
  for (const auto& row : rows)
    for (std::size_t i = 0; i < row.size(); ++i) {
      if (widest.size() <= i) widest.push_back(0);
      widest[i] = std::max(widest[i], columns(printable(row[i])));
    }
  std::fputs("\n", stdout);
  for (const auto& row : rows) {
    std::string line;
    for (std::size_t i = 0; i < row.size(); ++i) {
      const std::string cell = printable(row[i]);
      line += cell;
      if (i + 1 < row.size()) line.append(widest[i] + 2 - columns(cell), ' ');
    }
    std::fputs((line + "\n").c_str(), stdout);
  }
  std::fflush(stdout);
}

inline std::string percent(double share) {
  return fmt::format("{:.1f} %", 100 * share);
}

/// "20.8 % (8.3–37.5)"
inline std::string percent(const Interval& share) {
  return fmt::format("{} ({:.1f}–{:.1f})", percent(share.value), 100 * share.low, 100 * share.high);
}

/// Table rows on a detector's use of its picture.
inline Rows picture_rows(const Reliance& reliance) {
  Rows rows = {{"use of the picture", describe(reliance)}};
  if (const std::string note = picture_note(reliance); !note.empty()) rows.push_back({"images", note});
  return rows;
}

/// Removes the pages that validation/report/command_page.py made in this folder: beside a result that they do
/// not show they would pass for its own.
inline void remove_pages(const std::filesystem::path& out) {
  for (const char* page : {"audit.html", "compare.html", "drive.html", "score.html", "board.html"})
    std::filesystem::remove(out / page);
}

/// The page that a Python program makes beside OUT/result.json, one self-contained file
/// (validation/report/command_page.py). If Python fails, logs a warning that says why; a page of an earlier
/// result is removed all the same.
inline void write_page(const std::filesystem::path& out) {
  remove_pages(out);
  std::string output;
  if (run_script("validation/report/command_page.py", out, &output) != 0)
    spdlog::warn("no page beside {}: {}", (out / "result.json").string(),
                 output.empty() ? "install python3-jinja2 and python3-pil" : output);
}

}  // namespace mirage::cli
