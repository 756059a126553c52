// Frames written in the layouts of other data sets than KITTI's object benchmark (scene/data/data_set.h).
#pragma once

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cstring>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/files.h"
#include "base/image.h"
#include "base/names.h"
#include "scene/data/kitti.h"
#include "scene/data/kitti_rows.h"

namespace mirage::test {

/// Lines of a file that one of the KITTI writers wrote; removes the file.
inline std::vector<std::string> lines_of(const std::filesystem::path& file) {
  std::vector<std::string> lines;
  const std::string text = read_file(file);
  for (const std::string_view line : split(text, "\n")) lines.emplace_back(line);
  std::filesystem::remove(file);
  return lines;
}

/// The rows of a calibration file, without their colons.
inline std::map<std::string, std::string> calibration_rows(const std::filesystem::path& scratch,
                                                           const Calibration& calibration) {
  const auto file = scratch / "rows.txt";
  write_calibration(file, calibration);
  std::map<std::string, std::string> rows;
  for (const std::string& line : lines_of(file)) {
    const auto colon = line.find(':');
    rows[line.substr(0, colon)] = line.substr(colon + 2);
  }
  return rows;
}

/// calib/SEQUENCE.txt of the tracking benchmark: two of its rows have no colon.
inline std::string tracking_calibration(const std::filesystem::path& scratch,
                                        const Calibration& calibration) {
  const auto rows = calibration_rows(scratch, calibration);
  return fmt::format("P0: {}\nP2: {}\nR_rect {}\nTr_velo_cam {}\n", rows.at("P0"), rows.at("P2"),
                     rows.at("R0_rect"), rows.at("Tr_velo_to_cam"));
}

/// Rows of label_02/SEQUENCE.txt for one frame.
inline std::string tracking_labels(const std::filesystem::path& scratch, int number, const Frame& frame) {
  const auto file = scratch / "labels.txt";
  write_labels(file, frame.labels, frame.calibration);
  std::string text;
  std::size_t i = 0;
  for (const std::string& line : lines_of(file)) {
    const Label& label = frame.labels[i++];
    auto words = split(line, " ");
    const std::string step = label.type == "DontCare" ? "-1"
                             : label.truncated < 0.05 ? "0"
                             : label.truncated < 0.5  ? "1"
                                                      : "2";
    words[1] = step;
    text += fmt::format("{} {} {}\n", number, label.track, fmt::join(words, " "));
  }
  return text;
}

/// One sequence, 0000, of the tracking benchmark; the frames' numbers are their places.
inline void write_tracking(const std::filesystem::path& data, const std::vector<Frame>& frames) {
  const auto training = data / "training";
  std::string labels;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const std::string name = fmt::format("{:06}", i);
    write_srgb(training / "image_02/0000" / (name + ".png"), frames[i].image);
    write_sweep(training / "velodyne/0000" / (name + ".bin"), frames[i].sweep);
    labels += tracking_labels(data, static_cast<int>(i), frames[i]);
  }
  write_file(training / "calib/0000.txt", tracking_calibration(data, frames.at(0).calibration));
  write_file(training / "label_02/0000.txt", labels);
}

/// A day's two calibration files, by name.
inline std::map<std::string, std::string> raw_calibration(const std::filesystem::path& scratch,
                                                          const Calibration& calibration) {
  const auto rows = calibration_rows(scratch, calibration);
  const auto pose = split(rows.at("Tr_velo_to_cam"), " ");
  std::string r, t;
  for (std::size_t i = 0; i < 12; ++i) (i % 4 == 3 ? t : r) += fmt::format(" {}", pose[i]);
  return {
      {"calib_cam_to_cam.txt", fmt::format("calib_time: 09-Jan-2012 13:57:47\nR_rect_00: {}\nP_rect_02: {}\n",
                                           rows.at("R0_rect"), rows.at("P2"))},
      {"calib_velo_to_cam.txt", fmt::format("calib_time: 15-Mar-2012 11:37:16\nR:{}\nT:{}\n", r, t)}};
}

/// tracklet_labels.xml: one tracklet of one pose for each label.
inline std::string tracklets(const std::vector<Frame>& frames) {
  std::string text =
      "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\" ?>\n<!DOCTYPE boost_serialization>\n"
      "<boost_serialization signature=\"serialization::archive\" version=\"9\">\n"
      "<tracklets class_id=\"0\" tracking_level=\"0\" version=\"0\">\n";
  for (std::size_t i = 0; i < frames.size(); ++i)
    for (const Label& label : frames[i].labels) {
      if (label.type == "DontCare") continue;
      const BevBox& bev = label.box.bev;
      text += fmt::format(
          "<item><objectType>{}</objectType><h>{:.17g}</h><w>{:.17g}</w><l>{:.17g}</l>"
          "<first_frame>{}</first_frame><poses><count>1</count><item_version>2</item_version>"
          "<item><tx>{:.17g}</tx><ty>{:.17g}</ty><tz>{:.17g}</tz><rx>0</rx><ry>0</ry><rz>{:.17g}</rz>"
          "<state>2</state><occlusion>{}</occlusion><truncation>0</truncation></item></poses>"
          "<finished>1</finished></item>\n",
          label.type, label.box.height, bev.width, bev.length, i, bev.x, bev.y, label.box.bottom, bev.yaw,
          label.occluded);
    }
  return text + "</tracklets>\n</boost_serialization>\n";
}

/// One drive of one day of KITTI's raw recordings; `data` is the day's folder.
inline void write_raw(const std::filesystem::path& data, const std::vector<Frame>& frames) {
  const auto drive = data / "2011_09_26_drive_0001_sync";
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const std::string name = fmt::format("{:010}", i);
    write_srgb(drive / "image_02/data" / (name + ".png"), frames[i].image);
    write_sweep(drive / "velodyne_points/data" / (name + ".bin"), frames[i].sweep);
  }
  for (const auto& [name, text] : raw_calibration(data, frames.at(0).calibration))
    write_file(data / name, text);
  write_file(drive / "tracklet_labels.xml", tracklets(frames));
}

/// A mount like that of nuScenes' unit: turned by 90° and slightly tilted.
inline Transform tilted_mount() {
  Transform ego_from_lidar = Transform::Identity();
  ego_from_lidar.linear() =
      (Eigen::AngleAxisd(-1.5688, Vec3d::UnitZ()) * Eigen::AngleAxisd(0.02, Vec3d::UnitY()) *
       Eigen::AngleAxisd(-0.01, Vec3d::UnitX()))
          .toRotationMatrix();
  ego_from_lidar.translation() = Vec3d(0.94, 0, 1.84);
  return ego_from_lidar;
}

/// nuScenes' tables as one object {"sensor": rows, …}. Pictures and sweep have different ego poses.
inline nlohmann::json nuscenes_tables(const std::vector<Frame>& frames) {
  using nlohmann::json;
  const auto pose = [](json row, const Transform& t) {
    const Eigen::Quaterniond q(t.linear());
    row["translation"] = {t.translation().x(), t.translation().y(), t.translation().z()};
    row["rotation"] = {q.w(), q.x(), q.y(), q.z()};
    return row;
  };
  json tables = {{"sensor",
                  {{{"token", "sensor-lidar"}, {"channel", "LIDAR_TOP"}, {"modality", "lidar"}},
                   {{"token", "sensor-camera"}, {"channel", "CAM_FRONT"}, {"modality", "camera"}},
                   {{"token", "sensor-back"}, {"channel", "CAM_BACK"}, {"modality", "camera"}}}},
                 {"category", json::array()}};
  const std::map<std::string, std::string> categories = {
      {"Car", "vehicle.car"},         {"Van", "vehicle.emergency.ambulance"},
      {"Truck", "vehicle.truck"},     {"Pedestrian", "human.pedestrian.adult"},
      {"Cyclist", "vehicle.bicycle"}, {"Misc", "static_object.bicycle_rack"}};
  for (const auto& [type, name] : categories)
    tables["category"].push_back({{"token", fmt::format("category-{}", type)}, {"name", name}});
  for (const char* name : {"calibrated_sensor", "ego_pose", "sample_data", "instance", "sample_annotation"})
    tables[name] = json::array();
  const Transform ego_from_lidar = tilted_mount();
  Transform ego_from_velo = Transform::Identity(), moved = Transform::Identity();
  ego_from_velo.translation() = ego_from_lidar.translation();
  moved.translation() = Vec3d(0.4, 0.01, 0);
  moved.linear() = Eigen::AngleAxisd(0.003, Vec3d::UnitZ()).toRotationMatrix();
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const Frame& frame = frames[i];
    const std::string n = std::to_string(i);
    Transform global_from_ego = Transform::Identity();
    global_from_ego.translation() = Vec3d(1010.1 + 10 * static_cast<double>(i), 610.6, 0.2);
    global_from_ego.linear() = (Eigen::AngleAxisd(2.2 + static_cast<double>(i), Vec3d::UnitZ()) *
                                Eigen::AngleAxisd(0.01, Vec3d::UnitY()))
                                   .toRotationMatrix();
    tables["calibrated_sensor"].push_back(pose({{"token", fmt::format("mount-lidar-{}", n)},
                                                {"sensor_token", "sensor-lidar"},
                                                {"camera_intrinsic", json::array()}},
                                               ego_from_lidar));
    const auto add_data = [&](const std::string& sensor, const std::string& token, const std::string& file) {
      tables["sample_data"].push_back({{"token", fmt::format("{}-{}", sensor, n)},
                                       {"sample_token", fmt::format("sample{}", n)},
                                       {"ego_pose_token", fmt::format("pose-{}-{}", token, n)},
                                       {"calibrated_sensor_token", fmt::format("mount-{}-{}", sensor, n)},
                                       {"is_key_frame", true},
                                       {"filename", file}});
    };
    add_data("lidar", "lidar", fmt::format("samples/LIDAR_TOP/{}.pcd.bin", n));
    for (std::size_t k = 0; k < frame.cameras(); ++k) {
      const PinholeCamera& camera = frame.calibration_of(k).camera;
      const Transform ego_from_camera = ego_from_velo * frame.calibration_of(k).camera_from_velo.inverse();
      const std::string sensor = k == 0                           ? "camera"
                                 : frame.name_of(k) == "CAM_BACK" ? "back"
                                                                  : frame.name_of(k);
      if (k > 0 && sensor != "back" && i == 0)
        tables["sensor"].push_back(
            {{"token", "sensor-" + sensor}, {"channel", frame.name_of(k)}, {"modality", "camera"}});
      tables["calibrated_sensor"].push_back(
          pose({{"token", fmt::format("mount-{}-{}", sensor, n)},
                {"sensor_token", "sensor-" + sensor},
                {"camera_intrinsic", {{camera.fx, 0, camera.cx}, {0, camera.fy, camera.cy}, {0, 0, 1}}}},
               moved.inverse() * ego_from_camera));
      add_data(sensor, "camera",
               fmt::format("samples/{}/{}.png", k == 0 ? "CAM_FRONT" : frame.name_of(k), n));
    }
    tables["ego_pose"].push_back(pose({{"token", fmt::format("pose-lidar-{}", n)}}, global_from_ego));
    tables["ego_pose"].push_back(
        pose({{"token", fmt::format("pose-camera-{}", n)}}, global_from_ego * moved));
    for (std::size_t k = 0; k < frame.labels.size(); ++k) {
      const Label& label = frame.labels[k];
      if (!categories.contains(label.type)) continue;
      const Box3& box = label.box;
      const std::string instance = fmt::format("instance-{:04}-{:02}", i, k);
      Transform velo_from_box = Transform::Identity();
      velo_from_box.translation() = Vec3d(box.bev.x, box.bev.y, box.bottom + box.height / 2);
      velo_from_box.linear() = Eigen::AngleAxisd(box.bev.yaw, Vec3d::UnitZ()).toRotationMatrix();
      tables["instance"].push_back(
          {{"token", instance}, {"category_token", fmt::format("category-{}", label.type)}});
      tables["sample_annotation"].push_back(
          pose({{"token", instance + "-annotation"},
                {"sample_token", fmt::format("sample{}", n)},
                {"instance_token", instance},
                {"visibility_token", std::to_string(label.occluded > 2 ? 1 : 4 - label.occluded)},
                {"size", {box.bev.width, box.bev.length, box.height}},
                {"num_lidar_pts", 7}},
               global_from_ego * ego_from_velo * velo_from_box));
    }
  }
  return tables;
}

/// Samples sample0, sample1, …
inline void write_nuscenes(const std::filesystem::path& data, const std::vector<Frame>& frames) {
  const nlohmann::json tables = nuscenes_tables(frames);
  for (const auto& [name, rows] : tables.items()) write_json(data / "v1.0-mini" / (name + ".json"), rows);
  const Eigen::Matrix3f lidar_from_ego = tilted_mount().linear().transpose().cast<float>();
  for (std::size_t i = 0; i < frames.size(); ++i) {
    for (std::size_t k = 0; k < frames[i].cameras(); ++k)
      write_srgb(data / fmt::format("samples/{}/{}.png", k == 0 ? "CAM_FRONT" : frames[i].name_of(k), i),
                 frames[i].image_of(k));
    std::string bytes;
    for (const LidarPoint& p : frames[i].sweep) {
      const Vec3f at = lidar_from_ego * p.position();
      const float row[5] = {at.x(), at.y(), at.z(), 255 * p.reflectance, 3};
      bytes.append(reinterpret_cast<const char*>(row), sizeof row);
    }
    write_file(data / fmt::format("samples/LIDAR_TOP/{}.pcd.bin", i), bytes);
  }
}

}  // namespace mirage::test
