// Attack success by what a host vehicle is and where: range, occlusion, truncation, kind.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "attack/success_rates.h"

namespace mirage {

/// One part of the hosts.
struct HostPart {
  std::string by, name;
  std::function<bool(const HostOutcome&)> holds;
};
/// Range: 0-15, 15-30, 30-50, 50+ m (the nearer end belongs to the part). Occlusion: KITTI's four levels.
/// Truncation: up to 0.15 (KITTI's "easy") and more. Kind: HostOutcome::kind, in alphabetical order.
std::vector<HostPart> host_parts(std::span<const HostOutcome> hosts);

/// Success in one of host_parts.
struct StratumSuccess {
  std::string by;    ///< "range", "occlusion", "truncation" or "kind"
  std::string name;  ///< "15-30 m", "partly occluded", …
  int hosts = 0;     ///< of one mesh
  int vehicles = 0;  ///< of these: detected clean
  SuccessRates rates;
};

/// In each part, with no hosts too.
std::vector<StratumSuccess> strata(const std::vector<HostOutcome>& hosts, int meshes = 1);

/// [{by, name, hosts, vehicles, fn_asr: {value, low, high}, fp_asr, asr}]
nlohmann::json to_json(const std::vector<StratumSuccess>& strata);

/// What kind of vehicle each host is, where the data set tells: a generated set lays its streets out again
/// and gives cars' body styles ("hatchback", …). Empty for recorded sets and sets of other generator
/// versions, whose hosts are all of the type "Car". By host_name.
std::map<std::string, std::string> vehicle_kinds(const std::filesystem::path& data,
                                                 const std::vector<HostId>& hosts);

}  // namespace mirage
