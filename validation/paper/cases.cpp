#include "validation/paper/cases.h"

#include <algorithm>

#include "base/error.h"

namespace mirage::paper {

std::filesystem::path data_folder(const ReproduceSettings& settings, const std::string& rig) {
  const auto& given = rig == "real" ? settings.real : rig == "xenith" ? settings.xenith : settings.kitti64;
  return given.empty() ? settings.out / "data" / rig : given;
}

std::string argument(const Case& one, const std::string& option, const std::string& otherwise) {
  const auto found = std::find(one.arguments.begin(), one.arguments.end(), option);
  return found == one.arguments.end() || found + 1 == one.arguments.end() ? otherwise : *(found + 1);
}

const Case& Experiments::at(const std::string& name) const {
  const auto found = std::find_if(cases.begin(), cases.end(), [&](const Case& c) { return c.name == name; });
  if (found == cases.end()) throw InputError("experiments", name, "no such case", "name one of the list");
  return *found;
}

}  // namespace mirage::paper
