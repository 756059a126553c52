#include "scene/data/kitti.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <iterator>
#include <limits>
#include <mutex>
#include <numbers>
#include <optional>
#include <set>
#include <sstream>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/intervals.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/memory.h"
#include "base/names.h"
#include "base/sizes.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/layouts.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little);  // as in the files of sweeps and their truth

const char* kRestore = "restore the file from its source";

fs::path part(const fs::path& data, const char* folder, const std::string& id, const char* extension) {
  return data / "training" / folder / (id + extension);
}

fs::path track_file(const fs::path& data, const std::string& id) {
  return part(data, "track_2", id, ".txt");
}

/// Reads one integer per line.
std::vector<int> read_track_file(const fs::path& file) {
  std::vector<int> tracks;
  std::istringstream lines(read_text(file, kMaxTextBytes));
  int row = 0;
  for (std::string line; std::getline(lines, line);) {
    ++row;
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.pop_back();
    if (line.empty()) continue;
    const auto track = try_parse_number<int>(line);
    if (!track || *track < -1) {
      line.resize(std::min<std::size_t>(line.size(), 40));
      std::replace(line.begin(), line.end(), '\r', ' ');
      throw InputError(file.string(), fmt::format("row {}", row),
                       fmt::format("'{}' is not an identity", line), "write the vehicle's number, or -1");
    }
    tracks.push_back(*track);
  }
  return tracks;
}

// Frames with several cameras add training/cameras/ID.json, with their names, calibrations and the labels
// outside the first camera's view, and training/cameras/NAME/ID.png.

/// Cameras after the first, and the labels that only they see.
struct Surround {
  std::string first;
  std::vector<SideCamera> others;  ///< without their pictures, which are read later
  std::vector<Label> labels;
};

constexpr double kMaxCameraDistance = 100;  // m from the LiDAR
constexpr std::size_t kMaxCameras = 64, kMaxLabels = 10000;

fs::path side_picture(const fs::path& part, const std::string& camera, const std::string& id) {
  return part / "cameras" / camera / (id + ".png");
}

nlohmann::json surround_json(const Frame& frame) {
  auto cameras = nlohmann::json::array(), labels = nlohmann::json::array();
  for (const SideCamera& side : frame.others) {
    const PinholeCamera& c = side.calibration.camera;
    auto pose = nlohmann::json::array();
    for (int i = 0; i < 12; ++i) pose.push_back(side.calibration.camera_from_velo.matrix()(i / 4, i % 4));
    cameras.push_back({{"name", side.name},
                       {"intrinsics", {c.fx, c.fy, c.cx, c.cy}},
                       {"size", {c.width, c.height}},
                       {"camera_from_velo", pose}});
  }
  for (const Label& label : frame.labels) {
    if (label.camera == 0) continue;
    const BevBox& bev = label.box.bev;
    labels.push_back(
        {{"camera", frame.name_of(as_size(label.camera))},
         {"type", label.type},
         {"truncated", label.truncated},
         {"occluded", label.occluded},
         {"track", label.track},
         {"picture", {label.left, label.top, label.right, label.bottom}},
         {"box", {bev.x, bev.y, label.box.bottom, bev.length, bev.width, label.box.height, bev.yaw}}});
  }
  return {{"camera", frame.camera}, {"others", cameras}, {"labels", labels}};
}

/// The inverse of surround_json. `part`: DATA/training. InputError naming file and field.
Surround read_surround(const fs::path& part, const std::string& id) {
  const fs::path file = part / "cameras" / (id + ".json");
  const nlohmann::json json = read_json(file, kMaxLabelBytes);
  const JsonFields from(file, json, kRestore);
  Surround all;
  all.first = from.text("camera");
  std::vector<std::string> names;
  for (const nlohmann::json& entry : from.list("others", kMaxCameras)) {
    const JsonFields camera = from.inner(fmt::format("others[{}]", names.size()), entry);
    const std::string name = names.emplace_back(camera.text("name"));
    if (!frame_id_problem(name).empty()) camera.fail("name", "cannot be a folder's name");
    const auto k = camera.numbers("intrinsics", 4, 0, 1e5), size = camera.numbers("size", 2, 1, 16384),
               pose = camera.numbers("camera_from_velo", 12, -kMaxCameraDistance, kMaxCameraDistance);
    SideCamera side{name, {}, Lazy<ImageF>([] { return ImageF(); })};
    PinholeCamera& c = side.calibration.camera;
    c = {k[0], k[1], k[2], k[3], static_cast<int>(size[0]), static_cast<int>(size[1])};
    if (!(c.fx > 0 && c.fy > 0)) camera.fail("intrinsics", "have no focal length");
    for (int i = 0; i < 12; ++i) side.calibration.camera_from_velo.matrix()(i / 4, i % 4) = pose[as_size(i)];
    const Eigen::Matrix3d r = side.calibration.camera_from_velo.linear();
    if ((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-3 || r.determinant() < 0)
      camera.fail("camera_from_velo", "its 3x3 part is not a rotation");
    const PictureSize expected{c.width, c.height};
    side.image = Lazy<ImageF>(
        [picture = side_picture(part, name, id), expected] { return read_srgb(picture, expected); });
    all.others.push_back(std::move(side));
  }
  for (const nlohmann::json& entry : from.list("labels", kMaxLabels)) {
    const JsonFields row = from.inner(fmt::format("labels[{}]", all.labels.size()), entry);
    Label& label = all.labels.emplace_back();
    const auto named = std::find(names.begin(), names.end(), row.text("camera"));
    if (named == names.end()) row.fail("camera", "is not one of the others");
    label.camera = static_cast<int>(named - names.begin()) + 1;
    label.type = kitti_type(row.text("type"));
    label.truncated = row.number("truncated", 0, 1);
    label.occluded = static_cast<int>(row.integer("occluded", 0, 3));
    label.track = static_cast<int>(row.integer("track", -1, std::numeric_limits<int>::max()));
    const auto picture = row.numbers("picture", 4, -1e6, 1e6), box = row.numbers("box", 7, -1e4, 1e4);
    label.left = picture[0], label.top = picture[1], label.right = picture[2], label.bottom = picture[3];
    label.box = {{box[0], box[1], box[3], box[4], box[6]}, box[2], box[5]};
    if (const std::string problem = label_problem(label.box); !problem.empty()) row.fail("box", problem);
  }
  return all;
}

class KittiObject : public DataSet {
 public:
  explicit KittiObject(const fs::path& data, Cameras cameras = Cameras::first)
      : DataSet(data), part_(benchmark_part(data)), cameras_(cameras) {}

  const char* layout() const override { return "kitti-object"; }

  std::vector<std::string> frames() const override {
    const fs::path folder = part_ / "velodyne";
    if (!fs::is_directory(folder)) throw no_layout(data());
    std::vector<std::string> ids;
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (entry.path().extension() != ".bin") continue;
      ids.push_back(entry.path().stem().string());
      if (const std::string problem = frame_id_problem(ids.back()); !problem.empty())
        throw InputError(entry.path().string(), "name", problem, "give the frame's files a shorter name");
    }
    if (ids.empty())
      throw InputError(folder.string(), "", "holds no .bin file", "give a data set with at least one frame");
    std::sort(ids.begin(), ids.end());
    return ids;
  }

  std::vector<SourceFile> source_files(const std::string& id) const override {
    check_id(id);
    std::vector<SourceFile> files = {{part_ / "velodyne" / (id + ".bin"), "the sweep"},
                                     {picture_in(part_ / "image_2", id), "the image"},
                                     {part_ / "calib" / (id + ".txt"), "the calibration"}};
    if (const fs::path labels = part_ / "label_2" / (id + ".txt"); fs::exists(labels))
      files.push_back({labels, "the labels"});
    if (cameras_ == Cameras::first) return files;
    files.push_back({part_ / "cameras" / (id + ".json"), "the other cameras"});
    if (fs::exists(files.back().file))
      for (const SideCamera& side : others(id))
        files.push_back({side_picture(part_, side.name, id), "a picture of another camera"});
    return files;
  }

  /// From the first file that names cameras: all frames are of one rig.
  std::string camera() const override {
    std::error_code none;
    for (const auto& entry : fs::directory_iterator(part_ / "cameras", none))
      if (entry.path().extension() == ".json")
        return read_surround(part_, entry.path().stem().string()).first;
    return DataSet::camera();
  }

  std::shared_ptr<const DataSet> with_all_cameras() const override {
    return fs::is_directory(part_ / "cameras") ? std::make_shared<KittiObject>(data(), Cameras::all)
                                               : nullptr;
  }

  std::vector<SideCamera> others(const std::string& id) const override {
    return cameras_ == Cameras::all ? read_surround(part_, id).others : std::vector<SideCamera>();
  }

  Sweep sweep(const std::string& id) const override { return read_sweep(source_files(id).at(0).file); }

  Annotations annotations(const std::string& id, int width, int height) const override {
    Annotations result;
    const std::vector<SourceFile> files = source_files(id);
    result.calibration = read_calibration(files[2].file, width, height);
    const fs::path labels = part_ / "label_2" / (id + ".txt");
    result.labelled = fs::exists(labels);
    if (!result.labelled) return result;
    result.labels = read_labels(labels, result.calibration, &result.notes);
    if (const auto numbers = first_tracks(id)) {
      if (numbers->size() != result.labels.size())
        throw InputError(track_file(data(), id).string(), fmt::format("{} lines", numbers->size()),
                         fmt::format("{} has {} labels", labels.string(), result.labels.size()),
                         "give each label its line (-1 where the vehicle is unknown)");
      for (std::size_t i = 0; i < numbers->size(); ++i) {
        const int number = result.labels[i].track = (*numbers)[i];
        if (number >= 0 && std::ranges::count(result.labels, number, &Label::track) > 1)
          throw InputError(track_file(data(), id).string(), fmt::format("label {}", i),
                           fmt::format("has the identity {} of a label before", number),
                           "give each vehicle of a frame its own number");
      }
    }
    if (cameras_ == Cameras::all)
      for (Label& label : read_surround(part_, id).labels) result.labels.push_back(std::move(label));
    return result;
  }

  std::optional<Lighting> lighting(const std::string& id) const override {
    return generated_lighting(data(), id);
  }

  std::optional<std::vector<int>> tracks(const std::string& id) const override {
    auto numbers = first_tracks(id);
    if (cameras_ == Cameras::first) return numbers;
    return numbers ? DataSet::tracks(id) : std::nullopt;  // the labels of annotations()
  }

 private:
  std::optional<std::vector<int>> first_tracks(const std::string& id) const {
    const fs::path file = track_file(data(), id);
    return fs::exists(file) ? std::optional(read_track_file(file)) : std::nullopt;
  }

  fs::path part_;  ///< DATA/training or DATA/testing
  Cameras cameras_;
};

/// Number of floats a point, from a file's first values: neighbouring points differ least when equal columns
/// are compared. `columns`, unless another number stands out.
std::size_t floats_a_point(const std::vector<float>& values, std::size_t columns) {
  constexpr std::size_t kMinCount = 3, kMax = 8;
  constexpr float kClearly = 0.5;
  const auto step = [&](std::size_t apart) {
    std::vector<float> steps;
    for (std::size_t i = apart; i < values.size(); ++i)
      if (const float by = std::abs(values[i] - values[i - apart]); std::isfinite(by)) steps.push_back(by);
    return steps.empty() ? HUGE_VALF : lower_quantile(std::move(steps), 0.5);
  };
  std::size_t best = columns;
  float least = kClearly * step(columns);
  for (std::size_t apart = kMinCount; apart <= kMax; ++apart)
    if (const float by = step(apart); apart != columns && by < least) best = apart, least = by;
  return best;
}

/// Whether a point is a return: drivers write NaN or zeros for a missing one.
bool is_return(const LidarPoint& p) {
  return p.position().allFinite() && std::isfinite(p.reflectance) && !p.position().isZero(0);
}

/// Warns, once for each folder, that points of a sweep are left out.
void warn_of_no_returns(const fs::path& file, std::size_t left_out, std::size_t points) {
  static std::mutex mutex;
  static std::set<fs::path> told;
  const std::scoped_lock lock(mutex);
  if (told.insert(file.parent_path()).second)
    spdlog::warn(
        "{}: {} of {} points are not finite, or zeros (nothing came back): such points are left out, "
        "of the folder's other sweeps too",
        file.string(), left_out, points);
}

/// The rows of a file of floats, streamed; complete rows only.
class PointFile {
 public:
  PointFile(const fs::path& file, std::size_t columns) : file_(file), row_(columns * sizeof(float)) {}

  /// The file's first values, enough to tell its columns, and the bytes read so far.
  std::vector<float> head;
  std::uintmax_t size = 0;

  template <class Visit>
  void for_each(const Visit& visit) {
    constexpr std::size_t kAtOnce = 1024, kHead = 1 << 16;
    const OpenFile from(file_);
    from.check(from.size(), kMaxSweepBytes);
    std::string bytes(kAtOnce * row_, '\0');
    size = 0;
    std::size_t place = 0;
    for (std::size_t filled = 1; filled != 0; size += filled) {
      filled = 0;
      for (std::size_t got = 1; got != 0 && filled < bytes.size(); filled += got)
        got = from.read(bytes.data() + filled, bytes.size() - filled);
      from.check(size + filled, kMaxSweepBytes);
      const std::size_t floats = filled / sizeof(float), before = size / sizeof(float);
      if (before == head.size() && head.size() < kHead) {
        head.resize(before + floats);
        copy_bytes(head.data() + before, bytes.data(), floats * sizeof(float));
      }
      for (std::size_t at = 0; at + row_ <= filled; at += row_) {
        LidarPoint p;
        std::memcpy(&p, bytes.data() + at, sizeof p);
        visit(p, place++);
      }
    }
  }

 private:
  const fs::path& file_;
  std::size_t row_;
};

// KITTI's text files: calibration and labels.

using Matrix34 = Eigen::Matrix<double, 3, 4>;

Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& matrix, const MatrixRow& row) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(matrix, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d rotation = svd.matrixU() * svd.matrixV().transpose();
  if ((rotation - matrix).cwiseAbs().maxCoeff() > 1e-3 || rotation.determinant() < 0)
    throw InputError(row.file.string(), row.name, "is not a rotation",
                     "restore the calibration from the recording that the frame comes from");
  return rotation;
}

/// Limits of focal lengths (pixels), as in rig files, and of distances between sensors (m).
constexpr double kFocal[] = {1, 1e5}, kMaxDistance = 20;

/// A box may pass the image's edge by this (pixels): rounding in labels.
constexpr double kEdgeTolerance = 1.0;

/// Clips the label's 2-D box to the picture, or projects the 3-D box if it has none.
void clip(Label& label, const Calibration& calibration, LabelNotes& notes) {
  const double right = calibration.camera.width - 1, bottom = calibration.camera.height - 1;
  const bool missing = label.right <= label.left || label.bottom <= label.top || label.right <= 0 ||
                       label.bottom <= 0 || label.left >= right || label.top >= bottom;
  if (missing && label.in_space) {
    ++notes.projected;
    const PictureBox seen = projected(label.box, calibration).value_or(PictureBox{});
    label.left = seen.left, label.top = seen.top, label.right = seen.right, label.bottom = seen.bottom;
    return;
  }
  const double beyond = std::max({-label.left, -label.top, label.right - right, label.bottom - bottom});
  if (beyond <= kEdgeTolerance) return;
  ++notes.clipped;
  label.left = std::clamp(label.left, 0.0, right), label.right = std::clamp(label.right, 0.0, right);
  label.top = std::clamp(label.top, 0.0, bottom), label.bottom = std::clamp(label.bottom, 0.0, bottom);
}

}  // namespace

std::shared_ptr<const DataSet> open_kitti_object(const fs::path& data) {
  return std::make_shared<KittiObject>(data);
}

Sweep read_points(const fs::path& file, std::size_t columns) {
  const std::size_t row = columns * sizeof(float);
  constexpr float kMaxDistance = 1000;  // m
  constexpr std::size_t kOdd = 100;     // more than one odd reflectance in this many is not rounding
  PointFile points(file, columns);
  // A first pass only checks the rows, so that an error at the end takes no memory.
  std::size_t rows = 0, returns = 0, odd = 0;
  std::optional<std::size_t> far;
  points.for_each([&](const LidarPoint& p, std::size_t place) {
    ++rows;
    if (!is_return(p)) return;
    ++returns;
    odd += !(p.reflectance >= 0 && p.reflectance <= 1);
    if (!far && p.position().cwiseAbs().maxCoeff() > kMaxDistance) far = place;
  });
  if (points.size == 0) throw InputError(file.string(), "byte 0", "the sweep is empty", kRestore);
  const std::size_t cut = points.size % row;
  if (columns == 4 && (cut != 0 || far || odd * kOdd > returns))
    if (const std::size_t floats = floats_a_point(points.head, columns); floats != columns)
      throw InputError(
          file.string(), "",
          fmt::format("has {} floats a point{}", floats, floats == 5 ? ", as nuScenes' files" : ""),
          "write four of each (x, y, z, reflectance from 0 to 1), or give nuScenes' data set with "
          "its tables");
  if (far)
    throw InputError(file.string(), fmt::format("point {} (byte {})", *far, *far * row),
                     "further than 1 km away", kRestore);
  if (cut != 0)
    throw InputError(file.string(), fmt::format("byte {}", points.size - cut),
                     fmt::format("truncated: {} bytes are not a multiple of {}", points.size, row), kRestore);
  if (returns == 0)
    throw InputError(file.string(), fmt::format("{} points", rows), "none is a return (not finite, or zeros)",
                     kRestore);
  if (returns < rows) warn_of_no_returns(file, rows - returns, rows);
  Sweep sweep;
  sweep.reserve(returns);
  points.for_each([&](const LidarPoint& p, std::size_t) {
    if (is_return(p)) sweep.push_back(p);
  });
  return sweep;
}

Sweep read_sweep(const fs::path& file) {
  return read_points(file, 4);
}

void write_sweep(const fs::path& file, const Sweep& sweep) {
  write_file(file, {reinterpret_cast<const char*>(sweep.data()), sweep.size() * sizeof(LidarPoint)});
}

fs::path lighting_file(const fs::path& data, const std::string& id) {
  return part(data, "lighting", id, ".json");
}

template <class Visitor, FieldsOf<Lighting> S>
void visit_fields(Visitor& visit, S& s) {
  constexpr double kMost = 1e3;
  visit({.name = "to_sun_velo", .range = {-kMost, kMost}}, s.to_sun_velo);
  visit({.name = "sun", .range = {0, kMost}}, s.sun);
  visit({.name = "ambient", .range = {0, kMost}}, s.ambient);
  visit({.name = "hemisphere", .range = {0, kMost}}, s.hemisphere);
}

Lighting read_lighting(const fs::path& file) {
  const nlohmann::json json = read_json(file, kMaxTextBytes);
  const JsonFields from(file, json, "write it as three numbers, e.g. [0.5, 0.5, 0.7]");
  Lighting lighting;
  read_fields(from, lighting);
  if (lighting.to_sun_velo.norm() < 1e-6)
    throw InputError(file.string(), "to_sun_velo", "has no length", "give the direction towards the sun");
  lighting.to_sun_velo.normalize();
  return lighting;
}

std::optional<Lighting> generated_lighting(const fs::path& data, const std::string& id) {
  const fs::path file = lighting_file(data, id);
  return fs::exists(file) ? std::optional(read_lighting(file)) : std::nullopt;
}

nlohmann::json to_json(const Lighting& lighting) {
  return fields_json(lighting);
}

fs::path true_depth_file(const fs::path& data, const std::string& id) {
  return part(data, "depth", id, ".png");
}

fs::path instance_file(const fs::path& data, const std::string& id) {
  return part(data, "instance_2", id, ".png");
}

Image<std::uint16_t> read_instances(const fs::path& data, const std::string& id, int width, int height) {
  Image<std::uint16_t> instances = read_index_png(instance_file(data, id));
  if (instances.width != width || instances.height != height)
    throw InputError(instance_file(data, id).string(), "size", "differs from the image's",
                     "write both with the same mirage generate --truth");
  return instances;
}

fs::path point_label_file(const fs::path& data, const std::string& id) {
  return part(data, "instance_velodyne", id, ".label");
}

void write_point_labels(const fs::path& file, const std::vector<std::uint32_t>& labels) {
  write_file(file, {reinterpret_cast<const char*>(labels.data()), labels.size() * sizeof labels[0]});
}

std::vector<std::uint32_t> read_point_labels(const fs::path& file, std::size_t points) {
  const std::size_t needed = points * sizeof(std::uint32_t);
  const auto check = [&](std::uintmax_t size) {
    if (size != needed)
      throw InputError(
          file.string(), "size", fmt::format("{} bytes for {} points", size, points),
          "4 bytes a point of the sweep are needed; make the set again with mirage generate --truth");
  };
  check(OpenFile(file).size());  // before any of the file is in memory
  const std::string bytes = read_file(file);
  check(bytes.size());
  std::vector<std::uint32_t> labels(points);
  copy_bytes(labels.data(), bytes.data(), needed);
  return labels;
}

void write_frame(const fs::path& data, const Frame& frame) {
  write_srgb(part(data, "image_2", frame.id, ".png"), frame.image);
  write_calibration(part(data, "calib", frame.id, ".txt"), frame.calibration);
  std::vector<Label> first;  // labels that the first camera sees
  std::copy_if(frame.labels.begin(), frame.labels.end(), std::back_inserter(first),
               [](const Label& label) { return label.camera == 0; });
  write_labels(part(data, "label_2", frame.id, ".txt"), first, frame.calibration);
  write_json(lighting_file(data, frame.id), to_json(frame.lighting));
  if (std::any_of(frame.labels.begin(), frame.labels.end(), [](const Label& l) { return l.track >= 0; })) {
    std::string tracks;
    for (const Label& label : first) tracks += fmt::format("{}\n", label.track);
    write_file(track_file(data, frame.id), tracks);
  }
  if (!frame.others.empty()) {
    for (const SideCamera& side : frame.others)
      write_srgb(side_picture(data / "training", side.name, frame.id), side.image.get());
    write_json(part(data, "cameras", frame.id, ".json"), surround_json(frame));
  }
  // Last: list_frames lists the sweeps, so an interrupted frame isn't listed.
  write_sweep(part(data, "velodyne", frame.id, ".bin"), frame.sweep);
}

CalibrationFile::CalibrationFile(fs::path file)
    : file_(std::move(file)), text_(read_text(file_, kMaxTextBytes)) {
  for (const std::string_view line : split(text_, "\n")) {
    const std::size_t begin = line.find_first_not_of(" \t\r");
    if (begin == line.npos) continue;
    // A colon, a blank or both follow the name.
    const std::size_t end = std::min(line.find_first_of(": \t\r", begin), line.size());
    std::string_view numbers = line.substr(end);
    numbers.remove_prefix(std::min(numbers.find_first_not_of(" \t\r"), numbers.size()));
    if (numbers.starts_with(':')) numbers.remove_prefix(1);
    Words words = split(numbers, " \t\r");
    if (!words.empty()) rows_[std::string(line.substr(begin, end - begin))].push_back(std::move(words));
  }
}

MatrixRow CalibrationFile::row(std::initializer_list<const char*> names, std::size_t count) const {
  std::string name;
  std::vector<Words> found;
  for (const char* other : names)
    if (const auto rows = rows_.find(other); rows != rows_.end()) {
      if (!name.empty() && rows->second.front() == found.front()) continue;  // the same row under both names
      name += (name.empty() ? "" : ", ") + std::string(other);
      found.insert(found.end(), rows->second.begin(), rows->second.end());
    }
  if (found.empty())
    throw InputError(file_.string(), fmt::format("{}", fmt::join(names, " or ")), "row missing",
                     "add the row (KITTI's development kit describes it)");
  if (found.size() > 1)
    throw InputError(file_.string(), name, fmt::format("the row is there {} times", found.size()),
                     "keep the one that belongs to the recording");
  const Words& words = found.front();
  if (words.size() != count)
    throw InputError(file_.string(), name, fmt::format("{} numbers where {} belong", words.size(), count),
                     "complete the row");
  MatrixRow matrix{file_, name, {}};
  for (std::size_t i = 0; i < count; ++i)
    matrix.values.push_back(to_number(words[i], file_, fmt::format("{}, number {}", name, i + 1)));
  return matrix;
}

Calibration calibration_of(const MatrixRow& projection, const MatrixRow& rectification, const MatrixRow& pose,
                           int width, int height) {
  using RowMajor34 = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;
  using RowMajor33 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  const auto bad = [](const MatrixRow& row, const std::string& problem, const char* fix) {
    return InputError(row.file.string(), row.name, problem, fix);
  };
  const Matrix34 p = Eigen::Map<const RowMajor34>(projection.values.data());
  const Matrix34 tr = Eigen::Map<const RowMajor34>(pose.values.data());
  const Eigen::Matrix3d k = p.leftCols<3>();
  if (!(k(0, 0) >= kFocal[0] && k(0, 0) <= kFocal[1]) || !(k(1, 1) >= kFocal[0] && k(1, 1) <= kFocal[1]) ||
      std::abs(k(0, 1)) > 1e-6 || std::abs(k(1, 0)) > 1e-6 || std::abs(k(2, 0)) > 1e-9 ||
      std::abs(k(2, 1)) > 1e-9 || std::abs(k(2, 2) - 1) > 1e-9)
    throw bad(projection, "is not a rectified camera's projection",
              "write it as fx 0 cx · 0 fy cy · 0 0 1 · with fx and fy in pixels (1 to 100 000)");
  Calibration calibration;
  calibration.camera = {k(0, 0), k(1, 1), k(0, 2), k(1, 2), width, height};
  const auto& camera = calibration.camera;
  // Cropping shifts a principal point by a few per cent; resizing moves it far.
  if (std::abs(camera.cx - width / 2.0) > 0.2 * width || std::abs(camera.cy - height / 2.0) > 0.25 * height)
    throw bad(projection,
              fmt::format("principal point ({:.1f}, {:.1f}) is far from the middle of the {}x{} image",
                          camera.cx, camera.cy, width, height),
              "use the calibration that belongs to the image");
  calibration.rect_from_cam0 =
      nearest_rotation(Eigen::Map<const RowMajor33>(rectification.values.data()), rectification);
  Transform rect_from_velo = Transform::Identity();
  rect_from_velo.linear() = calibration.rect_from_cam0 * nearest_rotation(tr.leftCols<3>(), pose);
  rect_from_velo.translation() = calibration.rect_from_cam0 * tr.col(3);
  // p_image ~ K p_rect + the projection's last column = K (p_rect + K⁻¹ column)
  calibration.camera_from_rect.translation() = k.inverse() * p.col(3);
  calibration.camera_from_velo = calibration.camera_from_rect * rect_from_velo;
  // Negated, because numbers of 1e308 give a distance that is NaN or infinite.
  if (!(calibration.camera_from_rect.translation().norm() <= kMaxDistance))
    throw bad(projection, "its last column puts the camera more than 20 m off",
              "write it as the focal length times metres");
  if (!(calibration.camera_from_velo.translation().norm() <= kMaxDistance))
    throw bad(pose, "camera and LiDAR are more than 20 m apart", "write the row in metres");
  return calibration;
}

Transform rigid(const MatrixRow& row) {
  using RowMajor34 = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;
  const Matrix34 matrix = Eigen::Map<const RowMajor34>(row.values.data());
  Transform transform = Transform::Identity();
  transform.linear() = nearest_rotation(matrix.leftCols<3>(), row);
  transform.translation() = matrix.col(3);
  if (!(transform.translation().norm() <= kMaxDistance))
    throw InputError(row.file.string(), row.name, "moves by more than 20 m", "write the row in metres");
  return transform;
}

Calibration read_calibration(const fs::path& file, int width, int height) {
  const CalibrationFile rows(file);
  const MatrixRow projection = rows.row({"P2"}, 12), rectification = rows.row({"R0_rect", "R_rect"}, 9);
  return calibration_of(projection, rectification, rows.row({"Tr_velo_to_cam", "Tr_velo_cam"}, 12), width,
                        height);
}

void write_calibration(const fs::path& file, const Calibration& calibration) {
  const auto& camera = calibration.camera;
  Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
  k << camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1;
  const auto row = [](const char* name, const auto& matrix) {
    std::string line = std::string(name) + ":";
    for (Eigen::Index r = 0; r < matrix.rows(); ++r)
      for (Eigen::Index c = 0; c < matrix.cols(); ++c) line += fmt::format(" {:.12e}", matrix(r, c));
    return line + "\n";
  };
  Matrix34 p0 = Matrix34::Zero(), p2, tr, imu = Matrix34::Identity();
  p0.leftCols<3>() = p2.leftCols<3>() = k;
  p2.col(3) = k * calibration.camera_from_rect.translation();
  const Transform rect_from_velo = calibration.rect_from_velo();
  tr.leftCols<3>() = calibration.rect_from_cam0.transpose() * rect_from_velo.linear();
  tr.col(3) = calibration.rect_from_cam0.transpose() * rect_from_velo.translation();
  // The other cameras and the inertial unit aren't simulated; readers expect their rows.
  write_file(file, row("P0", p0) + row("P1", p0) + row("P2", p2) + row("P3", p0) +
                       row("R0_rect", calibration.rect_from_cam0) + row("Tr_velo_to_cam", tr) +
                       row("Tr_imu_to_velo", imu));
}

Label label_of(const KittiRow& row, const Calibration& calibration, LabelNotes& notes) {
  const auto& value = row.value;
  Label label;
  label.type = kitti_type(row.words[0]);
  label.category = std::string(row.words[0]);
  label.truncated = value[1];
  label.left = value[4], label.top = value[5], label.right = value[6], label.bottom = value[7];
  row.demand(value[1] >= -1 && value[1] <= 1, 1, "is not a share from 0 to 1");
  row.demand(value[2] == std::floor(value[2]) && value[2] >= -1 && value[2] <= 3, 2,
             "is not one of 0, 1, 2, 3");
  label.occluded = static_cast<int>(value[2]);
  row.demand(label.right >= label.left, 6, "is left of the box's left side");
  row.demand(label.bottom >= label.top, 7, "is above the box's top");
  label.in_space = label.type != "DontCare" && !row.leaves_box_out();
  if (label.in_space) {
    label.box = row.box(calibration);
    row.demand(std::abs(value[14]) <= 2 * std::numbers::pi, 14, "rad is more than a full turn");
  }
  const bool empty = label.right <= label.left || label.bottom <= label.top;
  row.demand(label.in_space || label.type == "DontCare" || !empty, 8,
             "is not a size, and the 2-D box is empty");
  clip(label, calibration, notes);
  return label;
}

void add_label(const KittiRow& row, Label label, std::vector<Label>& labels) {
  const auto repeats = [&](const Label& other) {
    return other.in_space && in_one_place(other.box.bev, label.box.bev);
  };
  row.demand(!label.in_space || std::ranges::none_of(labels, repeats), 0,
             "stands where one of an earlier row does");
  labels.push_back(std::move(label));
}

std::vector<Label> read_labels(const fs::path& file, const Calibration& calibration, LabelNotes* notes) {
  constexpr RowAdvice kAdvice{"15", "complete the row", "correct the label or delete its row"};
  std::vector<Label> labels;
  LabelNotes counted;
  for_each_row(file, kAdvice,
               [&](const KittiRow& row) { add_label(row, label_of(row, calibration, counted), labels); });
  if (notes != nullptr) *notes = counted;
  return labels;
}

void write_labels(const fs::path& file, const std::vector<Label>& labels, const Calibration& calibration) {
  std::string text;
  for (const Label& label : labels) {
    const std::string box2d =
        fmt::format("{:.2f} {:.2f} {:.2f} {:.2f}", label.left, label.top, label.right, label.bottom);
    if (label.type == "DontCare") {
      text += fmt::format("DontCare -1 -1 -10 {} -1 -1 -1 -1000 -1000 -1000 -10\n", box2d);
      continue;
    }
    if (!label.in_space) {
      text +=
          fmt::format("{} {:.2f} {} -10 {} {}\n", label.type, label.truncated, label.occluded, box2d, kNoBox);
      continue;
    }
    const RectBox box = rect_box(label.box, calibration);
    text += fmt::format("{} {:.2f} {} {:.2f} {} {}\n", label.type, label.truncated, label.occluded,
                        observation_angle(box), box2d, to_row(box));
  }
  write_file(file, text);
}

}  // namespace mirage
