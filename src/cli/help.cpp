#include "cli/help.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <set>
#include <sstream>
#include <vector>

#include "base/fields.h"
#include "base/plugins.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "defense/adversarial_training.h"
#include "detection/detector.h"
#include "detection/detector_settings.h"

namespace mirage::cli {
namespace {

constexpr std::size_t kIndent = 30, kWidest = 100, kNarrowest = 60;
constexpr std::size_t kUngrouped = 15;  // options that need no headings

/// Headings in their order, and the options under them.
const std::vector<std::pair<std::string, std::vector<std::string>>>& headings() {
  static const std::vector<std::pair<std::string, std::vector<std::string>>> all = {
      {"Data", {"--data",         "--run",        "--hosts-of",     "--hosts",
                "--rig",          "--frames",     "--validation",   "--validation-frames",
                "--types",        "--depth",      "--rooftop",      "--place",
                "--cameras",      "--sun",        "--min-view",     "--hosts-from",
                "--min-points",   "--evaluation", "--tradeoff",     "--runs",
                "--kitti64",      "--xenith",     "--real",         "--judge-frames",
                "--sequence",     "--between",    "--least-frames", "--learn-data",
                "--learn-frames", "--board",      "--classes",      "--sensors",
                "--sweeps",       "--drive",      "--vehicle",      "--frame",
                "--scene",        "--detections"}},
      {"Tracker", {"--tracker", "--birth", "--death", "--track-by", "--track-iou", "--track-distance"}},
      {"Detector",
       {"--detector", "--detectors", "--weights",   "--defense",    "--clean-memory", "--precision",
        "--locality", "--matching",  "--trust-run", "--start",      "--camera",       "--lidar",
        "--fresh",    "--gate",      "--claim",     "--score",      "--iou",          "--keep-start",
        "--certify",  "--check",     "--kitti",     "--no-detector"}},
      {"Object",
       {"--size", "--parts", "--mesh", "--free", "--gamut", "--min-thickness", "--baseline",
        "--random-meshes", "--mesh-forward", "--mesh-up", "--model", "--mesh-format", "--objects",
        "--sizes"}},
      {"Camera, light and LiDAR",
       {"--quality", "--sigma", "--gamma", "--supersampling", "--light", "--camera-effects",
        "--lidar-effects", "--lidar-gradient", "--renderer", "--cycles", "--cycles-samples", "--cycles-renew",
        "--cycles-renew-texels", "--samples", "--noise", "--ladder", "--budget", "--budget-of",
        "--budget-confidence"}},
      {"Learning", {"--attack",          "--target",
                    "--expect",          "--iterations",
                    "--until-plateau",   "--validate-every",
                    "--batch",           "--vertex-rate",
                    "--texel-rate",      "--lambda-fp",
                    "--lambda-lap",      "--fp-top-k",
                    "--method",          "--steps",
                    "--learning-rate",   "--minutes",
                    "--attacked",        "--adversary-updates",
                    "--adversary-batch", "--crop",
                    "--scatter",         "--shift",
                    "--without-picture", "--queries",
                    "--no-adaptive"}},
      {"Run",
       {"--out", "--seed", "--threads", "--quiet", "--config", "--checkpoint-every", "--checkpoint-seconds",
        "--pictures", "--animation", "--fail-above", "--sign-off", "--quick", "--only", "--seeds", "--help"}},
  };
  return all;
}

/// The heading of an option; empty for one of no heading.
std::string heading_of(const CLI::Option& option) {
  for (const auto& [heading, names] : headings())
    for (const std::string& name : option.get_lnames())
      if (std::find(names.begin(), names.end(), "--" + name) != names.end()) return heading;
  return "";
}

std::size_t line_width() {
  winsize size{};
  if (!isatty(STDOUT_FILENO) || ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0)
    return kWidest;
  return std::clamp<std::size_t>(size.ws_col, kNarrowest, kWidest);
}

/// The words of "{both,image,lidar}".
std::vector<std::string> words_in(const std::string& braces) {
  return CLI::detail::split(braces.substr(1, braces.find('}') - 1), ',');
}

/// Whether a description names all the words.
bool names_all(const std::string& description, const std::string& braces) {
  const auto words = words_in(braces);
  return std::all_of(words.begin(), words.end(),
                     [&](const std::string& word) { return description.find(word) != std::string::npos; });
}

/// The text in lines of `width` columns, all but the first indented by `indent`; a line that starts with a
/// space stays as it is.
std::string wrapped(const std::string& text, std::size_t width, std::size_t indent) {
  std::string result;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (!result.empty()) result.append("\n").append(line.empty() ? 0 : indent, ' ');
    if (line.starts_with(' ')) {
      result += line;
      continue;
    }
    std::size_t used = 0;
    std::istringstream words(line);
    for (std::string word; words >> word;) {
      while (columns(word) > width && word.find(',') < width) {  // a list without spaces parts at its commas
        const std::size_t end = word.rfind(',', width - 1) + 1;
        if (used > 0) result.append("\n").append(indent, ' ');
        result.append(word, 0, end);
        word.erase(0, end);
        used = width;  // the rest stands in a line of its own
      }
      const std::size_t length = columns(word);
      if (used > 0 && used + 1 + length > width) {
        result.append("\n").append(indent, ' ');
        used = 0;
      } else if (used > 0) {
        result += ' ';
        ++used;
      }
      result += word;
      used += length;
    }
  }
  return result;
}

class Formatter : public CLI::Formatter {
 public:
  std::string make_help(const CLI::App* app, std::string name, CLI::AppFormatMode) const override {
    std::string text = wrapped(app->get_description(), line_width(), 0) + "\n\n" + make_usage(app, name);
    text += make_positionals(app);
    auto own = app->get_options([](const CLI::Option* option) { return option->nonpositional(); });
    // The command's own first, those of every command last.
    std::stable_partition(own.begin(), own.end(), [](const CLI::Option* option) {
      return heading_of(*option) != headings().back().first;
    });
    std::map<std::string, std::vector<const CLI::Option*>> under;
    for (const CLI::Option* option : own)
      under[own.size() > kUngrouped ? heading_of(*option) : ""].push_back(option);
    for (const auto& [heading, names] : headings())
      if (under.contains(heading)) text += make_group(heading, false, under[heading]);
    if (under.contains(""))
      text += make_group(under.size() > 1 ? "Other options" : "Options", false, under[""]);
    text += make_subcommands(app, CLI::AppFormatMode::Normal);
    return text + make_footer(app);
  }

  std::string make_option(const CLI::Option* option, bool is_positional) const override {
    const auto [type, limits] = type_of(*option);
    const bool takes = option->get_items_expected_max() > 0;
    std::string name = "  " + make_option_name(option, is_positional);
    if (takes && !is_positional) name += " " + placeholder(type, limits);
    std::vector<std::string> more;
    for (const std::string& word : {type, limits})
      if (word.starts_with('{') && !names_all(option->get_description(), word))
        more.push_back(fmt::format("{}", fmt::join(words_in(word), ", ")));
    if (!limits.empty() && !limits.starts_with('{')) more.push_back(limits);
    if (option->get_required()) more.emplace_back("required");
    if (const std::string standing = option->get_default_str();
        takes && !standing.empty() && standing != "\"\"" && standing != "[]")
      more.push_back("default " + standing);
    add_names(more, "with ", option->get_needs());
    add_names(more, "not with ", option->get_excludes());
    std::string text = option->get_description();
    if (!more.empty()) text += fmt::format(" ({})", fmt::join(more, "; "));
    return entry(name, text);
  }

  std::string make_subcommand(const CLI::App* sub) const override {
    return entry("  " + sub->get_name(), sub->get_description());
  }

  std::string make_footer(const CLI::App* app) const override {
    const std::string footer = app->get_footer();
    return footer.empty() ? "" : "\n" + wrapped(footer, line_width(), 0) + "\n";
  }

 private:
  static void add_names(std::vector<std::string>& more, const char* word,
                        const std::set<CLI::Option*>& options) {
    std::set<std::string> names;  // in an order that is every build's
    for (const CLI::Option* option : options) names.insert(option->get_name());
    if (!names.empty()) more.push_back(fmt::format("{}{}", word, fmt::join(names, ", ")));
  }

  static std::string placeholder(const std::string& type, const std::string& limits) {
    if (type.starts_with('{') || limits.starts_with('{')) return "WORD";
    if (type == "INT" || type == "UINT") return "N";
    return type == "FLOAT" ? "X" : type;
  }

  /// A name in the left column; its text beside it, or below where the name is long.
  static std::string entry(std::string name, const std::string& text) {
    const std::size_t length = columns(name);
    name += length + 2 > kIndent ? "\n" + std::string(kIndent, ' ') : std::string(kIndent - length, ' ');
    return name + wrapped(text, line_width() - kIndent, kIndent) + "\n";
  }
};

std::vector<std::string> shipped(const char* kind) {
  std::vector<std::string> words;
  for (const ShippedPlugin& plugin : shipped_plugins(kind))
    words.insert(words.end(), plugin.words.begin(), plugin.words.end());
  return words;
}

/// Words of options that take others, too, such as a file's name.
std::vector<std::string> usual_words(const CLI::App& command, const CLI::Option& option) {
  const std::string name = option.get_name();
  if (name == "--detector") return shipped(kDetectorPlugins);
  if (name == "--depth") {
    std::vector<std::string> words = shipped("depth");
    words.emplace_back("ip-basic");
    return words;
  }
  if (name == "--rig") return shipped_names("scenes/rigs", ".toml");
  if (name == "--lidar" && command.get_name() == "generate") return shipped_names("scenes/lidars", ".toml");
  if (name == "--method") return defense_methods();
  if (name == "--weights") return {kRealWeights};
  if (name == "--rooftop") return {"shape", "box"};
  if (name == "--place") return shipped_names("scenes/placements", ".toml");
  if (name == "--gamut") return shipped_names("scenes/prints", ".ti3");
  if (name == "--mesh" && command.get_name() != "drive") return {"zoo"};
  if (name == "--sun") return {"frame", "photo"};
  if (name == "--hosts") return {"test", "train", "all"};
  if (name == "--baseline") return {"start", "sized", "ellipsoid", "cuboid", "all", "none"};
  if (name == "--expect")
    return {"roof", "tilt", "shape", "colour", "sun", "light", "exposure", "noise", "all", "none"};
  if (name == "--camera-effects") return {"ideal", "unit", "blur", "noise"};
  if (name == "--lidar-effects")
    return {"ideal",     "as-recorded", "unit",   "noise", "drop-out",
            "dark-loss", "divergence",  "motion", "albedo"};
  if (name != "--defense") return {};
  std::vector<std::string> words = defense_methods();
  for (const char* word : {"none", "jpeg:", "ceiling:", kConsistency, kShadows}) words.emplace_back(word);
  return words;
}

/// The words of a choice, "{both,image}" in the option's type; empty for free text.
std::vector<std::string> choices(const CLI::App& command, const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const auto open = type.find('{');
  return open == std::string::npos ? usual_words(command, option) : words_in(type.substr(open));
}

std::string names(const CLI::Option& option, const char* separator) {
  std::vector<std::string> all;
  for (const std::string& name : option.get_lnames()) all.push_back("--" + name);
  for (const std::string& name : option.get_snames()) all.push_back("-" + name);
  return fmt::format("{}", fmt::join(all, separator));
}

/// Shell cases for one command by the word before the one to complete. After an option with a value come its
/// words or files.
std::string cases_of(const CLI::App& command) {
  std::string text;
  std::vector<std::string> free;
  for (const CLI::Option* option : command.get_options()) {
    const auto words = choices(command, *option);
    if (option->get_positional()) free.insert(free.end(), words.begin(), words.end());
    if (!option->nonpositional()) continue;
    free.push_back(names(*option, " "));
    if (option->get_items_expected_max() > 0)
      text += fmt::format("          {}) words=\"{}\" ;;\n", names(*option, "|"), fmt::join(words, " "));
  }
  return text + fmt::format("          *) words=\"{}\" ;;\n", fmt::join(free, " "));
}

std::string bash_completion(const CLI::App& app) {
  std::string cases, commands;
  for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; })) {
    commands += command->get_name() + " ";
    cases += fmt::format("      {})\n        case \"$previous\" in\n{}        esac ;;\n", command->get_name(),
                         cases_of(*command));
  }
  return fmt::format(R"(# Completion of mirage in bash: what `mirage --completion bash` prints.
_mirage() {{
  local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD-1]}} words=""
  # --option=value comes as three words.
  if [[ $current == "=" ]]; then
    current=""  # and `previous` is the option
  elif [[ $previous == "=" ]]; then
    previous=${{COMP_WORDS[COMP_CWORD-2]}}
  fi
  if ((COMP_CWORD == 1)); then
    words="{}--help --version --completion"
  else
    case "${{COMP_WORDS[1]}}" in
{}    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _mirage mirage
)",
                     commands, cases);
}

std::string command_list(const CLI::App& app) {
  std::string text;
  for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
    text += command->get_name() + "\t" + command->get_description() + "\n";
  return text;
}

}  // namespace

void format_help(CLI::App& app) {
  const auto formatter = std::make_shared<Formatter>();
  app.formatter(formatter);
  for (CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
    command->formatter(formatter);
}

void add_example(CLI::App& app, const std::string& example) {
  const std::string rest = app.get_footer();
  app.footer("Example:\n  " + example + (rest.empty() ? "" : "\n\n" + rest));
}

bool print_completion(const CLI::App& app, const std::string& what) {
  const std::map<std::string, std::string> texts = {
      {"bash", bash_completion(app)},
      {"zsh", "autoload -Uz compinit bashcompinit && compinit && bashcompinit\n" + bash_completion(app)},
      {"commands", command_list(app)}};
  if (!texts.contains(what)) return false;
  std::fputs(texts.at(what).c_str(), stdout);
  return true;
}

}  // namespace mirage::cli
