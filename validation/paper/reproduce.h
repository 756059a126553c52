// Runs the cases: finished cases are kept, the others are run. Under mpirun the ranks take cases side by
// side, each case on one rank, which holds the lock of the case's folder. The others read its outcome from
// OUT/steps, which all ranks must see.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <string>

#include "validation/paper/results.h"

namespace mirage::paper {

// The experiments' figures as reproduce.json has them: tables beside what the paper printed, and every arm,
// whatever table it stands in. Shares in [0, 1].

/// {name, title, note, matrix, columns: [{key, title}], rows: [{label, rig, case, values: {key: {value, low?,
/// high?}}, paper: {key: share}, vehicles?, hosts?, frames?, meshes?, runs?, clusters?, minutes?, error?,
/// note?, curve?, false_positive_distances?, false_positives_of?, size?, source?, target?}]}. Of a row,
/// vehicles: detected clean; hosts: of one mesh and run; minutes: of the cases it needs, without data; error:
/// why there are no values, or no clean AP; note: it is about a picture that its detector does not use;
/// false_positive_distances: m, of attacks, and false_positives_of: the vehicles they come from, once a mesh
/// and run.
nlohmann::json table_json(const Table& table, const Experiments& experiments, const Evidence& evidence);

/// Every judged mesh of each evaluation, in the cases' order; repetitions are pooled. [{name, detector and
/// target (attacked), defense?, parts?, rig (of the frames), judge, mesh ("learned" or a control's word),
/// seeds, vehicles, frames, hidden: {rule: {value, low, high, vehicles} or null}, net?: {rule: {value, low,
/// high} or null}, fp_asr, interval: {confidence, drawn}}]. net: less random meshes of its size.
nlohmann::json arms_json(const Experiments& experiments, const ReproduceSettings& settings,
                         const Evidence& evidence);

/// Runs one command of mirage to its end; throws what it throws.
using Execute = std::function<void(const std::string& command, const NamedSettings& settings)>;

/// Whether the case's folder holds the result of exactly these settings, made of what its inputs are now.
bool is_finished(const Case& command, const std::filesystem::path& out);

/// Executes the cases that are not finished, in order. A case that fails, and all cases that need it, become
/// failed steps; an interrupt (base/error.h, Interrupted) ends everything. Collective: each rank learns how
/// every case went.
std::map<std::string, Step> execute(const Experiments& experiments, const ReproduceSettings& settings,
                                    const Execute& run);

// `mirage reproduce`: runs the cases that the experiments still lack, and writes tables, findings and page.
//
//     OUT/data/RIG               generated frames, unless a data set is given
//     OUT/runs/NAME              run folders of mirage attack
//     OUT/evaluations/NAME       mirage evaluate; FROM--on--RUN: transfer onto RUN's hosts
//     OUT/detect/NAME            mirage detect: clean AP
//     OUT/steps/NAME.json        the settings of each finished command, what it read, and its seconds
//     OUT/steps/NAME.failed.json why it failed, for the other processes under mpirun
//     OUT/reproduce.json
//     OUT/reproduce.{md,html}, OUT/TABLE.md   by paper_page.py

/// The file of a table's text in Markdown; missing without Python.
std::filesystem::path text_file(const std::filesystem::path& out, const std::string& table);

/// Runs everything and writes OUT. Returns the content of reproduce.json: {what, settings, tables, arms,
/// findings (finding.h), reliance: each detector on its data once, as Reliance, and case, words; steps:
/// {case: step}}, and the page, if it could be written. Collective: the first rank makes tables, findings and
/// page; the others return an empty object.
nlohmann::json reproduce(const ReproduceSettings& settings, const Execute& run);

}  // namespace mirage::paper
