#include "attack/hosts.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "attack/adversary.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "base/random.h"
#include "detection/points_in_view.h"
#include "scene/data_rig.h"
#include "scene/kitti.h"
#include "scene/shape/shape_rooftop.h"

namespace mirage {

FrameStore::FrameStore(std::filesystem::path data, const LidarModel& lidar,
                       std::shared_ptr<const DepthCompletion> depth,
                       std::shared_ptr<const RooftopFinder> finder)
    : data_(std::move(data)), lidar_(lidar), depth_(std::move(depth)), finder_(std::move(finder)) {
  if (!finder_) finder_ = std::make_shared<BoxRooftopFinder>();
}

FrameStore::FrameStore(const std::filesystem::path& data, const std::string& depth,
                       const std::string& rooftop, const std::string& sun)
    : FrameStore(data, lidar_of(data), load_depth_completion({depth})) {
  finder_ = make_rooftop_finder(rooftop, lidar_);
  sun_ = parse_sun(sun);
}

const FrameStore::Entry& FrameStore::at(const std::string& id) {
  const std::lock_guard lock(mutex_);
  auto& slot = frames_[id];
  if (!slot) {
    Frame frame = read_frame(data_, id);
    frame.lighting = with_sun(frame, sun_);
    auto entry = std::make_unique<Entry>();
    isolated([&] {
      entry->rooftops.resize(frame.labels.size());
      parallel_for(frame.labels.size(), [&](std::size_t i) {
        if (frame.labels[i].type != "DontCare") entry->rooftops[i] = finder_->find(frame, frame.labels[i]);
      });
      frame.sweep = points_in_view(frame.sweep, frame.calibration);
      entry->prepared = prepare(std::move(frame), lidar_, depth_.get());
    });
    slot = std::move(entry);
  }
  return *slot;
}

const Rooftop& FrameStore::rooftop(const HostId& host) {
  const Entry& entry = at(host.frame);
  label_of(entry.prepared.frame, host);
  return entry.rooftops[static_cast<std::size_t>(host.label)];
}

nlohmann::json to_json(const RooftopCount& count) {
  return {{"fitted", count.fitted}, {"from_box", count.from_box}};
}

std::string host_name(const HostId& id) {
  return fmt::format("{}_{}", id.frame, id.label);
}

const Label& label_of(const Frame& frame, const HostId& id) {
  if (id.label < 0 || static_cast<std::size_t>(id.label) >= frame.labels.size())
    throw InputError("run.json", "host " + host_name(id), "is not in the data set",
                     "give the --data folder that the run was made with");
  return frame.labels[static_cast<std::size_t>(id.label)];
}

LidarModel lidar_of(const std::filesystem::path& data) {
  if (const auto own = data / "rig.toml"; std::filesystem::exists(own)) return read_lidar_model(own);
  return read_lidar_model(shipped_file("scenes/rigs/" + data_rig(data) + ".toml"));
}

std::vector<BevBox> ground_truth_boxes(const Frame& frame) {
  std::vector<BevBox> boxes;
  for (const Label& label : frame.labels)
    if (label.type != "DontCare") boxes.push_back(label.box.bev);
  return boxes;
}

std::vector<Host> find_hosts(FrameStore& store, const std::string& frame, const std::array<double, 4>& region,
                             const SimulationSettings& simulation, double min_view) {
  const PreparedFrame& prepared = store.get(frame);
  const TexturedMesh reference = initial_adversary({}, 1.0);
  std::vector<Host> hosts;
  const auto& labels = prepared.frame.labels;
  for (std::size_t i = 0; i < labels.size(); ++i) {
    const Label& label = labels[i];
    const BevBox& box = label.box.bev;
    if (label.type != "Car" || box.x < region[0] || box.x > region[1] || box.y < region[2] ||
        box.y > region[3])
      continue;
    const HostId id{frame, static_cast<int>(i)};
    const Host host{id, store.rooftop(id)};
    if (simulate(prepared, label, host.rooftop, reference, simulation).visible_share >= min_view)
      hosts.push_back(host);
  }
  return hosts;
}

std::vector<Host> find_all_hosts(FrameStore& store, const std::vector<std::string>& frames,
                                 const std::array<double, 4>& region, const SimulationSettings& simulation,
                                 double min_view) {
  std::vector<Host> hosts;
  for (const std::string& id : frames) {
    throw_if_interrupted("nothing was lost: no vehicle had been attacked yet");
    const auto found = find_hosts(store, id, region, simulation, min_view);
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
