#include "validation/paper/repetitions.h"

#include <fmt/format.h>

namespace mirage::paper {
namespace {

constexpr char kMark = '+';

bool is_repeated(const Case& command) {
  return command.kind == Case::Kind::attack || command.kind == Case::Kind::evaluation;
}

/// With another seed, and on the runs of that; pictures are made once.
Case repeated(const Case& command, int number, const ReproduceSettings& settings) {
  Case rerun{repetition(command.name, number), command.kind, {}, {}};
  for (const std::string& need : command.needs)
    rerun.needs.push_back(command.kind == Case::Kind::evaluation ? repetition(need, number) : need);
  for (std::size_t i = 0; i < command.arguments.size(); ++i) {
    if (command.arguments[i] == "--seed" || command.arguments[i] == "--pictures") {
      ++i;
      continue;
    }
    std::string argument = command.arguments[i];
    for (std::size_t n = 0; n < command.needs.size(); ++n)
      if (argument == (settings.out / command.needs[n]).string())
        argument = (settings.out / rerun.needs[n]).string();
    rerun.arguments.push_back(std::move(argument));
  }
  rerun.arguments.insert(rerun.arguments.end(),
                         {"--seed", std::to_string(settings.seed + static_cast<std::uint64_t>(number))});
  return rerun;
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
