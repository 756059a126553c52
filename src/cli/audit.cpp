// mirage audit: what a detector loses when one of its inputs is wrong.
#include "detection/audit.h"

#include "attack/detector_pool.h"
#include "base/error.h"
#include "base/files.h"
#include "base/ranks.h"
#include "cli/command.h"
#include "cli/options.h"
#include "detection/detector_settings.h"
#include "frames/data_check.h"
#include "frames/frame_provenance.h"
#include "frames/frame_store.h"
#include "scene/data/read_frames.h"

namespace mirage::cli {
namespace {

struct AuditOptions : FrameSource {
  DetectorOptions detector;
  std::size_t frames = kAuditFrames;
  bool gate = false;
  std::filesystem::path claim;
};

/// The measured detectors that the file holds; none if there is no file.
nlohmann::json read_claims(const std::filesystem::path& file) {
  if (!std::filesystem::exists(file)) return nlohmann::json::object();
  nlohmann::json claims = read_json(file, kMaxRecordBytes);
  if (!claims.is_object())
    throw InputError(file.string(), "", "is not an object of measured detectors",
                     "name another file with --claim");
  return claims;
}

/// Writes the measurement under the weights' name into the file that the tests compare with.
void write_claim(const std::filesystem::path& file, const DetectorOptions& detector,
                 const std::filesystem::path& data, const Reliance& reliance) {
  const Defense defense = read_defense(detector.defense);
  if (defense.around != read_defense(detector.weights).around)
    throw FieldError("claim", file.string(), "is of weights, and the defence stands around them",
                     "leave --defense or --claim out");
  const std::filesystem::path weights = weights_file(detector);
  if (weights.empty())
    throw FieldError("claim", file.string(), "is of weights, and " + detector.detector + " has none",
                     "leave --claim out");
  nlohmann::json claims = read_claims(file);
  claims[weights.stem().string()] = to_json(reliance);
  claims[weights.stem().string()].update(
      {{"data", data.filename().string()}, {"weights_hash", file_hash(weights)}});
  write_json(file, claims);
}

void add_options(CLI::App& app, AuditOptions& options) {
  add_fields(app, static_cast<FrameSource&>(options), {"depth", "rooftop", "placement", "sun"});
  add_fields(app, options.detector);
  add_defaulted(app, "--frames", options.frames, "N frames, spread evenly over the data set (0: all)");
  app.add_flag("--gate", options.gate,
               "measure only whether the detector uses its picture: another frame's, a black one and none");
  app.add_option("--claim", options.claim,
                 "put the gate's answer under the weights' name into this file "
                 "(plugins/detectors/fusion/weights/reliance.json is what the tests check)");
  add_cache_note(app);
}

/// A loss as a gain: the interval with its sign changed.
Interval less(const Interval& lost) {
  return {-lost.value, -lost.high, -lost.low};
}

nlohmann::json run(const AuditOptions& options, const Common& common) {
  if (!options.claim.empty()) read_claims(options.claim);  // now, not after the work
  const DetectorOptions detector_options = with_common(options.detector, common, options);
  check_known_options(detector_options, false);
  check_data(options.data, options.rig, UnitUse::reads_sweeps);
  const std::vector<std::string> ids = spread_evenly(list_frames(options.data), options.frames);
  check_labels(options.data, ids, "an audit", options.classes);
  const DetectorPool pool = load_detector_pool(detector_options, static_cast<int>(ids.size()));
  const std::vector<Detector*> detectors = instances(pool);
  const Capabilities can = detectors.front()->capabilities();
  std::vector<AuditChange> changes = options.gate ? gate_changes() : audit_changes(can);
  if (!can.reads_image)
    std::erase_if(changes, [](const AuditChange& change) { return change.input() == AuditInput::picture; });
  Audit audit;
  if (!changes.empty())
    audit = run_audit(
        detectors, recorded_frames(options, detector_identity(detector_options, can.version), "audit"), ids,
        changes, lidar_of(options.data, options.rig), common.seed, progress_of("audit", common.quiet));
  if (rank() > 0) return nlohmann::json::object();  // the first tells
  add_detector(*common.provenance, detector_options);
  common.provenance->set("classes", options.classes);
  common.provenance->input("sensors", sensors_identity(options.sensors));
  add_data(*common.provenance, options.data, ids, options.cameras);
  const Reliance reliance = can.reads_image ? reliance_of(audit) : no_camera();
  if (!options.claim.empty()) write_claim(options.claim, detector_options, options.data, reliance);
  nlohmann::json result = nlohmann::json::object();
  if (!changes.empty()) result = to_json(audit);
  result["detector"] = detectors.front()->name();
  result["reliance"] = to_json(reliance);
  if (common.quiet) return result;
  if (changes.empty()) {  // the gate of a detector without a camera: nothing was looked at
    print_table(picture_rows(reliance));
    return result;
  }
  Rows rows = {{"frames", std::to_string(audit.frames)},
               {"cars", fmt::format("{}, AP 0.7 {}", audit.vehicles, percent(audit.ap70))}};
  if (audit.vehicles > 0) rows.push_back({"intervals over", to_string(audit.clusters)});
  for (auto& row : picture_rows(reliance)) rows.push_back(std::move(row));
  for (const std::string& line : describe(audit)) rows.push_back({"answer", line});
  print_table(rows);
  Columns changes_of = {{"input", "change", "AP 0.7, points (95 %)", "logits move by"}};
  for (const AuditRow& row : audit.rows)
    if (row.refused.empty())
      changes_of.push_back({to_word(row.change.input()), row.change.text(), signed_points(less(row.drop)),
                            fmt::format("{:.2f}", row.delta_logit.value)});
    else
      changes_of.push_back({to_word(row.change.input()), row.change.text(), "refused: " + row.refused});
  print_columns(changes_of);
  return result;
}

void afterwards(const AuditOptions& options, const Common& common) {
  if (options.gate)
    remove_pages(common.out);  // the gate's answer has none
  else
    write_page(common.out);
}

}  // namespace

Command audit_command() {
  return command_of<AuditOptions>({
      .name = "audit",
      .help = "measures what a detector loses when its picture, its sweep or its calibration is wrong",
      .example = "mirage audit --data path/to/kitti --detector fusion",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
