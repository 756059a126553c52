// `mirage reproduce`: runs what the experiments need and have not got, and writes tables, findings and page.
//
//     OUT/data/RIG               generated frames, unless a data set is given
//     OUT/runs/NAME              run folders of mirage attack
//     OUT/evaluations/NAME       mirage evaluate; FROM--on--RUN: transfer onto RUN's hosts
//     OUT/detect/NAME            mirage detect: clean AP
//     OUT/steps/NAME.json        the settings of each finished command, what it read, and its seconds
//     OUT/steps/NAME.failed.json why it failed, for the other processes under mpirun
//     OUT/reproduce.json
//     OUT/reproduce.{md,html}, OUT/TABLE.md   by paper_page.py
#pragma once

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "detection/reliance.h"
#include "validation/paper/evaluation_arms.h"
#include "validation/paper/experiments.h"
#include "validation/paper/finding.h"
#include "validation/paper/steps.h"
#include "validation/paper/tables.h"

namespace mirage::paper {

/// How much an attacked detector uses its picture, and in which evaluation that was measured.
struct CaseReliance {
  std::string name;  ///< the evaluation's, without its folder
  Reliance reliance;
};

struct ReproduceResult {
  ReproduceSettings settings;  ///< `out` absolute
  std::vector<TableResult> tables;
  std::vector<Arm> arms;
  std::vector<Finding> findings;
  std::vector<CaseReliance> reliance;  ///< each detector on its data once
  std::map<std::string, Step> steps;   ///< by case
  std::filesystem::path page;          ///< empty: could not be written
};

/// What reproduce.json holds: {what, settings, tables, arms, findings, reliance: [as Reliance, and case,
/// words], steps: {case: step}, page?}.
nlohmann::json to_json(const ReproduceResult& result);

/// A table's text in Markdown; there is none without Python.
std::filesystem::path text_file(const std::filesystem::path& out, const std::string& table);

/// All of it; writes OUT. A call of all ranks, of which the first makes tables, findings and page.
ReproduceResult reproduce(const ReproduceSettings& settings, const Execute& run);

}  // namespace mirage::paper
