// The experiments' figures as reproduce.json has them: tables beside what the paper printed, and every arm,
// whatever table it stands in. Shares in [0, 1].
#pragma once

#include <nlohmann/json.hpp>

#include "validation/paper/results.h"

namespace mirage::paper {

/// {name, title, note, matrix, columns: [{key, title}], rows: [{label, rig, case, values: {key: {value, low?,
/// high?}}, paper: {key: share}, vehicles?, hosts?, frames?, meshes?, runs?, clusters?, minutes?, error?,
/// note?, curve?, false_positive_distances?, size?, source?, target?}]}. Of a row, vehicles: detected clean;
/// hosts: of one mesh and run; minutes: of the cases it needs, without data; error: why there are no values,
/// or no clean AP; note: it is about a picture that its detector does not use; false_positive_distances: m,
/// of attacks.
nlohmann::json table_json(const Table& table, const Experiments& experiments, const Evidence& evidence);

/// A mesh of each evaluation that was judged, in the cases' order; repetitions are pooled. [{name, detector
/// and target (attacked), defense?, parts?, rig (of the frames), judge, mesh ("learned" or a control's word),
/// seeds, vehicles, frames, hidden: {rule: {value, low, high, vehicles} or null}, net?: {rule: {value, low,
/// high} or null}, fp_asr, interval: {confidence, drawn}}]. net: less random meshes of its size.
nlohmann::json arms_json(const Experiments& experiments, const ReproduceSettings& settings,
                         const Evidence& evidence);

}  // namespace mirage::paper
