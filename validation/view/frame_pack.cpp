#include "validation/view/frame_pack.h"

#include <fmt/format.h>
#include <openssl/evp.h>
#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <string_view>

#include "base/error.h"
#include "base/fields.h"
#include "base/intervals.h"
#include "base/names.h"
#include "base/sizes.h"
#include "detection/average_precision.h"
#include "detection/car_in_picture.h"
#include "detection/defenses.h"
#include "scene/data/kitti.h"
#include "simulation/render_scene.h"

namespace mirage {
namespace {

constexpr double kReach = 327;  // m

/// Which points of `whole` are missing from `left`, both in the same order. Only those of `candidates` can
/// be.
std::vector<bool> missing(const Sweep& whole, const Sweep& candidates, const Sweep& left) {
  const auto same = [](const LidarPoint& a, const LidarPoint& b) {
    return a.position() == b.position() && a.reflectance == b.reflectance;
  };
  std::vector<bool> result(whole.size());
  std::size_t candidate = 0, at = 0;
  for (std::size_t i = 0; i < whole.size() && candidate < candidates.size(); ++i) {
    if (!same(whole[i], candidates[candidate])) continue;
    ++candidate;
    if (at < left.size() && same(whole[i], left[at]))
      ++at;
    else
      result[i] = true;
  }
  return result;
}

/// RFC 1952; a browser's DecompressionStream("gzip") undoes it.
std::string gzip(std::string_view bytes) {
  z_stream stream{};
  constexpr int kGzip = 16 + MAX_WBITS;
  if (deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, kGzip, 8, Z_DEFAULT_STRATEGY) != Z_OK)
    throw Failure("zlib", "could not start", "check the free memory");
  std::string out(deflateBound(&stream, bytes.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(out.size());
  const int status = deflate(&stream, Z_FINISH);
  out.resize(stream.total_out);
  deflateEnd(&stream);
  if (status != Z_STREAM_END) throw Failure("zlib", "did not finish", "report this as a bug");
  return out;
}

/// RFC 4648, section 4.
std::string base64(const std::string& bytes) {
  std::string text(4 * ((bytes.size() + 2) / 3) + 1, '\0');
  text.resize(as_size(EVP_EncodeBlock(reinterpret_cast<unsigned char*>(text.data()),
                                      reinterpret_cast<const unsigned char*>(bytes.data()),
                                      static_cast<int>(bytes.size()))));
  return text;
}

/// Points as columns that gzip makes small, n points each:
///   x, y, z: whole centimetres, the difference to the point before in zigzag form (0, −1, 1, −2, … as 0, 1,
///   2, 3, …),
///            low bytes of all, then high bytes of all; 6n bytes
///   reflectance: 255ths; n bytes
///   instance: as given; n bytes
/// All points lie within ±kReach; `instance` has as many values.
std::string packed_points(const Sweep& points, const std::vector<unsigned char>& instance) {
  const std::size_t n = points.size();
  std::string bytes(8 * n, '\0');
  for (int axis = 0; axis < 3; ++axis) {
    char* low = bytes.data() + 2 * n * as_size(axis);
    char* high = low + n;
    int before = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const int now = static_cast<int>(std::lround(100 * points[i].position()[axis]));
      const int step =
          now - before;  // two's complement in 17 bits at most: wraps to 16, and back in the page
      const auto wrapped = static_cast<std::int16_t>(static_cast<std::uint16_t>(step));
      const auto zigzag = static_cast<std::uint16_t>(wrapped < 0 ? -2 * wrapped - 1 : 2 * wrapped);
      low[i] = static_cast<char>(zigzag & 255);
      high[i] = static_cast<char>(zigzag >> 8);
      before = now;
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    bytes[6 * n + i] = static_cast<char>(std::lround(255 * std::clamp(points[i].reflectance, 0.0f, 1.0f)));
    bytes[7 * n + i] = static_cast<char>(instance[i]);
  }
  return bytes;
}

using nlohmann::json;

constexpr int kLowestQuality = 40, kCoarsest = 64, kPatchQuality = 92;
constexpr double kPictureShare = 0.5;  // of the limit, at most

double rounded(double value, double digits = 1e4) {
  return std::round(value * digits) / digits;
}

json page_box(const Box3& box) {
  const BevBox& b = box.bev;
  return {rounded(b.x),     rounded(b.y),        rounded(box.bottom), rounded(b.length),
          rounded(b.width), rounded(box.height), rounded(b.yaw)};
}

json page_box(const PictureBox& box) {
  return {rounded(box.left, 10), rounded(box.top, 10), rounded(box.right, 10), rounded(box.bottom, 10)};
}

json label_json(const Label& label) {
  json entry = {{"type", label.type}, {"picture", page_box(picture_box(label))}};
  if (label.camera > 0) entry["camera"] = label.camera;
  if (has_box(label)) entry["box"] = page_box(label.box);
  if (label.track >= 0) entry["track"] = label.track;
  return entry;
}

json labels_json(const ViewFrame& view) {
  std::vector<int> returns(view.frame.labels.size());
  for (const int k : view.instance)
    if (k >= 0) ++returns[as_size(k)];
  json list = json::array();
  for (std::size_t k = 0; k < view.frame.labels.size(); ++k) {
    const Label& label = view.frame.labels[k];
    json& entry = list.emplace_back(label_json(label));
    if (has_box(label))
      entry.update({{"occluded", label.occluded},
                    {"truncated", rounded(label.truncated, 100)},
                    {"returns", returns[k]}});
  }
  return list;
}

/// The camera's number in the frame; −1: it has none of that name.
int camera_number(const Frame& frame, const std::string& name) {
  for (std::size_t k = 0; k < frame.cameras(); ++k)
    if (name.empty() || frame.name_of(k) == name) return static_cast<int>(k);
  return -1;
}

/// Null if the frame was not looked at.
json detections_json(const ViewDetections& detections, const Frame& frame) {
  if (!detections.looked) return nullptr;
  json list = json::array();
  for (const KittiDetection& detection : detections.found) {
    json entry = {{"type", detection.type}, {"score", rounded(detection.score)}};
    if (detection.box) entry["box"] = page_box(*detection.box);
    if (detection.picture) entry["picture"] = page_box(*detection.picture);
    if (const int camera = camera_number(frame, detection.camera); camera != 0) entry["camera"] = camera;
    list.push_back(entry);
  }
  return list;
}

json tracks_json(const std::vector<ViewTrack>& tracks) {
  json list = json::array();
  for (const ViewTrack& track : tracks)
    list.push_back(
        {{"identity", track.identity}, {"box", page_box(track.box)}, {"detected", track.detected}});
  return list;
}

/// Blobs behind one another, and where each lies.
struct Blobs {
  std::string bytes;
  json add(const std::string& blob) {
    const std::size_t at = bytes.size();
    bytes += blob;
    return {at, blob.size()};
  }
};

std::string words(const std::vector<std::uint32_t>& values) {
  std::string bytes;
  for (const std::uint32_t value : values)
    for (int shift = 0; shift < 32; shift += 8) bytes.push_back(static_cast<char>(value >> shift & 0xff));
  return bytes;
}

bool within_reach(const LidarPoint& p) {
  return p.position().cwiseAbs().maxCoeff() < kReach;
}

/// Which points stay.
std::vector<bool> kept_points(const ViewFrame& view, int step) {
  const Sweep& sweep = view.frame.sweep;
  std::vector<bool> kept(sweep.size());
  for (std::size_t i = 0; i < sweep.size(); ++i) {
    bool needed = i % as_size(step) == 0 || view.instance[i] >= 0;
    for (const ViewAttack& attack : view.attacks) needed = needed || attack.removed[i];
    kept[i] = needed && within_reach(sweep[i]);
  }
  return kept;
}

std::string container(const ViewFrame& view, const std::vector<std::string>& photos,
                      const std::vector<bool>& kept) {
  const Frame& frame = view.frame;
  Blobs blobs;
  json about = {{"id", frame.id},
                {"cameras", json::array()},
                {"labels", labels_json(view)},
                {"true_instance", view.true_instance},
                {"found", detections_json(view.found, frame)},
                {"tracks", tracks_json(view.found.tracks)},
                {"file", detections_json(view.from_file, frame)},
                {"total", frame.sweep.size()}};
  for (std::size_t k = 0; k < frame.cameras(); ++k) {
    const Calibration& calibration = frame.calibration_of(k);
    about["cameras"].push_back({{"name", frame.name_of(k)},
                                {"size", {calibration.camera.width, calibration.camera.height}},
                                {"pixel_from_velo", pixel_from_velo(calibration)},
                                {"photo", blobs.add(photos[k])}});
  }
  Sweep points;
  std::vector<unsigned char> instance;
  std::vector<std::uint32_t> place(frame.sweep.size());
  for (std::size_t i = 0; i < frame.sweep.size(); ++i) {
    if (!kept[i]) continue;
    place[i] = static_cast<std::uint32_t>(points.size());
    points.push_back(frame.sweep[i]);
    instance.push_back(static_cast<unsigned char>(std::min(view.instance[i] + 1, 255)));
  }
  about["points"] = blobs.add(packed_points(points, instance));
  about["attacks"] = json::array();
  for (const ViewAttack& attack : view.attacks) {
    std::vector<std::uint32_t> removed;
    for (std::size_t i = 0; i < attack.removed.size(); ++i)
      if (attack.removed[i] && kept[i]) removed.push_back(place[i]);
    Sweep added = attack.added;
    std::erase_if(added, [](const LidarPoint& p) { return !within_reach(p); });
    json entry = {{"name", attack.name},
                  {"patches", json::array()},
                  {"label", attack.label},
                  {"removed", blobs.add(words(removed))},
                  {"added", blobs.add(packed_points(added, std::vector<unsigned char>(added.size())))},
                  {"found", detections_json(attack.found, frame)},
                  {"tracks", tracks_json(attack.found.tracks)},
                  {"outcome", attack.outcome}};
    if (attack.victim) entry["victim"] = *attack.victim;
    if (attack.object) entry["object"] = label_json(*attack.object);
    for (const ViewAttack::Patch& patch : attack.patches) {
      const PixelRect& r = patch.rect;
      entry["patches"].push_back({{"camera", patch.camera},
                                  {"rect", {r.u0, r.v0, r.width(), r.height()}},
                                  {"patch", blobs.add(encode_jpeg(patch.patch, kPatchQuality))}});
    }
    about["attacks"].push_back(entry);
  }
  const std::string text = json_text(about);
  return words({static_cast<std::uint32_t>(text.size())}) + text + blobs.bytes;
}

}  // namespace

void find_instances(const std::filesystem::path& data, ViewFrame& view) {
  const Frame& frame = view.frame;
  view.instance.assign(frame.sweep.size(), -1);
  const auto truth = point_label_file(data, frame.id);
  view.true_instance = std::filesystem::exists(truth);
  if (view.true_instance) {
    const auto words_of = read_point_labels(truth, frame.sweep.size());
    for (std::size_t i = 0; i < words_of.size(); ++i)
      if (const auto k = words_of[i] >> 16; k > 0 && k <= frame.labels.size())
        view.instance[i] = static_cast<int>(k) - 1;
    return;
  }
  for (std::size_t k = 0; k < frame.labels.size(); ++k) {
    const Label& label = frame.labels[k];
    if (!has_box(label)) continue;
    const double reach = std::hypot(label.box.bev.length, label.box.bev.width) / 2;
    for (std::size_t i = 0; i < frame.sweep.size(); ++i) {
      const LidarPoint& p = frame.sweep[i];
      if (view.instance[i] >= 0 || std::abs(p.x - label.box.bev.x) > reach ||
          std::abs(p.y - label.box.bev.y) > reach)
        continue;
      if (contains(label.box, p.position().cast<double>())) view.instance[i] = static_cast<int>(k);
    }
  }
}

ViewAttack attack_of(const ViewFrame& view, const PreparedFrame& prepared, const HostId& host,
                     const Simulated& simulated) {
  const Frame& seen = prepared.frame;
  ViewAttack attack;
  attack.name = host_name(host);
  attack.label = host.label;
  for (std::size_t k = 0; k < seen.cameras(); ++k)
    if (const CameraSight& sight = simulated.sight(k); !sight.rect.empty())
      attack.patches.push_back({k, sight.rect, crop(sight.image, sight.rect)});
  const auto own = simulated.sweep.end() - simulated.adversary_points;
  attack.added.assign(own, simulated.sweep.end());
  attack.removed = missing(view.frame.sweep, seen.sweep, {simulated.sweep.begin(), own});
  attack.outcome = {{"visible", simulated.best_share()},
                    {"returns", simulated.adversary_points},
                    {"removed", simulated.removed_points}};
  return attack;
}

PackedFrame pack(const ViewFrame& view, std::size_t limit, PackSettings start) {
  PackedFrame packed;
  packed.settings = start;
  packed.points = view.frame.sweep.size();
  std::vector<std::string> photos(view.frame.cameras());
  const auto encode = [&] {  // bytes of the photographs as base64
    std::size_t bytes = 0;
    for (std::size_t k = 0; k < photos.size(); ++k) {
      photos[k] = encode_jpeg(view.frame.image_of(k), packed.settings.quality);
      bytes += photos[k].size();
    }
    return 4 * bytes / 3;
  };
  while (static_cast<double>(encode()) > kPictureShare * static_cast<double>(limit) &&
         packed.settings.quality > kLowestQuality)
    packed.settings.quality -= 15;
  while (true) {
    const std::vector<bool> kept = kept_points(view, packed.settings.step);
    packed.text = base64(gzip(container(view, photos, kept)));
    packed.kept = as_size(std::count(kept.begin(), kept.end(), true));
    if (packed.text.size() <= limit) break;
    if (packed.settings.step >= kCoarsest)
      throw FieldError("size", "",
                       fmt::format("frame {} does not fit into {:.1f} MB", view.frame.id,
                                   1e-6 * static_cast<double>(limit)),
                       "give a larger --size or fewer --frames");
    packed.settings.step = std::min(kCoarsest, packed.settings.step + std::max(1, packed.settings.step / 2));
  }
  std::vector<double> heights, reflectances;
  for (const LidarPoint& p : view.frame.sweep) {
    heights.push_back(p.z);
    reflectances.push_back(p.reflectance);
  }
  if (heights.empty()) return packed;
  packed.lowest = quantile(heights, 0.01);
  packed.highest = quantile(heights, 0.99);
  packed.brightest = quantile(reflectances, 0.99);
  return packed;
}

}  // namespace mirage
