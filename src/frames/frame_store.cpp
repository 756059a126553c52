#include "frames/frame_store.h"

#include <fmt/format.h>

#include <algorithm>

#include "base/files.h"
#include "base/parallel.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "frames/data_check.h"
#include "geometry/mesh.h"
#include "scene/data/data_rig.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "scene/shape/shape_fit.h"
#include "simulation/insertion.h"

namespace mirage {

std::vector<HostView> host_views(const PreparedFrame& prepared, const std::vector<Carrier>& carriers,
                                 const PlaceChoice& place, const std::array<double, 4>& region,
                                 const SimulationSettings& simulation) {
  const TexturedMesh reference = grey_ellipsoid(place.volume / 2);
  const auto& labels = prepared.frame.labels;
  std::vector<HostView> views;
  for (std::size_t i = 0; i < labels.size(); ++i) {
    const BevBox& box = labels[i].box.bev;
    if (!is_sought(labels[i]) || !has_box(labels[i]) || box.x < region[0] || box.x > region[1] ||
        box.y < region[2] || box.y > region[3])
      continue;
    const Placement placement = placement_of(place, carriers[i], labels);
    HostView& view = views.emplace_back(HostView{static_cast<int>(i), 0, carriers[i].from_box});
    view.share = placement.left_out == LeftOut::no
                     ? simulate(prepared, placement, reference, simulation).best_share()
                     : -static_cast<double>(placement.left_out);
  }
  return views;
}

namespace {

/// Upper estimate of a frame's memory: the index keeps some 48 bytes a return and a cell a ray.
std::size_t bytes_of(const PreparedFrame& prepared, const std::vector<Carrier>& carriers) {
  std::size_t bytes = sizeof(float) * (prepared.frame.image.data.size() + prepared.depth.data.size()) +
                      (sizeof(LidarPoint) + 48) * prepared.frame.sweep.size() +
                      sizeof(int) * prepared.lidar.beams.size() * as_size(prepared.index.firing_count());
  for (const SideCamera& camera : prepared.frame.others)  // picture and depth, once requested
    bytes += 4 * sizeof(float) * as_size(camera.calibration.camera.width) *
             as_size(camera.calibration.camera.height);
  for (const Measurement& measured : prepared.frame.measurements)
    bytes += sizeof(float) * measured.data.size();
  for (const Carrier& carrier : carriers)
    if (carrier.shape)
      bytes += sizeof(Vec3d) * carrier.shape->vertices.size() + sizeof(Face) * carrier.shape->faces.size();
  return bytes;
}

}  // namespace

std::string FrameContents::of(const std::string& id) const {
  {
    const std::lock_guard lock(mutex_);
    if (const auto existing = known_.find(id); existing != known_.end()) return existing->second;
  }
  const auto set = open_data_set(data_, cameras_);
  std::string hash = set->hash(id);
  if (const auto light = set->lighting(id)) hash = content_hash(hash + to_json(*light).dump());
  if (!sensors_.empty()) {
    hash += sensors_;
    for (const Label& label : set->read(id).labels)  // labels that plugins read depend on other frames
      for (const double v : label.velocity.value_or(Vec3d::Zero())) hash += fmt::format(" {:.9g}", v);
    hash = content_hash(hash);
  }
  const std::lock_guard lock(mutex_);
  return known_.emplace(id, hash).first->second;
}

FrameStore::FrameStore(std::filesystem::path data, const LidarModel& lidar,
                       std::shared_ptr<const DepthCompletion> depth, std::shared_ptr<const RoofFinder> finder)
    : data_(std::move(data)),
      lidar_(lidar),
      depth_(std::move(depth)),
      finder_(std::move(finder)),
      contents_(std::make_unique<FrameContents>(data_)) {
  if (!depth_) depth_ = std::make_shared<IpBasic>();
  if (!finder_) finder_ = std::make_shared<BoxRoofFinder>();
}

FrameStore::FrameStore(const FrameSource& source)
    : FrameStore(source.data, lidar_of(source.data, source.rig), load_depth_completion({source.depth})) {
  check_data(source.data, source.rig, UnitUse::casts_rays);
  finder_ = make_roof_finder(source.rooftop, lidar_);
  sun_ = parse_sun(source.sun);
  place_ = source.placement;
  cameras_ = source.cameras;
  classes_ = source.classes;
  sensors_ = load_sensors(source.sensors);
  contents_ = std::make_unique<FrameContents>(source.data, source.cameras, sensors_identity(source.sensors));
  cache_ = FrameCache(DiskCache::from_environment(), depth_identity({source.depth}),
                      rooftop_identity(source.rooftop), lidar_);
}

std::shared_ptr<const FrameStore::Entry> FrameStore::read(const std::string& id) const {
  Frame frame = read_frame(data_, id, cameras_);
  const std::string hash = cache_.on() ? content(id) : "";
  frame.lighting = with_sun(frame, sun_);
  if (classes_ != kCars) mark_sought(classes_of(classes_), frame.labels);
  auto entry = std::make_shared<Entry>();
  entry->carriers = cache_.carriers(hash, frame.labels, [&] {
    std::vector<Carrier> carriers(frame.labels.size());
    parallel_for(frame.labels.size(), [&](std::size_t i) {
      if (has_box(frame.labels[i])) carriers[i] = finder_->find(frame, frame.labels[i]);
    });
    return carriers;
  });
  auto measured_by = record(sensors_, data_, frame);
  if (frame.others.empty()) frame.sweep = points_in_view(frame.sweep, frame.calibration);
  const auto cached = [this](const std::string& key, const PinholeCamera& camera, const auto& compute) {
    return cache_.depth(key, camera.width, camera.height, compute);
  };
  const Calibration& first = frame.calibration;
  ImageF depth = cached(hash, first.camera,
                        [&] { return depth_->complete(frame.image, sparse_depth(frame.sweep, first)); });
  entry->prepared = prepare(std::move(frame), lidar_, depth_.get(), std::move(depth));
  for (std::size_t k = 0; k < entry->prepared.other_depths.size(); ++k) {
    const SideCamera& camera = entry->prepared.frame.others[k];
    Lazy<ImageF>& later = entry->prepared.other_depths[k];
    later = Lazy<ImageF>([cached, key = hash + " " + camera.name, of = camera.calibration.camera, later] {
      return cached(key, of, [&] { return later.get(); });
    });
  }
  entry->prepared.measured_by = std::move(measured_by);
  entry->bytes = bytes_of(entry->prepared, entry->carriers);
  return entry;
}

std::shared_ptr<const FrameStore::Entry> FrameStore::at(const std::string& id) {
  std::shared_ptr<Slot> slot;
  {
    const std::lock_guard lock(mutex_);
    auto& existing = slots_[id];
    if (!existing) existing = std::make_shared<Slot>();
    slot = existing;
    if (auto entry = in_memory(id, *slot)) return entry;
  }
  const std::lock_guard reading(slot->reading);
  {
    const std::lock_guard lock(mutex_);
    if (auto entry = in_memory(id, *slot)) return entry;
  }
  std::shared_ptr<const Entry> entry;
  isolated([&] { entry = read(id); });
  const std::lock_guard lock(mutex_);
  ++reads_;
  hold(id, *slot, entry);
  return entry;
}

std::shared_ptr<const FrameStore::Entry> FrameStore::in_memory(const std::string& id, Slot& slot) {
  if (slot.place) {
    recent_.splice(recent_.begin(), recent_, *slot.place);
    return recent_.front().second;
  }
  auto entry = slot.entry.lock();  // still in use
  if (entry) hold(id, slot, entry);
  return entry;
}

void FrameStore::hold(const std::string& id, Slot& slot, std::shared_ptr<const Entry> entry) {
  bytes_ += entry->bytes;
  slot.entry = entry;
  recent_.emplace_front(id, std::move(entry));
  slot.place = recent_.begin();
  drop_oldest();
}

void FrameStore::drop_oldest() {
  while (bytes_ > limit_ && !recent_.empty()) {
    const auto& [id, entry] = recent_.back();
    bytes_ -= entry->bytes;
    slots_.at(id)->place.reset();
    recent_.pop_back();
  }
}

void FrameStore::set_memory_limit(std::size_t bytes) {
  const std::lock_guard lock(mutex_);
  limit_ = bytes;
  drop_oldest();
}

std::size_t FrameStore::memory() const {
  const std::lock_guard lock(mutex_);
  return bytes_;
}

std::size_t FrameStore::reads() const {
  const std::lock_guard lock(mutex_);
  return reads_;
}

std::shared_ptr<const PreparedFrame> FrameStore::get(const std::string& id) {
  auto entry = at(id);
  const PreparedFrame* prepared = &entry->prepared;
  return {std::move(entry), prepared};
}

Placement FrameStore::placement(const HostId& host) {
  const auto entry = at(host.frame);
  label_of(entry->prepared.frame, host);
  return placement_of(place_, entry->carriers[as_size(host.label)], entry->prepared.frame.labels);
}

Provenance FrameStore::provenance(const HostId& host) const {
  Provenance provenance = cache_.prepared(content(host.frame));
  provenance.set("sun", sun_.word);
  provenance.set("placement", content_of(place_));
  provenance.set("host", host_name(host));  // sampled effects have their streams by it
  return provenance;
}

std::vector<HostView> FrameStore::views(const std::string& id, const std::array<double, 4>& region,
                                        const SimulationSettings& simulation) {
  const auto search = [&] {
    const auto entry = at(id);
    return host_views(entry->prepared, entry->carriers, place_, region, simulation);
  };
  const std::string sought = classes_ == kCars ? "" : " " + classes_;
  return cache_.views(cache_.on() ? content(id) + sought : "", place_, region, simulation, search);
}

void FrameStore::prefetch(std::vector<std::string> ids) {
  {
    const std::lock_guard lock(ahead_mutex_);
    prefetch_ids_ = std::move(ids);
    std::reverse(prefetch_ids_.begin(), prefetch_ids_.end());  // taken from the back
    ahead_.clear();
    if (!ahead_thread_.joinable())
      ahead_thread_ = std::jthread([this](const std::stop_token& stop) { read_ahead(stop); });
  }
  ahead_changed_.notify_one();
}

void FrameStore::read_ahead(const std::stop_token& stop) {
  std::unique_lock lock(ahead_mutex_);
  while (ahead_changed_.wait(lock, stop, [&] { return !prefetch_ids_.empty(); }) && !stop.stop_requested()) {
    const std::string id = std::move(prefetch_ids_.back());
    prefetch_ids_.pop_back();
    lock.unlock();
    std::shared_ptr<const Entry> entry;
    try {
      entry = at(id);
    } catch (const std::exception&) {
      // get() meets the same error and reports it.
    }
    lock.lock();
    if (entry) ahead_.push_back(std::move(entry));
  }
}

RecordedFrames recorded_frames(const FrameSource& source) {
  RecordedFrames frames(source.data, source.classes);
  frames.cameras = source.cameras;
  if (const auto sensors = load_sensors(source.sensors); !sensors.empty())
    frames.add_measurements = [sensors, data = source.data](Frame& frame) { record(sensors, data, frame); };
  return frames;
}

RecordedFrames recorded_frames(const FrameSource& source, const std::string& detector,
                               const std::string& command) {
  RecordedFrames frames = recorded_frames(source);
  const auto cache =
      std::make_shared<FrameCache>(DiskCache::from_environment(), depth_identity({source.depth}),
                                   rooftop_identity(source.rooftop), lidar_of(source.data, source.rig));
  require_shared(*cache, command, detector);
  if (!cache->on() || detector.empty()) return frames;
  const auto contents =
      std::make_shared<const FrameContents>(source.data, source.cameras, sensors_identity(source.sensors));
  frames.cached = [cache, contents, detector](const std::string& id, const auto& compute) {
    return cache->detections(contents->of(id), detector, kScoreThresholdForAp, compute);
  };
  frames.cached_views = [cache, contents, detector, lidar = lidar_identity(lidar_of(source.data, source.rig)),
                         classes = source.classes](const ShownView& view, const auto& compute) {
    Provenance provenance;
    for (std::size_t i = 0; i < view.frames.size(); ++i)
      provenance.input(fmt::format("frame_{}", i), contents->of(view.frames[i]));
    provenance.input("detector", detector);
    provenance.input("lidar", lidar);
    provenance.set("classes", classes);  // the cars that the answers are told of
    provenance.set("change", view.change);
    return cache->answers("audited", provenance, [&] { return FrameAnswers{compute()}; }).found;
  };
  return frames;
}

std::vector<Detection> cached_detections(FrameStore& store, const std::string& frame,
                                         const std::string& detector, double score_threshold,
                                         const std::function<std::vector<Detection>(const Frame&)>& compute) {
  const auto now = [&] { return compute(store.get(frame)->frame); };
  if (detector.empty() || !store.cache().on()) return now();
  return store.cache().detections(store.content(frame), detector, score_threshold, now);
}

}  // namespace mirage
