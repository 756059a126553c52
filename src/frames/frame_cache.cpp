#include "frames/frame_cache.h"

#include <fmt/format.h>

#include <cstring>
#include <span>
#include <type_traits>

#include "base/files.h"
#include "detection/given_detector.h"
#include "detection/precision.h"
#include "scene/shape/shape_rooftop.h"

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
T kept(DiskCache* disk, const char* kind, const std::string& key, const std::function<T()>& compute,
       const std::function<T(Reader&)>& decode, const std::function<void(Writer&, const T&)>& encode) {
  if (!disk || !disk->on()) return compute();
  const std::string whole = program_identity() + "\n" + key;
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
      if (i < 0 || static_cast<std::size_t>(i) >= mesh.vertices.size()) throw std::out_of_range("face");
  }
  return mesh;
}

void encode_rooftop(Writer& writer, const Rooftop& rooftop) {
  writer.put_all(std::span<const double>(rooftop.velo_from_adversary.matrix().data(), 16));
  writer.put<std::uint8_t>(rooftop.from_box);
  writer.put_text(rooftop.reason);
  writer.put<std::uint8_t>(rooftop.vehicle != nullptr);
  if (rooftop.vehicle) encode_mesh(writer, *rooftop.vehicle);
}

Rooftop decode_rooftop(Reader& reader) {
  Rooftop rooftop;
  reader.get_all(std::span<double>(rooftop.velo_from_adversary.matrix().data(), 16));
  rooftop.from_box = reader.get<std::uint8_t>() != 0;
  rooftop.reason = reader.get_text();
  if (reader.get<std::uint8_t>() != 0) rooftop.vehicle = std::make_shared<const Mesh>(decode_mesh(reader));
  return rooftop;
}

/// Every number of the model that says where rays go.
std::string lidar_identity(const LidarModel& lidar) {
  Writer writer;
  static_assert(sizeof(LidarBeam) == 5 * sizeof(double));  // a new field belongs below
  for (const LidarBeam& b : lidar.beams)
    for (const double value : {b.elevation, b.height, b.lateral, b.azimuth_offset, b.time}) writer.put(value);
  for (const double value :
       {lidar.azimuth_step, lidar.encoder_step, lidar.azimuth_min, lidar.azimuth_max, lidar.range_min,
        lidar.range_max, lidar.rate, lidar.divergence.x(), lidar.divergence.y(), lidar.height})
    writer.put(value);
  writer.put(lidar.rotation);
  writer.put_all(std::span<const double>(lidar.velo_from_lidar.matrix().data(), 16));
  return content_hash(writer.take());
}

/// What of the settings a silhouette and its occlusion depend on.
std::string camera_identity(const SimulationSettings& settings) {
  const auto& r = settings.raster;
  return fmt::format("{:a} {:a} {:a} {:a} {} {} {} {} {} {} {} {} {} {:a}{}", r.sigma, r.gamma, r.epsilon,
                     r.dist_eps, static_cast<int>(r.coverage), static_cast<int>(r.color),
                     static_cast<int>(r.silhouette), static_cast<int>(r.background),
                     static_cast<int>(r.sides), r.perspective_texture, settings.supersampling,
                     settings.reference, to_word(settings.light), settings.occlusion_margin,
                     settings.exact_coverage ? " exact" : "");
}

std::string file_identity(const std::filesystem::path& file) {
  return file_hash(file);
}

}  // namespace

FrameCache::FrameCache() = default;

FrameCache::FrameCache(std::unique_ptr<DiskCache> disk, const std::string& depth, const std::string& rooftop,
                       const LidarModel& lidar)
    : disk_(std::move(disk)), depth_(depth), rooftop_(rooftop), lidar_(lidar_identity(lidar)) {}

ImageF FrameCache::depth(const std::string& frame, int width, int height,
                         const std::function<ImageF()>& compute) {
  return kept<ImageF>(
      disk_.get(), "depth", "depth\n" + frame + "\n" + depth_, compute,
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

std::vector<Rooftop> FrameCache::rooftops(const std::string& frame,
                                          const std::function<std::vector<Rooftop>()>& compute) {
  return kept<std::vector<Rooftop>>(
      disk_.get(), "rooftops", "rooftops\n" + frame + "\n" + lidar_ + "\n" + rooftop_, compute,
      [](Reader& reader) {
        std::vector<Rooftop> rooftops(reader.get_count(16 * sizeof(double)));
        for (Rooftop& rooftop : rooftops) rooftop = decode_rooftop(reader);
        return rooftops;
      },
      [](Writer& writer, const std::vector<Rooftop>& rooftops) {
        writer.put<std::uint64_t>(rooftops.size());
        for (const Rooftop& rooftop : rooftops) encode_rooftop(writer, rooftop);
      });
}

std::vector<HostView> FrameCache::views(const std::string& frame, const std::array<double, 4>& region,
                                        const SimulationSettings& simulation,
                                        const std::function<std::vector<HostView>()>& compute) {
  const std::string key =
      fmt::format("views\n{}\n{}\n{}\n{}\n{:a} {:a} {:a} {:a}\n{}", frame, lidar_, depth_, rooftop_,
                  region[0], region[1], region[2], region[3], camera_identity(simulation));
  return kept<std::vector<HostView>>(
      disk_.get(), "views", key, compute,
      [](Reader& reader) {
        std::vector<HostView> views(reader.get_count(sizeof(std::int32_t) + sizeof(double)));
        for (HostView& view : views) {
          view.label = reader.get<std::int32_t>();
          view.share = reader.get<double>();
        }
        return views;
      },
      [](Writer& writer, const std::vector<HostView>& views) {
        writer.put<std::uint64_t>(views.size());
        for (const HostView& view : views) {
          writer.put<std::int32_t>(view.label);
          writer.put(view.share);
        }
      });
}

std::vector<Proposal> FrameCache::detections(const std::string& frame, const std::string& detector,
                                             double score_threshold,
                                             const std::function<std::vector<Proposal>()>& compute) {
  return kept<std::vector<Proposal>>(
      disk_.get(), "detections", fmt::format("detections\n{}\n{}\n{:a}", frame, detector, score_threshold),
      compute,
      [](Reader& reader) {
        std::vector<Proposal> proposals(reader.get_count(10 * sizeof(double)));
        for (Proposal& p : proposals)
          for (double* value : {&p.box.x, &p.box.y, &p.box.length, &p.box.width, &p.box.yaw, &p.logit,
                                &p.picture.left, &p.picture.top, &p.picture.right, &p.picture.bottom})
            *value = reader.get<double>();
        return proposals;
      },
      [](Writer& writer, const std::vector<Proposal>& proposals) {
        writer.put<std::uint64_t>(proposals.size());
        for (const Proposal& p : proposals)
          for (const double value : {p.box.x, p.box.y, p.box.length, p.box.width, p.box.yaw, p.logit,
                                     p.picture.left, p.picture.top, p.picture.right, p.picture.bottom})
            writer.put(value);
      });
}

std::string rooftop_identity(const std::string& rooftop) {
  return rooftop == "box" ? rooftop : "shape " + rooftop_model_hash(rooftop);
}

std::string detector_identity(const DetectorOptions& options) {
  if (options.fresh || is_given(options)) return "";
  std::string parts;
  for (const std::string& part : options.parts) parts += part + ",";
  std::string others;
  for (const DetectorOptions& other : witnesses(options)) others += " with " + detector_identity(other);
  return fmt::format("{} {} {} {} {} {} {} {}{}", options.detector, file_identity(plugin_file(options)),
                     file_identity(weights_file(options)), options.defense, parts,
                     usable_precision(options.precision), options.locality, options.start, others);
}

}  // namespace mirage
