// Provenance of results from frames and from a detector, by content (base/provenance.h).
#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "base/provenance.h"
#include "detection/detector.h"
#include "frames/host_id.h"
#include "scene/frame_source.h"

namespace mirage {

/// Hash of all data read from those frames: pictures, sweeps, calibration, labels and their identities,
/// light, and the set's rig. InputError for a missing file. Uses several threads.
std::string frames_hash(const std::filesystem::path& data, std::span<const std::string> ids,
                        Cameras cameras = Cameras::first);
/// Hash of all that a detector's answers depend on besides the frame (add_detector). Empty for fresh weights
/// and for an external detector without a `version` (Capabilities): their answers must not be cached.
std::string detector_identity(const DetectorOptions& options, const std::string& version = "");

/// Adds those frames as the input "data".
void add_data(Provenance& provenance, const std::filesystem::path& data, std::span<const std::string> ids,
              Cameras cameras = Cameras::first);
/// Adds the source's frames and settings, its depth completion and its roof finder.
void add_frames(Provenance& provenance, const FrameSource& source, std::span<const std::string> ids);
/// Adds the frames of these hosts.
void add_frames(Provenance& provenance, const FrameSource& source, std::span<const HostId> hosts);
/// Adds the options, plugin and weights of the detector and of its auxiliary detectors. Errors as
/// weights_file's.
void add_detector(Provenance& provenance, const DetectorOptions& options);

}  // namespace mirage
