// The same experiments again from other seeds: each attack is learned anew, on another split of the frames,
// and judged beside the first one.
#pragma once

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "validation/paper/cases.h"
#include "validation/paper/results.h"

namespace mirage::paper {

/// The name of an attack's or evaluation's repetition; number 0 is the case itself.
std::string repetition(const std::string& name, int number);
bool is_repetition(const std::string& name);

/// Appends settings.seeds − 1 repetitions of every attack and evaluation, a whole seed after the other.
void repeat(Experiments& experiments, const ReproduceSettings& settings);

// What the finished cases say: how each went, and what its result.json holds.

/// How a case went.
struct Step {
  enum class Status { missing, done, failed } status = Status::missing;
  std::string error;   ///< of a failed one
  double seconds = 0;  ///< that it took when it was run; 0: unknown
};
/// {status: "missing", "done" or "failed", error?, seconds?}
nlohmann::json to_json(const Step& step);

/// A share, and its 95 % interval where it has one.
struct Share {
  Interval interval;
  bool bounded = true;  ///< false: the value alone
};
/// {value, low?, high?}
nlohmann::json to_json(const Share& share);

/// A detector's clean AP at IoU 0.5 and 0.7; none that the file does not hold.
struct Detection {
  std::optional<Share> ap50, ap70;
};
/// Of mirage detect's result.json. InputError naming file and field.
Detection read_detection(const std::filesystem::path& file);

struct Evidence {
  std::map<std::string, Step> steps;            ///< by case
  std::map<std::string, Judged> evaluations;    ///< by case; its repetitions by other seeds pooled
  std::map<std::string, Detection> detections;  ///< by case

  /// Null where it is missing or failed.
  const Outcomes* learned(const std::string& evaluation) const { return of(evaluation, &Judged::learned); }
  const Outcomes* random(const std::string& evaluation) const { return of(evaluation, &Judged::random); }
  const Outcomes* sized(const std::string& evaluation) const { return of(evaluation, &Judged::sized); }
  const Outcomes* cuboid(const std::string& evaluation) const { return of(evaluation, &Judged::cuboid); }

 private:
  const Outcomes* of(const std::string& evaluation, std::shared_ptr<const Outcomes> Judged::*mesh) const;
};

/// Reads the results of the cases whose step is done; one that can't be read becomes a failed step.
Evidence gather(const Experiments& experiments, const std::filesystem::path& out,
                std::map<std::string, Step> steps);

}  // namespace mirage::paper
