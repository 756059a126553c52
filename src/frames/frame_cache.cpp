#include "frames/frame_cache.h"

#include <cstring>
#include <span>
#include <type_traits>

#include "base/error.h"
#include "base/files.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "scene/shape/shape_fit.h"

namespace mirage {
namespace {

/// Raw values, one after another; the machine's own byte order.
class Writer {
 public:
  template <class T>
  void put(const T& value) {
    static_assert(std::is_arithmetic_v<T>);
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  template <class T>
  void put_all(std::span<const T> values) {
    static_assert(std::is_arithmetic_v<T>);
    bytes_.append(reinterpret_cast<const char*>(values.data()), values.size_bytes());
  }
  void put_text(const std::string& text) {
    put<std::uint64_t>(text.size());
    bytes_ += text;
  }
  std::string take() { return std::move(bytes_); }

 private:
  std::string bytes_;
};

/// Throws std::out_of_range where the bytes end too early.
class Reader {
 public:
  explicit Reader(std::string_view bytes) : bytes_(bytes) {}
  template <class T>
  T get() {
    T value;
    std::memcpy(&value, take(1, sizeof value), sizeof value);
    return value;
  }
  template <class T>
  void get_all(std::span<T> values) {
    if (!values.empty()) std::memcpy(values.data(), take(values.size(), sizeof(T)), values.size_bytes());
  }
  std::string get_text() {
    const auto size = get<std::uint64_t>();
    return {take(size, 1), size};
  }
  /// A number of things of at least `size` bytes each that still fit.
  std::size_t get_count(std::size_t size) {
    const auto count = get<std::uint64_t>();
    if (count > (bytes_.size() - at_) / size) throw std::out_of_range("count");
    return count;
  }
  void end() const {
    if (at_ != bytes_.size()) throw std::out_of_range("more bytes than values");
  }

 private:
  const char* take(std::size_t count, std::size_t size) {
    if (count > (bytes_.size() - at_) / size) throw std::out_of_range("too short");
    const char* from = bytes_.data() + at_;
    at_ += count * size;
    return from;
  }
  std::string_view bytes_;
  std::size_t at_ = 0;
};

/// The kept result, or else the computed one, which is then kept.
template <class T>
T kept(DiskCache* disk, const char* kind, const Provenance& made_of, const std::function<T()>& compute,
       const std::function<T(Reader&)>& decode, const std::function<void(Writer&, const T&)>& encode) {
  if (!disk || !disk->on()) return compute();
  const std::string whole = made_of.made_of().dump();
  if (const auto bytes = disk->read(kind, whole)) try {
      Reader reader(*bytes);
      T result = decode(reader);
      reader.end();
      return result;
    } catch (const std::out_of_range&) {
      disk->report_damaged(kind, whole);
    }
  T result = compute();
  Writer writer;
  encode(writer, result);
  disk->write(kind, whole, writer.take());
  return result;
}

void encode_mesh(Writer& writer, const Mesh& mesh) {
  writer.put<std::uint64_t>(mesh.vertices.size());
  for (const Vec3d& v : mesh.vertices) writer.put_all(std::span<const double>(v.data(), 3));
  writer.put<std::uint64_t>(mesh.faces.size());
  for (const Face& f : mesh.faces) writer.put_all(std::span<const int>(f));
}

Mesh decode_mesh(Reader& reader) {
  Mesh mesh;
  mesh.vertices.resize(reader.get_count(3 * sizeof(double)));
  for (Vec3d& v : mesh.vertices) reader.get_all(std::span<double>(v.data(), 3));
  mesh.faces.resize(reader.get_count(3 * sizeof(int)));
  for (Face& f : mesh.faces) {
    reader.get_all(std::span<int>(f));
    for (const int i : f)
      if (i < 0 || as_size(i) >= mesh.vertices.size()) throw std::out_of_range("face");
  }
  return mesh;
}

/// All but its label, which is the frame's.
void encode_carrier(Writer& writer, const Carrier& carrier) {
  writer.put_all(std::span<const double>(carrier.velo_from_roof.matrix().data(), 16));
  writer.put<std::uint8_t>(carrier.from_box);
  writer.put_text(carrier.reason);
  writer.put<std::uint8_t>(carrier.shape != nullptr);
  if (carrier.shape) encode_mesh(writer, *carrier.shape);
}

Carrier decode_carrier(Reader& reader, const Label& label) {
  Carrier carrier;
  carrier.label = label;
  reader.get_all(std::span<double>(carrier.velo_from_roof.matrix().data(), 16));
  carrier.from_box = reader.get<std::uint8_t>() != 0;
  carrier.reason = reader.get_text();
  if (reader.get<std::uint8_t>() != 0) carrier.shape = std::make_shared<const Mesh>(decode_mesh(reader));
  return carrier;
}

/// What is kept of a detection.
template <class Use>
void for_each_value(Detection& d, const Use& use) {
  auto& [x, y, length, width, yaw] = d.box.bev;
  for (double* value : {&x, &y, &length, &width, &yaw, &d.box.bottom, &d.box.height, &d.logit,
                        &d.picture.left, &d.picture.top, &d.picture.right, &d.picture.bottom})
    use(*value);
  for (int* value : {&d.type, &d.camera, &d.identity}) use(*value);
  auto moves = static_cast<std::uint8_t>(d.velocity.has_value());
  use(moves);
  if (moves == 0) return;
  if (!d.velocity) d.velocity.emplace();
  for (double& value : *d.velocity) use(value);
}

void encode_all(Writer& writer, const std::vector<Detection>& found) {
  writer.put<std::uint64_t>(found.size());
  for (Detection detection : found) for_each_value(detection, [&](const auto& value) { writer.put(value); });
}

std::vector<Detection> decode_all(Reader& reader) {
  std::vector<Detection> found(reader.get_count(12 * sizeof(double)));
  for (Detection& detection : found)
    for_each_value(detection, [&](auto& value) { value = reader.get<std::decay_t<decltype(value)>>(); });
  return found;
}

/// Of one frame, named by its hash.
Provenance of_frame(const std::string& frame) {
  Provenance made_of;
  made_of.input("frame", frame);
  return made_of;
}

}  // namespace

FrameCache::FrameCache() = default;

FrameCache::FrameCache(std::unique_ptr<DiskCache> disk, const std::string& depth, const std::string& rooftop,
                       const LidarModel& lidar)
    : disk_(std::move(disk)), depth_(depth), rooftop_(rooftop), lidar_(lidar_identity(lidar)) {}

Provenance FrameCache::with_roofs(const std::string& frame) const {
  Provenance made_of = of_frame(frame);
  made_of.input("lidar", lidar_);
  made_of.input("rooftop", rooftop_);
  return made_of;
}

Provenance FrameCache::prepared(const std::string& frame) const {
  Provenance made_of = with_roofs(frame);
  made_of.input("depth", depth_);
  return made_of;
}

ImageF FrameCache::depth(const std::string& frame, int width, int height,
                         const std::function<ImageF()>& compute) {
  Provenance made_of = of_frame(frame);
  made_of.input("depth", depth_);
  return kept<ImageF>(
      disk_.get(), "depth", made_of, compute,
      [&](Reader& reader) {
        if (reader.get<std::int32_t>() != width || reader.get<std::int32_t>() != height)
          throw std::out_of_range("size");
        ImageF depth(width, height, 1);
        reader.get_all(std::span<float>(depth.data));
        return depth;
      },
      [](Writer& writer, const ImageF& depth) {
        writer.put<std::int32_t>(depth.width);
        writer.put<std::int32_t>(depth.height);
        writer.put_all(std::span<const float>(depth.data));
      });
}

std::vector<Carrier> FrameCache::carriers(const std::string& frame, const std::vector<Label>& labels,
                                          const std::function<std::vector<Carrier>()>& compute) {
  return kept<std::vector<Carrier>>(
      disk_.get(), "rooftops", with_roofs(frame), compute,
      [&](Reader& reader) {
        if (reader.get_count(16 * sizeof(double)) != labels.size()) throw std::out_of_range("labels");
        std::vector<Carrier> carriers;
        for (const Label& label : labels) carriers.push_back(decode_carrier(reader, label));
        return carriers;
      },
      [](Writer& writer, const std::vector<Carrier>& carriers) {
        writer.put<std::uint64_t>(carriers.size());
        for (const Carrier& carrier : carriers) encode_carrier(writer, carrier);
      });
}

std::vector<HostView> FrameCache::views(const std::string& frame, const PlaceChoice& place,
                                        const std::array<double, 4>& region,
                                        const SimulationSettings& simulation,
                                        const std::function<std::vector<HostView>()>& compute) {
  Provenance made_of = prepared(frame);
  made_of.set("placement", content_of(place));
  made_of.set("region", region);
  SimulationSettings seen = simulation;  // what no silhouette depends on
  seen.lidar_effects = {};
  seen.camera_effects = {};
  made_of.add(seen);
  return kept<std::vector<HostView>>(
      disk_.get(), "views", made_of, compute,
      [](Reader& reader) {
        std::vector<HostView> views(reader.get_count(sizeof(std::int32_t) + sizeof(double) + 1));
        for (HostView& view : views) {
          view.label = reader.get<std::int32_t>();
          view.share = reader.get<double>();
          view.from_box = reader.get<std::uint8_t>() != 0;
        }
        return views;
      },
      [](Writer& writer, const std::vector<HostView>& views) {
        writer.put<std::uint64_t>(views.size());
        for (const HostView& view : views) {
          writer.put<std::int32_t>(view.label);
          writer.put(view.share);
          writer.put<std::uint8_t>(view.from_box);
        }
      });
}

std::vector<Detection> FrameCache::detections(const std::string& frame, const std::string& detector,
                                              double score_threshold,
                                              const std::function<std::vector<Detection>()>& compute) {
  Provenance made_of = of_frame(frame);
  made_of.input("detector", detector);
  made_of.set("score_threshold", score_threshold);
  return kept<std::vector<Detection>>(disk_.get(), "found", made_of, compute, decode_all, encode_all);
}

FrameAnswers FrameCache::answers(const char* kind, const Provenance& made_of,
                                 const std::function<FrameAnswers()>& compute) {
  return kept<FrameAnswers>(
      disk_.get(), kind, made_of, compute,
      [](Reader& reader) {
        FrameAnswers answers;
        answers.found.resize(reader.get_count(sizeof(std::uint64_t)));
        for (auto& found : answers.found) found = decode_all(reader);
        answers.numbers.resize(reader.get_count(sizeof(double)));
        reader.get_all(std::span<double>(answers.numbers));
        return answers;
      },
      [](Writer& writer, const FrameAnswers& answers) {
        writer.put<std::uint64_t>(answers.found.size());
        for (const auto& found : answers.found) encode_all(writer, found);
        writer.put<std::uint64_t>(answers.numbers.size());
        writer.put_all(std::span<const double>(answers.numbers));
      });
}

FoundAttacked FrameCache::attacked(const Provenance& made_of, const std::function<FoundAttacked()>& compute) {
  return kept<FoundAttacked>(
      disk_.get(), "attacked", made_of, compute,
      [](Reader& reader) {
        FoundAttacked result{decode_all(reader), {}};
        if (reader.get<std::uint8_t>() == 0) return result;
        PictureBox& box = result.object.emplace();
        for (double* value : {&box.left, &box.top, &box.right, &box.bottom}) *value = reader.get<double>();
        return result;
      },
      [](Writer& writer, const FoundAttacked& result) {
        encode_all(writer, result.detections);
        writer.put<std::uint8_t>(result.object.has_value());
        if (const auto& box = result.object)
          for (const double value : {box->left, box->top, box->right, box->bottom}) writer.put(value);
      });
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
