#include "validation/paper/finding.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <utility>

#include "attack/host_outcome.h"
#include "base/config.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/names.h"
#include "base/sizes.h"

namespace mirage::paper {
namespace {

constexpr double kAlpha = 0.05;

/// The claim as "above the bound".
struct Above {
  Interval difference;
  double bound = 0;
};

Above as_above(Claim claim, const Interval& d) {
  if (claim == Claim::more) return {d, 0};
  if (claim == Claim::no_less) return {d, -kMargin};
  return {{-d.value, -d.high, -d.low}, -kMargin};
}

/// p of a difference that lies `away` from its bound and has a 95 % interval of ±`end`.
double p_of(double away, double end, int clusters) {
  return mirage::p_value(Interval{away, away - end, away + end}, clusters);
}

/// How far a difference must lie from its bound for that p, in reaches of its interval (1 for 0.05).
double reaches_for(double p, int clusters) {
  double low = 0, high = 1e6;
  for (int i = 0; i < 100; ++i) {
    const double middle = (low + high) / 2;
    (p_of(middle, 1, clusters) > p ? low : high) = middle;
  }
  return low;
}

/// From the value to the end of the interval on the bound's side.
double reach(const Above& claim) {
  const Interval& d = claim.difference;
  return d.value > claim.bound ? d.value - d.low : d.high - d.value;
}

using nlohmann::json;

json comparison_json(const Comparison& comparison) {
  return {{"what", comparison.what},
          {"difference", to_json(comparison.difference)},
          {"verdict", to_string(comparison.verdict)},
          {"p", comparison.p},
          {"p_family", comparison.p_family}};
}

json check_json(const Check& check) {
  return {{"rig", check.rig},
          {"verdict", to_string(check.verdict)},
          {"sentence", check.sentence},
          {"why", check.why},
          {"vehicles", check.vehicles},
          {"vehicles_needed", check.vehicles_needed ? json(*check.vehicles_needed) : json()},
          {"comparisons", list_json(check.comparisons, comparison_json)}};
}

Verdict verdict_of(const Check& check) {
  std::vector<Verdict> verdicts;
  for (const Comparison& c : check.comparisons) verdicts.push_back(c.verdict);
  if (check.few || verdicts.empty()) return Verdict::open;
  if (check.agree &&
      std::any_of(verdicts.begin(), verdicts.end(), [&](Verdict other) { return other != verdicts.front(); }))
    return Verdict::open;
  return all_of(verdicts);
}

std::string with_thousands(long number) {
  std::string text = std::to_string(number);
  for (int at = static_cast<int>(text.size()) - 3; at > 0; at -= 3)
    text = fmt::format("{} {}", text.substr(0, as_size(at)), text.substr(as_size(at)));
  return text;
}

/// Open, and that is an answer.
bool same(const Comparison& c) {
  return c.verdict == Verdict::open && classify(c.difference) == DifferenceVerdict::same;
}

void settle_check(Check& check) {
  check.verdict = verdict_of(check);
  if (check.comparisons.empty()) return;
  if (check.comparisons.size() > 1) {
    std::string list;
    for (const Comparison& c : check.comparisons)
      list += fmt::format("{}{}: {}", list.empty() ? "" : ", ", c.what,
                          same(c) ? to_word(DifferenceVerdict::same) : to_string(c.verdict));
    check.sentence += "; " + list;
  } else if (same(check.comparisons.front())) {
    check.sentence += std::string("; ") + to_word(DifferenceVerdict::same);
  }
  for (const Comparison& c : check.comparisons)
    if (!check.few && c.verdict == Verdict::open && judge(c.claim, c.difference) != Verdict::open)
      check.sentence +=
          fmt::format("; {} would be told alone (p = {:.3f}), not among the {} questions of this run", c.what,
                      c.p, c.family);
  if (check.verdict != Verdict::open) return;
  std::optional<long> most;
  bool never = false, unsettled = false;
  for (const Comparison& c : check.comparisons) {
    if ((c.verdict != Verdict::open || same(c)) && !check.few) continue;
    unsettled = true;
    const auto needed = vehicles_needed(c, check.vehicles);
    never = never || !needed;
    if (needed) most = std::max(most.value_or(0), *needed);
  }
  if (!unsettled) return;  // the comparisons are told, and contradict each other, or are the same
  if (never) {
    check.sentence +=
        "; no number of vehicles can be given that would tell: the difference is too close to its bound, or "
        "its spread is not known";
    return;
  }
  check.vehicles_needed = check.few ? std::max<long>(*most, kMinCount) : *most;
  check.sentence += fmt::format("; it would take about {} vehicles", with_thousands(*check.vehicles_needed));
}

/// Corrects the comparisons of these findings as one family, and sets the results: verdicts of the checks,
/// and in their sentences the verdict of each of several comparisons, those that the correction leaves open,
/// and the vehicles needed to decide.
void settle(std::vector<Finding>& findings) {
  std::vector<Comparison*> family;
  for (Finding& finding : findings)
    for (Check& check : finding.checks)
      if (!check.few)
        for (Comparison& c : check.comparisons) family.push_back(&c);
  correct(family);
  for (Finding& finding : findings)
    for (Check& check : finding.checks) settle_check(check);
}

/// A check of a claim about images. If an attacked detector does not use its picture, the check stays open,
/// and the detector's note replaces all sentences.
Check about_images(Check check, const std::vector<const Outcomes*>& attacked) {
  for (const Outcomes* outcomes : attacked)
    if (const std::string note = outcomes->note(); !note.empty()) {
      check.verdict = Verdict::open;
      check.sentence = note;
      check.why.clear();
      check.comparisons.clear();
      break;
    }
  return check;
}

// The findings of findings.toml: the evaluations that each compares, and its sentences on them.

using Variables = std::map<std::string, std::string>;

/// Replaces each $NAME by its value, which may hold other names.
std::string filled(std::string text, const Variables& variables) {
  for (std::size_t at; (at = text.find('$')) != std::string::npos;) {
    const std::size_t end =
        std::min(text.size(), text.find_first_not_of("abcdefghijklmnopqrstuvwxyz_", at + 1));
    text.replace(at, end - at, variables.at(text.substr(at + 1, end - at - 1)));
  }
  return text;
}

/// The parts between any of the characters `by`; none is empty.
std::vector<std::string> parted(const std::string& text, const char* by) {
  const auto parts = split(text, by);
  return {parts.begin(), parts.end()};
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

  /// Empty if a mesh is missing.
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
    for (const std::string& name : parted(text("images"), " ")) seeing.push_back(meshes_.at(name));
    return about_images(std::move(check), seeing);
  }

 private:
  std::string text(const char* key) const { return filled(finding_.value(key, ""), variables_); }

  /// The terms of "a − b + c"; empty if a mesh is missing.
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

  /// The text with its braces filled in; empty if one of its meshes is missing.
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

// Findings on a rig that are not plain comparisons.

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
  Difference rise = difference(terms, question("asr"));
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
    const Estimate estimate =
        jackknife(sums, [&](std::span<const double> of) { return left(of, 1) - left(of, 0); });
    const Difference difference = {plain_interval(estimate, 1 / std::max(1.0, std::min(all[0], all[1]))),
                                   clusters_of(estimate)};
    checks.push_back(check(
        where, {none, with}, {comparison("share of the false positives left − of the misses", difference)},
        fmt::format("left are {:.0f} % of the misses (FN ASR {} → {}) and {:.0f} % of the false positives "
                    "(FP ASR {} → {}); difference {}",
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
  return fmt::format("{}{}, median {:.1f} m{}, {}{} beyond {:.0f} m", all.size(),
                     word(all.size() == 1 ? " false positive" : " false positives"), quantile(all, 0.5),
                     word(" from the host"), percent(far.interval()), word(" of them"), kFar);
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
    const Difference more = difference(*both, *random, question("far"));
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

std::string to_string(Verdict verdict) {
  return verdict == Verdict::holds ? "holds" : verdict == Verdict::fails ? "does not hold" : "cannot be told";
}

Verdict judge(Claim claim, const Interval& difference) {
  const auto [d, bound] = as_above(claim, difference);
  return d.low > bound ? Verdict::holds : d.high < bound ? Verdict::fails : Verdict::open;
}

Verdict all_of(const std::vector<Verdict>& verdicts) {
  const auto any = [&](Verdict verdict) {
    return std::find(verdicts.begin(), verdicts.end(), verdict) != verdicts.end();
  };
  return verdicts.empty() || (!any(Verdict::fails) && any(Verdict::open)) ? Verdict::open
         : any(Verdict::fails)                                            ? Verdict::fails
                                                                          : Verdict::holds;
}

double p_value(Claim claim, const Interval& difference, int clusters) {
  const Above above = as_above(claim, difference);
  const double away = std::abs(above.difference.value - above.bound), end = reach(above);
  if (away == 0 || !std::isfinite(end) || clusters < 2) return 1;
  if (end <= 0) return 0;
  const double p = p_of(away, end, clusters);
  // If the interval's end lies on the bound, rounding must not decide what judge() leaves open.
  return judge(claim, difference) == Verdict::open ? std::max(p, kAlpha)
                                                   : std::min(p, std::nextafter(kAlpha, 0.0));
}

Comparison comparison(std::string what, const Difference& difference, Claim claim) {
  Comparison comparison;
  comparison.what = std::move(what);
  comparison.difference = difference;
  comparison.claim = claim;
  comparison.verdict = judge(claim, difference);
  comparison.p = comparison.p_family = p_value(claim, difference, difference.clusters);
  return comparison;
}

void correct(const std::vector<Comparison*>& family) {
  std::vector<double> p;
  for (const Comparison* comparison : family) p.push_back(comparison->p);
  const std::vector<double> adjusted = holm(p);
  for (std::size_t i = 0; i < family.size(); ++i) {
    Comparison& comparison = *family[i];
    comparison.rank = 0;
    for (std::size_t k = 0; k < p.size(); ++k) comparison.rank += std::pair(p[k], k) < std::pair(p[i], i);
    comparison.family = static_cast<int>(p.size());
    comparison.p_family = adjusted[i];
    if (!(comparison.p_family < kAlpha)) comparison.verdict = Verdict::open;
  }
}

std::optional<long> vehicles_needed(const Comparison& comparison, int vehicles) {
  const Above above = as_above(comparison.claim, comparison.difference);
  const double away = std::abs(above.difference.value - above.bound), end = reach(above);
  const int clusters = comparison.difference.clusters;
  if (!(away > 0) || !std::isfinite(end) || vehicles <= 0 || clusters < 2) return std::nullopt;
  // An interval of ±0.1 shows, with a chance of 80 %, a difference of one reach and this much more.
  const double power = detectable_difference({0, -0.1, 0.1}, clusters) / 0.1 - 1;
  const double threshold = kAlpha / std::max(1, comparison.family - comparison.rank);
  return sample_size(vehicles, (reaches_for(threshold, clusters) + power) * end, away);
}

std::string title(const std::string& rig) {
  return rig == "kitti64" ? "KITTI rig" : rig == "xenith" ? "Xenith rig" : "real KITTI frames";
}

std::string points(const Interval& difference) {
  // An interval wider than any difference of shares says nothing.
  std::string text = difference.high - difference.low < 2
                         ? signed_points(difference) + " points"
                         : signed_points(difference.value) + " points (too few vehicles for an interval)";
  for (std::size_t at; (at = text.find('-')) != std::string::npos;) text.replace(at, 1, "−");
  return text;
}

std::string percent(const Interval& share) {
  return fmt::format("{:.1f} % ({:.1f}–{:.1f})", 100 * share.value, 100 * share.low, 100 * share.high);
}

Check check(const std::string& where, const std::vector<const Outcomes*>& used,
            std::vector<Comparison> comparisons, std::string sentence, std::string why) {
  Check check;
  check.rig = where;
  int frames = std::numeric_limits<int>::max(), clusters = frames;
  check.vehicles = frames;
  for (const Outcomes* outcomes : used) {
    check.vehicles = std::min(check.vehicles, outcomes->vehicles);
    frames = std::min(frames, outcomes->frames());
    clusters = std::min(clusters, outcomes->clusters().count);
  }
  check.few = check.vehicles < kMinCount || clusters < kMinClusters;
  check.sentence = std::move(sentence);
  if (check.few)
    check.sentence += fmt::format("; too few to tell: {} vehicle{} in {} frame{}", check.vehicles,
                                  check.vehicles == 1 ? "" : "s", frames, frames == 1 ? "" : "s");
  check.why = std::move(why);
  check.comparisons = std::move(comparisons);
  return check;
}

std::string overall(const Finding& finding) {
  const auto any = [&](Verdict verdict) {
    return std::any_of(finding.checks.begin(), finding.checks.end(),
                       [&](const Check& check) { return check.verdict == verdict; });
  };
  if (finding.checks.empty()) return "not measured";
  if (any(Verdict::holds) && any(Verdict::fails)) return "holds in part";
  return to_string(any(Verdict::holds)   ? Verdict::holds
                   : any(Verdict::fails) ? Verdict::fails
                                         : Verdict::open);
}

json to_json(const Finding& finding) {
  return {{"name", finding.name},
          {"claim", finding.claim},
          {"verdict", overall(finding)},
          {"checks", list_json(finding.checks, check_json)}};
}

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
