// A run folder, as `mirage attack` writes it and the other commands read it. Whoever made it, reading it runs
// none of its code: it names shipped parts by word and data by path; what it names that is code (a plugin, a
// TorchScript model) is used only where the user asks for it (TrustRun).
//
//     RUN/run.json        settings, data set, hosts of the training and test split
//     RUN/checkpoint.json adversary, Adam's state, iteration (atomic; resumes bit-identically)
//     RUN/adversary.glb   the learned adversary (lossless)
//     RUN/random.glb      a random mesh of the same size: the baseline
//     RUN/loss.csv        iteration, loss, hide, false_positive, laplacian, hidden, found (hosts of the
//                         batch found as recorded, and those of them that no proposal finds)
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
  AttackSettings settings;  ///< those that run.json says: what decides the result
  std::vector<HostId> train, test;
  std::string train_frames, test_frames;  ///< frames_hash() of those that these stand in; empty: not said
  TexturedMesh adversary, random;
  TrustRun trust = TrustRun::no;
  /// Code that run.json names. Set only if the run is not trusted; the settings' own fields are then empty.
  struct Refused {
    std::string detector, depth, sensors;
    std::filesystem::path weights;
  };
  Refused refused;  ///< see Refused
};

/// The keys of run.json that say Run::train_frames and Run::test_frames.
inline constexpr const char *kTrainFrames = "train_frames", *kTestFrames = "test_frames";

/// Whether `data` is another folder than the run's: its labels are not the run's hosts.
bool is_other_data(const Run& run, const std::filesystem::path& data);
/// Frames of `data` whose sweeps are those of some of the frames `ids` of `other`, whatever their names.
/// `unknown`, if given: how many have the name of one of these that is not there.
std::set<std::string> frames_shared(const std::filesystem::path& data, const std::filesystem::path& other,
                                    std::span<const std::string> ids, std::size_t* unknown = nullptr);
/// Frames of `data` that the run was learned on. Of another folder, such as a copy, a part or what
/// --hosts-from detections has labelled: frames_shared(). Warns of names whose own sweeps are gone.
std::set<std::string> frames_learned_on(const Run& run, const std::filesystem::path& data);
/// InputError if it is.
void require_own_data(const Run& run, const std::filesystem::path& data);

/// What is asked for in place of other settings: texts as the options take them, by field (base/fields.h),
/// and those that set several: "quality" (simulation/insertion.h) and "lidar_effects"
/// (sensors/lidar_effects.h).
using Overrides = std::map<std::string, std::string>;
/// Puts them into the settings; `seed` draws the noise of the LiDAR's effects. FieldError for a text that a
/// field does not take.
void override_settings(AttackSettings& settings, const Overrides& overrides, std::uint64_t seed);
/// The same for a run: its own depth completion and sensors may be used only if they are no code, or trusted
/// (InputError as use_detector_of's), and if not `other_data`, its own data set alone (InputError).
void override_settings(Run& run, const Overrides& overrides, std::uint64_t seed, bool other_data = false);

/// Options that leave open what use_detector_of fills in.
DetectorOptions detector_of_the_run();
/// Fills in what `options` leaves open (empty; a locality below 0): the run's detector, and its weights,
/// defence, precision, locality and matching if it is that detector, else what a detector has by default.
/// Weights of the user's own keep none of the run's defences but JPEG. InputError naming the file that would
/// be loaded if that is code and the run is not trusted.
void use_detector_of(const Run& run, DetectorOptions& options);

/// Remembers that this user's own program wrote a file of code (by its whole content, in the disk cache), so
/// that a run which holds it is read without --trust-run. Failure if it can't be read.
void remember_code_made_here(const std::filesystem::path& file);
/// Whether it was remembered, with this content.
bool is_code_made_here(const std::filesystem::path& file);

/// InputError naming the file and field if the folder is not a finished run, or holds a value that no run can
/// have.
Run read_run(const std::filesystem::path& folder, TrustRun trust = TrustRun::no);

/// Frames as escape_name writes them.
nlohmann::json to_json(const std::vector<HostId>& hosts);
/// What a run says of itself, and what a checkpoint must agree with: its settings that decide the result,
/// and the content of the shape model that finds its roofs, of its placement's file and of the plugins that
/// the user brought (*.so). Iterations are not in it: a finished run can be prolonged. InputError for a
/// plugin that is not there.
RunIdentity identity(const AttackSettings& settings);

}  // namespace mirage
