#include "frames/frame_cache.h"

#include <algorithm>
#include <span>

#include "base/error.h"
#include "base/files.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "scene/shape/shape_fit.h"

namespace mirage {
namespace {

/// Cached values as bytes, one after another, in native byte order. One serialize() for each type both writes
/// and reads. Reading throws std::out_of_range if the bytes don't hold such values.
class Archive {
 public:
  /// Writes values.
  Archive() = default;
  /// Reads values back.
  explicit Archive(std::string bytes) : bytes_(std::move(bytes)), reads_(true) {}

  template <class T>
  void operator()(T& value) {
    serialize(*this, value);
  }
  template <Number T>
  void operator()(T& value) {
    all(std::span(&value, 1));
  }
  void operator()(bool& value) {
    auto byte = static_cast<std::uint8_t>(value);
    (*this)(byte);
    value = byte != 0;
  }
  /// Reading into a list that isn't empty demands its count.
  template <class T>
  void operator()(std::vector<T>& list) {
    resize(list);
    for (T& entry : list) (*this)(entry);
  }
  void operator()(std::string& text) {
    resize(text);
    all(std::span(text));
  }
  template <class T>
  void operator()(std::optional<T>& value) {
    bool there = value.has_value();
    (*this)(there);
    if (!there) return;
    if (!value) value.emplace();
    (*this)(*value);
  }
  template <Number T>
  void all(std::span<T> values) {
    if (!reads_) {
      bytes_.append(reinterpret_cast<const char*>(values.data()), values.size_bytes());
      return;
    }
    if (values.size_bytes() > left()) throw std::out_of_range("too short");
    std::copy_n(bytes_.data() + at_, values.size_bytes(), reinterpret_cast<char*>(values.data()));
    at_ += values.size_bytes();
  }

  std::size_t left() const { return bytes_.size() - at_; }
  const std::string& bytes() const { return bytes_; }

 private:
  template <class List>
  void resize(List& list) {
    std::uint64_t count = list.size();
    (*this)(count);
    if (count > left() && reads_) throw std::out_of_range("count");
    if (!list.empty() && count != list.size()) throw std::out_of_range("another count");
    list.resize(count);
  }
  std::string bytes_;
  std::size_t at_ = 0;
  bool reads_ = false;
};

void serialize(Archive& archive, Vec3d& v) {
  archive.all(std::span(v.data(), 3));
}

void serialize(Archive& archive, Face& face) {
  archive.all(std::span<int>(face));
}

void serialize(Archive& archive, Mesh& mesh) {
  archive(mesh.vertices);
  archive(mesh.faces);
  for (const Face& face : mesh.faces)
    for (const int i : face)
      if (i < 0 || as_size(i) >= mesh.vertices.size()) throw std::out_of_range("face");
}

/// All but its label, which is the frame's.
void serialize(Archive& archive, Carrier& carrier) {
  archive.all(std::span(carrier.velo_from_roof.matrix().data(), 16));
  archive(carrier.from_box);
  archive(carrier.reason);
  auto shape = carrier.shape ? std::optional(*carrier.shape) : std::nullopt;
  archive(shape);
  if (shape) carrier.shape = std::make_shared<const Mesh>(*std::move(shape));
}

/// One channel, of the size that it has.
void serialize(Archive& archive, ImageF& depth) {
  int width = depth.width, height = depth.height;
  archive(width), archive(height);
  if (width != depth.width || height != depth.height) throw std::out_of_range("size");
  archive.all(std::span(depth.data));
}

void serialize(Archive& archive, PictureBox& box) {
  for (double* value : {&box.left, &box.top, &box.right, &box.bottom}) archive(*value);
}

void serialize(Archive& archive, Detection& d) {
  auto& [x, y, length, width, yaw] = d.box.bev;
  for (double* value : {&x, &y, &length, &width, &yaw, &d.box.bottom, &d.box.height, &d.logit})
    archive(*value);
  archive(d.picture);
  for (int* value : {&d.type, &d.camera, &d.identity}) archive(*value);
  archive(d.velocity);
}

void serialize(Archive& archive, HostView& view) {
  archive(view.label), archive(view.share), archive(view.from_box);
}

void serialize(Archive& archive, FrameAnswers& answers) {
  archive(answers.found), archive(answers.numbers);
}

void serialize(Archive& archive, AttackedDetections& found) {
  archive(found.detections), archive(found.object);
}

/// The cached result, or the computed one, which is then cached. `start`: the object to read into.
template <class T>
T kept(DiskCache* disk, const char* kind, const Provenance& provenance, const std::function<T()>& compute,
       T start = {}) {
  if (!disk || !disk->on()) return compute();
  const std::string whole = provenance.provenance().dump();
  if (auto bytes = disk->read(kind, whole)) try {
      Archive archive(*std::move(bytes));
      archive(start);
      if (archive.left() > 0) throw std::out_of_range("more bytes than values");
      return start;
    } catch (const std::out_of_range&) {
      disk->report_damaged(kind, whole);
    }
  T result = compute();
  Archive archive;
  archive(result);
  disk->write(kind, whole, archive.bytes());
  return result;
}

/// Provenance of one frame, named by its hash.
Provenance of_frame(const std::string& frame) {
  Provenance provenance;
  provenance.input("frame", frame);
  return provenance;
}

}  // namespace

FrameCache::FrameCache() = default;

FrameCache::FrameCache(std::unique_ptr<DiskCache> disk, const std::string& depth, const std::string& rooftop,
                       const LidarModel& lidar)
    : disk_(std::move(disk)), depth_(depth), rooftop_(rooftop), lidar_(lidar_identity(lidar)) {}

Provenance FrameCache::with_roofs(const std::string& frame) const {
  Provenance provenance = of_frame(frame);
  provenance.input("lidar", lidar_);
  provenance.input("rooftop", rooftop_);
  return provenance;
}

Provenance FrameCache::prepared(const std::string& frame) const {
  Provenance provenance = with_roofs(frame);
  provenance.input("depth", depth_);
  return provenance;
}

ImageF FrameCache::depth(const std::string& frame, int width, int height,
                         const std::function<ImageF()>& compute) {
  Provenance provenance = of_frame(frame);
  provenance.input("depth", depth_);
  return kept(disk_.get(), "depth", provenance, compute, ImageF(width, height, 1));
}

std::vector<Carrier> FrameCache::carriers(const std::string& frame, const std::vector<Label>& labels,
                                          const std::function<std::vector<Carrier>()>& compute) {
  std::vector<Carrier> start;
  start.reserve(labels.size());
  for (const Label& label : labels) start.push_back({.label = label});
  return kept(disk_.get(), "rooftops", with_roofs(frame), compute, std::move(start));
}

std::vector<HostView> FrameCache::views(const std::string& frame, const PlaceChoice& place,
                                        const std::array<double, 4>& region,
                                        const SimulationSettings& simulation,
                                        const std::function<std::vector<HostView>()>& compute) {
  Provenance provenance = prepared(frame);
  provenance.set("placement", content_of(place));
  provenance.set("region", region);
  SimulationSettings seen = simulation;  // without what no silhouette depends on
  seen.lidar_effects = {};
  seen.camera_effects = {};
  provenance.add(seen);
  return kept(disk_.get(), "views", provenance, compute);
}

std::vector<Detection> FrameCache::detections(const std::string& frame, const std::string& detector,
                                              double score_threshold,
                                              const std::function<std::vector<Detection>()>& compute) {
  Provenance provenance = of_frame(frame);
  provenance.input("detector", detector);
  provenance.set("score_threshold", score_threshold);
  return kept(disk_.get(), "found", provenance, compute);
}

FrameAnswers FrameCache::answers(const char* kind, const Provenance& provenance,
                                 const std::function<FrameAnswers()>& compute) {
  return kept(disk_.get(), kind, provenance, compute);
}

AttackedDetections FrameCache::attacked(const Provenance& provenance,
                                        const std::function<AttackedDetections()>& compute) {
  return kept(disk_.get(), "attacked", provenance, compute);
}

void require_shared(const FrameCache& cache, const std::string& command, const std::string& detector) {
  if (rank_count() == 1) return;
  if (!cache.on())
    throw InputError(command, "mpirun",
                     "processes share their work through the disk cache, which is off here",
                     "set MIRAGE_CACHE to a folder that all of them see, or start it without mpirun");
  if (detector.empty())
    throw InputError(command, "mpirun",
                     "processes share their work through the disk cache, which cannot keep what this "
                     "detector says: its weights are fresh, or it tells no version",
                     "start it without mpirun");
}

std::string lidar_identity(const LidarModel& lidar) {
  // A new field does not compile until it is named here.
  const auto& [name, beams, azimuth_step, encoder_step, azimuth_min, azimuth_max, range_min, range_max, rate,
               rotation, divergence, velo_from_lidar, height, recorded_effects] = lidar;
  nlohmann::json all = {azimuth_step,   encoder_step,   azimuth_min, azimuth_max,
                        range_min,      range_max,      rate,        rotation,
                        divergence.x(), divergence.y(), height,      nlohmann::json::array()};
  const auto& mount = velo_from_lidar.matrix();
  all.push_back(std::vector<double>(mount.data(), mount.data() + mount.size()));
  for (const auto& [elevation, up, lateral, azimuth_offset, time] : beams)
    all.push_back({elevation, up, lateral, azimuth_offset, time});
  return content_hash(all.dump());
}

std::string rooftop_identity(const std::string& rooftop) {
  return rooftop == "box" ? rooftop : "shape " + rooftop_model_hash(rooftop);
}

}  // namespace mirage
