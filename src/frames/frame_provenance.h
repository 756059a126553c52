// What results owe to frames and to a detector, by content (base/provenance.h).
#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "base/provenance.h"
#include "detection/detector.h"
#include "frames/host_id.h"
#include "scene/frame_source.h"

namespace mirage {

/// Hash of all that is read of those frames: pictures, sweeps, calibration, labels and their identities,
/// light, and the set's rig. InputError for a missing file. Uses several threads.
std::string frames_hash(const std::filesystem::path& data, std::span<const std::string> ids,
                        Cameras cameras = Cameras::first);
/// What a detector's answers depend on besides the frame (add_detector). Empty for fresh weights and for a
/// detector outside that tells no `version` (Capabilities): what those say is not to be kept.
std::string detector_identity(const DetectorOptions& options, const std::string& version = "");

/// Those frames as the input "data".
void add_data(Provenance& provenance, const std::filesystem::path& data, std::span<const std::string> ids,
              Cameras cameras = Cameras::first);
/// The frames of that source, its settings, what completes their depth and finds their roofs.
void add_frames(Provenance& provenance, const FrameSource& source, std::span<const std::string> ids);
/// The frames of these hosts.
void add_frames(Provenance& provenance, const FrameSource& source, std::span<const HostId> hosts);
/// The detector's options, plugin and weights, and those of its auxiliary detectors. Errors as
/// weights_file's.
void add_detector(Provenance& provenance, const DetectorOptions& options);

}  // namespace mirage
