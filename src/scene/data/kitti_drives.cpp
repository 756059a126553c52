#include <fmt/format.h>
#include <tinyxml2.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <mutex>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "base/sizes.h"
#include "scene/data/data_set.h"
#include "scene/data/kitti.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/layouts.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr double kEarthRadius = 6378137;  // m, the development kit's
constexpr double kSweepSeconds = 0.1;     // between sweeps of a recording without times
constexpr const char* kRestoreRow = "restore the file from the recording";

std::string row_name(std::size_t row) {
  return fmt::format("row {}", row + 1);
}

/// Line `row`, from 0. InputError if the file is shorter or the line is empty.
std::string text_line(const fs::path& file, std::size_t row) {
  const std::string text = read_text(file, kMaxLabelBytes);
  std::size_t begin = 0;
  for (std::size_t i = 0; i < row && begin != text.npos; ++i) {
    begin = text.find('\n', begin);
    if (begin != text.npos) ++begin;
  }
  std::string line = begin == text.npos ? "" : text.substr(begin, text.find('\n', begin) - begin);
  if (line.find_first_not_of(" \t\r") == line.npos)
    throw InputError(file.string(), row_name(row), "missing: the recording has a frame of that number",
                     kRestoreRow);
  return line;
}

/// A row of the recordings' 30 numbers. InputError for fewer than 25 (30 without the five flags at the end),
/// for a word that is not a number and for a place that is not on Earth.
OxtsRow oxts_row(const fs::path& file, std::size_t row) {
  constexpr std::size_t kMinCount = 25;
  const std::string line = text_line(file, row);
  const auto words = split(line, " \t\r\n");
  if (words.size() < kMinCount)
    throw InputError(file.string(), row_name(row), fmt::format("{} numbers where 30 belong", words.size()),
                     kRestoreRow);
  double value[6];
  for (std::size_t i = 0; i < 6; ++i)
    value[i] = to_number(words[i], file, fmt::format("{}, number {}", row_name(row), i + 1));
  const OxtsRow pose{value[0], value[1], value[2], value[3], value[4], value[5]};
  if (!(std::max({std::abs(pose.roll), std::abs(pose.pitch), std::abs(pose.yaw)}) <= 2 * std::numbers::pi))
    throw InputError(file.string(), row_name(row), "roll, pitch or yaw is more than a full turn",
                     "write the angles in radians");
  if (!(std::abs(pose.latitude) < 89 && std::abs(pose.longitude) <= 360 && std::abs(pose.altitude) < 1e5))
    throw InputError(file.string(), row_name(row),
                     "is not a place on a road: latitude and longitude in degrees, altitude in metres",
                     kRestoreRow);
  return pose;
}

/// s from 2000-01-01 on, of "2011-09-26 13:02:25.594360375". InputError for another form.
double stamp_seconds(const fs::path& file, std::size_t row) {
  const std::string stamp = text_line(file, row);
  const auto words = split(stamp, "-: \t\r\n");
  double value[6] = {};
  bool good = words.size() == 6;
  for (std::size_t i = 0; good && i < 6; ++i) {
    value[i] = try_parse_number<double>(words[i]).value_or(-1);
    good = value[i] >= 0 && value[i] < 10000;
  }
  namespace chrono = std::chrono;
  const chrono::year_month_day day(chrono::year(static_cast<int>(value[0])),
                                   chrono::month(static_cast<unsigned>(value[1])),
                                   chrono::day(static_cast<unsigned>(value[2])));
  if (!good || !day.ok() || value[3] >= 24 || value[4] >= 60 || value[5] >= 61)
    throw InputError(file.string(), row_name(row), "is not a time, as 2011-09-26 13:02:25.594360375",
                     kRestoreRow);
  const chrono::sys_days start = chrono::year(2000) / 1 / 1;
  const double days = static_cast<double>((chrono::sys_days(day) - start).count());
  return ((days * 24 + value[3]) * 60 + value[4]) * 60 + value[5];
}

/// A frame, by its sequence and its number in it; its id is SEQUENCE_NAME.
struct Place {
  std::string sequence, name;  ///< "2011_09_26_drive_0009_sync", "0000000012"; "0003", "000012"
  int frame = 0;               ///< the name as a number
  std::size_t number = 0;      ///< the sequence's group for track_number()
  fs::path folder = {};        ///< raw drives only
};

/// The common part of both layouts of drives.
class KittiDrives : public DataSet {
 public:
  using DataSet::DataSet;

  Sweep sweep(const std::string& id) const override { return read_sweep(source_files(id).at(0).file); }

  std::optional<std::string> beside(const std::string& id, int step) const override {
    const Place at = place(id);
    if (at.frame + step < 0) return std::nullopt;
    const std::string other =
        fmt::format("{}_{:0{}}", at.sequence, at.frame + step, static_cast<int>(at.name.size()));
    return fs::exists(source_files(other).at(0).file) ? std::optional(other) : std::nullopt;
  }

 protected:
  virtual Place place(const std::string& id) const = 0;

  /// `first`: the pose at the world's origin.
  static Moment moment_at(const Place& at, const fs::path& times, const OxtsRow& pose, const OxtsRow& first,
                          const MatrixRow& velo_from_imu) {
    const double time = fs::exists(times) ? stamp_seconds(times, as_size(at.frame)) - stamp_seconds(times, 0)
                                          : at.frame * kSweepSeconds;
    return {at.sequence, at.frame, time, world_from_imu(pose, first) * rigid(velo_from_imu).inverse()};
  }
};

// KITTI's raw recordings (Geiger et al., IJRR 2013), synchronised and rectified: a folder for each day with
// its calibration, in it one for each drive. Labels are the drive's tracklets: boxes in `velo`; the 2-D boxes
// are their projections. A frame's id is DRIVE_FRAME, "2011_09_26_drive_0009_sync_0000000012". The car's pose
// is in DRIVE/oxts/data/FRAME.txt, the time in DRIVE/velodyne_points/timestamps.txt.

using tinyxml2::XMLElement;

constexpr const char* kPose = "calib_velo_to_cam.txt";
constexpr const char* kCameras = "calib_cam_to_cam.txt";
constexpr const char* kInertial = "calib_imu_to_velo.txt";
constexpr const char* kLabels = "tracklet_labels.xml";
constexpr const char* kTrackletFix = "restore the drive's tracklets";

/// Elements of a tracklet file. InputError, naming the element, if it is missing or not a number.
class Tracklets {
 public:
  explicit Tracklets(fs::path file) : file_(std::move(file)) {
    const std::string text = read_text(file_, kMaxLabelBytes);
    // A tag takes 165 bytes of memory, and so does an attribute.
    constexpr std::ptrdiff_t kMaxTags = 400000;
    if (std::count_if(text.begin(), text.end(), [](char c) { return c == '<' || c == '='; }) > kMaxTags)
      throw InputError(file_.string(), "", fmt::format("has more than {} tags and attributes", kMaxTags),
                       kTrackletFix);
    if (document_.Parse(text.data(), text.size()) != tinyxml2::XML_SUCCESS)
      throw InputError(
          file_.string(), fmt::format("line {}", document_.ErrorLineNum()),
          std::string("no XML (") + tinyxml2::XMLDocument::ErrorIDToName(document_.ErrorID()) + ")",
          kTrackletFix);
    const XMLElement* root = document_.FirstChildElement("boost_serialization");
    list_ = root != nullptr ? root->FirstChildElement("tracklets") : nullptr;
    if (list_ == nullptr) throw InputError(file_.string(), "tracklets", "missing", kTrackletFix);
  }

  const XMLElement* first() const { return list_->FirstChildElement("item"); }

  const XMLElement& child(const XMLElement& of, const char* name) const {
    const XMLElement* element = of.FirstChildElement(name);
    if (element == nullptr) throw wrong(of, name, "missing");
    return *element;
  }
  double number(const XMLElement& of, const char* name) const {
    double value = 0;
    if (child(of, name).QueryDoubleText(&value) != tinyxml2::XML_SUCCESS || !std::isfinite(value))
      throw wrong(of, name, "is not a finite number");
    return value;
  }
  int whole(const XMLElement& of, const char* name, int low, int high) const {
    const double value = number(of, name);
    if (!(value >= low && value <= high) || value != std::floor(value))
      throw wrong(of, name, fmt::format("is not a whole number from {} to {}", low, high));
    return static_cast<int>(value);
  }
  std::string text(const XMLElement& of, const char* name) const {
    const char* content = child(of, name).GetText();
    if (content == nullptr) throw wrong(of, name, "is empty");
    return content;
  }
  InputError wrong(const XMLElement& at, const char* field, const std::string& problem) const {
    return {file_.string(), fmt::format("line {}, {}", at.GetLineNum(), field), problem, kTrackletFix};
  }

 private:
  fs::path file_;
  tinyxml2::XMLDocument document_;  // refuses more than 500 nested elements
  const XMLElement* list_ = nullptr;
};

class KittiRaw : public KittiDrives {
 public:
  using KittiDrives::KittiDrives;

  const char* layout() const override { return "kitti-raw"; }

  std::vector<std::string> frames() const override {
    std::vector<std::string> ids;
    for (const fs::path& drive : drives())
      if (const fs::path sweeps = drive / "velodyne_points" / "data"; fs::is_directory(sweeps))
        add_numbered_sweeps(sweeps, drive.filename().string(), ids);
    if (ids.empty())
      throw InputError(
          data().string(), "velodyne_points/data", "no drive holds a .bin file",
          "give the folder of a day (with calib_*.txt and its *_sync folders) or of several days");
    std::sort(ids.begin(), ids.end());
    return ids;
  }

  std::vector<SourceFile> source_files(const std::string& id) const override {
    const Place at = place(id);
    std::vector<SourceFile> files = {
        {at.folder / "velodyne_points" / "data" / (at.name + ".bin"), "the sweep"},
        {picture_in(at.folder / "image_02" / "data", at.name), "the image"},
        {at.folder.parent_path() / kCameras, "the cameras' calibration"},
        {at.folder.parent_path() / kPose, "the LiDAR's calibration"}};
    if (fs::exists(at.folder / kLabels)) files.push_back({at.folder / kLabels, "the labels"});
    return files;
  }

  Annotations annotations(const std::string& id, int width, int height) const override {
    const Place at = place(id);
    const std::vector<SourceFile> files = source_files(id);
    const CalibrationFile cameras(files[2].file), pose(files[3].file);
    const MatrixRow projection = cameras.row({"P_rect_02"}, 12),
                    rectification = cameras.row({"R_rect_00"}, 9);
    Annotations result;
    result.calibration =
        calibration_of(projection, rectification, pose_row(pose, files[3].file), width, height);
    result.labelled = files.size() > 4;
    if (result.labelled)
      result.labels = read_tracklets(files[4].file, at.frame, at.number, result.calibration);
    return result;
  }

  std::optional<Moment> moment(const std::string& id) const override {
    const Place at = place(id);
    const fs::path poses = at.folder / "oxts" / "data",
                   times = at.folder / "velodyne_points" / "timestamps.txt",
                   inertial = at.folder.parent_path() / kInertial;
    // The world's origin is the drive's first row, which a partial drive may lack.
    const auto first = first_pose(poses);
    if (!first || !fs::exists(inertial)) return std::nullopt;
    return moment_at(at, times, oxts_row(poses / (at.name + ".txt"), 0), oxts_row(*first, 0),
                     pose_row(CalibrationFile(inertial), inertial));
  }

 private:
  /// R and T of a calibration file as one row of 12 numbers.
  static MatrixRow pose_row(const CalibrationFile& rows, const fs::path& file) {
    const MatrixRow r = rows.row({"R"}, 9), t = rows.row({"T"}, 3);
    MatrixRow whole{file, "R, T", {}};
    for (std::size_t row = 0; row < 3; ++row) {
      for (std::size_t column = 0; column < 3; ++column) whole.values.push_back(r.values[3 * row + column]);
      whole.values.push_back(t.values[row]);
    }
    return whole;
  }
  /// The row with the lowest number; nullopt if the folder has none.
  static std::optional<fs::path> first_pose(const fs::path& folder) {
    std::vector<fs::path> rows = entries_of(folder);
    std::erase_if(rows, [](const fs::path& row) { return row.extension() != ".txt"; });
    return rows.empty() ? std::nullopt : std::optional(*std::ranges::min_element(rows));
  }

  std::vector<fs::path> drives() const {
    std::vector<fs::path> days = {data()}, folders;
    std::error_code closed;  // an unreadable folder is not a day
    for (const auto& entry : fs::directory_iterator(data()))
      if (entry.is_directory() && fs::exists(entry.path() / kPose, closed)) days.push_back(entry.path());
    for (const fs::path& day : days)
      for (const auto& entry : fs::directory_iterator(day))
        if (entry.is_directory() && entry.path().filename().string().find("_drive_") != std::string::npos)
          folders.push_back(entry.path());
    std::sort(folders.begin(), folders.end());
    return folders;
  }

  Place place(const std::string& id) const override {
    check_id(id);
    if (const auto parts = split_id(id)) {
      const std::vector<fs::path> all = drives();
      for (std::size_t i = 0; i < all.size(); ++i)
        if (all[i].filename() == parts->first)
          return {parts->first, id.substr(parts->first.size() + 1), parts->second, i, all[i]};
    }
    throw InputError(data().string(), "frame \"" + id + "\"", "is not of any drive here",
                     "give drive and number, as 2011_09_26_drive_0009_sync_0000000012");
  }
};

// KITTI's tracking benchmark (Geiger et al., CVPR 2012): a sequence is a folder of pictures and sweeps, one
// calibration and one file of labels. A frame's id is SEQUENCE_FRAME, "0003_000012". The car's pose is in
// oxts/SEQUENCE.txt, a row a frame. times/SEQUENCE.txt has a stamp a frame as in the raw recordings; the
// benchmark itself omits it, and its sweeps came every 0.1 s.

/// The benchmark gives truncation in three steps. These shares put slightly truncated cars among the moderate
/// ones of the object benchmark, and heavily truncated cars beyond all its levels.
constexpr double kTruncated[] = {0, 0.3, 0.8};

class KittiTracking : public KittiDrives {
 public:
  explicit KittiTracking(const fs::path& data) : KittiDrives(data), part_(benchmark_part(data)) {}

  const char* layout() const override { return "kitti-tracking"; }

  std::vector<std::string> frames() const override {
    const fs::path folder = part_ / "velodyne";
    if (!fs::is_directory(folder))
      throw InputError(folder.string(), "", "no such folder", "add the tracking benchmark's sweeps");
    std::vector<std::string> ids;
    for (const auto& sequence : fs::directory_iterator(folder))
      if (sequence.is_directory())
        add_numbered_sweeps(sequence.path(), sequence.path().filename().string(), ids);
    if (ids.empty())
      throw InputError(folder.string(), "", "holds no SEQUENCE/FRAME.bin",
                       "add the tracking benchmark's sweeps");
    std::sort(ids.begin(), ids.end());
    return ids;
  }

  std::vector<SourceFile> source_files(const std::string& id) const override {
    const Place at = place(id);
    std::vector<SourceFile> files = {{part_ / "velodyne" / at.sequence / (at.name + ".bin"), "the sweep"},
                                     {picture_in(part_ / "image_02" / at.sequence, at.name), "the image"},
                                     {part_ / "calib" / (at.sequence + ".txt"), "the calibration"}};
    if (const fs::path labels = part_ / "label_02" / (at.sequence + ".txt"); fs::exists(labels))
      files.push_back({labels, "the labels"});
    return files;
  }

  Annotations annotations(const std::string& id, int width, int height) const override {
    const Place at = place(id);
    const std::vector<SourceFile> files = source_files(id);
    Annotations result;
    result.calibration = read_calibration(files[2].file, width, height);
    result.labelled = files.size() > 3;
    if (result.labelled)
      result.labels =
          read_tracking_labels(files[3].file, at.frame, at.number, result.calibration, result.notes);
    return result;
  }

  std::optional<Lighting> lighting(const std::string& id) const override {
    return generated_lighting(data(), id);
  }

  std::optional<Moment> moment(const std::string& id) const override {
    const Place at = place(id);
    const fs::path poses = part_ / "oxts" / (at.sequence + ".txt"),
                   times = part_ / "times" / (at.sequence + ".txt");
    if (!fs::exists(poses)) return std::nullopt;
    const fs::path calibration = part_ / "calib" / (at.sequence + ".txt");
    return moment_at(at, times, oxts_row(poses, as_size(at.frame)), oxts_row(poses, 0),
                     CalibrationFile(calibration).row({"Tr_imu_to_velo", "Tr_imu_velo"}, 12));
  }

 private:
  Place place(const std::string& id) const override {
    check_id(id);
    const auto parts = split_id(id);
    if (!parts)
      throw InputError(data().string(), "frame \"" + id + "\"", "is not a SEQUENCE_FRAME",
                       "give its sequence and number, as 0003_000012");
    const auto& [sequence, frame] = *parts;
    return {sequence, id.substr(sequence.size() + 1), frame, group_of(sequence), {}};
  }

  /// Group of a sequence's tracks: its number as the benchmark writes it; sequences without one follow,
  /// sorted by name.
  std::size_t group_of(const std::string& sequence) const {
    constexpr std::size_t kDigits = 4, kOthers = 10000;
    const auto is_number = [](const std::string& name) {
      return name.size() == kDigits && name.find_first_not_of("0123456789") == std::string::npos;
    };
    if (is_number(sequence)) return std::stoul(sequence);
    const std::scoped_lock lock(mutex_);
    if (others_.empty()) {
      for (const fs::path& entry : entries_of(part_ / "velodyne"))
        if (const std::string name = entry.filename().string(); !is_number(name)) others_.push_back(name);
      std::ranges::sort(others_);
    }
    return kOthers + as_size(std::ranges::lower_bound(others_, sequence) - others_.begin());
  }

  fs::path part_;                            ///< DATA/training or DATA/testing
  mutable std::mutex mutex_;                 // of what follows
  mutable std::vector<std::string> others_;  // sequences without a number
};

}  // namespace

Transform world_from_imu(const OxtsRow& row, const OxtsRow& first) {
  const double scale = std::cos(first.latitude * kDegree) * kEarthRadius;
  const auto place = [&](const OxtsRow& at) {
    return Vec3d(scale * at.longitude * kDegree,
                 scale * std::log(std::tan((90 + at.latitude) * std::numbers::pi / 360)), at.altitude);
  };
  Transform pose = Transform::Identity();
  pose.linear() = (Eigen::AngleAxisd(row.yaw, Vec3d::UnitZ()) * Eigen::AngleAxisd(row.pitch, Vec3d::UnitY()) *
                   Eigen::AngleAxisd(row.roll, Vec3d::UnitX()))
                      .toRotationMatrix();
  pose.translation() = place(row) - place(first);
  return pose;
}

std::vector<Label> read_tracklets(const fs::path& file, int frame, std::size_t drive,
                                  const Calibration& calibration) {
  const Tracklets tracklets(file);
  std::vector<Label> labels;
  std::size_t index = 0;
  for (const XMLElement* item = tracklets.first(); item != nullptr;
       item = item->NextSiblingElement("item"), ++index) {
    constexpr int kMaxFrames = 1000000;
    const int first = tracklets.whole(*item, "first_frame", 0, kMaxFrames);
    const XMLElement* pose = tracklets.child(*item, "poses").FirstChildElement("item");
    for (int passed = first; pose != nullptr && passed < frame; ++passed)
      pose = pose->NextSiblingElement("item");
    if (pose == nullptr || first > frame) continue;
    const Box3 box{
        {tracklets.number(*pose, "tx"), tracklets.number(*pose, "ty"), tracklets.number(*item, "l"),
         tracklets.number(*item, "w"), tracklets.number(*pose, "rz")},
        tracklets.number(*pose, "tz"),
        tracklets.number(*item, "h")};
    if (const std::string problem = label_problem(box); !problem.empty())
      throw tracklets.wrong(*pose, "tx", "the box " + problem);
    const std::string category = tracklets.text(*item, "objectType");
    auto label = projected_label(kitti_type(category), box, calibration);
    if (!label) continue;
    label->category = category;
    const int hidden = tracklets.whole(*pose, "occlusion", -1, 3);
    label->occluded = hidden < 0 ? 3 : hidden;  // -1: not annotated
    label->track = track_number(drive, index);
    labels.push_back(std::move(*label));
  }
  return labels;
}

std::shared_ptr<const DataSet> open_kitti_raw(const fs::path& data) {
  const auto holds_pose = [](const fs::path& folder) {
    std::error_code ignored;
    return fs::exists(folder / kPose, ignored);
  };
  if (!holds_pose(data) && std::ranges::none_of(entries_of(data), holds_pose)) return nullptr;
  return std::make_shared<KittiRaw>(data);
}

std::vector<Label> read_tracking_labels(const fs::path& file, int frame, std::size_t sequence,
                                        const Calibration& calibration, LabelNotes& notes) {
  std::vector<Label> labels;
  constexpr RowAdvice kAdvice{"17", "complete the row", "correct the label or delete its row", 2};
  for_each_row(file, kAdvice, [&](const KittiRow& source_row) {
    if (source_row.before[0] != frame) return;
    KittiRow row = source_row;
    const double step = row.value[1];
    row.demand(step == -1 || step == 0 || step == 1 || step == 2, 1, "is not one of 0, 1, 2");
    if (step > 0) row.value[1] = kTruncated[static_cast<std::size_t>(step)];
    Label label = label_of(row, calibration, notes);
    const double track = row.before[1];
    if (track >= 0 && track < static_cast<double>(kMaxVehicles) && track == std::floor(track))
      label.track = track_number(sequence, static_cast<std::size_t>(track));
    if (label.track >= 0 && std::ranges::count(labels, label.track, &Label::track) > 0)
      throw InputError(file.string(), fmt::format("row {}", row.number),
                       fmt::format("has the identity {} of a row before, in frame {}", track, frame),
                       kAdvice.fix_value);
    add_label(row, std::move(label), labels);
  });
  return labels;
}

std::shared_ptr<const DataSet> open_kitti_tracking(const fs::path& data) {
  // A folder with both benchmarks counts as the object benchmark's.
  const fs::path part = benchmark_part(data);
  if (fs::is_directory(part / "label_2") || fs::is_directory(part / "image_2") ||
      !(fs::is_directory(part / "label_02") || fs::is_directory(part / "image_02")))
    return nullptr;
  return std::make_shared<KittiTracking>(data);
}

}  // namespace mirage
