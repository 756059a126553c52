// Files of a generated frame's truth, beside its labels: whose each pixel and each return is.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "base/image.h"

namespace mirage {

/// What is written of a frame's truth, beside its labels.
enum class Truth {
  none,
  depth,  ///< true_depth_file()
  all     ///< and instance_file(), point_label_file()
};
/// DIR/training/instance_2/ID.png: FrameTruth::instance (write_index_png).
std::filesystem::path instance_file(const std::filesystem::path& data, const std::string& id);
/// InputError if it can't be read or is not of the image's size.
Image<std::uint16_t> read_instances(const std::filesystem::path& data, const std::string& id, int width,
                                    int height);
/// DIR/training/instance_velodyne/ID.label: FrameTruth::returns, little-endian, in the sweep's order
/// (SemanticKITTI's layout).
std::filesystem::path point_label_file(const std::filesystem::path& data, const std::string& id);
/// One word a point of the sweep, little-endian, atomically.
void write_point_labels(const std::filesystem::path& file, const std::vector<std::uint32_t>& labels);
/// InputError if the file can't be read or does not hold `points` words.
std::vector<std::uint32_t> read_point_labels(const std::filesystem::path& file, std::size_t points);

}  // namespace mirage
