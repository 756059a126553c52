#include "cli/help.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <map>
#include <sstream>
#include <vector>

#include "cli/field_options.h"

namespace mirage::cli {
namespace {

constexpr std::size_t kIndent = 30, kWidest = 100, kNarrowest = 60;

/// Headings in their order, and the options under them.
const std::vector<std::pair<std::string, std::vector<std::string>>>& headings() {
  static const std::vector<std::pair<std::string, std::vector<std::string>>> all = {
      {"Data", {"--data",        "--run",      "--hosts-of",     "--hosts",
                "--rig",         "--frames",   "--validation",   "--validation-frames",
                "--types",       "--depth",    "--rooftop",      "--place",
                "--sun",         "--min-view", "--hosts-from",   "--min-points",
                "--evaluation",  "--tradeoff", "--runs",         "--kitti64",
                "--xenith",      "--real",     "--judge-frames", "--sequence",
                "--least-frames"}},
      {"Tracker", {"--birth", "--death", "--track-by", "--track-iou", "--track-distance"}},
      {"Detector",
       {"--detector", "--detectors", "--weights", "--defense", "--clean-memory", "--precision", "--locality",
        "--matching", "--trust-run", "--start", "--camera", "--lidar", "--fresh", "--gate", "--claim",
        "--score", "--iou", "--keep-start"}},
      {"Object",
       {"--size", "--parts", "--mesh", "--buildable", "--min-thickness", "--baseline", "--random-meshes",
        "--mesh-forward", "--mesh-up", "--model", "--mesh-format", "--objects", "--sizes"}},
      {"Camera, light and LiDAR",
       {"--quality", "--sigma", "--gamma", "--supersampling", "--light", "--camera-effects",
        "--lidar-effects", "--lidar-gradient", "--renderer", "--cycles-samples", "--cycles-renew",
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
                    "--without-picture", "--queries"}},
      {"Run",
       {"--out", "--seed", "--threads", "--quiet", "--config", "--checkpoint-every", "--checkpoint-seconds",
        "--pictures", "--fail-above", "--help"}},
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

/// Letters of UTF-8, each a column.
std::size_t columns(const std::string& text) {
  return static_cast<std::size_t>(std::count_if(
      text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xc0) != 0x80; }));
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
bool told(const std::string& description, const std::string& braces) {
  const auto words = words_in(braces);
  return std::all_of(words.begin(), words.end(),
                     [&](const std::string& word) { return description.find(word) != std::string::npos; });
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
    for (const std::string& said : {type, limits})
      if (said.starts_with('{') && !told(option->get_description(), said))
        more.push_back(fmt::format("{}", fmt::join(words_in(said), ", ")));
    if (!limits.empty() && !limits.starts_with('{')) more.push_back(limits);
    if (option->get_required()) more.emplace_back("required");
    if (const std::string standing = option->get_default_str();
        takes && !standing.empty() && standing != "\"\"" && standing != "[]")
      more.push_back("default " + standing);
    for (const CLI::Option* other : option->get_needs()) more.push_back("with " + other->get_name());
    for (const CLI::Option* other : option->get_excludes()) more.push_back("not with " + other->get_name());
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

}  // namespace

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

}  // namespace mirage::cli
