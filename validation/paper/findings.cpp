// The findings of findings.toml: which evaluations each compares, and what it says of them.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "validation/paper/finding.h"

namespace mirage::paper {
namespace {

using nlohmann::json;
using Variables = std::map<std::string, std::string>;

/// Each $NAME by its value, which may hold others.
std::string filled(std::string text, const Variables& variables) {
  for (std::size_t at; (at = text.find('$')) != std::string::npos;) {
    const std::size_t end =
        std::min(text.size(), text.find_first_not_of("abcdefghijklmnopqrstuvwxyz_", at + 1));
    text.replace(at, end - at, variables.at(text.substr(at + 1, end - at - 1)));
  }
  return text;
}

std::vector<std::string> parted(const std::string& text, const std::string& by) {
  std::vector<std::string> parts{""};
  for (std::size_t at = 0; at < text.size();)
    if (text.compare(at, by.size(), by) == 0) {
      parts.emplace_back();
      at += by.size();
    } else {
      parts.back() += text[at++];
    }
  return parts;
}

/// Every combination of an entry of each list.
std::vector<Variables> combinations(const json& lists, const std::string& names, const Variables& with) {
  std::vector<Variables> all{with};
  for (const std::string& name : parted(names, " ")) {
    std::vector<Variables> more;
    for (const Variables& before : all)
      for (const json& entry : lists.at(name)) {
        more.push_back(before);
        for (const auto& [key, value] : entry.items()) more.back()[key] = value.get<std::string>();
      }
    all = std::move(more);
  }
  return all;
}

Claim claim_of(const std::string& words) {
  return words == "no less" ? Claim::no_less : words == "no help" ? Claim::no_help : Claim::more;
}

/// One check of a finding, with its variables filled in.
class Checked {
 public:
  Checked(const Evidence& evidence, const json& finding, Variables variables)
      : finding_(finding), variables_(std::move(variables)) {
    for (const auto& [name, text] : finding.at("meshes").items()) {
      const std::string of = filled(text, variables_);
      const bool sized = of.starts_with("sized ");
      meshes_[name] = evidence.of("evaluations/" + of.substr(sized ? 6 : 0), sized ? "sized" : "learned");
    }
  }

  /// None where a mesh is missing.
  std::optional<Check> check() {
    std::string sentence;
    for (const json& asked : finding_.value("compare", json::array()))
      if (!compare(asked)) return std::nullopt;
    const std::string hidden = text("hidden");
    for (const auto& [rule, word] :
         {std::pair("vanished", "vanished"), std::pair("iou70", "missed at IoU 0.7")}) {
      if (hidden.empty()) break;
      hidden_ = rule;
      if (!compare({{"what", word}, {"of", hidden}, {"key", rule}})) return std::nullopt;
      sentence += fmt::format("{}{}: {}, {}", sentence.empty() ? "" : "; ", word, *expanded(text("share")),
                              points(comparisons_.back().difference));
    }
    if (hidden.empty()) sentence = expanded(text("sentence")).value();
    std::string why;
    for (const std::string& part : parted(text("why"), "|")) why += expanded(part).value_or("");
    Check check = paper::check(text("place"), used_, std::move(comparisons_), sentence, why);
    if (finding_.contains("further")) add_further(check, finding_.at("further"));
    std::vector<const Outcomes*> seeing;
    for (const std::string& name : parted(text("images"), " "))
      if (!name.empty()) seeing.push_back(meshes_.at(name));
    return about_images(std::move(check), seeing);
  }

 private:
  std::string text(const char* key) const { return filled(finding_.value(key, ""), variables_); }

  /// Of "a − b + c"; none where a mesh is missing.
  std::optional<std::vector<Term>> terms(const std::string& text) const {
    std::vector<Term> list;
    double sign = 1;
    for (const std::string& word : parted(text, " ")) {
      if (word == "−" || word == "+") {
        sign = word == "+" ? 1 : -1;
        continue;
      }
      list.push_back({meshes_.at(word), sign});
      if (!list.back().of) return std::nullopt;
    }
    return list;
  }

  bool compare(const json& asked) {
    const auto of = terms(asked.at("of"));
    if (!of) return false;
    for (const Term& term : *of) used_.push_back(term.of);
    comparisons_.push_back(comparison(asked.at("what"), difference(*of, question(asked.value("key", "asr"))),
                                      claim_of(asked.value("claim", "more"))));
    return true;
  }

  void add_further(Check& check, const json& further) {
    const auto when = terms(further.at("when"));
    if (!when || judge(Claim::more, difference(*when, question("asr"))) != Verdict::holds) return;
    comparisons_ = std::move(check.comparisons);
    compare(further);
    check.sentence += expanded(further.at("sentence")).value();
    check.comparisons = std::move(comparisons_);
    check.agree = true;
  }

  /// With what stands in braces; none where a mesh of it is missing.
  std::optional<std::string> expanded(const std::string& text) const {
    std::string out;
    for (std::size_t at = 0; at < text.size();) {
      if (text[at] != '{') {
        out += text[at++];
        continue;
      }
      const std::size_t end = text.find('}', at);
      const auto value = figure(text.substr(at + 1, end - at - 1));
      if (!value) return std::nullopt;
      out += *value;
      at = end + 1;
    }
    return out;
  }

  std::optional<std::string> figure(const std::string& text) const {
    if (text == "margin") return fmt::format("{:.0f}", 100 * kMargin);
    const std::size_t space = text.find(' ');
    if (space == std::string::npos) return points(comparisons_.at(std::stoul(text) - 1).difference);
    const auto of = terms(text.substr(space + 1));
    if (!of) return std::nullopt;
    const std::string key = text.substr(0, space);
    if (key == "name") return of->front().of->name;
    const Question asked = question(key == "hidden" ? hidden_ : key);
    if (of->size() > 1) return points(difference(*of, asked));
    return vehicles(*of->front().of, asked) > 0 ? percent(share(*of->front().of, asked)) : "none";
  }

  const json& finding_;
  Variables variables_;
  std::map<std::string, const Outcomes*> meshes_;
  std::vector<const Outcomes*> used_;
  std::vector<Comparison> comparisons_;
  std::string hidden_;  ///< the rule that {hidden …} stands for
};

// Those that are no plain comparison, on a rig.

using Checks = std::vector<Check>;

std::string asr(const Outcomes& outcomes, const char* key = "asr") {
  return percent(share(outcomes, question(key)));
}

/// The least-squares slope of the ASR over the sizes of the box.
void size(const Evidence& evidence, const std::string& rig, Checks& checks) {
  std::vector<std::pair<double, Outcomes>> sizes;
  for (const double size : kBoxSizes)
    if (const Outcomes* learned = evidence.of("evaluations/" + run_name(rig + "-fusion-both", of_size(size))))
      sizes.push_back({size, *learned});
  if (sizes.size() < 2) return;
  double mean = 0, spread = 0;
  for (auto& [size, outcomes] : sizes) {
    mean += size / static_cast<double>(sizes.size());
    for (const auto& [other, theirs] : sizes) outcomes = shared_hosts(outcomes, theirs);
  }
  for (const auto& [size, outcomes] : sizes) spread += (size - mean) * (size - mean);
  std::vector<Term> terms;
  std::vector<const Outcomes*> used;
  std::string list;
  for (const auto& [size, outcomes] : sizes) {
    terms.push_back({&outcomes, (size - mean) / spread});
    used.push_back(&outcomes);
    list += fmt::format("{}{} at L = {:.1f} m", list.empty() ? "" : ", ", asr(outcomes), size);
  }
  Interval rise = difference(terms, question("asr"));
  for (double* end : {&rise.value, &rise.low, &rise.high}) *end *= 0.1;
  checks.push_back(check(title(rig), used, {comparison("rise of ASR for each 0.1 m of L", rise)},
                         fmt::format("ASR {}; slope {} for each 0.1 m of L", list, points(rise))));
}

/// Share of the misses that a defence leaves, and of the false positives; the second more than the first.
void harder(const Evidence& evidence, const std::string& rig, Checks& checks) {
  const std::string name = "evaluations/" + rig + "-fusion-both";
  const Outcomes* none = evidence.of(name);
  for (const auto& [defense, words] :
       {std::pair("adversarial", "adversarial training"), std::pair("denoising", "feature denoising")}) {
    const Outcomes* with = evidence.of(name + "-" + defense);
    if (!none || !with) continue;
    const std::array<Outcomes, 2> both = {shared_hosts(*none, *with), shared_hosts(*with, *none)};
    SumsByCrossing sums;  // hidden, with a false positive, vehicles; without the defence and with it
    std::vector<double> all(6);
    for (std::size_t side = 0; side < 2; ++side)
      for (const Outcome& host : both[side].hosts) {
        if (!host.detected) continue;
        std::vector<double>& own = sums[{host.cluster(), host.run}];
        own.resize(6);
        for (std::vector<double>* to : {&own, &all}) {
          (*to)[3 * side] += host.hidden;
          (*to)[3 * side + 1] += host.false_positive;
          (*to)[3 * side + 2] += 1;
        }
      }
    const auto left = [](std::span<const double> of, std::size_t part) {
      return of.size() == 6 && of[part] > 0 && of[5] > 0 ? (of[3 + part] / of[5]) / (of[part] / of[2])
                                                         : std::numeric_limits<double>::quiet_NaN();
    };
    const double misses = left(all, 0), positives = left(all, 1);
    const std::string where = title(rig) + ", " + words;
    if (std::isnan(misses) || std::isnan(positives)) {
      checks.emplace_back().rig = where;
      checks.back().vehicles = std::min(none->vehicles, with->vehicles);
      checks.back().sentence =
          "the undefended detector has no miss or no false positive that could be removed";
      continue;
    }
    const Interval difference =
        plain_interval(jackknife(sums, [&](std::span<const double> of) { return left(of, 1) - left(of, 0); }),
                       1 / std::max(1.0, std::min(all[0], all[1])));
    checks.push_back(check(
        where, {none, with}, {comparison("share of the false positives left − of the misses", difference)},
        fmt::format(
            "left are {:.0f} % of the misses (FN ASR {} → {}) and {:.0f} % of the false positives (FP "
            "ASR {} → {}); difference {}",
            100 * misses, asr(both[0], "fn_asr"), asr(both[1], "fn_asr"), 100 * positives,
            asr(both[0], "fp_asr"), asr(both[1], "fp_asr"), points(difference))));
    if (defense == std::string("denoising")) checks.back() = about_images(checks.back(), {none, with});
  }
}

/// "12 false positives, median 9.1 m from the host, 25.0 % (…) of them beyond 12 m", in full or with the
/// figures alone; empty without any.
std::string distances(const Outcomes& outcomes, bool in_full) {
  ClusteredShare far;
  std::vector<double> all;
  for (const Outcome& host : outcomes.hosts) {
    if (!host.detected) continue;
    for (const double distance : host.distances()) {
      far.add(host.cluster(), distance > kFar, host.run, 1.0 / outcomes.meshes);
      all.push_back(distance);
    }
  }
  if (all.empty()) return "";
  const auto word = [&](const char* text) { return in_full ? text : ""; };
  return fmt::format("{}{}, median {:.1f} m{}, {}{} beyond {:.0f} m", all.size(), word(" false positives"),
                     quantile(all, 0.5), word(" from the host"), percent(far.interval()), word(" of them"),
                     kFar);
}

/// Vehicles that get a false positive far away, beside those that a random mesh gives one: background that
/// was about to be found anyway is far away whatever stands on the roof.
void far(const Evidence& evidence, const std::string& rig, Checks& checks) {
  const std::string name = "evaluations/" + rig + "-fusion-both";
  const Outcomes *both = evidence.of(name), *random = evidence.of(name, "sized");
  if (!both || !random) return;
  Check made;
  std::string sentence = distances(*both, true);
  if (sentence.empty()) {
    made.rig = title(rig);
    made.vehicles = both->vehicles;
    made.sentence = "no false positive";
  } else {
    const Interval more = difference(*both, *random, question("far"));
    sentence += fmt::format("; {} of the vehicles get one that far, {} under a {}: {}", asr(*both, "far"),
                            asr(*random, "far"), random->name, points(more));
    made = check(title(rig), {both, random},
                 {comparison("vehicles with one beyond that distance, learned − random", more)}, sentence);
  }
  // Without an image there is no wrong pixel–point association.
  const Outcomes* alone = evidence.of("evaluations/" + rig + "-lidar-lidar");
  made.why = both->note();
  if (made.why.empty() && alone) {
    const std::string theirs = distances(*alone, false);
    made.why = "the LiDAR-only detector, which associates no pixels" +
               (theirs.empty() ? ", has none" : ": " + theirs);
  }
  checks.push_back(made);
}

}  // namespace

std::vector<Finding> findings(const Evidence& evidence) {
  const json file = read_toml(shipped_file("validation/paper/findings.toml"));
  const std::map<std::string, void (*)(const Evidence&, const std::string&, Checks&)> computed = {
      {"size", size}, {"harder", harder}, {"far", far}};
  std::vector<Finding> all, family;
  std::string of;
  const auto end_family = [&] {
    settle(family);
    std::move(family.begin(), family.end(), std::back_inserter(all));
    family.clear();
  };
  for (const json& own : file.at("finding")) {
    json entry =
        own.contains("like") ? file.at("like").at(own.at("like").get<std::string>()) : json::object();
    entry.update(own);
    if (entry.at("family") != of) end_family();
    of = entry.at("family");
    Finding& finding = family.emplace_back(Finding{entry.at("name"), entry.at("claim"), {}});
    if (const auto compute = computed.find(finding.name); compute != computed.end())
      for (const char* rig : {"kitti64", "xenith", "real"}) compute->second(evidence, rig, finding.checks);
    else
      for (const Variables& variables :
           combinations(file.at("lists"), entry.at("each"), entry.value("with", Variables())))
        if (auto check = Checked(evidence, entry, variables).check())
          finding.checks.push_back(std::move(*check));
  }
  end_family();
  return all;
}

}  // namespace mirage::paper
