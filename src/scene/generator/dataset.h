// A whole generated data set on disk.
#pragma once

#include <functional>

#include "scene/generator.h"

namespace mirage {

/// Changes whenever the same seed gives other frames.
inline constexpr int kGeneratorVersion = 4;

/// Counts over the frames written in this run.
struct DatasetSummary {
  int written = 0, kept = 0, cars = 0, others = 0;
  std::size_t points = 0;
};

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
void write_point_labels(const std::filesystem::path& file, const std::vector<std::uint32_t>& labels);
/// InputError if the file can't be read or does not hold `points` words.
std::vector<std::uint32_t> read_point_labels(const std::filesystem::path& file, std::size_t points);

/// Writes frames [first, first + count) of (rig, seed) to `out` and dataset.json. Frames whose files are as
/// recorded (frame_record.h) are kept (a set made with less truth can be given more later: the other files
/// come out the same); a folder made with another rig, seed or generator version is refused (InputError).
/// Several frames are made at once. After Ctrl-C the frames in hand are finished and Interrupted is thrown.
DatasetSummary generate_dataset(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                                const std::filesystem::path& out,
                                const std::function<void(std::size_t done)>& tell, Truth truth = Truth::none);

}  // namespace mirage
