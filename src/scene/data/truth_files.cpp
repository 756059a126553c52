#include "scene/data/truth_files.h"

#include <fmt/format.h>

#include "base/error.h"
#include "base/files.h"

namespace mirage {

std::filesystem::path instance_file(const std::filesystem::path& data, const std::string& id) {
  return data / "training/instance_2" / (id + ".png");
}

Image<std::uint16_t> read_instances(const std::filesystem::path& data, const std::string& id, int width,
                                    int height) {
  Image<std::uint16_t> instances = read_index_png(instance_file(data, id));
  if (instances.width != width || instances.height != height)
    throw InputError(instance_file(data, id).string(), "size", "differs from the image's",
                     "write both with the same mirage generate --truth");
  return instances;
}

std::filesystem::path point_label_file(const std::filesystem::path& data, const std::string& id) {
  return data / "training/instance_velodyne" / (id + ".label");
}

void write_point_labels(const std::filesystem::path& file, const std::vector<std::uint32_t>& labels) {
  std::string bytes;
  bytes.reserve(4 * labels.size());
  for (std::uint32_t word : labels)
    for (int shift = 0; shift < 32; shift += 8) bytes.push_back(static_cast<char>(word >> shift & 0xff));
  write_file(file, bytes);
}

std::vector<std::uint32_t> read_point_labels(const std::filesystem::path& file, std::size_t points) {
  const auto check = [&](std::uintmax_t size) {
    if (size != 4 * points)
      throw InputError(
          file.string(), "size", fmt::format("{} bytes for {} points", size, points),
          "4 bytes a point of the sweep are needed; make the set again with mirage generate --truth");
  };
  check(OpenFile(file).size());  // before any of it is in memory
  const std::string bytes = read_file(file);
  check(bytes.size());
  std::vector<std::uint32_t> labels(points);
  for (std::size_t i = 0; i < bytes.size(); ++i)
    labels[i / 4] |= static_cast<std::uint32_t>(static_cast<unsigned char>(bytes[i])) << 8 * (i % 4);
  return labels;
}

}  // namespace mirage
