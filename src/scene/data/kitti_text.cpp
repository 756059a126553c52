// KITTI's text files: calibration and labels.
#include <fmt/format.h>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "scene/data/kitti.h"
#include "scene/data/kitti_results.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/label_types.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using Matrix34 = Eigen::Matrix<double, 3, 4>;

Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& matrix, const MatrixRow& row) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(matrix, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d rotation = svd.matrixU() * svd.matrixV().transpose();
  if ((rotation - matrix).cwiseAbs().maxCoeff() > 1e-3 || rotation.determinant() < 0)
    throw InputError(row.file.string(), row.name, "is not a rotation",
                     "restore the calibration from the recording that the frame comes from");
  return rotation;
}

/// Focal lengths (pixels), as rig files have them, and distances between sensors (m) that can be.
constexpr double kFocal[] = {1, 1e5}, kFarthest = 20;

/// A box may pass the image's edge by this much: rounding in labels.
constexpr double kEdgeTolerance = 1.0;

/// Keeps the label's box in the picture within the picture, or projects the box in space where there is none.
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

CalibrationFile::CalibrationFile(fs::path file)
    : file_(std::move(file)), text_(read_text(file_, kLargestText)) {
  for (const std::string_view line : split(text_, "\n")) {
    const std::size_t begin = line.find_first_not_of(" \t\r");
    if (begin == line.npos) continue;
    // Behind the name stands a colon, a blank or both.
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
  for (const char* known : names)
    if (const auto rows = rows_.find(known); rows != rows_.end()) {
      if (!name.empty() && rows->second.front() == found.front()) continue;  // the same under both names
      name += (name.empty() ? "" : ", ") + std::string(known);
      found.insert(found.end(), rows->second.begin(), rows->second.end());
    }
  if (found.empty())
    throw InputError(file_.string(), fmt::format("{}", fmt::join(names, " or ")), "row missing",
                     "add the row (KITTI's development kit describes it)");
  if (found.size() > 1)
    throw InputError(file_.string(), name, fmt::format("the row stands there {} times", found.size()),
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
  // Cropping shifts a principal point by a few per cent; a resized image puts it in another place altogether.
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
  // Asked this way round: numbers of 1e308 make a distance that is none.
  if (!(calibration.camera_from_rect.translation().norm() <= kFarthest))
    throw bad(projection, "its last column puts the camera more than 20 m off",
              "write it as the focal length times metres");
  if (!(calibration.camera_from_velo.translation().norm() <= kFarthest))
    throw bad(pose, "camera and LiDAR are more than 20 m apart", "write the row in metres");
  return calibration;
}

Transform rigid(const MatrixRow& row) {
  using RowMajor34 = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;
  const Matrix34 matrix = Eigen::Map<const RowMajor34>(row.values.data());
  Transform transform = Transform::Identity();
  transform.linear() = nearest_rotation(matrix.leftCols<3>(), row);
  transform.translation() = matrix.col(3);
  if (!(transform.translation().norm() <= kFarthest))
    throw InputError(row.file.string(), row.name, "moves by more than 20 m", "write the row in metres");
  return transform;
}

Calibration read_calibration(const fs::path& file, int width, int height) {
  const CalibrationFile rows(file);
  const MatrixRow projection = rows.row({"P2"}, 12), rectification = rows.row(kRectification, 9);
  return calibration_of(projection, rectification, rows.row(kLidarPose, 12), width, height);
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
  row.demand(label.in_space || label.type == "DontCare" || !empty, 8, "is no size, and the 2-D box is empty");
  clip(label, calibration, notes);
  return label;
}

std::vector<Label> read_labels(const fs::path& file, const Calibration& calibration, LabelNotes* notes) {
  constexpr RowAdvice kAdvice{"15", "complete the row", "correct the label or delete its row"};
  std::vector<Label> labels;
  LabelNotes counted;
  for_each_row(file, kAdvice,
               [&](const KittiRow& row) { labels.push_back(label_of(row, calibration, counted)); });
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
