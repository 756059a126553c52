#include "generator/drive_dataset.h"

#include <fmt/format.h>

#include <cmath>
#include <mutex>
#include <numbers>
#include <optional>

#include "base/angles.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "generator/moving_street.h"
#include "scene/data/kitti.h"
#include "scene/data/kitti_rows.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// What a frame adds to its sequence's files, kept until all frames are there.
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
  fs::path record(const std::string& frame) const {
    return training / "written" / (sequence + "_" + frame + ".json");
  }
  fs::path of_sequence(const char* kind) const { return training / kind / (sequence + ".txt"); }
};

/// The rows of a frame whose files are as they were written; none otherwise.
std::optional<FrameRows> kept_rows(const DriveFiles& files, const std::string& frame) {
  try {
    if (!fs::exists(files.record(frame))) return std::nullopt;
    const nlohmann::json record = read_json(files.record(frame), kLargestRecord);
    for (const auto& [name, file] :
         {std::pair("picture", files.picture(frame)), std::pair("sweep", files.sweep(frame))})
      if (!fs::is_regular_file(file) || file_hash(file, kLargestFile) != record.at(name).get<std::string>())
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

/// A row of poses (scene/data/kitti_drives.h) of a unit in the car's `velo`; the world's origin lies at 49°
/// north, 8.4° east.
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
      const generator::Mover& mover = street.movers[static_cast<std::size_t>(label.track - standing)];
      at = mover.way[street.step(number * kDriveStep)];
      role = mover.role;
    } else {
      const Box3& box = street.standing.placed[static_cast<std::size_t>(label.track)].box;
      at.position = Vec3d(box.bev.x, box.bev.y, box.bottom);
      at.yaw = box.bev.yaw;
    }
    rows.motion += fmt::format("{} {} {} {:.4f} {:.4f} {:.4f} {:.5f} {:.4f} {:.4f} {:.4f}\n", number,
                               label.track, role, at.position.x(), at.position.y(), at.position.z(), at.yaw,
                               at.velocity.x(), at.velocity.y(), at.velocity.z());
  }
  write_srgb(files.picture(name), frame.image);
  write_sweep(files.sweep(name), frame.sweep);
  // Last, so that what it speaks of is there.
  write_json(files.record(name), {{"picture", file_hash(files.picture(name), kLargestFile)},
                                  {"sweep", file_hash(files.sweep(name), kLargestFile)},
                                  {"labels", rows.labels},
                                  {"motion", rows.motion},
                                  {"cars", rows.cars},
                                  {"others", rows.others}});
  return rows;
}

}  // namespace

int frames_of_drive(double seconds) {
  return std::max(1, static_cast<int>(std::lround(seconds / kDriveStep)));
}

DatasetSummary generate_drives(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                               double seconds, const fs::path& out,
                               const std::function<void(std::size_t)>& tell) {
  begin_dataset(rig,
                {{"rig", rig.name},
                 {"seed", seed},
                 {"look", name_of(rig.look)},
                 {"generator", kGeneratorVersion},
                 {"drives_of_s", seconds}},
                out);
  DatasetSummary sum;
  std::size_t done = 0;
  const int frames = frames_of_drive(seconds);
  for (std::uint64_t index = first; index < first + static_cast<std::uint64_t>(count); ++index) {
    const DriveFiles files{out / "training", fmt::format("{:04}", index)};
    const generator::MovingStreet street = generator::make_moving_street(
        seed, index, rig.lidar.height, rig.look, seconds + 2 * generator::kWayStep);
    const RayScene standing(street.standing.surfaces);
    std::vector<FrameRows> rows(static_cast<std::size_t>(frames));
    std::mutex mutex;
    const std::vector<std::size_t> order = order_among_ranks(rows.size());
    parallel_for(order.size(), [&](std::size_t k) {
      if (interrupted()) return;
      const std::size_t i = order[k];
      const std::string name = fmt::format("{:06}", i);
      const auto number = static_cast<int>(i);
      std::optional<FrameRows> kept = kept_rows(files, name);
      if (!kept) {
        const Frame frame = generate_drive_frame(rig, street, standing, seed, index, number * kDriveStep);
        rows[i] = write_drive_frame(files, name, number, frame, street);
      }
      const std::scoped_lock lock(mutex);
      ++(kept ? sum.kept : sum.written);
      if (kept) rows[i] = std::move(*kept);
      sum.points += fs::file_size(files.sweep(name)) / sizeof(LidarPoint);
      sum.cars += rows[i].cars, sum.others += rows[i].others;
      tell(++done);
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
