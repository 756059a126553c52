#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <ctime>
#include <exception>
#include <filesystem>
#include <map>
#include <new>
#include <optional>
#include <set>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "cli/help.h"
#include "exchange/gltf_document.h"
#include "frames/frame_provenance.h"
#include "scene/data/read_frames.h"

namespace mirage::cli {
namespace {

constexpr int kMaxThreads = 1024;

std::vector<Command> all_commands() {
  return {demo_command(),      generate_command(), simulate_command(), fit_command(),    train_command(),
          detect_command(),    attack_command(),   evaluate_command(), export_command(), validate_command(),
          tradeoff_command(),  defend_command(),   certify_command(),  render_command(), depth_command(),
          reproduce_command(), rig_command(),      view_command(),     audit_command(),  compare_command(),
          drive_command(),     zoo_command(),      score_command()};
}

void add_common(CLI::App& app, Common& common, const std::string& default_out) {
  common.out = default_out;
  add_defaulted(app, "--seed", common.seed, "seed of every random stream");
  add_defaulted(app, "--threads", common.threads, "threads at most; 0: all cores")
      ->check(within({0, kMaxThreads}));
  add_defaulted(app, "--out", common.out, "output folder");
  app.add_flag("--quiet", common.quiet, "print warnings only");
  app.add_option(
         "--config",
         "TOML file with option names as keys; options on the command line override it. It cannot name "
         "plugins or TorchScript models, which are code: name those on the command line")
      ->type_name("TEXT");
}

/// InputError for the first argument that looks like an option but is unknown to the command, or that stands
/// where nothing is expected.
void check_names(const std::vector<std::string>& arguments, const CLI::App& command) {
  for (std::size_t i = 1; i < arguments.size() && arguments[i] != "--"; ++i) {
    if (!arguments[i].starts_with("--")) continue;
    const std::string name = arguments[i].substr(0, arguments[i].find('='));
    const CLI::Option* option = command.get_option_no_throw(name);
    if (!option) {
      std::vector<std::string> long_names;
      for (const CLI::Option* other : command.get_options())
        for (const std::string& its : other->get_lnames()) long_names.push_back("--" + its);
      throw InputError(command.get_name(), name, "no such option", use_one_of(name, long_names));
    }
    if (name.size() == arguments[i].size())  // its values follow
      i += as_size(std::max(0, option->get_items_expected_min()));
  }
}

/// InputError for a first argument that is no command.
void check_command(const std::vector<std::string>& arguments, const std::vector<CLI::App*>& commands) {
  std::vector<std::string> command_names;
  for (const CLI::App* command : commands) command_names.push_back(command->get_name());
  if (arguments.empty())
    throw InputError("command", "", "is missing",
                     use_one_of("", command_names) + "; mirage --help tells what they do");
  const std::string& word = arguments.front();
  const std::vector<std::string> options = {"--help", "--version", "--completion"};
  const bool dashes = word.starts_with("-");
  if (word == "-h" || std::find(options.begin(), options.end(), word) != options.end() ||
      std::find(command_names.begin(), command_names.end(), word) != command_names.end())
    return;
  throw InputError(word, "", dashes ? "no such option" : "no such command",
                   dashes ? use_one_of(word, options, "a command first, such as mirage attack")
                          : use_one_of(word, command_names));
}

/// InputError for a value that is neither a valid path nor anything else that an option takes.
void check_lengths(const CLI::App& app) {
  constexpr std::size_t kMaxNameLength = 255, kMaxPathLength = 3800;  // Linux's, less what is added to it
  for (const CLI::Option* option : app.get_options())
    for (const std::string& text : option->results()) {
      std::size_t longest = 0;
      for (const auto& part : std::filesystem::path(text)) longest = std::max(longest, part.native().size());
      if (longest > kMaxNameLength || text.size() > kMaxPathLength)
        throw InputError(
            option->get_name(), text.substr(0, 40) + "…", "is too long",
            fmt::format("names of files have {} bytes at most, paths {}", kMaxNameLength, kMaxPathLength));
    }
}

/// "mirage 0.1.0 (commit ea8efec)"; for sources without their history: "mirage 0.1.0 (sources without git)".
std::string version_text() {
  const std::string commit = program_commit();
  return fmt::format("mirage {} ({})", program_version(),
                     commit.empty() ? "sources without git" : "commit " + commit);
}

/// The word as a shell takes it.
std::string quoted(const std::string& text) {
  const bool plain = !text.empty() && text.find_first_not_of(
                                          "abcdefghijklmnopqrstuvwxyz"
                                          "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
                                          "0123456789-_=+./,:@%") == std::string::npos;
  if (plain) return text;
  std::string out = "'";
  for (const char c : text) out += c == '\'' ? "'\\''" : std::string(1, c);
  return out + "'";
}

/// Identifies a run folder by content, wherever it and its data set lie.
std::string run_hash(const std::filesystem::path& run) {
  nlohmann::json about = read_json(run / "run.json");
  if (about.is_object())
    for (const char* place : {"data", "weights"}) about.erase(place);
  std::string hashes = content_hash(json_text(about));
  for (const char* file : {"adversary.glb", "random.glb"})
    if (std::filesystem::is_regular_file(run / file)) hashes += file_hash(run / file);
  return content_hash(hashes);
}

/// A number or boolean as JSON, else the text.
nlohmann::json typed(const std::string& text) {
  nlohmann::json value = nlohmann::json::parse(text, nullptr, false);
  return value.is_number() || value.is_boolean() ? value : nlohmann::json(written_text(text));
}

/// Identifies an earlier result by its provenance: its date and timings do not count.
std::string result_hash(const std::filesystem::path& file) {
  const nlohmann::json result = read_json(file);
  const nlohmann::json::json_pointer identity("/provenance/identity");
  return result.contains(identity) && result.at(identity).is_string() ? result.at(identity).get<std::string>()
                                                                      : file_hash(file);
}

/// Identifies a file by content; for a glTF, with the files that it names.
std::string whole_hash(const std::filesystem::path& file) {
  std::string hash = file_hash(file);
  if (const std::string kind = lower_extension(file); kind == ".gltf" || kind == ".glb")
    for (const std::string& buffer : open_gltf(file).buffers)
      if (!buffer.empty()) hash = content_hash(hash + content_hash(buffer));
  return hash;
}

constexpr auto kDataOptions =
    std::to_array<const char*>({"data", "validation", "real", "kitti64", "xenith", "meshes"});

/// All options of a command with their values, set or not, except those that name a place for results or
/// affect time alone. Files, run folders and earlier results count by content; the command adds data sets
/// itself, or add_data_sets does.
void add_options(Provenance& provenance, const CLI::App& command) {
  const std::set<std::string> beside = {"help", "out", "threads", "quiet", "config", "kitti", "claim"};
  for (const CLI::Option* option : command.get_options()) {
    std::string name = option->get_lnames().empty() ? option->get_name() : option->get_lnames().front();
    if (beside.contains(name)) continue;
    std::replace(name.begin(), name.end(), '-', '_');
    std::string text = option->get_default_str();
    if (option->count() > 0) text = fmt::format("{}", fmt::join(option->results(), ","));
    if (text.empty() && option->get_expected_max() == 0) text = "false";
    const std::filesystem::path file = text;
    std::error_code none;
    if (text.empty()) continue;
    try {
      if (std::filesystem::is_regular_file(file, none))
        provenance.input(name, whole_hash(file));
      else if (std::filesystem::is_regular_file(file / "run.json", none))
        provenance.input(name, run_hash(file));
      else if (std::ranges::find(kDataOptions, name) !=
               kDataOptions.end())  // beside generated frames lies a result.json, too
        continue;
      else if (std::filesystem::is_regular_file(file / "result.json", none))
        provenance.input(name, result_hash(file / "result.json"));
      else if (!std::filesystem::is_directory(file, none))
        provenance.set(name, typed(text));
    } catch (const InputError&) {  // the command itself says what is wrong with the file
    }
  }
}

/// Adds folders of options that the command has not added itself: a data set's first --frames frames, or the
/// files of another folder.
void add_data_sets(Provenance& provenance, const CLI::App& command) {
  const CLI::Option* frames = command.get_option_no_throw("--frames");
  for (const char* name : kDataOptions) {
    const CLI::Option* option = command.get_option_no_throw(std::string("--") + name);
    if (!option || option->count() == 0 || !provenance.input(name).empty()) continue;
    const std::filesystem::path folder = option->results().back();
    try {
      std::vector<std::string> ids = list_frames(folder);
      if (std::string(name) != "data") {
        provenance.input(name, frames_hash(folder, ids));
        continue;
      }
      if (const auto most = frames && frames->count() > 0 ? frames->as<std::size_t>() : 0; most > 0)
        ids.resize(std::min(ids.size(), most));
      add_data(provenance, folder, ids);
    } catch (const InputError&) {
      std::map<std::string, std::string> files;
      std::error_code none;
      for (const auto& entry : std::filesystem::directory_iterator(folder, none))
        if (entry.is_regular_file(none)) files[entry.path().filename()] = file_hash(entry.path());
      std::string all;
      for (const auto& [file, hash] : files) all += escape_name(file) + " " + hash + "\n";
      provenance.input(name, content_hash(all));
    }
  }
}

/// Runs one command line; returns CLI11's own exit code for --help, throws for errors. The content of
/// result.json also goes to `result_out`, if that is not null.
int run(const std::vector<std::string>& arguments, nlohmann::json* result_out = nullptr) {
  CLI::App app("Mirage: differentiable multi-sensor simulation for attacks on camera + LiDAR detectors",
               "mirage");
  app.require_subcommand(1);
  app.set_help_flag("-h,--help", "prints this text");
  app.set_version_flag("--version", version_text(), "prints version and commit");
  std::vector<Command> commands = all_commands();
  std::vector<Common> commons(commands.size());
  std::vector<CLI::App*> subcommands;
  for (std::size_t i = 0; i < commands.size(); ++i) {
    CLI::App* sub = app.add_subcommand(commands[i].name, commands[i].help);
    add_common(*sub, commons[i], commands[i].default_out);
    if (!commands[i].page.empty())
      sub->get_option("--out")->description(
          fmt::format("{} (*{}), or a folder for it", commands[i].one_file,
                      std::filesystem::path(commands[i].page).extension().string()));
    commands[i].options(*sub);
    check_numbers(*sub);
    if (!commands[i].example.empty()) add_example(*sub, commands[i].example);
    subcommands.push_back(sub);
  }
  app.add_option("--completion",
                 "prints a script that completes commands, options and words in bash or zsh: "
                 "source <(mirage --completion bash)")
      ->check(one_of({"bash", "zsh"}));
  format_help(app);
  if (arguments.size() == 2 && arguments[0] == "--completion" && print_completion(app, arguments[1]))
    return 0;
  check_command(arguments, subcommands);
  std::vector<std::string> expanded = arguments;
  const auto chosen = std::find_if(subcommands.begin(), subcommands.end(),
                                   [&](const CLI::App* sub) { return sub->get_name() == arguments.front(); });
  if (chosen != subcommands.end()) {
    check_names(arguments, **chosen);
    expanded = apply_config(arguments, **chosen);
  }
  std::reverse(expanded.begin(), expanded.end());  // CLI11 takes them from the back
  const auto with_options = [&](const auto& work) {
    try {
      return work();
    } catch (const FieldError& error) {  // a field that the user set by an option
      if (chosen == subcommands.end()) throw;
      throw InputError(option_of(**chosen, error.field), error.value, error.problem, error.fix);
    }
  };
  try {
    with_options([&] { app.parse(std::move(expanded)); });
  } catch (const CLI::Success& help) {
    return app.exit(help);
  } catch (const CLI::ParseError& error) {
    const UsageError complaint = usage_error(error, chosen == subcommands.end() ? app : **chosen);
    if (!complaint.option.empty() && complaint.problem != "is missing")
      throw InputError(complaint.option, "", complaint.problem, complaint.fix);
    throw InputError(arguments.front(), complaint.option, complaint.problem, complaint.fix);
  }
  for (std::size_t i = 0; i < commands.size(); ++i) {
    if (!subcommands[i]->parsed()) continue;
    if (rank_count() > 1 && !commands[i].many_ranks)
      throw InputError(commands[i].name, "mpirun", "this command runs in one process",
                       "start it without mpirun");
    check_lengths(*subcommands[i]);
    commons[i].quiet = commons[i].quiet || rank() > 0;
    set_thread_count(commons[i].threads);
    start_logging(commons[i].quiet);
    std::filesystem::path result_file = commons[i].out / "result.json";
    if (const std::string& page = commands[i].page; !page.empty()) {
      std::filesystem::path& out = commons[i].out;
      if (out.extension() ==
          std::filesystem::path(page)
              .extension())  // not *.json itself, which may be the user's own beside the page
        result_file = std::filesystem::path(out).replace_extension(".result.json");
      else
        out /= page;
    }
    const std::filesystem::path folder = std::filesystem::absolute(result_file).parent_path();
    make_output_folder(folder);
    std::optional<FolderLock> lock;
    if (rank() == 0)  // the only one that writes; what lies in folders beside a page is not the page's
      lock.emplace(folder, commands[i].page.empty() ? kFoldersBelow : 0);
    Provenance& provenance = *commons[i].provenance;
    std::string line = "mirage";
    for (const std::string& argument : arguments) line += " " + quoted(argument);
    provenance.record("command", written_text(line));
    provenance.record("date", fmt::format("{:%FT%TZ}", fmt::gmtime(std::time(nullptr))));
    provenance.record("seed", commons[i].seed);
    add_options(provenance, *subcommands[i]);
    nlohmann::json result = with_options([&] { return commands[i].run(commons[i]); });
    if (rank() == 0) {
      add_data_sets(provenance, *subcommands[i]);
      result["provenance"] = provenance.json();
      write_json(result_file, result);
    }
    if (rank() == 0 && commands[i].afterwards) with_options([&] { commands[i].afterwards(commons[i]); });
    if (result_out) *result_out = std::move(result);
  }
  return 0;
}

}  // namespace

nlohmann::json run_command(const std::string& name, const NamedSettings& settings, const std::string& where) {
  CLI::App table;
  for (const Command& command : all_commands()) {
    if (command.name != name) continue;
    Common common;
    add_common(table, common, command.default_out);
    command.options(table);
    std::vector<std::string> arguments = arguments_of(settings, table, where);
    arguments.insert(arguments.begin(), name);
    nlohmann::json result;
    run(arguments, &result);
    return result;
  }
  throw InputError(where, name, "is not a command of mirage", "see mirage --help");
}

int dispatch(std::vector<std::string> arguments) {
  const auto complain = [](std::string text) {
    std::replace(text.begin(), text.end(), '\n', ' ');  // one line, whatever a library put into its message
    std::fputs(fmt::format("mirage: {}\n", printable(text)).c_str(), stderr);
  };
  try {
    return run(arguments);
  } catch (const InputError& error) {
    complain(error.what());
    return 2;
  } catch (const std::filesystem::filesystem_error& error) {
    complain(fmt::format("{}: {}; {}", error.path1().string(), error.code().message(),
                         fix_for(error.code().value())));
    return 1;
  } catch (const std::bad_alloc&) {
    complain("out of memory; use fewer --threads or a smaller data set");
    return 1;
  } catch (const std::exception& error) {
    complain(error.what());
    return 1;
  }
}

}  // namespace mirage::cli
