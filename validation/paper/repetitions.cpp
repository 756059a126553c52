#include "validation/paper/repetitions.h"

#include <fmt/format.h>

namespace mirage::paper {
namespace {

constexpr char kMark = '+';

bool is_repeated(const Case& one) {
  return one.kind == Case::Kind::attack || one.kind == Case::Kind::evaluation;
}

/// With another seed, and on the runs of that; pictures are made once.
Case repeated(const Case& one, int number, const ReproduceSettings& settings) {
  Case made{repetition(one.name, number), one.kind, {}, {}};
  for (const std::string& need : one.needs)
    made.needs.push_back(one.kind == Case::Kind::evaluation ? repetition(need, number) : need);
  for (std::size_t i = 0; i < one.arguments.size(); ++i) {
    if (one.arguments[i] == "--seed" || one.arguments[i] == "--pictures") {
      ++i;
      continue;
    }
    std::string argument = one.arguments[i];
    for (std::size_t n = 0; n < one.needs.size(); ++n)
      if (argument == (settings.out / one.needs[n]).string())
        argument = (settings.out / made.needs[n]).string();
    made.arguments.push_back(std::move(argument));
  }
  made.arguments.insert(made.arguments.end(),
                        {"--seed", std::to_string(settings.seed + static_cast<std::uint64_t>(number))});
  return made;
}

}  // namespace

std::string repetition(const std::string& name, int number) {
  return number == 0 ? name : fmt::format("{}{}{}", name, kMark, number);
}

bool is_repetition(const std::string& name) {
  return name.find(kMark) != std::string::npos;
}

void repeat(Experiments& experiments, const ReproduceSettings& settings) {
  experiments.seeds = settings.seeds;
  const std::size_t once = experiments.cases.size();
  for (int number = 1; number < settings.seeds; ++number)
    for (std::size_t i = 0; i < once; ++i)
      if (is_repeated(experiments.cases[i]))
        experiments.cases.push_back(repeated(experiments.cases[i], number, settings));
}

}  // namespace mirage::paper
