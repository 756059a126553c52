// KITTI's raw recordings (Geiger et al., IJRR 2013), synchronised and rectified: a folder for each day with
// its calibration, in it one for each drive. Labels are the drive's tracklets: boxes in `velo`, which the
// picture's boxes are projected from. A frame's id is DRIVE_FRAME,
// "2011_09_26_drive_0009_sync_0000000012". Where the car stood says DRIVE/oxts/data/FRAME.txt, when
// DRIVE/velodyne_points/timestamps.txt.
#include <fmt/format.h>
#include <tinyxml2.h>

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "base/files.h"
#include "scene/data/kitti.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/label_types.h"
#include "scene/data/layouts.h"
#include "scene/data/oxts.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using tinyxml2::XMLElement;

constexpr const char* kPose = "calib_velo_to_cam.txt";
constexpr const char* kCameras = "calib_cam_to_cam.txt";
constexpr const char* kInertial = "calib_imu_to_velo.txt";
constexpr const char* kLabels = "tracklet_labels.xml";
constexpr const char* kTrackletFix = "restore the drive's tracklets";

/// Elements of a tracklet file: what is missing or no number is an InputError that names it.
class Tracklets {
 public:
  explicit Tracklets(fs::path file) : file_(std::move(file)) {
    const std::string text = read_text(file_, kLargestLabels);
    // A tag takes 165 bytes of memory, an attribute as many.
    constexpr std::ptrdiff_t kMostTags = 400000;
    if (std::count_if(text.begin(), text.end(), [](char c) { return c == '<' || c == '='; }) > kMostTags)
      throw InputError(file_.string(), "", fmt::format("has more than {} tags and attributes", kMostTags),
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
      throw wrong(of, name, "is no finite number");
    return value;
  }
  int whole(const XMLElement& of, const char* name, int low, int high) const {
    const double value = number(of, name);
    if (!(value >= low && value <= high) || value != std::floor(value))
      throw wrong(of, name, fmt::format("is no whole number from {} to {}", low, high));
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
  tinyxml2::XMLDocument document_;  // refuses more than 500 elements within each other
  const XMLElement* list_ = nullptr;
};

class KittiRaw : public DataSet {
 public:
  using DataSet::DataSet;

  const char* layout() const override { return "kitti-raw"; }

  std::vector<std::string> frames() const override {
    // Drives without tracklets only where no other is there: beside labelled ones they are none that anybody
    // wants to attack.
    std::vector<std::string> ids;
    for (const bool labelled : {true, false}) {
      for (const fs::path& drive : drives()) {
        const fs::path sweeps = drive / "velodyne_points" / "data";
        if (fs::is_directory(sweeps) && fs::exists(drive / kLabels) == labelled)
          add_numbered_sweeps(sweeps, drive.filename().string(), ids);
      }
      if (!ids.empty()) break;
    }
    if (ids.empty())
      throw InputError(
          data().string(), "velodyne_points/data", "no drive holds a .bin file",
          "give the folder of a day (with calib_*.txt and its *_sync folders) or of several days");
    std::sort(ids.begin(), ids.end());
    return ids;
  }

  std::vector<Part> parts(const std::string& id) const override {
    const Place at = place(id);
    std::vector<Part> files = {{at.drive / "velodyne_points" / "data" / (at.name + ".bin"), "the sweep"},
                               {picture_in(at.drive / "image_02" / "data", at.name), "the image"},
                               {at.drive.parent_path() / kCameras, "the cameras' calibration"},
                               {at.drive.parent_path() / kPose, "the LiDAR's calibration"}};
    if (fs::exists(at.drive / kLabels)) files.push_back({at.drive / kLabels, "the labels"});
    return files;
  }

  Sweep sweep(const std::string& id) const override { return read_sweep(parts(id).at(0).file); }

  Annotations annotations(const std::string& id, int width, int height) const override {
    const Place at = place(id);
    const std::vector<Part> files = parts(id);
    const CalibrationFile cameras(files[2].file), pose(files[3].file);
    const MatrixRow projection = cameras.row({"P_rect_02"}, 12),
                    rectification = cameras.row({"R_rect_00"}, 9);
    Annotations known;
    known.calibration =
        calibration_of(projection, rectification, pose_row(pose, files[3].file), width, height);
    known.labelled = files.size() > 4;
    if (known.labelled)
      known.labels = read_tracklets(files[4].file, at.frame, at.drive_number, known.calibration);
    return known;
  }

  std::optional<Moment> moment(const std::string& id) const override {
    const Place at = place(id);
    const fs::path poses = at.drive / "oxts" / "data",
                   times = at.drive / "velodyne_points" / "timestamps.txt",
                   inertial = at.drive.parent_path() / kInertial;
    // The world's origin: the drive's first row, which a part of a drive may lack.
    const auto first = first_pose(poses);
    if (!first || !fs::exists(inertial)) return std::nullopt;
    const auto pose = [](const fs::path& file) { return oxts_row(text_line(file, 0), file, 0); };
    const auto time = [&](std::size_t k) { return stamp_seconds(text_line(times, k), times, k); };
    const Transform velo_from_imu = rigid(pose_row(CalibrationFile(inertial), inertial));
    const auto row = static_cast<std::size_t>(at.frame);
    return Moment{at.drive.filename().string(), at.frame,
                  fs::exists(times) ? time(row) - time(0) : at.frame * kSweepSeconds,
                  world_from_imu(pose(poses / (at.name + ".txt")), pose(*first)) * velo_from_imu.inverse()};
  }

  std::optional<std::string> beside(const std::string& id, int step) const override {
    const Place at = place(id);
    if (at.frame + step < 0) return std::nullopt;
    const std::string name = fmt::format("{:0{}}", at.frame + step, static_cast<int>(at.name.size()));
    if (!fs::exists(at.drive / "velodyne_points" / "data" / (name + ".bin"))) return std::nullopt;
    return at.drive.filename().string() + "_" + name;
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
  /// The row of the lowest number; none without any.
  static std::optional<fs::path> first_pose(const fs::path& folder) {
    std::optional<fs::path> first;
    std::error_code missing;
    for (fs::directory_iterator entry(folder, missing), end; !missing && entry != end;
         entry.increment(missing))
      if (entry->path().extension() == ".txt" && (!first || entry->path() < *first)) first = entry->path();
    return first;
  }

  struct Place {
    fs::path drive;
    std::string name;  ///< "0000000012"
    int frame = 0;
    std::size_t drive_number = 0;
  };

  std::vector<fs::path> drives() const {
    std::vector<fs::path> days = {data()}, folders;
    for (const auto& entry : fs::directory_iterator(data()))
      if (entry.is_directory() && fs::exists(entry.path() / kPose)) days.push_back(entry.path());
    for (const fs::path& day : days)
      for (const auto& entry : fs::directory_iterator(day))
        if (entry.is_directory() && entry.path().filename().string().find("_drive_") != std::string::npos)
          folders.push_back(entry.path());
    std::sort(folders.begin(), folders.end());
    return folders;
  }

  Place place(const std::string& id) const {
    check_id(id);
    if (const auto parts = split_id(id)) {
      const std::vector<fs::path> all = drives();
      for (std::size_t i = 0; i < all.size(); ++i)
        if (all[i].filename() == parts->first)
          return {all[i], id.substr(parts->first.size() + 1), parts->second, i};
    }
    throw InputError(data().string(), "frame \"" + id + "\"", "is of no drive here",
                     "give drive and number, as 2011_09_26_drive_0009_sync_0000000012");
  }
};

}  // namespace

std::vector<Label> read_tracklets(const fs::path& file, int frame, std::size_t drive,
                                  const Calibration& calibration) {
  const Tracklets tracklets(file);
  std::vector<Label> labels;
  std::size_t index = 0;
  for (const XMLElement* item = tracklets.first(); item != nullptr;
       item = item->NextSiblingElement("item"), ++index) {
    constexpr int kMostFrames = 1000000;
    const int first = tracklets.whole(*item, "first_frame", 0, kMostFrames);
    const XMLElement* pose = tracklets.child(*item, "poses").FirstChildElement("item");
    for (int passed = first; pose != nullptr && passed < frame; ++passed)
      pose = pose->NextSiblingElement("item");
    if (pose == nullptr || first > frame) continue;
    const Box3 box{
        {tracklets.number(*pose, "tx"), tracklets.number(*pose, "ty"), tracklets.number(*item, "l"),
         tracklets.number(*item, "w"), tracklets.number(*pose, "rz")},
        tracklets.number(*pose, "tz"),
        tracklets.number(*item, "h")};
    if (const std::string problem = box_problem(box); !problem.empty())
      throw tracklets.wrong(*pose, "tx", "the box " + problem);
    const std::string category = tracklets.text(*item, "objectType");
    auto label = projected_label(kitti_type(category), box, calibration);
    if (!label) continue;
    label->category = category;
    const int hidden = tracklets.whole(*pose, "occlusion", -1, 3);
    label->occluded = hidden < 0 ? 3 : hidden;  // -1: nobody said
    label->track = track_number(drive, index);
    labels.push_back(std::move(*label));
  }
  return labels;
}

std::shared_ptr<const DataSet> open_kitti_raw(const fs::path& data) {
  std::error_code error, ignored;
  bool found = fs::exists(data / kPose, ignored);
  for (fs::directory_iterator entry(data, error), end; !found && !error && entry != end;
       entry.increment(error))
    found = fs::exists(entry->path() / kPose, ignored);
  if (!found) return nullptr;
  return std::make_shared<KittiRaw>(data);
}

}  // namespace mirage
