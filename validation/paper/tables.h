// Every arm of the experiments as numbers, whatever table it stands in.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "attack/hiding.h"
#include "base/clusters.h"
#include "validation/paper/cases.h"
#include "validation/paper/evidence.h"

namespace mirage::paper {

/// A mesh of an evaluation, judged. Shares in [0, 1].
struct Arm {
  std::string name;              ///< the evaluation's, without its folder
  std::string detector, target;  ///< who was attacked, and through which sensors
  std::string defense;           ///< of the attacked one; empty: none
  std::string parts;             ///< word of --parts: what was learned; empty: shape and texture
  std::string rig;               ///< of the frames
  std::string judge;             ///< the detector that judges
  std::string mesh;              ///< "learned" or a control's word (attack/baseline.h)
  std::vector<std::uint64_t> seeds;
  int vehicles = 0, frames = 0;
  HidingRates hiding;
  /// Of the learned mesh: the same less random meshes of its size, by kHidingRules.
  std::optional<std::array<std::optional<Interval>, kHidingRules.size()>> net;
  Interval false_positives;
};

/// Of the evaluations that were judged, in the cases' order; repetitions are pooled.
std::vector<Arm> evaluation_arms(const Experiments& experiments, const ReproduceSettings& settings,
                                 const Evidence& evidence);

/// {name, detector, target, defense?, parts?, rig, judge, mesh, seeds, vehicles, frames, asr: as HidingRates,
/// net?: {vanished, iou50, iou70, distance1m, distance2m: each {value, low, high} or null}, fp_asr, interval:
/// {confidence, drawn}}
nlohmann::json to_json(const Arm& arm);

// The tables: experiments beside what was measured for them.

/// What a row's numbers rest on.
struct RowCounts {
  int vehicles = 0;       ///< detected clean
  std::size_t hosts = 0;  ///< of one mesh and run
  int frames = 0, meshes = 1, runs = 1;
  ClusterCount clusters = {};
};

/// A row as measured. Shares in [0, 1].
struct RowResult {
  std::string label, rig, source, target;  ///< as in Row
  std::string evaluation;                  ///< case
  double size = 0;                         ///< fig4: L, m
  std::optional<RowCounts> counts;         ///< none without its evaluation
  std::map<std::string, Share> values;     ///< by key of a column, and clean AP
  std::map<std::string, double> paper;     ///< by key of a column
  std::string note;                        ///< the row is about a picture that its detector does not use
  std::string error;                       ///< why there are no values, or no clean AP
  std::optional<RecallCurve> curve;        ///< fig3
  std::optional<std::vector<double>> false_positive_distances;  ///< m; of tables of attacks
  std::optional<double> minutes;  ///< of the cases it needs, without data; none: unknown
};

struct TableResult {
  std::string name, title, note;
  bool matrix = false;  ///< as Table::matrix
  std::vector<Column> columns;
  std::vector<RowResult> rows;
};

TableResult table_result(const Table& table, const Experiments& experiments, const Evidence& evidence);

/// {name, title, note, matrix, columns: [{key, title}], rows: [{label, rig, case, values: {key: {value, low?,
/// high?}}, paper: {key: share}, vehicles?, hosts?, frames?, meshes?, runs?, minutes?, error?, note?, curve?,
/// false_positive_distances?, size?, source?, target?}]}
nlohmann::json to_json(const TableResult& table);

}  // namespace mirage::paper
