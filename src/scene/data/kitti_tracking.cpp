// KITTI's tracking benchmark (Geiger et al., CVPR 2012): a sequence is a folder of pictures and sweeps, one
// calibration and one file of labels. A frame's id is SEQUENCE_FRAME, "0003_000012". Where the car stood says
// oxts/SEQUENCE.txt, a row a frame; when, times/SEQUENCE.txt, a stamp a frame as in the raw recordings, which
// the benchmark leaves out: its sweeps came every 0.1 s.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "scene/data/kitti.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/layouts.h"
#include "scene/data/oxts.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// The benchmark tells truncation in three steps. The shares put what is cut off a little among the moderate
/// cars of the object benchmark, and what is cut off by a lot beyond all of them.
constexpr double kTruncated[] = {0, 0.3, 0.8};

class KittiTracking : public DataSet {
 public:
  explicit KittiTracking(const fs::path& data) : DataSet(data), part_(benchmark_part(data)) {}

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

  std::vector<Part> parts(const std::string& id) const override {
    const Place at = place(id);
    std::vector<Part> files = {{part_ / "velodyne" / at.sequence / (at.name + ".bin"), "the sweep"},
                               {picture_in(part_ / "image_02" / at.sequence, at.name), "the image"},
                               {part_ / "calib" / (at.sequence + ".txt"), "the calibration"}};
    if (const fs::path labels = part_ / "label_02" / (at.sequence + ".txt"); fs::exists(labels))
      files.push_back({labels, "the labels"});
    return files;
  }

  Sweep sweep(const std::string& id) const override { return read_sweep(parts(id).at(0).file); }

  Annotations annotations(const std::string& id, int width, int height) const override {
    const Place at = place(id);
    const std::vector<Part> files = parts(id);
    const CalibrationFile rows(files[2].file);
    const MatrixRow projection = rows.row({"P2"}, 12), rectification = rows.row(kRectification, 9);
    Annotations known;
    known.calibration = calibration_of(projection, rectification, rows.row(kLidarPose, 12), width, height);
    known.labelled = files.size() > 3;
    if (known.labelled)
      known.labels =
          read_tracking_labels(files[3].file, at.frame, at.sequence_number, known.calibration, known.notes);
    return known;
  }

  std::optional<Moment> moment(const std::string& id) const override {
    const Place at = place(id);
    const fs::path poses = part_ / "oxts" / (at.sequence + ".txt"),
                   times = part_ / "times" / (at.sequence + ".txt");
    if (!fs::exists(poses)) return std::nullopt;
    const auto row = static_cast<std::size_t>(at.frame);
    const auto pose = [&](std::size_t k) { return oxts_row(text_line(poses, k), poses, k); };
    const auto time = [&](std::size_t k) { return stamp_seconds(text_line(times, k), times, k); };
    const Transform velo_from_imu =
        rigid(CalibrationFile(part_ / "calib" / (at.sequence + ".txt")).row(kInertialPose, 12));
    return Moment{at.sequence, at.frame, fs::exists(times) ? time(row) - time(0) : at.frame * kSweepSeconds,
                  world_from_imu(pose(row), pose(0)) * velo_from_imu.inverse()};
  }

  std::optional<std::string> beside(const std::string& id, int step) const override {
    const Place at = place(id);
    if (at.frame + step < 0) return std::nullopt;
    const std::string other =
        fmt::format("{}_{:0{}}", at.sequence, at.frame + step, static_cast<int>(at.name.size()));
    return fs::exists(parts(other).at(0).file) ? std::optional(other) : std::nullopt;
  }

 private:
  struct Place {
    std::string sequence, name;  ///< "0003", "000012"
    int frame = 0;
    std::size_t sequence_number = 0;
  };
  Place place(const std::string& id) const {
    check_id(id);
    const auto parts = split_id(id);
    if (!parts)
      throw InputError(data().string(), "frame \"" + id + "\"", "is no SEQUENCE_FRAME",
                       "give its sequence and number, as 0003_000012");
    const auto& [sequence, frame] = *parts;
    const bool number = !sequence.empty() && sequence.size() < 7 &&
                        sequence.find_first_not_of("0123456789") == std::string::npos;
    return {sequence, id.substr(sequence.size() + 1), frame, number ? std::stoul(sequence) : 0};
  }

  fs::path part_;  ///< DATA/training or DATA/testing
};

}  // namespace

std::vector<Label> read_tracking_labels(const fs::path& file, int frame, std::size_t sequence,
                                        const Calibration& calibration, LabelNotes& notes) {
  std::vector<Label> labels;
  constexpr RowAdvice kAdvice{"17", "complete the row", "correct the label or delete its row", 2};
  for_each_row(file, kAdvice, [&](const KittiRow& given) {
    if (given.before[0] != frame) return;
    KittiRow row = given;
    const double step = row.value[1];
    row.demand(step == -1 || step == 0 || step == 1 || step == 2, 1, "is not one of 0, 1, 2");
    if (step > 0) row.value[1] = kTruncated[static_cast<std::size_t>(step)];
    Label label = label_of(row, calibration, notes);
    const double track = row.before[1];
    if (track >= 0 && track < static_cast<double>(kMostVehicles) && track == std::floor(track))
      label.track = track_number(sequence, static_cast<std::size_t>(track));
    labels.push_back(std::move(label));
  });
  return labels;
}

std::shared_ptr<const DataSet> open_kitti_tracking(const fs::path& data) {
  // Where both benchmarks lie in one folder it is the object benchmark's.
  const fs::path part = benchmark_part(data);
  if (fs::is_directory(part / "label_2") || fs::is_directory(part / "image_2") ||
      !(fs::is_directory(part / "label_02") || fs::is_directory(part / "image_02")))
    return nullptr;
  return std::make_shared<KittiTracking>(data);
}

}  // namespace mirage
