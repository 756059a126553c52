// The layouts (data_set.h), one function each: it returns the data set, or null if the folder has another
// layout. A new layout is a file with such a function, and its line in open_data_set (read_frames.cpp).
#pragma once

#include <nlohmann/json.hpp>

#include "base/error.h"
#include "scene/data/data_set.h"

namespace mirage {

/// Never null: the fallback for a folder of no other layout.
std::shared_ptr<const DataSet> open_kitti_object(const std::filesystem::path& data);
/// A folder with DATA/training/label_02 and without label_2.
std::shared_ptr<const DataSet> open_kitti_tracking(const std::filesystem::path& data);
/// calib_velo_to_cam.txt in the folder or in a subfolder.
std::shared_ptr<const DataSet> open_kitti_raw(const std::filesystem::path& data);
/// sample_data.json in the folder or in one DATA/v1.0-*.
std::shared_ptr<const DataSet> open_nuscenes(const std::filesystem::path& data);

/// Third-party labels for a set's unlabelled frames: DATA/labels.json names the set ({"data": folder}),
/// DATA/label_2 has a file ID.txt for each such frame, as in KITTI's object benchmark.
std::shared_ptr<const DataSet> open_separate_labels(const std::filesystem::path& data);
/// Writes labels.json, which keeps `about`, and copies of the set's rig files (dataset.json, rig.toml).
void write_separate_labels(const std::filesystem::path& folder, const std::filesystem::path& data,
                           nlohmann::json about);

/// Whether the folder holds such labels with the same `about`. InputError if their `about` differs.
bool are_labels_of(const std::filesystem::path& folder, const std::filesystem::path& data,
                   nlohmann::json about);

/// A label of a set with 3-D boxes only: projects the box (m, `velo`) and sets its truncation by the
/// picture's edges. Nullopt if the camera sees nothing of it.
std::optional<Label> projected_label(std::string type, const Box3& box, const Calibration& calibration);
/// Why the box cannot be a road user's; empty if it can.
std::string box_problem(const Box3& box);
/// The same for a labelled box; its heading must also be in radians: at most a full turn.
std::string label_problem(const Box3& box);
/// Limit on the vehicles of a drive, scene or sequence.
inline constexpr std::size_t kMaxVehicles = 100000;
/// The track id of the `index`-th vehicle (below kMaxVehicles) of the `group`-th drive, scene or sequence.
/// Drives count in the order of their paths: adding one may change the others' ids.
int track_number(std::size_t group, std::size_t index);
/// A frame's labels from its sequence's file of the tracking benchmark. `sequence`: the group of its tracks
/// (track_number); `notes` is added to. InputError for an invalid row of that frame, as kitti.h's
/// read_labels.
std::vector<Label> read_tracking_labels(const std::filesystem::path& file, int frame, std::size_t sequence,
                                        const Calibration& calibration, LabelNotes& notes);
/// A frame's labels from its drive's tracklets (tracklet_labels.xml) in the camera's view; `drive`: the group
/// of its tracks. InputError for a file that is not XML, and for a tracklet without a field or a valid box.
std::vector<Label> read_tracklets(const std::filesystem::path& file, int frame, std::size_t drive,
                                  const Calibration& calibration);
/// A sweep of `columns` floats a point, the first four of them x, y, z and reflectance. Errors as kitti.h's
/// read_sweep.
Sweep read_points(const std::filesystem::path& file, std::size_t columns);
/// The error for a folder that is not a data set: whether it is missing or part of a data set ("give its
/// parent"), and its content.
InputError no_layout(const std::filesystem::path& data);
/// DATA/training of KITTI's benchmarks, or DATA/testing (without labels) if only that exists.
std::filesystem::path benchmark_part(const std::filesystem::path& data);
/// The folder's entries, unordered; empty if it cannot be read.
std::vector<std::filesystem::path> entries_of(const std::filesystem::path& folder);
/// FOLDER/NAME.png, or if missing the picture of that name with another ending (.jpg, .jpeg or other case).
std::filesystem::path picture_in(const std::filesystem::path& folder, const std::string& name);
/// Adds an id PREFIX_NAME for every NAME.bin of the folder. InputError for a NAME that is not a number or too
/// long.
void add_numbered_sweeps(const std::filesystem::path& folder, const std::string& prefix,
                         std::vector<std::string>& ids);
/// The part of the name before the last underscore, and the number after it; nullopt for another name.
/// "0003_000012": {"0003", 12}.
std::optional<std::pair<std::string, int>> split_id(const std::string& id);

/// The car's pose: the first six numbers of a row of KITTI's OXTS RT 3003 (Geiger et al., IJRR 2013).
struct OxtsRow {
  double latitude = 0, longitude = 0;   ///< degrees
  double altitude = 0;                  ///< m
  double roll = 0, pitch = 0, yaw = 0;  ///< rad; roll left side up, yaw counter-clockwise from east
};
/// The unit's pose (m): the world's origin is its position at `first`; x points east, y north, z up.
/// Positions are projected by Mercator at the latitude of `first`, as in the development kit.
Transform world_from_imu(const OxtsRow& row, const OxtsRow& first);

}  // namespace mirage
