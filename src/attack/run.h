// A run folder, as `mirage attack` writes it and the other commands read it:
//     RUN/run.json        settings, data set, hosts of the training and test split
//     RUN/checkpoint.json adversary, Adam's state, iteration (atomic; resumes bit-identically)
//     RUN/adversary.glb   the learned adversary (lossless)
//     RUN/random.glb      a random mesh of the same size: the baseline
//     RUN/loss.csv        iteration, loss, hide, false_positive, laplacian, hidden (hosts of the batch that
//     no
//                         proposal found)
//     RUN/result.json
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "attack/buildable.h"
#include "detection/detector.h"
#include "geometry/mesh.h"
#include "scene/insertion.h"
#include "scene/sun.h"

namespace mirage {

/// One host vehicle: a label of a frame.
struct HostId {
  std::string frame;
  int label = 0;  ///< index into Frame::labels
};

/// A finished attack, as its folder holds it.
struct Run {
  std::filesystem::path folder, data, weights;  ///< weights: empty for the shipped ones
  std::string detector, defense = "none", target, depth = "ip-basic", rooftop = "box", sun = kDefaultSun;
  std::vector<HostId> train, test;
  TexturedMesh adversary, random;
  SimulationSettings simulation;
  double min_view = 0.7;
  std::uint64_t seed = 0;
  AdversaryLimits limits;
  BuildableSettings buildable;
};

/// Whether `data` is another folder than the run's: its labels are not the run's hosts.
bool is_other_data(const Run& run, const std::filesystem::path& data);
/// InputError if it is.
void require_own_data(const Run& run, const std::filesystem::path& data);

/// Fills in what `options` leaves open (empty): the run's detector, and its weights and defence if it is that
/// detector. Weights of the user's own keep none of the run's defences but JPEG.
void use_detector_of(const Run& run, DetectorOptions& options);

/// InputError naming the file and key if the folder is not a finished run.
Run read_run(const std::filesystem::path& folder);

/// [{"frame", "label"}, …]
nlohmann::json to_json(const std::vector<HostId>& hosts);
/// What a run says of how it simulated: the settings that change results, by name.
nlohmann::json to_json(const SimulationSettings& settings);

}  // namespace mirage
