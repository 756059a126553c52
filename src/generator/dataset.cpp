#include "generator/dataset.h"

#include <fmt/format.h>

#include <cmath>
#include <mutex>
#include <numbers>
#include <optional>
#include <vector>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/logging.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "base/types.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

fs::path record_file(const fs::path& data, const std::string& id) {
  return data / "training/written" / (id + ".json");
}

/// Relative to training/. write_frame's files and those of the truth.
std::vector<std::string> files_of(const std::string& id, Truth truth) {
  std::vector<std::string> files = {"image_2/" + id + ".png", "velodyne/" + id + ".bin",
                                    "calib/" + id + ".txt", "label_2/" + id + ".txt",
                                    "lighting/" + id + ".json"};
  if (truth != Truth::none) files.push_back("depth/" + id + ".png");
  if (truth == Truth::all)
    files.insert(files.end(), {"instance_2/" + id + ".png", "instance_velodyne/" + id + ".label"});
  return files;
}

std::string track_of(const std::string& id) {
  return "track_2/" + id + ".txt";  // of frames with identities only
}

/// The frame's files in training/cameras; only frames with several cameras have them.
std::vector<std::string> camera_files(const fs::path& data, const std::string& id) {
  const fs::path training = data / "training";
  const std::string about = "cameras/" + id + ".json";
  if (!fs::exists(training / about)) return {};
  std::vector<std::string> files = {about};
  for (const auto& entry : fs::directory_iterator(training / "cameras"))
    if (const fs::path picture = entry.path() / (id + ".png"); fs::exists(picture))
      files.push_back(fs::relative(picture, training).generic_string());
  return files;
}

/// The record, or an empty object if it is missing or unusable.
nlohmann::json read_record(const fs::path& data, const std::string& id) {
  const fs::path file = record_file(data, id);
  if (!fs::is_regular_file(file)) return nlohmann::json::object();
  try {
    nlohmann::json record = read_json(file, kMaxRecordBytes);
    for (const auto& [name, hash] : record.items())
      if (!hash.is_string()) return nlohmann::json::object();
    return record.is_object() ? record : nlohmann::json::object();
  } catch (const InputError&) {
    return nlohmann::json::object();
  }
}

std::string hash_of(const fs::path& file) {
  return fs::is_regular_file(file) ? file_hash(file, kMaxFileBytes) : "";
}

constexpr const char* kDrives = "drives_of_s";  // a field of sets that are drives

/// A frame's rows in its sequence's files, kept until all frames are there.
struct FrameRows {
  std::string labels, motion;
  int cars = 0, others = 0;
};

/// One drive's files.
struct DriveFiles {
  fs::path training;
  std::string sequence;
  fs::path picture(const std::string& frame) const {
    return training / "image_02" / sequence / (frame + ".png");
  }
  fs::path sweep(const std::string& frame) const {
    return training / "velodyne" / sequence / (frame + ".bin");
  }
  fs::path lighting(const std::string& frame) const {
    return lighting_file(training.parent_path(), sequence + "_" + frame);
  }
  fs::path record(const std::string& frame) const {
    return training / "written" / (sequence + "_" + frame + ".json");
  }
  fs::path of_sequence(const char* kind) const { return training / kind / (sequence + ".txt"); }
};

/// The rows of a frame whose files are unchanged; empty otherwise.
std::optional<FrameRows> kept_rows(const DriveFiles& files, const std::string& frame) {
  try {
    if (!fs::exists(files.record(frame))) return std::nullopt;
    const nlohmann::json record = read_json(files.record(frame), kMaxRecordBytes);
    for (const auto& [name, file] :
         {std::pair("picture", files.picture(frame)), std::pair("sweep", files.sweep(frame)),
          std::pair("lighting", files.lighting(frame))})
      if (!fs::is_regular_file(file) || file_hash(file, kMaxFileBytes) != record.at(name).get<std::string>())
        return std::nullopt;
    return FrameRows{record.at("labels"), record.at("motion"), record.at("cars"), record.at("others")};
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;
  } catch (const InputError&) {
    return std::nullopt;
  }
}

/// A row of the tracking benchmark's labels, which tell truncation in three steps.
std::string tracking_row(int frame, const Label& label, const Calibration& calibration) {
  const RectBox box = rect_box(label.box, calibration);
  return fmt::format("{} {} {} {} {} {:.2f} {:.2f} {:.2f} {:.2f} {:.2f} {}\n", frame, label.track, label.type,
                     label.truncated < 0.15  ? 0
                     : label.truncated < 0.5 ? 1
                                             : 2,
                     label.occluded, observation_angle(box), label.left, label.top, label.right, label.bottom,
                     to_row(box));
}

/// A row of poses (OxtsRow, scene/data/layouts.h) of a unit in the car's `velo`; the world's origin lies at
/// 49° north, 8.4° east.
std::string pose_row(const generator::Waypoint& own) {
  constexpr double kLatitude = 49, kLongitude = 8.4, kEarthRadius = 6378137;  // degrees, m
  const double scale = std::cos(kLatitude * kDegree) * kEarthRadius;
  const double north =
      scale * std::log(std::tan((90 + kLatitude) * std::numbers::pi / 360)) + own.position.y();
  const double latitude = std::atan(std::exp(north / scale)) * 360 / std::numbers::pi - 90,
               longitude = kLongitude + own.position.x() / (scale * kDegree);
  const Vec3d along = own.pose().linear().transpose() * own.velocity;
  return fmt::format(
      "{:.14f} {:.14f} {:.9f} 0 0 {:.12f} {:.6f} {:.6f} {:.6f} {:.6f} {:.6f} 0 0 0 0 0 0 0 0 {:.6f} 0 0 "
      "{:.6f} 0 0 4 10 4 4 0\n",
      latitude, longitude, own.position.z(), own.yaw, own.velocity.y(), own.velocity.x(), along.x(),
      along.y(), along.z(), own.yaw_rate, own.yaw_rate);
}

FrameRows write_drive_frame(const DriveFiles& files, const std::string& name, int number, const Frame& frame,
                            const generator::MovingStreet& street) {
  FrameRows rows;
  const auto standing = static_cast<int>(street.standing.placed.size());
  for (const Label& label : frame.labels) {
    rows.labels += tracking_row(number, label, frame.calibration);
    ++(label.type == "Car" ? rows.cars : rows.others);
    generator::Waypoint at;
    std::string role = "stands";
    if (label.track >= standing) {
      const generator::Mover& mover = street.movers[as_size(label.track - standing)];
      at = mover.way[street.step(number * kDriveStep)];
      role = mover.role;
    } else {
      const Box3& box = street.standing.placed[as_size(label.track)].box;
      at.position = Vec3d(box.bev.x, box.bev.y, box.bottom);
      at.yaw = box.bev.yaw;
    }
    rows.motion += fmt::format("{} {} {} {:.4f} {:.4f} {:.4f} {:.5f} {:.4f} {:.4f} {:.4f}\n", number,
                               label.track, role, at.position.x(), at.position.y(), at.position.z(), at.yaw,
                               at.velocity.x(), at.velocity.y(), at.velocity.z());
  }
  write_srgb(files.picture(name), frame.image);
  write_sweep(files.sweep(name), frame.sweep);
  write_json(files.lighting(name), to_json(frame.lighting));
  // Last, so that the files that it describes exist.
  write_json(files.record(name), {{"picture", file_hash(files.picture(name), kMaxFileBytes)},
                                  {"sweep", file_hash(files.sweep(name), kMaxFileBytes)},
                                  {"lighting", file_hash(files.lighting(name), kMaxFileBytes)},
                                  {"labels", rows.labels},
                                  {"motion", rows.motion},
                                  {"cars", rows.cars},
                                  {"others", rows.others}});
  return rows;
}

/// A rig's file without entries that only recorded sweeps have.
nlohmann::json drawing_rig(nlohmann::json rig) {
  if (rig.contains("lidar") && rig["lidar"].is_object()) rig["lidar"].erase("recorded_effects");
  return rig;
}

/// Writes the record from the frame's files, after the last of them. Truth recorded before stays recorded.
void record_frame(const fs::path& data, const std::string& id, Truth truth) {
  nlohmann::json record = read_record(data, id);
  std::vector<std::string> files = files_of(id, truth);
  if (fs::exists(data / "training" / track_of(id))) files.push_back(track_of(id));
  for (std::string& name : camera_files(data, id)) files.push_back(std::move(name));
  for (const std::string& name : files) record[name] = hash_of(data / "training" / name);
  write_json(record_file(data, id), record);
}

/// Makes the folder with rig.toml and dataset.json, or takes it up again; InputError if it was made of
/// another rig or with other fields. `seconds`: of its drives; none: it has single frames.
void begin_dataset(const Rig& rig, std::uint64_t seed, std::optional<double> seconds, const fs::path& out) {
  nlohmann::json about = {
      {"rig", rig.name}, {"seed", seed}, {"look", name_of(rig.look)}, {"generator", kGeneratorVersion}};
  if (seconds) about[kDrives] = *seconds;
  make_output_folder(out);
  const fs::path file = out / "dataset.json", existing = out / "rig.toml";
  if (fs::exists(file)) {
    const nlohmann::json before = read_json(file, kMaxRecordBytes);
    if (!before.is_object())
      throw InputError(file.string(), "", "is not an object of a data set's fields",
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
    if (!fs::exists(existing))
      throw InputError(existing.string(), "", "is missing, and with it which rig drew the frames there",
                       "restore the file or choose another --out folder");
  }
  // Other commands need the very LiDAR, not its name; and frames of an edited rig are not this set's.
  if (fs::exists(existing) && drawing_rig(read_toml(existing)) != drawing_rig(parse_toml(rig.text, rig.name)))
    throw InputError(existing.string(), "", "is not the rig " + rig.name + " as it is now",
                     "choose another --out folder, or restore the rig file");
  // The rig first: a set that was stopped between the two goes on, and one without its rig has lost it.
  write_file(existing, rig.text);
  write_json(file, about);
}

}  // namespace

bool is_as_recorded(const fs::path& data, const std::string& id, Truth truth) {
  const nlohmann::json record = read_record(data, id);
  std::vector<std::string> files = files_of(id, truth);
  for (const auto& [name, hash] : record.items())
    if (name == track_of(id) || name.starts_with("cameras/")) files.push_back(name);
  for (const std::string& name : files) {
    if (!record.contains(name)) return false;
    const fs::path file = data / "training" / name;
    const std::string now = hash_of(file);
    if (!now.empty() && now == record[name].get_ref<const std::string&>()) continue;
    spdlog::warn("{}: is not what was written ({}); the frame is made anew", file.string(),
                 fs::exists(file) ? "cut short or edited" : "removed");
    return false;
  }
  return true;
}

DatasetSummary generate_dataset(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                                const std::filesystem::path& out,
                                const std::function<void(std::size_t)>& progress, Truth truth) {
  begin_dataset(rig, seed, std::nullopt, out);
  DatasetSummary sum;
  std::mutex mutex;
  std::size_t done = 0;
  const std::vector<std::size_t> order = order_among_ranks(as_size(count));
  parallel_for(order.size(), [&](std::size_t k) {
    if (interrupted()) return;
    const std::uint64_t index = first + order[k];
    const std::string id = fmt::format("{:06}", index);
    const bool keep = is_as_recorded(out, id, truth);
    std::vector<Label> labels;
    if (keep) {
      labels = read_annotations(out, id, Cameras::all).labels;
    } else {
      FrameTruth drawn;
      Frame frame = generate_frame(rig, seed, index, truth == Truth::none ? nullptr : &drawn);
      // Before the frame: its sweep comes last, so that a listed frame has its truth.
      if (truth != Truth::none) write_depth_png(true_depth_file(out, frame.id), drawn.depth);
      if (truth == Truth::all) {
        write_index_png(instance_file(out, frame.id), drawn.instance);
        write_point_labels(point_label_file(out, frame.id), drawn.returns);
      }
      write_frame(out, frame);
      record_frame(out, frame.id, truth);
      labels = std::move(frame.labels);
    }
    const std::scoped_lock lock(mutex);
    ++(keep ? sum.existing : sum.written);
    for (const Label& label : labels) ++(label.type == "Car" ? sum.cars : sum.others);
    sum.points += fs::file_size(out / "training" / "velodyne" / (id + ".bin")) / sizeof(LidarPoint);
    progress(++done);
  });
  throw_if_interrupted("the frames written so far are kept; the same command goes on from there");
  return sum;
}

int frames_of_drive(double seconds) {
  return std::max(1, static_cast<int>(std::lround(seconds / kDriveStep)));
}

DatasetSummary generate_drives(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                               double seconds, const fs::path& out,
                               const std::function<void(std::size_t)>& progress) {
  begin_dataset(rig, seed, seconds, out);
  DatasetSummary sum;
  std::size_t done = 0;
  const int frames = frames_of_drive(seconds);
  for (std::uint64_t index = first; index < first + static_cast<std::uint64_t>(count); ++index) {
    const DriveFiles files{out / "training", fmt::format("{:04}", index)};
    const generator::MovingStreet street = generator::make_moving_street(
        seed, index, rig.lidar.height, rig.look, seconds + 2 * generator::kWayStep);
    const RayScene standing(street.standing.surfaces);
    std::vector<FrameRows> rows(as_size(frames));
    std::mutex mutex;
    const std::vector<std::size_t> order = order_among_ranks(rows.size());
    parallel_for(order.size(), [&](std::size_t k) {
      if (interrupted()) return;
      const std::size_t i = order[k];
      const std::string name = fmt::format("{:06}", i);
      const auto number = static_cast<int>(i);
      std::optional<FrameRows> existing = kept_rows(files, name);
      if (!existing) {
        const Frame frame = generate_drive_frame(rig, street, standing, seed, index, number * kDriveStep);
        rows[i] = write_drive_frame(files, name, number, frame, street);
      }
      const std::scoped_lock lock(mutex);
      ++(existing ? sum.existing : sum.written);
      if (existing) rows[i] = std::move(*existing);
      sum.points += fs::file_size(files.sweep(name)) / sizeof(LidarPoint);
      sum.cars += rows[i].cars, sum.others += rows[i].others;
      progress(++done);
    });
    throw_if_interrupted("the frames written so far are kept; the same command goes on from there");
    std::string labels, motion, poses, times;
    for (std::size_t i = 0; i < rows.size(); ++i) {
      labels += rows[i].labels, motion += rows[i].motion;
      const double time = static_cast<double>(i) * kDriveStep;
      const generator::Waypoint& own = street.own[street.step(time)];
      poses += pose_row(own);
      times +=
          fmt::format("2020-01-01 00:{:02}:{:012.9f}\n", static_cast<int>(time / 60), std::fmod(time, 60));
    }
    write_calibration(files.of_sequence("calib"), rig.calibration);
    write_file(files.of_sequence("oxts"), poses);
    write_file(files.of_sequence("times"), times);
    write_file(files.of_sequence("motion_02"), motion);
    write_file(files.of_sequence("label_02"), labels);
  }
  return sum;
}

}  // namespace mirage
