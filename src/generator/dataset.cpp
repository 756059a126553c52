#include "generator/dataset.h"

#include <fmt/format.h>

#include <mutex>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "generator/frame_record.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"

namespace mirage {

namespace {

constexpr const char* kDrives = "drives_of_s";  // a field of sets that are drives

}  // namespace

void begin_dataset(const Rig& rig, const nlohmann::json& about, const std::filesystem::path& out) {
  make_output_folder(out);
  const std::filesystem::path file = out / "dataset.json", kept = out / "rig.toml";
  if (std::filesystem::exists(file)) {
    const nlohmann::json before = read_json(file, kLargestRecord);
    if (!before.is_object())
      throw InputError(file.string(), "", "is no object of a data set's fields",
                       "choose another --out folder");
    if (before.contains(kDrives) != about.contains(kDrives))
      throw InputError(file.string(), kDrives,
                       before.contains(kDrives) ? "is there: the folder holds drives"
                                                : "is missing: the folder holds single frames",
                       "choose another --out folder");
    for (const auto& [key, value] : about.items())
      if (before.value(key, nlohmann::json()) != value)
        throw InputError(
            file.string(), key,
            fmt::format("is {}, asked for is {}", before.value(key, nlohmann::json()).dump(), value.dump()),
            "choose another --out folder");
    if (!std::filesystem::exists(kept))
      throw InputError(kept.string(), "", "is missing, and with it which rig drew the frames there",
                       "restore the file or choose another --out folder");
  }
  // Other commands need the very LiDAR, not its name; and frames of an edited rig are not this set's.
  if (std::filesystem::exists(kept) && read_toml(kept) != parse_toml(rig.text, rig.name))
    throw InputError(kept.string(), "", "is not the rig " + rig.name + " as it is now",
                     "choose another --out folder, or restore the rig file");
  // The rig first: a set that was stopped between the two goes on, and one without its rig has lost it.
  write_file(kept, rig.text);
  write_json(file, about);
}

DatasetSummary generate_dataset(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                                const std::filesystem::path& out,
                                const std::function<void(std::size_t)>& tell, Truth truth) {
  begin_dataset(
      rig, {{"rig", rig.name}, {"seed", seed}, {"look", name_of(rig.look)}, {"generator", kGeneratorVersion}},
      out);
  DatasetSummary sum;
  std::mutex mutex;
  std::size_t done = 0;
  const std::vector<std::size_t> order = order_among_ranks(static_cast<std::size_t>(count));
  parallel_for(order.size(), [&](std::size_t k) {
    if (interrupted()) return;
    const std::uint64_t index = first + order[k];
    const bool keep = is_as_recorded(out, fmt::format("{:06}", index), truth);
    Frame frame;
    if (keep) {
      frame = read_frame(out, fmt::format("{:06}", index));
    } else {
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
