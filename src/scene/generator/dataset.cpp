#include "scene/generator/dataset.h"

#include <fmt/format.h>

#include <mutex>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "scene/kitti.h"

namespace mirage {
namespace {

bool complete(const std::filesystem::path& out, const std::string& id, bool with_depth) {
  // write_frame's files; each is written atomically, so that one that exists is whole.
  for (const char* file :
       {"image_2/{}.png", "velodyne/{}.bin", "calib/{}.txt", "label_2/{}.txt", "lighting/{}.json"})
    if (!std::filesystem::exists(out / "training" / fmt::format(fmt::runtime(file), id))) return false;
  return !with_depth || std::filesystem::exists(true_depth_file(out, id));
}

}  // namespace

DatasetSummary generate_dataset(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                                const std::filesystem::path& out,
                                const std::function<void(std::size_t)>& tell, bool with_depth) {
  make_output_folder(out);
  const std::filesystem::path file = out / "dataset.json";
  nlohmann::json about = {{"rig", rig.name}, {"seed", seed}, {"generator", kGeneratorVersion}};
  if (std::filesystem::exists(file)) {
    const nlohmann::json before = read_json(file);
    for (const auto& [key, value] : about.items())
      if (before.value(key, nlohmann::json()) != value)
        throw InputError(
            file.string(), key,
            fmt::format("is {}, asked for is {}", before.value(key, nlohmann::json()).dump(), value.dump()),
            "choose another --out folder");
  }
  write_json(file, about);
  write_file(out / "rig.toml", rig.text);  // other commands need the very LiDAR, not its name

  DatasetSummary sum;
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(static_cast<std::size_t>(count), [&](std::size_t i) {
    if (interrupted()) return;
    const std::uint64_t index = first + i;
    const bool keep = complete(out, fmt::format("{:06}", index), with_depth);
    Frame frame;
    if (!keep) {
      ImageF depth;
      frame = generate_frame(rig, seed, index, with_depth ? &depth : nullptr);
      // Before the frame: its sweep comes last, so that a listed frame has its depth.
      if (with_depth) write_depth_png(true_depth_file(out, frame.id), depth);
      write_frame(out, frame);
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
