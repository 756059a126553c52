#include "detection/detection_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "detection/upright.h"

namespace mirage {
namespace {

constexpr std::uintmax_t kLargestDetections = 1 << 26;  // bytes; half a million detections

namespace fs = std::filesystem;
using nlohmann::json;

/// The ID.txt of a folder, by ID.
std::map<std::string, fs::path> texts_of(const fs::path& folder) {
  std::map<std::string, fs::path> texts;
  for (const auto& entry : fs::directory_iterator(folder))
    if (entry.is_regular_file() && entry.path().extension() == ".txt")
      texts[entry.path().stem().string()] = entry.path();
  return texts;
}

double number(const json& from, const char* key, const fs::path& file, const std::string& where) {
  if (!from.is_object() || !from.contains(key) || !from[key].is_number() ||
      !std::isfinite(from[key].get<double>()))
    throw InputError(file.string(), where + "." + key, "is missing or not a finite number",
                     "write it again with mirage detect");
  return from[key].get<double>();
}

PictureBox picture_of(const json& from, const fs::path& file, const std::string& where) {
  return {number(from, "left", file, where), number(from, "top", file, where),
          number(from, "right", file, where), number(from, "bottom", file, where)};
}

}  // namespace

std::vector<KittiDetection> kitti_detections(std::span<const Proposal> proposals, Plane plane,
                                             const Frame& frame) {
  std::vector<KittiDetection> result;
  for (const Proposal& proposal : proposals) {
    KittiDetection detection;
    detection.score = proposal.score();
    if (plane == Plane::bev) detection.box = upright(proposal.box, frame.sweep);
    if (area(proposal.picture) > 0) detection.picture = proposal.picture;
    result.push_back(detection);
  }
  return result;
}

DetectionFiles::DetectionFiles(const fs::path& path) : path_(path) {
  const auto none = [&](const std::string& problem) {
    return InputError(path.string(), "", problem,
                      "give detections.json of mirage detect, or KITTI result files (ID.txt)");
  };
  if (!fs::exists(path)) throw none("No such file or folder");
  if (fs::is_directory(path)) {
    if (fs::exists(path / "detections.json")) {
      path_ = path / "detections.json";
    } else {
      texts_ = texts_of(path);
      if (texts_.empty() && fs::is_directory(path / "data")) texts_ = texts_of(path / "data");
      if (texts_.empty()) throw none("holds no detections");
      return;
    }
  } else if (path.extension() == ".txt") {
    texts_[path.stem().string()] = path;
    return;
  }
  const json file = read_json(path_, kLargestDetections);
  if (!file.is_object() || !file.contains("frames") || !file["frames"].is_array())
    throw InputError(path_.string(), "frames", "is missing or no list", "write it again with mirage detect");
  for (const json& frame : file["frames"]) {
    if (!frame.is_object() || !frame.contains("frame") || !frame["frame"].is_string() ||
        !frame.contains("detections") || !frame["detections"].is_array())
      throw InputError(path_.string(), fmt::format("frames.{}", frames_.size()),
                       "has no frame's name or no list of detections", "write it again with mirage detect");
    frames_[unescape_name(frame["frame"].get<std::string>())] = frame["detections"];
  }
}

bool DetectionFiles::has(const std::string& id) const {
  return texts_.contains(id) || frames_.contains(id);
}

std::vector<KittiDetection> DetectionFiles::of(const Frame& frame) const {
  std::vector<KittiDetection> detections;
  if (const auto text = texts_.find(frame.id); text != texts_.end()) {
    detections = read_results(text->second, frame.calibration);
  } else if (const auto listed = frames_.find(frame.id); listed != frames_.end()) {
    for (std::size_t i = 0; i < listed->second.size(); ++i) {
      const json& from = listed->second[i];
      const std::string where = fmt::format("frame {}, detection {}", frame.id, i);
      KittiDetection detection;
      detection.score = number(from, "score", path_, where);
      if (from.contains("left")) {  // a detector of the picture alone
        detection.picture = picture_of(from, path_, where);
      } else {
        const BevBox box{number(from, "x", path_, where), number(from, "y", path_, where),
                         number(from, "length", path_, where), number(from, "width", path_, where),
                         number(from, "yaw", path_, where)};
        detection.box = upright(box, frame.sweep);
        if (from.contains("picture"))
          detection.picture = picture_of(from["picture"], path_, where + ".picture");
      }
      detections.push_back(detection);
    }
  }
  std::stable_sort(detections.begin(), detections.end(),
                   [](const auto& a, const auto& b) { return a.score > b.score; });
  return detections;
}

}  // namespace mirage
