#include "validation/paper/fusions.h"

#include <fmt/format.h>

#include <set>

namespace mirage::paper {
namespace {

const std::vector<Column> kCell = {{"vanished", "vanished"},
                                   {"net_vanished", "vanished, net of its size"},
                                   {"fn_asr", "missed at IoU 0.7"},
                                   {"net_fn_asr", "missed at IoU 0.7, net of its size"},
                                   {"fp_asr", "FP ASR"}};
constexpr const char* kCuboid = "no learning: cuboid";

std::vector<Attacked> attacks(bool quick) {
  std::vector<Attacked> all;
  for (const std::string& detector : fusion_detectors()) {
    const bool fused = through_all(detector).target == "both";
    if (quick && fused && detector != "fusion") continue;
    if (fused)
      for (const char* target : {"image", "lidar"}) all.push_back({detector, target});
    all.push_back(through_all(detector));
  }
  return all;
}

std::string words(const Attacked& attacked) {
  return attacked.detector + ", " + target_title(attacked.target);
}

/// One row for each mesh and judge; `judged` names, and adds, the evaluation.
template <class Judged>
void add_rows(Table& table, const std::string& rig, bool quick, const Judged& judged) {
  std::set<std::string> judges;
  for (const Attacked& attacked : attacks(quick)) judges.insert(attacked.detector);
  const auto add = [&](const std::string& source, const std::string& judge, const std::string& evaluation) {
    Row row;
    row.label = source + " → " + judge;
    row.rig = rig;
    row.evaluation = evaluation;
    row.source = source;
    row.target = judge;
    table.rows.push_back(row);
    return &table.rows.back();
  };
  for (const Attacked& attacked : attacks(quick))
    for (const std::string& judge : fusion_detectors())
      if (judges.contains(judge))
        add(words(attacked), judge, judged(attacked, judge))->image =
            attacked.target == "image" && attacked.detector == judge;
  for (const std::string& judge : fusion_detectors())
    if (judges.contains(judge)) add(kCuboid, judge, judged(through_all(judge), judge))->cuboid = true;
}

constexpr const char* kNote =
    "Rows: against which detector, and through which of its sensors, the mesh was learned; columns: who "
    "judges it, on the same vehicles. Net: less a random mesh of the same extents on the same vehicles; the "
    "cuboid fills the box and is net of the random mesh beside the judge's own row. Compare rows within a "
    "column: camera is judged in the picture's plane, the others in the bird's-eye view, and each column has "
    "the vehicles that its detector finds clean.";

}  // namespace

const std::vector<std::string>& fusion_detectors() {
  static const std::vector<std::string> all = {"lidar", "camera", "painted", "fusion", "refined", "late"};
  return all;
}

const std::vector<std::string>& fused_detectors() {
  static const std::vector<std::string> fused = {"painted", "fusion", "refined", "late"};
  return fused;
}

Attacked through_all(const std::string& detector) {
  return {detector, all_sensors(detector)};
}

std::string cell_case(const std::string& rig, const Attacked& attacked, const std::string& judge) {
  if (rig == "real") return fmt::format("evaluations/{}--on--real-{}", attacked.run("kitti64"), judge);
  const std::string own = "evaluations/" + attacked.run(rig);
  return attacked.detector == judge ? own : own + "--on--" + through_all(judge).run(rig);
}

Table fusions_table(CaseList& list, const std::string& rig) {
  Table table{rig == "xenith" ? "fusions-xenith" : "fusions",
              std::string("Which fusion is weak where, ") + (rig == "xenith" ? "Xenith rig" : "KITTI rig"),
              kNote,
              kCell,
              {},
              true};
  const auto run = [&](const Attacked& attacked) {
    return list.attack(rig, attacked.detector, attacked.target);
  };
  add_rows(table, rig, list.quick(), [&](const Attacked& attacked, const std::string& judge) {
    if (attacked.detector != judge) return list.transfer(run(attacked), run(through_all(judge)));
    return list.evaluate(run(attacked));
  });
  return table;
}

Table fusions_on_real(CaseList& list) {
  Table table{
      "fusions-real",
      "Which fusion is weak where, real KITTI frames",
      std::string("Learned on generated frames of the KITTI rig, judged on all usable vehicles of the "
                  "given ones. ") +
          kNote,
      kCell,
      {},
      true};
  add_rows(table, "real", list.quick(), [&](const Attacked& attacked, const std::string& judge) {
    const Attacked own = through_all(judge);
    return list.on_real(list.attack("kitti64", attacked.detector, attacked.target), judge,
                        attacked.detector == judge && attacked.target == own.target);
  });
  return table;
}

}  // namespace mirage::paper
