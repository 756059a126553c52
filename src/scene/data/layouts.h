// The layouts (data_set.h), one function each: the data set, or null if the folder is of another layout.
// A new one is a file with such a function, and its line in open_data_set (read_frames.cpp).
#pragma once

#include <nlohmann/json.hpp>

#include "base/error.h"
#include "scene/data/data_set.h"

namespace mirage {

/// Never null: what is no other layout is taken for this one.
std::shared_ptr<const DataSet> open_kitti_object(const std::filesystem::path& data);
/// DATA/training/label_02, and no label_2 beside it.
std::shared_ptr<const DataSet> open_kitti_tracking(const std::filesystem::path& data);
/// calib_velo_to_cam.txt in the folder or in one below.
std::shared_ptr<const DataSet> open_kitti_raw(const std::filesystem::path& data);
/// sample_data.json in the folder or in one DATA/v1.0-*.
std::shared_ptr<const DataSet> open_nuscenes(const std::filesystem::path& data);

/// Labels that somebody else than the set's makers gave to its unlabelled frames: DATA/labels.json names the
/// set ({"data": folder}), DATA/label_2 has a file ID.txt for each such frame, as KITTI's object benchmark.
std::shared_ptr<const DataSet> open_separate_labels(const std::filesystem::path& data);
/// Writes labels.json, and beside it what the set itself says of its rig (dataset.json, rig.toml); `about` is
/// kept in labels.json.
void write_separate_labels(const std::filesystem::path& folder, const std::filesystem::path& data,
                           nlohmann::json about);

/// Whether the folder holds such labels with the same `about`. InputError for those with another one.
bool are_labels_of(const std::filesystem::path& folder, const std::filesystem::path& data,
                   nlohmann::json about);

/// A label of a set that knows boxes in space and none in the picture: projects the box (m, `velo`), and says
/// how much of it the picture's frame cuts off. None if the camera sees nothing of it.
std::optional<Label> projected_label(std::string type, const Box3& box, const Calibration& calibration);
/// Why the box can be no road user's; empty if it can.
std::string box_problem(const Box3& box);
/// The same of a labelled box, whose heading must be radians, too: at most a full turn.
std::string label_problem(const Box3& box);
/// Vehicles of a drive, scene or sequence at most.
inline constexpr std::size_t kMaxVehicles = 100000;
/// The number that stands for the `index`-th vehicle (below kMaxVehicles) of the `group`-th drive, scene or
/// sequence. Drives are counted as they lie in the folder: with another one added theirs may be others.
int track_number(std::size_t group, std::size_t index);
/// A frame's labels out of its sequence's file of the tracking benchmark; `sequence`: the group of its tracks
/// (track_number); `notes` counts on. InputError for a row of that frame that is none, as kitti.h's
/// read_labels.
std::vector<Label> read_tracking_labels(const std::filesystem::path& file, int frame, std::size_t sequence,
                                        const Calibration& calibration, LabelNotes& notes);
/// A frame's labels out of its drive's tracklets (tracklet_labels.xml), those that the camera sees; `drive`:
/// the group of its tracks. InputError for a file that is no XML, and a tracklet that misses a field or is no
/// box.
std::vector<Label> read_tracklets(const std::filesystem::path& file, int frame, std::size_t drive,
                                  const Calibration& calibration);
/// A sweep of `columns` floats a point, of which the first four are x, y, z and reflectance; kitti.h's
/// read_sweep says what is refused.
Sweep read_points(const std::filesystem::path& file, std::size_t columns);
/// For a folder that is none of a data set's: whether there is none, or it is a part of one ("give its
/// parent"), and what it holds.
InputError no_layout(const std::filesystem::path& data);
/// DATA/training of KITTI's benchmarks, or DATA/testing, which has no labels, where that alone is there.
std::filesystem::path benchmark_part(const std::filesystem::path& data);
/// What lies in the folder, in no order; nothing where it cannot be read.
std::vector<std::filesystem::path> entries_of(const std::filesystem::path& folder);
/// FOLDER/NAME.png, or the JPEG (.jpg, .jpeg) or otherwise spelt picture of that name where there is no such
/// file.
std::filesystem::path picture_in(const std::filesystem::path& folder, const std::string& name);
/// Adds an id PREFIX_NAME for every NAME.bin of the folder. InputError for one that is no number or too long.
void add_numbered_sweeps(const std::filesystem::path& folder, const std::string& prefix,
                         std::vector<std::string>& ids);
/// The part of the name behind the last underscore, as a number, and what stands before it; none for another
/// name. "0003_000012": {"0003", 12}.
std::optional<std::pair<std::string, int>> split_id(const std::string& id);

/// Where the car is, as the first six numbers of a row of KITTI's OXTS RT 3003 say it (Geiger et al., IJRR
/// 2013).
struct OxtsRow {
  double latitude = 0, longitude = 0;   ///< degrees
  double altitude = 0;                  ///< m
  double roll = 0, pitch = 0, yaw = 0;  ///< rad; roll left side up, yaw counter-clockwise from east
};
/// Where the unit stands: the world's origin is the unit's place at `first`, x points east, y north, z up
/// (m). Places are laid flat by Mercator's projection at the latitude of `first`, as the development kit
/// does.
Transform world_from_imu(const OxtsRow& row, const OxtsRow& first);

}  // namespace mirage
