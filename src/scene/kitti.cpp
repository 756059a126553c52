#include "scene/kitti.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <sstream>
#include <tuple>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/names.h"
#include "scene/road_exposure.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

const char* kRestore = "restore the file from its source";

fs::path part(const fs::path& data, const char* folder, const std::string& id, const char* extension) {
  return data / "training" / folder / (id + extension);
}

void need_file(const fs::path& file, const std::string& what) {
  if (!fs::is_regular_file(file))
    throw InputError(file.string(), "", "missing (" + what + " of the frame)",
                     "add the file or drop the frame");
}

fs::path track_file(const fs::path& data, const std::string& id) {
  return part(data, "track_2", id, ".txt");
}

Vec3d read_triple(const nlohmann::json& json, const char* key, const fs::path& file, double low) {
  const auto bad = [&](const char* problem) {
    return InputError(file.string(), key, problem, "write it as three numbers, e.g. [0.5, 0.5, 0.7]");
  };
  if (!json.is_object() || !json.contains(key)) throw bad("missing");
  const auto& value = json[key];
  if (!value.is_array() || value.size() != 3) throw bad("not a list of three numbers");
  Vec3d result;
  for (int i = 0; i < 3; ++i) {
    if (!value[i].is_number()) throw bad("not a list of three numbers");
    result[i] = value[i].get<double>();
  }
  if (!result.allFinite() || result.minCoeff() < low || result.maxCoeff() > 1e3) throw bad("out of range");
  return result;
}

}  // namespace

std::vector<std::string> list_frames(const fs::path& data) {
  const fs::path folder = data / "training" / "velodyne";
  if (!fs::is_directory(folder))
    throw InputError(data.string(), "training/velodyne", "no such folder",
                     "give a data set in KITTI layout (made by `mirage generate`, for one)");
  std::vector<std::string> ids;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (entry.path().extension() != ".bin") continue;
    ids.push_back(entry.path().stem().string());
    if (const std::string problem = frame_id_problem(ids.back()); !problem.empty())
      throw InputError(entry.path().string(), "name", problem, "give the frame's files a shorter name");
  }
  if (ids.empty())
    throw InputError(data.string(), "training/velodyne", "holds no .bin file",
                     "give a data set with at least one frame");
  std::sort(ids.begin(), ids.end());
  return ids;
}

Sweep read_sweep(const fs::path& file) {
  const std::string bytes = read_file(file);
  if (bytes.empty()) throw InputError(file.string(), "byte 0", "the sweep is empty", kRestore);
  if (bytes.size() % sizeof(LidarPoint) != 0)
    throw InputError(file.string(), fmt::format("byte {}", bytes.size() - bytes.size() % sizeof(LidarPoint)),
                     fmt::format("truncated: {} bytes are no multiple of 16", bytes.size()), kRestore);
  Sweep sweep(bytes.size() / sizeof(LidarPoint));
  std::memcpy(sweep.data(), bytes.data(), bytes.size());
  for (std::size_t i = 0; i < sweep.size(); ++i) {
    const LidarPoint& p = sweep[i];
    if (!p.position().allFinite() || !std::isfinite(p.reflectance))
      throw InputError(file.string(), fmt::format("point {} (byte {})", i, i * sizeof(LidarPoint)),
                       "not a finite number", kRestore);
    if (p.position().cwiseAbs().maxCoeff() > 1000)
      throw InputError(file.string(), fmt::format("point {} (byte {})", i, i * sizeof(LidarPoint)),
                       "further than 1 km away", kRestore);
  }
  return sweep;
}

void write_sweep(const fs::path& file, const Sweep& sweep) {
  write_file(file, {reinterpret_cast<const char*>(sweep.data()), sweep.size() * sizeof(LidarPoint)});
}

Lighting read_lighting(const fs::path& file) {
  const nlohmann::json json = read_json(file);
  Lighting lighting;
  lighting.to_sun_velo = read_triple(json, "to_sun_velo", file, -1e3);
  if (lighting.to_sun_velo.norm() < 1e-6)
    throw InputError(file.string(), "to_sun_velo", "has no length", "give the direction towards the sun");
  lighting.to_sun_velo.normalize();
  lighting.sun = read_triple(json, "sun", file, 0);
  lighting.ambient = read_triple(json, "ambient", file, 0);
  lighting.hemisphere = read_triple(json, "hemisphere", file, 0);
  return lighting;
}

void write_lighting(const fs::path& file, const Lighting& lighting) {
  const auto list = [](const Vec3d& v) { return nlohmann::json{v.x(), v.y(), v.z()}; };
  write_json(file, {{"to_sun_velo", list(lighting.to_sun_velo)},
                    {"sun", list(lighting.sun)},
                    {"ambient", list(lighting.ambient)},
                    {"hemisphere", list(lighting.hemisphere)}});
}

fs::path true_depth_file(const fs::path& data, const std::string& id) {
  return part(data, "depth", id, ".png");
}

std::optional<std::vector<int>> read_tracks(const fs::path& data, const std::string& id) {
  const fs::path file = track_file(data, id);
  if (!fs::exists(file)) return std::nullopt;
  std::vector<int> tracks;
  std::istringstream lines(read_file(file));
  int row = 0;
  for (std::string line; std::getline(lines, line);) {
    ++row;
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.pop_back();
    if (line.empty()) continue;
    int track = 0;
    const char* end = line.data() + line.size();
    const auto [read, error] = std::from_chars(line.data(), end, track);
    if (error != std::errc() || read != end || track < -1) {
      line.resize(std::min<std::size_t>(line.size(), 40));
      std::replace(line.begin(), line.end(), '\r', ' ');
      throw InputError(file.string(), fmt::format("row {}", row), fmt::format("'{}' is no identity", line),
                       "write the vehicle's number, or -1");
    }
    tracks.push_back(track);
  }
  return tracks;
}

Frame read_frame(const fs::path& data, const std::string& id) {
  if (const std::string problem = frame_id_problem(id); !problem.empty())
    throw InputError(data.string(), "frame \"" + id.substr(0, 2 * kLongestFrameId) + "\"", problem,
                     "give the name of a file in training/velodyne, without .bin");
  const fs::path image = part(data, "image_2", id, ".png"), sweep = part(data, "velodyne", id, ".bin"),
                 calibration = part(data, "calib", id, ".txt"), labels = part(data, "label_2", id, ".txt"),
                 lighting = part(data, "lighting", id, ".json");
  need_file(sweep, "the sweep");
  need_file(image, "the image");
  need_file(calibration, "the calibration");
  need_file(labels, "the labels");
  Frame frame;
  frame.id = id;
  frame.sweep = read_sweep(sweep);
  // Header, calibration, pixels: a header that claims too much contradicts the calibration before it costs
  // memory.
  PictureSize size;
  read_image_size(image, size.width, size.height);
  frame.calibration = read_calibration(calibration, size.width, size.height);
  frame.image = read_srgb(image, size);
  frame.labels = read_labels(labels, frame.calibration);
  if (const auto tracks = read_tracks(data, id)) {
    if (tracks->size() != frame.labels.size())
      throw InputError(track_file(data, id).string(), fmt::format("{} lines", tracks->size()),
                       fmt::format("{} has {} labels", labels.string(), frame.labels.size()),
                       "give each label its line (-1 where the vehicle is unknown)");
    for (std::size_t i = 0; i < tracks->size(); ++i) frame.labels[i].track = (*tracks)[i];
  }
  frame.lighting = fs::exists(lighting) ? read_lighting(lighting) : with_road_exposure(frame);
  return frame;
}

std::string frame_hash(const fs::path& data, const std::string& id) {
  std::string hashes;
  for (const auto& [folder, extension, what] : {std::tuple{"velodyne", ".bin", "the sweep"},
                                                {"image_2", ".png", "the image"},
                                                {"calib", ".txt", "the calibration"},
                                                {"label_2", ".txt", "the labels"}}) {
    const fs::path file = part(data, folder, id, extension);
    need_file(file, what);
    hashes += content_hash(read_file(file));
  }
  return content_hash(hashes);
}

void write_frame(const fs::path& data, const Frame& frame) {
  write_srgb(part(data, "image_2", frame.id, ".png"), frame.image);
  write_calibration(part(data, "calib", frame.id, ".txt"), frame.calibration);
  write_labels(part(data, "label_2", frame.id, ".txt"), frame.labels, frame.calibration);
  write_lighting(part(data, "lighting", frame.id, ".json"), frame.lighting);
  if (std::any_of(frame.labels.begin(), frame.labels.end(), [](const Label& l) { return l.track >= 0; })) {
    std::string tracks;
    for (const Label& label : frame.labels) tracks += fmt::format("{}\n", label.track);
    write_file(track_file(data, frame.id), tracks);
  }
  // Last: list_frames goes by the sweeps, so a frame that was cut short isn't listed.
  write_sweep(part(data, "velodyne", frame.id, ".bin"), frame.sweep);
}

}  // namespace mirage
