// The tables: experiments beside what was measured for them, as JSON and as Markdown.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "validation/paper/cases.h"
#include "validation/paper/results.h"

namespace mirage::paper {

/// How a case went.
struct Step {
  enum class Status { missing, done, failed } status = Status::missing;
  std::string error;   ///< of a failed one
  double seconds = 0;  ///< that it took when it was run; 0: unknown
};

/// What the finished cases say.
struct Evidence {
  std::map<std::string, Step> steps;                 ///< by case
  std::map<std::string, Judged> evaluations;         ///< by case; its repetitions by other seeds pooled
  std::map<std::string, nlohmann::json> detections;  ///< result.json of mirage detect, by case

  /// Null where it is missing or failed.
  const Outcomes* learned(const std::string& evaluation) const;
  const Outcomes* random(const std::string& evaluation) const;
  const Outcomes* sized(const std::string& evaluation) const;
  const Outcomes* cuboid(const std::string& evaluation) const;
};

/// Reads the results of the cases whose step is done; one that can't be read becomes a failed step.
Evidence gather(const Experiments& experiments, const std::filesystem::path& out,
                std::map<std::string, Step> steps);

/// {name, title, note, matrix, columns: [{key, title}], rows: [{label, rig, vehicles, hosts, frames, meshes,
/// runs, minutes, values: {key: {value, low, high}}, paper: {key: share}, error?, note?, curve?, size?,
/// source?, target?, case, far?}]}; shares in [0, 1]. A row without its evaluation has an error instead of
/// values; a note says that the row's detector does not use the picture that the row is about.
nlohmann::json table_json(const Table& table, const Experiments& experiments, const Evidence& evidence);

/// The same as a Markdown table, the paper's number beside each of ours; a matrix as matrix_markdown.h has
/// it.
std::string markdown(const nlohmann::json& table);

/// "31.9 (24.1–40.0)", per cent.
std::string in_percent(const Interval& interval);

}  // namespace mirage::paper
