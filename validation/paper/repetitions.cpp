#include "validation/paper/repetitions.h"

#include <fmt/format.h>

namespace mirage::paper {
namespace {

constexpr char kMark = '+';

bool is_repeated(const Case& command) {
  return command.kind == Case::Kind::attack || command.kind == Case::Kind::evaluate;
}

/// With another seed, and on the runs of that; pictures are made once.
Case repeated(const Case& command, int number, const ReproduceSettings& settings) {
  Case rerun = command;
  rerun.name = repetition(command.name, number);
  if (command.kind == Case::Kind::evaluate)
    for (auto& [folder, need] : rerun.needs)
      if (folder != "data") need = repetition(need, number);
  rerun.settings.erase("pictures");
  rerun.settings["seed"] = std::to_string(settings.seed + static_cast<std::uint64_t>(number));
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
