#include "scene/generator/dataset.h"

#include <fmt/format.h>

#include <mutex>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "scene/generator/frame_record.h"
#include "scene/kitti.h"

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
  const std::string bytes = read_file(file);
  if (bytes.size() != 4 * points)
    throw InputError(
        file.string(), "size", fmt::format("{} bytes for {} points", bytes.size(), points),
        "4 bytes a point of the sweep are needed; make the set again with mirage generate --truth");
  std::vector<std::uint32_t> labels(points);
  for (std::size_t i = 0; i < bytes.size(); ++i)
    labels[i / 4] |= static_cast<std::uint32_t>(static_cast<unsigned char>(bytes[i])) << 8 * (i % 4);
  return labels;
}

DatasetSummary generate_dataset(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                                const std::filesystem::path& out,
                                const std::function<void(std::size_t)>& tell, Truth truth) {
  make_output_folder(out);
  const std::filesystem::path file = out / "dataset.json";
  nlohmann::json about = {
      {"rig", rig.name}, {"seed", seed}, {"look", name_of(rig.look)}, {"generator", kGeneratorVersion}};
  if (std::filesystem::exists(file)) {
    const nlohmann::json before = read_json(file);
    for (const auto& [key, value] : about.items())
      if (before.value(key, nlohmann::json()) != value)
        throw InputError(
            file.string(), key,
            fmt::format("is {}, asked for is {}", before.value(key, nlohmann::json()).dump(), value.dump()),
            "choose another --out folder");
  }
  // Other commands need the very LiDAR, not its name; and frames of an edited rig are not this set's.
  const std::filesystem::path kept = out / "rig.toml";
  if (std::filesystem::exists(kept) && read_toml(kept) != parse_toml(rig.text, rig.name))
    throw InputError(kept.string(), "", "is not the rig " + rig.name + " as it is now",
                     "choose another --out folder, or restore the rig file");
  write_json(file, about);
  write_file(kept, rig.text);

  DatasetSummary sum;
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(static_cast<std::size_t>(count), [&](std::size_t i) {
    if (interrupted()) return;
    const std::uint64_t index = first + i;
    const bool keep = is_as_recorded(out, fmt::format("{:06}", index), truth);
    Frame frame;
    if (!keep) {
      FrameTruth known;
      frame = generate_frame(rig, seed, index, truth == Truth::none ? nullptr : &known);
      // Before the frame: its sweep comes last, so that a listed frame has its truth.
      if (truth != Truth::none) write_depth_png(true_depth_file(out, frame.id), known.depth);
      if (truth == Truth::all) {
        write_index_png(instance_file(out, frame.id), known.instance);
        write_point_labels(point_label_file(out, frame.id), known.returns);
      }
      write_frame(out, frame);
      record_frame(out, frame.id, truth);
    }
    const std::scoped_lock lock(mutex);
    ++(keep ? sum.kept : sum.written);
    for (const Label& label : frame.labels) ++(label.type == "Car" ? sum.cars : sum.others);
    sum.points += frame.sweep.size();
    tell(++done);
  });
  throw_if_interrupted("the frames written so far are kept; the same command goes on from there");
  return sum;
}

}  // namespace mirage
