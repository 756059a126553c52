// nuScenes (Caesar et al., CVPR 2020): tables of tokens in v1.0-*/*.json, and the files that they name. A
// frame is a sample, its id the sample's token: the keyframe of LIDAR_TOP and that of CAM_FRONT, with all
// cameras also of the other channels CAM_*, each at the pose that the car had then. Its sequence is its
// scene.
//
// A sweep between key frames is a frame too, by the token of its row (DataSet::sweeps): with the pictures
// nearest in time, and with boxes interpolated between the key frames around it, as in nuScenes' devkit
// (NuScenes.get_boxes).
//
// `velo` has the car's axes and the unit's origin: the unit stands turned by a quarter (x right, y forward)
// and is tilted by more than a degree. A box is kept if a camera sees part of it and it has a return or
// kMinBoxRows pixels of height. Tables are read a row at a time; memory holds only the rows for keyframes of
// these sensors.
#include <fmt/format.h>
#include <sys/stat.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <mutex>
#include <numbers>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/json_fields.h"
#include "base/names.h"
#include "scene/data/data_set.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/layouts.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char* kLidar = "LIDAR_TOP";
constexpr const char* kCamera = "CAM_FRONT";
constexpr const char* kAnyCamera = "CAM_";  // prefix of a camera's channel
constexpr const char* kFix = "restore the table from the data set's archive";
constexpr double kMinBoxRows = 25;     // pixels
constexpr float kFullIntensity = 255;  // of a return
/// m; a point nearer in both axes is on the car, or a firing without a return (a point at the unit itself).
constexpr float kMinReturnDistance = 1;

struct Sensor {
  Transform ego_from_sensor = Transform::Identity();
  std::vector<double> intrinsics;  ///< 9, cameras only
};

/// One sensor's part of a sample.
struct Shot {
  std::string file;  ///< relative to the data set's folder; empty: the sample has none
  const Sensor* sensor = nullptr;
  Transform global_from_ego = Transform::Identity();
  Transform global_from_sensor() const { return global_from_ego * sensor->ego_from_sensor; }
};

struct Annotation {
  std::string type, category;
  Vec3d centre = Vec3d::Zero(), size = Vec3d::Zero();  ///< global; width, length, height (m)
  Vec3d heading = Vec3d::UnitX();                      ///< global
  int visibility = 0;                                  ///< 1 … 4: under 40, 60, 80, 100 % visible
  std::int64_t returns = 0;
  int track = -1;
};

struct Sample {
  Shot lidar, camera;
  std::map<std::string, Shot> others;  ///< of the other cameras, by channel
  std::vector<Annotation> annotations;
  std::string scene;          ///< its name; empty: not in the tables
  int index = 0;              ///< in the scene, from 0
  double time = 0;            ///< s since the scene's first sample
  std::string before, after;  ///< tokens of the scene's neighbours; empty: none
  /// Of a sweep between key frames: the samples around it, and its share of the time from one to the other.
  std::string key_before = {}, key_after = {};
  double share = 0;
};

struct Tables {
  std::map<std::string, Sensor> sensors;  ///< calibrated ones of these channels, by token
  std::map<std::string, Sample> samples;  ///< by token
  bool labelled = false;                  ///< whether any sample has an annotation
  std::map<std::string, std::map<std::int64_t, std::string>> scenes;  ///< samples by time (µs), by scene
  std::map<std::string, Sample> between;  ///< sweeps that aren't key frames, by token; on request
  std::deque<Shot> pictures;              ///< of the sweeps in `between`
};

/// Tables that assign samples to scenes; without them a sample has no scene.
constexpr const char* kSceneTables[] = {"scene.json", "sample.json"};
/// Tables of annotations; a test set has none, or empty ones.
constexpr const char* kAnnotationTables[] = {"category.json", "instance.json", "sample_annotation.json"};

Transform pose_of(const JsonFields& row) {
  constexpr double kFar = 1e7;  // m; maps are kilometres wide
  const auto t = row.numbers("translation", 3, -kFar, kFar), q = row.numbers("rotation", 4, -1.01, 1.01);
  const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
  if (std::abs(rotation.norm() - 1) > 1e-3) row.fail("rotation", "is not a rotation");
  Transform pose = Transform::Identity();
  pose.linear() = rotation.normalized().toRotationMatrix();
  pose.translation() = Vec3d(t[0], t[1], t[2]);
  return pose;
}

template <class Visit>
void for_each_row_of(const fs::path& file, const Visit& visit) {
  const nlohmann::json whole = nlohmann::json::object();
  const JsonFields table(file, whole, kFix);
  for_each_json_row(file, "", kFix, [&](std::size_t i, const nlohmann::json& row) {
    visit(table.inner(fmt::format("[{}]", i), row));
  });
}

/// A path below the data set's folder: tables are untrusted and must not point outside.
std::string file_of(const JsonFields& row) {
  const std::string name = row.text("filename");
  const fs::path path(name);
  const bool leads_out = path.is_absolute() || std::find(path.begin(), path.end(), "..") != path.end();
  if (name.empty() || leads_out || name.find('\0') != std::string::npos)
    row.fail("filename", "names no file below the data set's folder");
  return name;
}

/// Sets each sample's scene and its time in it.
void add_scenes(const fs::path& folder, Tables& tables) {
  for (const char* name : kSceneTables)
    if (!fs::exists(folder / name)) return;
  std::map<std::string, std::string> names;
  std::set<std::string> given;
  for_each_row_of(folder / "scene.json", [&](const JsonFields& row) {
    if (!given.insert(names[row.text("token")] = row.text("name")).second)
      row.fail("name", "another scene has it");
  });
  for_each_row_of(folder / "sample.json", [&](const JsonFields& row) {
    const auto scene = names.find(row.text("scene_token"));
    if (scene == names.end()) row.fail("scene_token", "no such scene");
    const std::string token = row.text("token");
    const std::int64_t time = row.integer("timestamp", 0, std::int64_t{1} << 60);
    if (tables.samples.contains(token) && !tables.scenes[scene->second].emplace(time, token).second)
      row.fail("timestamp", "another sample of the scene has it");
  });
  for (const auto& [name, samples] : tables.scenes) {
    Sample* before = nullptr;
    std::string token_before;
    int index = 0;
    for (const auto& [time, token] : samples) {
      Sample& sample = tables.samples.at(token);
      sample.scene = name;
      sample.index = index++;
      sample.time = 1e-6 * static_cast<double>(time - samples.begin()->first);
      sample.before = token_before;
      if (before != nullptr) before->after = token;
      before = &sample;
      token_before = token;
    }
  }
}

/// Rows of sample_data that aren't key frames, until their sample is known.
struct LooseRow {
  std::string token, sample;  ///< of the row and of its sample
  std::string channel;
  std::int64_t time = 0;  ///< µs
  Shot* shot = nullptr;
};

/// Sets the pictures and neighbours of every sweep between two samples of a scene.
void add_between(const std::vector<LooseRow>& rows, Tables& tables) {
  using ByTime = std::map<std::int64_t, const Shot*>;
  std::map<std::string, std::map<std::string, ByTime>> pictures;      // by scene and channel
  std::map<std::string, std::map<std::int64_t, std::string>> sweeps;  // tokens by scene and time
  const auto scene_of = [&](const LooseRow& row) {
    const auto sample = tables.samples.find(row.sample);
    return sample == tables.samples.end() ? std::string() : sample->second.scene;
  };
  for (const LooseRow& row : rows)
    if (const std::string scene = scene_of(row); row.channel != kLidar && !scene.empty())
      pictures[scene][row.channel][row.time] = row.shot;
  for (const LooseRow& row : rows) {
    const std::string scene = scene_of(row);
    if (row.channel != kLidar || scene.empty()) continue;
    const auto& keys = tables.scenes.at(scene);
    const auto after = keys.upper_bound(row.time);
    if (after == keys.begin() || after == keys.end() || !pictures[scene].contains(kCamera)) continue;
    const auto before = std::prev(after);
    Sample& sweep = tables.between[row.token];
    sweep.lidar = *row.shot;
    for (const auto& [channel, shots] : pictures[scene]) {
      auto nearest = shots.lower_bound(row.time);
      if (nearest == shots.end() ||
          (nearest != shots.begin() && row.time - std::prev(nearest)->first < nearest->first - row.time))
        --nearest;
      (channel == kCamera ? sweep.camera : sweep.others[channel]) = *nearest->second;
    }
    sweep.scene = scene;
    sweep.key_before = before->second, sweep.key_after = after->second;
    sweep.index = tables.samples.at(before->second).index;
    sweep.time = 1e-6 * static_cast<double>(row.time - keys.begin()->first);
    sweep.share =
        static_cast<double>(row.time - before->first) / static_cast<double>(after->first - before->first);
    sweeps[scene][row.time] = row.token;
  }
  for (const auto& [scene, by_time] : sweeps) {
    std::map<std::int64_t, std::string> tokens = tables.scenes.at(scene);
    for (const auto& [time, token] : by_time) tokens[time] = token;
    for (const auto& [time, token] : by_time) {
      const auto at = tokens.find(time);
      Sample& sweep = tables.between.at(token);
      sweep.before = std::prev(at)->second, sweep.after = std::next(at)->second;
    }
  }
}

/// `between`: also the sweeps between key frames.
std::shared_ptr<const Tables> read_tables(const fs::path& folder, bool between) {
  auto tables = std::make_shared<Tables>();
  std::map<std::string, std::string> channels;
  for_each_row_of(folder / "sensor.json", [&](const JsonFields& row) {
    const std::string channel = row.text("channel");
    if (channel == kLidar || channel.starts_with(kAnyCamera)) channels[row.text("token")] = channel;
  });
  std::map<std::string, std::string> channel_of;
  for_each_row_of(folder / "calibrated_sensor.json", [&](const JsonFields& row) {
    const auto channel = channels.find(row.text("sensor_token"));
    if (channel == channels.end()) return;
    Sensor sensor{pose_of(row), {}};
    if (channel->second != kLidar) {
      for (const nlohmann::json& line : row.list("camera_intrinsic", 3))
        for (const nlohmann::json& value : line)
          if (value.is_number()) sensor.intrinsics.push_back(value.get<double>());
      if (sensor.intrinsics.size() != 9) row.fail("camera_intrinsic", "is not a matrix of 3 × 3 numbers");
    }
    const std::string token = row.text("token");
    channel_of[token] = channel->second;
    tables->sensors.insert_or_assign(token, std::move(sensor));
  });
  std::map<std::string, std::vector<Shot*>> waiting;  // by the token of their pose
  std::vector<LooseRow> loose;
  for_each_row_of(folder / "sample_data.json", [&](const JsonFields& row) {
    const bool key = row.truth("is_key_frame");
    if (!key && !between) return;
    const auto sensor = tables->sensors.find(row.text("calibrated_sensor_token"));
    if (sensor == tables->sensors.end()) return;
    const std::string token = row.text("sample_token");
    if (!frame_id_problem(token).empty()) row.fail("sample_token", "cannot be a frame's name");
    const std::string& channel = channel_of[sensor->first];
    const auto fill = [&](Shot& shot) {
      shot.file = file_of(row), shot.sensor = &sensor->second;
      waiting[row.text("ego_pose_token")].push_back(&shot);
    };
    if (between && (!key || channel != kLidar)) {
      Shot& shot = tables->pictures.emplace_back();
      fill(shot);
      loose.push_back(
          {row.text("token"), token, channel, row.integer("timestamp", 0, std::int64_t{1} << 60), &shot});
      if (!frame_id_problem(loose.back().token).empty()) row.fail("token", "cannot be a frame's name");
    }
    if (!key) return;
    Sample& sample = tables->samples[token];
    Shot& shot = channel == kLidar    ? sample.lidar
                 : channel == kCamera ? sample.camera
                                      : sample.others[channel];
    if (!shot.file.empty()) row.fail("sample_token", "the sample has another key frame of " + channel);
    fill(shot);
  });
  for_each_row_of(folder / "ego_pose.json", [&](const JsonFields& row) {
    const auto shots = waiting.find(row.text("token"));
    if (shots == waiting.end()) return;
    for (Shot* shot : shots->second) shot->global_from_ego = pose_of(row);
    waiting.erase(shots);
  });
  if (!waiting.empty())
    throw InputError((folder / "ego_pose.json").string(), waiting.begin()->first, "no such pose", kFix);
  std::erase_if(tables->samples, [](const auto& sample) {
    return sample.second.lidar.file.empty() || sample.second.camera.file.empty();
  });
  add_scenes(folder, *tables);
  add_between(loose, *tables);
  for (const char* name : kAnnotationTables)
    if (!fs::exists(folder / name)) return tables;
  struct Instance {
    std::string type, category;
    int track = -1;
  };
  std::map<std::string, std::string> category_of;
  std::map<std::string, Instance> instances;
  for_each_row_of(folder / "category.json",
                  [&](const JsonFields& row) { category_of[row.text("token")] = row.text("name"); });
  for_each_row_of(folder / "instance.json", [&](const JsonFields& row) {
    const auto category = category_of.find(row.text("category_token"));
    if (category == category_of.end()) row.fail("category_token", "no such category");
    instances[row.text("token")] = {kitti_type(category->second), category->second};
  });
  std::size_t number = 0;
  std::set<std::pair<std::string, std::string>> annotated;  // samples and instances
  for (auto& [token, instance] : instances) instance.track = track_number(0, number++);
  for_each_row_of(folder / "sample_annotation.json", [&](const JsonFields& row) {
    tables->labelled = true;
    const auto sample = tables->samples.find(row.text("sample_token"));
    if (sample == tables->samples.end()) return;
    const auto instance = instances.find(row.text("instance_token"));
    if (instance == instances.end()) row.fail("instance_token", "no such instance");
    if (!annotated.emplace(sample->first, instance->first).second)
      row.fail("instance_token", "the sample has another annotation of it");
    const Transform pose = pose_of(row);
    const auto size = row.numbers("size", 3, 0, 100);
    const std::string visibility = row.text("visibility_token");
    sample->second.annotations.push_back(
        {instance->second.type, instance->second.category, pose.translation(),
         Vec3d(size[0], size[1], size[2]), pose.linear().col(0),
         visibility.size() == 1 && visibility[0] >= '1' && visibility[0] <= '4' ? visibility[0] - '0' : 0,
         row.integer("num_lidar_pts", 0, 1 << 30), instance->second.track});
  });
  return tables;
}

/// Annotations of a sample. For a sweep between two samples, those of the later one, interpolated in time on
/// the straight line from their position in the earlier one. Headings turn the short way about the vertical.
std::vector<Annotation> annotations_of(const Tables& tables, const Sample& sample) {
  if (sample.key_after.empty()) return sample.annotations;
  std::vector<Annotation> moved = tables.samples.at(sample.key_after).annotations;
  std::map<int, const Annotation*> earlier;
  for (const Annotation& annotation : tables.samples.at(sample.key_before).annotations)
    earlier[annotation.track] = &annotation;
  for (Annotation& annotation : moved) {
    const auto before = earlier.find(annotation.track);
    if (before == earlier.end()) continue;
    const Annotation& from = *before->second;
    annotation.centre = from.centre + sample.share * (annotation.centre - from.centre);
    const double turn = std::remainder(std::atan2(annotation.heading.y(), annotation.heading.x()) -
                                           std::atan2(from.heading.y(), from.heading.x()),
                                       2 * std::numbers::pi);
    annotation.heading = Eigen::AngleAxisd(sample.share * turn, Vec3d::UnitZ()) * from.heading;
    annotation.returns = std::max(annotation.returns, from.returns);
    if (sample.share < 0.5) annotation.visibility = from.visibility;
  }
  return moved;
}

/// The tables of a folder, read again once one of them has changed.
std::shared_ptr<const Tables> tables_of(const fs::path& folder, bool between = false) {
  static std::mutex mutex;
  static std::map<std::pair<fs::path, bool>, std::pair<std::string, std::shared_ptr<const Tables>>> loaded;
  const std::scoped_lock lock(mutex);
  std::string state;
  const auto read_table = [&](const char* name, bool needed) {
    const fs::path file = folder / name;
    struct stat about {};
    const bool there = ::stat(file.c_str(), &about) == 0 && S_ISREG(about.st_mode);
    if (!there && needed) throw InputError(file.string(), "", "missing", kFix);
    state +=
        fmt::format("{} {} {}.{} ", about.st_ino, about.st_size, about.st_mtim.tv_sec, about.st_mtim.tv_nsec);
  };
  for (const char* name : {"sensor.json", "calibrated_sensor.json", "sample_data.json", "ego_pose.json"})
    read_table(name, true);
  for (const char* name : kAnnotationTables) read_table(name, false);
  for (const char* name : kSceneTables) read_table(name, false);
  const auto same = loaded.find({folder, between});
  if (same != loaded.end() && same->second.first == state) return same->second.second;
  auto tables = read_tables(folder, between);
  constexpr std::size_t kMaxSets = 4;  // kept in memory by one process
  if (loaded.size() >= kMaxSets) loaded.clear();
  loaded[{folder, between}] = {state, tables};
  return tables;
}

class NuScenes : public DataSet {
 public:
  /// `tables`: the folder of the tables.
  NuScenes(fs::path data, fs::path tables, Cameras cameras = Cameras::first)
      : DataSet(std::move(data)), tables_(std::move(tables)), cameras_(cameras) {}

  const char* layout() const override { return "nuscenes"; }
  std::string rig() const override { return "nuscenes"; }

  std::vector<std::string> frames() const override {
    const Archive archive = check_files();
    if (archive.samples == 0)
      throw InputError((tables_ / "sample_data.json").string(), "",
                       fmt::format("no sample has keyframes of {} and {}", kLidar, kCamera), kFix);
    if (archive.whole.empty())
      throw InputError(
          tables_.parent_path().string(), "samples",
          fmt::format("of {} samples {} have their file of {} there and {} that of {}: none has both",
                      archive.samples, archive.sweeps, kLidar, archive.pictures, kCamera),
          "unpack the archives that hold them");
    return archive.whole;
  }

  std::string incomplete() const override {
    const Archive archive = check_files();
    return archive.whole.size() == archive.samples
               ? ""
               : fmt::format("{} of {} samples are left out: their files of {} or {} are not there",
                             archive.samples - archive.whole.size(), archive.samples, kLidar, kCamera);
  }

  std::vector<std::string> sweeps() const override {
    std::vector<std::string> all = frames();
    const auto tables = tables_of(tables_, true);
    for (const auto& [token, sweep] : tables->between)
      if (fs::exists(tables_.parent_path() / sweep.lidar.file) &&
          fs::exists(tables_.parent_path() / sweep.camera.file))
        all.push_back(token);
    std::sort(all.begin(), all.end());
    return all;
  }

  std::string camera() const override { return kCamera; }

  std::shared_ptr<const DataSet> with_all_cameras() const override {
    return std::make_shared<NuScenes>(data(), tables_, Cameras::all);
  }

  std::vector<SideCamera> others(const std::string& id) const override {
    if (cameras_ == Cameras::first) return {};
    const auto [tables, sample] = of(id);
    std::vector<SideCamera> cameras;
    for (const auto& [channel, shot] : sample.others) {
      const fs::path file = tables_.parent_path() / shot.file;
      if (!fs::is_regular_file(file))
        throw InputError(file.string(), "", "missing (the image of " + channel + ")",
                         "unpack the archive that holds it, or give --cameras first");
      const PictureSize size = read_image_size(file);
      cameras.push_back({channel, calibration_by(sample, shot, size.width, size.height),
                         Lazy<ImageF>([file, size] { return read_srgb(file, size); })});
    }
    return cameras;
  }

  std::vector<SourceFile> source_files(const std::string& id) const override {
    const auto [tables, sample] = of(id);
    const fs::path root = tables_.parent_path();
    return {{root / sample.lidar.file, "the sweep"}, {root / sample.camera.file, "the image"}};
  }

  Sweep sweep(const std::string& id) const override {
    const auto [tables, sample] = of(id);
    Sweep points = read_points(tables_.parent_path() / sample.lidar.file, 5);  // the fifth is the beam
    const Eigen::Matrix3f turn = velo_from_lidar(sample).linear().cast<float>();
    std::erase_if(points, [](const LidarPoint& p) {
      return std::abs(p.x) < kMinReturnDistance && std::abs(p.y) < kMinReturnDistance;
    });
    for (LidarPoint& p : points) {
      const Vec3f at = turn * p.position();
      p = {at.x(), at.y(), at.z(), p.reflectance / kFullIntensity};
    }
    return points;
  }

  Annotations annotations(const std::string& id, int width, int height) const override {
    const auto [tables, sample] = of(id);
    Annotations result;
    result.labelled = tables->labelled;
    result.calibration = calibration_by(sample, sample.camera, width, height);
    const std::vector<SideCamera> cameras = others(id);
    std::vector<Label> elsewhere;
    const Transform velo_from_global = pose_of_sweep(sample).inverse();
    for (const Annotation& annotation : annotations_of(*tables, sample)) {
      const Vec3d centre = velo_from_global * annotation.centre,
                  along = velo_from_global.linear() * annotation.heading;
      const Box3 box{{centre.x(), centre.y(), annotation.size.y(), annotation.size.x(),
                      std::atan2(along.y(), along.x())},
                     centre.z() - annotation.size.z() / 2,
                     annotation.size.z()};
      if (const std::string problem = box_problem(box); !problem.empty())
        throw InputError((tables_ / "sample_annotation.json").string(), "sample " + id, "a box " + problem,
                         kFix);
      const auto seen_by = [&](const Calibration& calibration) {
        auto seen = projected_label(annotation.type, box, calibration);
        if (seen && annotation.returns == 0 && seen->bottom - seen->top < kMinBoxRows) seen.reset();
        return seen;
      };
      auto label = seen_by(result.calibration);
      for (std::size_t k = 0; k < cameras.size() && (!label || label->camera > 0); ++k)
        if (auto seen = seen_by(cameras[k].calibration);
            seen && (!label || seen->truncated < label->truncated)) {
          label = std::move(seen);
          label->camera = static_cast<int>(k) + 1;
        }
      if (!label) continue;
      constexpr int kOccluded[] = {3, 3, 2, 1, 0};  // by visibility
      label->occluded = kOccluded[annotation.visibility];
      label->track = annotation.track;
      label->category = annotation.category;
      (label->camera == 0 ? result.labels : elsewhere).push_back(std::move(*label));
    }
    result.labels.insert(result.labels.end(), elsewhere.begin(), elsewhere.end());
    return result;
  }

  std::optional<Moment> moment(const std::string& id) const override {
    const auto [tables, sample] = of(id);
    if (sample.scene.empty()) return std::nullopt;
    return Moment{sample.scene, sample.index, sample.time, pose_of_sweep(sample)};
  }

  std::optional<std::string> beside(const std::string& id, int step) const override {
    std::string at = id;
    for (int i = 0; i < std::abs(step) && !at.empty(); ++i) {
      const auto [tables, sample] = of(at);
      at = step < 0 ? sample.before : sample.after;
    }
    return at.empty() || at == id ? std::nullopt : std::optional(at);
  }

  std::string annotations_hash(const std::string& id) const override {
    const auto [width, height] = picture_size(id);
    const Annotations result = annotations(id, width, height);
    std::string text = result.labelled ? "" : "no labels ";
    const auto add = [&](double value) { text += fmt::format("{:.9g} ", value); };
    const auto add_camera = [&](const Calibration& calibration) {
      const PinholeCamera& camera = calibration.camera;
      for (const double value : {camera.fx, camera.fy, camera.cx, camera.cy}) add(value);
      for (int i = 0; i < 12; ++i) add(calibration.camera_from_velo.matrix()(i / 4, i % 4));
    };
    add_camera(result.calibration);
    for (const Label& label : result.labels) {
      const BevBox& bev = label.box.bev;
      text += fmt::format("{} {} ", label.type, label.occluded);
      for (const double value :
           {bev.x, bev.y, bev.length, bev.width, bev.yaw, label.box.bottom, label.box.height})
        add(value);
    }
    for (const SideCamera& camera : others(id)) {
      text += camera.name + " ";
      add_camera(camera.calibration);
      text += file_hash(tables_.parent_path() / of(id).sample.others.at(camera.name).file, kMaxFileBytes);
    }
    return content_hash(text);
  }

 private:
  /// The samples whose files are in the folder: archives come in parts.
  struct Archive {
    std::size_t samples = 0, sweeps = 0, pictures = 0;
    std::vector<std::string> whole;
  };
  Archive check_files() const {
    const auto tables = tables_of(tables_);
    Archive archive{tables->samples.size(), 0, 0, {}};
    for (const auto& [token, sample] : tables->samples) {
      const bool sweep = fs::exists(tables_.parent_path() / sample.lidar.file),
                 picture = fs::exists(tables_.parent_path() / sample.camera.file);
      archive.sweeps += sweep;
      archive.pictures += picture;
      if (sweep && picture) archive.whole.push_back(token);
    }
    return archive;
  }

  /// A frame's part of the tables, which it keeps alive.
  struct SampleTables {
    std::shared_ptr<const Tables> tables;
    const Sample& sample;
  };
  SampleTables of(const std::string& id) const {
    check_id(id);
    auto tables = tables_of(tables_);
    if (const auto sample = tables->samples.find(id); sample != tables->samples.end())
      return {tables, sample->second};
    tables = tables_of(tables_, true);
    if (const auto sweep = tables->between.find(id); sweep != tables->between.end())
      return {tables, sweep->second};
    throw InputError(data().string(), "frame \"" + id + "\"", "no such sample or sweep",
                     "give the token of a sample, or of a sweep's row of sample_data.json");
  }

  /// Calibration of the camera that took `shot`. `width`, `height`: its picture's.
  Calibration calibration_by(const Sample& sample, const Shot& shot, int width, int height) const {
    const Transform camera_from_velo = shot.global_from_sensor().inverse() * pose_of_sweep(sample);
    const fs::path file = tables_ / "calibrated_sensor.json";
    const auto& k = shot.sensor->intrinsics;
    const MatrixRow projection{
        file, "camera_intrinsic", {k[0], k[1], k[2], 0, k[3], k[4], k[5], 0, k[6], k[7], k[8], 0}};
    const MatrixRow upright{file, "rotation", {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    MatrixRow pose{file, "translation, rotation", {}};
    for (int i = 0; i < 12; ++i) pose.values.push_back(camera_from_velo.matrix()(i / 4, i % 4));
    return calibration_of(projection, upright, pose, width, height);
  }

  /// global_from_velo at the sweep's time.
  static Transform pose_of_sweep(const Sample& sample) {
    return sample.lidar.global_from_sensor() * velo_from_lidar(sample).inverse();
  }

  static Transform velo_from_lidar(const Sample& sample) {
    Transform turn = Transform::Identity();
    turn.linear() = sample.lidar.sensor->ego_from_sensor.linear();
    return turn;
  }

  fs::path tables_;
  Cameras cameras_;
};

}  // namespace

std::shared_ptr<const DataSet> open_nuscenes(const fs::path& data) {
  std::error_code error;
  if (fs::exists(data / "sample_data.json", error)) {
    fs::path tables = fs::absolute(data).lexically_normal();
    if (!tables.has_filename()) tables = tables.parent_path();  // "v1.0-mini/"
    return std::make_shared<NuScenes>(data, tables);
  }
  std::vector<fs::path> versions;
  for (const fs::path& entry : entries_of(data))
    if (entry.filename().string().starts_with("v1.0-") && fs::exists(entry / "sample_data.json"))
      versions.push_back(entry);
  if (versions.empty()) return nullptr;
  if (versions.size() > 1)
    throw InputError(data.string(), "v1.0-*", fmt::format("{} versions of the tables", versions.size()),
                     "give the folder of one of them");
  return std::make_shared<NuScenes>(data, fs::absolute(versions.front()));
}

}  // namespace mirage
