// Frames of a data set of any layout (data_set.h), by its folder.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scene/data/data_set.h"

namespace mirage {

/// The data set in a folder, by what the folder holds. What is none of the layouts is taken for an empty one
/// of KITTI's object benchmark, which frames() then complains of.
std::shared_ptr<const DataSet> open_data_set(const std::filesystem::path& data,
                                             Cameras cameras = Cameras::first);

/// As DataSet::frames().
std::vector<std::string> list_frames(const std::filesystem::path& data);
/// As DataSet::read().
Frame read_frame(const std::filesystem::path& data, const std::string& id, Cameras cameras = Cameras::first);
/// As DataSet::hash().
std::string frame_hash(const std::filesystem::path& data, const std::string& id,
                       Cameras cameras = Cameras::first);
/// As DataSet::tracks(), of the labels that any camera sees.
std::optional<std::vector<int>> read_tracks(const std::filesystem::path& data, const std::string& id);
/// The frame's picture: the second of DataSet::parts().
std::filesystem::path picture_file(const std::filesystem::path& data, const std::string& id);
/// As DataSet::annotations().
Annotations read_annotations(const std::filesystem::path& data, const std::string& id);

}  // namespace mirage
