// A run folder, as `mirage attack` writes it and the other commands read it. Reading a run never executes its
// code, whoever made it. It names shipped parts by word and data by path; code that it names (a plugin, a
// TorchScript model) is used only if the user asks for it (TrustRun).
//
//     RUN/run.json        settings, data set, hosts of the training and test split
//     RUN/checkpoint.json adversary, Adam's state, iteration (atomic; resumes bit-identically)
//     RUN/adversary.glb   the learned adversary (lossless)
//     RUN/random.glb      a random mesh of the same size: the baseline
//     RUN/loss.csv        iteration, loss, hide, false_positive, laplacian, hidden, found (found: hosts of
//                         the batch found as recorded; hidden: those of them that no proposal finds)
//     RUN/result.json
#pragma once

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "attack/attack_settings.h"
#include "base/json_fields.h"
#include "frames/host_id.h"

namespace mirage {

/// Whether code that a run names (--trust-run) may be loaded.
enum class TrustRun { no, yes };

/// A finished attack, as its folder holds it.
struct Run {
  std::filesystem::path folder;
  AttackSettings settings;  ///< from run.json: only settings that decide the result
  std::vector<HostId> train, test;
  std::string train_frames, test_frames;  ///< frames_hash() of their frames; empty: unknown
  TexturedMesh adversary, random;
  TrustRun trust = TrustRun::no;
  /// Code that run.json names. Set only if the run is not trusted; the fields of `settings` are then empty.
  struct Refused {
    std::string detector, depth, sensors;
    std::filesystem::path weights;
  };
  Refused refused;  ///< see Refused
};

/// The keys of run.json for Run::train_frames and Run::test_frames.
inline constexpr const char *kTrainFrames = "train_frames", *kTestFrames = "test_frames";

/// Whether `data` is another folder than the run's: its labels are not the run's hosts.
bool is_other_data(const Run& run, const std::filesystem::path& data);
/// Frames of `data` with the same sweep as one of the frames `ids` of `other`, whatever their names.
/// `unknown`, if not null: number of frames that share only the name of one of `ids` whose own sweep is
/// missing.
std::set<std::string> frames_shared(const std::filesystem::path& data, const std::filesystem::path& other,
                                    std::span<const std::string> ids, std::size_t* unknown = nullptr);
/// Frames of `data` that the run was learned on. For another folder (a copy, a part, or frames labelled by
/// --hosts-from detections): frames_shared(). Warns of frame names whose original sweeps are missing.
std::set<std::string> frames_learned_on(const Run& run, const std::filesystem::path& data);
/// InputError if is_other_data().
void require_own_data(const Run& run, const std::filesystem::path& data);

/// Settings that replace others: option texts by field (base/fields.h), and two that set several fields:
/// "quality" (simulation/insertion.h) and "lidar_effects" (sensors/lidar_effects.h).
using Overrides = std::map<std::string, std::string>;
/// Applies the overrides; `seed` draws the noise of the camera's and the LiDAR's effects. FieldError for a
/// text that its field does not accept.
void override_settings(AttackSettings& settings, const Overrides& overrides, std::uint64_t seed);
/// The same for a run. Its depth completion and sensors must not be code unless the run is trusted
/// (InputError as use_detector_of). Without `other_data` only the run's own data set is allowed (InputError).
void override_settings(Run& run, const Overrides& overrides, std::uint64_t seed, bool other_data = false);

/// Options that leave every field open for use_detector_of.
DetectorOptions detector_of_the_run();
/// Fills in the open fields of `options` (empty; a locality below 0): the run's detector, and, for that
/// detector, the run's weights, defence, precision, locality and matching; otherwise a detector's defaults.
/// User-supplied weights keep none of the run's defences except JPEG. InputError naming the file to be loaded
/// if it is code and the run is not trusted.
void use_detector_of(const Run& run, DetectorOptions& options);

/// Remembers (in the disk cache, by content) that this user's own program wrote a code file, so that a run
/// with this file needs no --trust-run. Failure if the file can't be read.
void remember_code_made_here(const std::filesystem::path& file);
/// Whether a file with this content was remembered.
bool is_code_made_here(const std::filesystem::path& file);

/// Reads a run folder. InputError naming file and field if it is not a finished run, or holds a value that no
/// run can have.
Run read_run(const std::filesystem::path& folder, TrustRun trust = TrustRun::no);

/// [{frame, label}]; frame names are escaped by escape_name.
nlohmann::json to_json(const std::vector<HostId>& hosts);
/// The identity of a run, which a checkpoint must match: the settings that decide the result, and the content
/// of rooftop shape model, rig file, placement file, gamut and user-supplied plugins (*.so). It excludes
/// iterations, so a finished run can be extended. InputError for a missing plugin.
RunIdentity identity(const AttackSettings& settings);

}  // namespace mirage
