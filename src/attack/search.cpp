#include "attack/search.h"

#include <fmt/format.h>

#include <algorithm>

#include "attack/baseline.h"
#include "base/random.h"

namespace mirage {

void check_search(const AttackSettings& settings) {
  if (settings.attack == AttackSearch::plain) return;
  const auto refuse = [&](const char* field, const std::string& value, const char* why, const char* fix) {
    throw FieldError(field, value,
                     fmt::format("does not go with --attack {}: {}", to_word(settings.attack), why), fix);
  };
  const bool black_box = settings.attack == AttackSearch::black_box;
  if (settings.target == AttackTarget::random)
    refuse("target", "random", "nothing is learned", "leave --attack out");
  if (black_box && settings.target != AttackTarget::both)
    refuse("target", to_word(settings.target), "no sensor has a gradient", "leave --target out");
  if (settings.until_plateau > 0)
    refuse("until_plateau", std::to_string(settings.until_plateau),
           black_box ? "it spends all of its --queries" : "it spends all of its --iterations",
           "leave --until-plateau out");
  if (settings.renderer)
    refuse("renderer", "cycles", "its candidates would need pictures of each", "use --renderer raster");
  if (settings.seconds > 0)
    refuse("seconds", fmt::format("{}", settings.seconds),
           black_box ? "its budget is in queries" : "its budget is in steps",
           black_box ? "use --queries" : "use --iterations");
}

bool learns_shape(const AttackSettings& settings) {
  return settings.parts == AttackParts::both || settings.parts == AttackParts::shape;
}

std::vector<NamedStart> search_starts(const AttackSettings& settings) {
  TexturedMesh paper = initial_adversary(settings.limits);
  if (settings.buildable.on) make_buildable(paper, settings.buildable, settings.limits);
  std::vector<NamedStart> starts{{"paper", paper}};
  if (learns_shape(settings))
    for (const Baseline kind : {Baseline::ellipsoid, Baseline::cuboid})
      starts.push_back({to_string(kind), filling_shape(kind, settings.limits, settings.buildable)});
  return starts;
}

std::vector<Host> search_hosts(std::vector<Host> hosts, std::uint64_t seed) {
  RandomStream random(seed, "search hosts");
  shuffle(hosts, random);
  hosts.resize(std::min(hosts.size(), kSearchHosts));
  return hosts;
}

}  // namespace mirage
