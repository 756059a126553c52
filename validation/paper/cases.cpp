#include "validation/paper/cases.h"

#include <algorithm>

#include "base/error.h"

namespace mirage::paper {

std::filesystem::path data_folder(const ReproduceSettings& settings, const std::string& rig) {
  const auto& given = rig == "real" ? settings.real : rig == "xenith" ? settings.xenith : settings.kitti64;
  return given.empty() ? settings.out / "data" / rig : given;
}

std::string argument(const Case& command, const std::string& option, const std::string& otherwise) {
  const auto flag = std::find(command.arguments.begin(), command.arguments.end(), option);
  return flag == command.arguments.end() || flag + 1 == command.arguments.end() ? otherwise : *(flag + 1);
}

const Case& Experiments::at(const std::string& name) const {
  const auto match = std::find_if(cases.begin(), cases.end(), [&](const Case& c) { return c.name == name; });
  if (match == cases.end()) throw InputError("experiments", name, "no such case", "name one of the list");
  return *match;
}

}  // namespace mirage::paper
