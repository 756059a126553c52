#include "attack/hosts.h"

#include <algorithm>
#include <cmath>

#include "attack/adversary.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "base/random.h"
#include "detection/points_in_view.h"
#include "scene/kitti.h"

namespace mirage {

const PreparedFrame& FrameStore::get(const std::string& id) {
  const std::lock_guard lock(mutex_);
  auto& slot = frames_[id];
  if (!slot) {
    Frame frame = read_frame(data_, id);
    frame.sweep = points_in_view(frame.sweep, frame.calibration);
    isolated([&] { slot = std::make_unique<PreparedFrame>(prepare(std::move(frame), lidar_, depth_.get())); });
  }
  return *slot;
}

LidarModel lidar_of(const std::filesystem::path& data) {
  if (const auto own = data / "rig.toml"; std::filesystem::exists(own)) return read_lidar_model(own);
  std::string rig = "kitti64";
  if (const auto file = data / "dataset.json"; std::filesystem::exists(file)) {
    const nlohmann::json about = read_json(file);
    if (!about.is_object() || !about.contains("rig") || !about.at("rig").is_string())
      throw InputError(file.string(), "rig", "missing or not a text",
                       "name the rig, for example \"kitti64\"");
    rig = about.at("rig");
  }
  return read_lidar_model(shipped_file("scenes/rigs/" + rig + ".toml"));
}

std::vector<BevBox> ground_truth_boxes(const Frame& frame) {
  std::vector<BevBox> boxes;
  for (const Label& label : frame.labels)
    if (label.type != "DontCare") boxes.push_back(label.box.bev);
  return boxes;
}

std::vector<Host> find_hosts(const PreparedFrame& prepared, const RooftopFinder& finder,
                             const std::array<double, 4>& region, const SimulationSettings& simulation,
                             double min_view) {
  const TexturedMesh reference = initial_adversary({}, 1.0);
  std::vector<Host> hosts;
  const auto& labels = prepared.frame.labels;
  for (std::size_t i = 0; i < labels.size(); ++i) {
    const Label& label = labels[i];
    const BevBox& box = label.box.bev;
    if (label.type != "Car" || box.x < region[0] || box.x > region[1] || box.y < region[2] ||
        box.y > region[3])
      continue;
    const Host host{{prepared.frame.id, static_cast<int>(i)}, finder.find(prepared.frame, label)};
    if (simulate(prepared, label, host.rooftop, reference, simulation).visible_share >= min_view)
      hosts.push_back(host);
  }
  return hosts;
}

std::vector<Host> find_all_hosts(FrameStore& store, const std::vector<std::string>& frames,
                                 const std::array<double, 4>& region, const SimulationSettings& simulation,
                                 double min_view) {
  const BoxRooftopFinder finder;
  std::vector<Host> hosts;
  for (const std::string& id : frames) {
    throw_if_interrupted("nothing was lost: no vehicle had been attacked yet");
    const auto found = find_hosts(store.get(id), finder, region, simulation, min_view);
    hosts.insert(hosts.end(), found.begin(), found.end());
  }
  return hosts;
}

void split_frames(std::vector<std::string> frames, std::uint64_t seed, std::vector<std::string>& train,
                  std::vector<std::string>& test) {
  std::sort(frames.begin(), frames.end());
  RandomStream random(seed, "train test split");
  for (std::size_t i = frames.size(); i > 1; --i)
    std::swap(frames[i - 1], frames[static_cast<std::size_t>(random.below(static_cast<int>(i)))]);
  std::size_t n = static_cast<std::size_t>(std::lround(0.7 * static_cast<double>(frames.size())));
  if (frames.size() >= 2) n = std::clamp<std::size_t>(n, 1, frames.size() - 1);
  train.assign(frames.begin(), frames.begin() + static_cast<std::ptrdiff_t>(n));
  test.assign(frames.begin() + static_cast<std::ptrdiff_t>(n), frames.end());
  std::sort(train.begin(), train.end());
  std::sort(test.begin(), test.end());
}

}  // namespace mirage
