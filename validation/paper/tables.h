// The tables: experiments beside what was measured for them.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "base/clusters.h"
#include "validation/paper/cases.h"
#include "validation/paper/evidence.h"

namespace mirage::paper {

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
