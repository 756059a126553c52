#include "validation/paper/cases.h"

#include <algorithm>

#include "base/error.h"

namespace mirage::paper {

std::filesystem::path data_folder(const ReproduceSettings& settings, const std::string& rig) {
  const auto& given = rig == "real" ? settings.real : rig == "xenith" ? settings.xenith : settings.kitti64;
  return given.empty() ? settings.out / "data" / rig : given;
}

std::string Case::setting(const std::string& key, const std::string& otherwise) const {
  const auto entry = settings.find(key);
  return entry == settings.end() ? otherwise : entry->second;
}

NamedSettings Case::settings_in(const std::filesystem::path& out) const {
  NamedSettings all = settings;
  for (const auto& [folder, need] : needs) all[folder] = (out / need).string();
  return all;
}

const std::string& Case::hosts_of() const {
  const auto other =
      std::find_if(needs.begin(), needs.end(), [](const auto& need) { return need.first == "hosts_of"; });
  return other == needs.end() ? run() : other->second;
}

const Case& Experiments::at(const std::string& name) const {
  const auto match = std::find_if(cases.begin(), cases.end(), [&](const Case& c) { return c.name == name; });
  if (match == cases.end()) throw InputError("experiments", name, "no such case", "name one of the list");
  return *match;
}

}  // namespace mirage::paper
