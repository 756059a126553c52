#include "frames/frame_provenance.h"

#include <vector>

#include "base/files.h"
#include "base/names.h"
#include "base/parallel.h"
#include "detection/detector_settings.h"
#include "detection/process_detector.h"
#include "frames/frame_store.h"
#include "scene/data/data_rig.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "scene/shape/shape_fit.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// A word as it is, a path's file name: the content counts separately.
std::string place_free(const std::string& word) {
  return escape_name(fs::path(word).has_parent_path() ? fs::path(word).filename().string() : word);
}

}  // namespace

std::string frames_hash(const fs::path& data, std::span<const std::string> ids, Cameras cameras) {
  const auto set = open_data_set(data, cameras);
  std::vector<json> frames(ids.size());
  parallel_for(ids.size(), [&](std::size_t i) {
    json& frame = frames[i] = {escape_name(ids[i]), set->hash(ids[i])};
    frame.push_back(set->tracks(ids[i]).value_or(std::vector<int>()));
    if (const auto lighting = set->lighting(ids[i])) {
      const auto& [to_sun, sun, ambient, hemisphere] = *lighting;
      for (const Vec3d* p : {&to_sun, &sun, &ambient, &hemisphere})
        frame.push_back(json::array({p->x(), p->y(), p->z()}));
    }
  });
  return content_hash(
      json{lidar_identity(lidar_of(data)), data_rig(data), recorded_lidar_effects(data), frames}.dump());
}

std::string detector_identity(const DetectorOptions& options, const std::string& version) {
  if (options.fresh || (is_outside(options) && version.empty())) return "";
  Provenance provenance;
  add_detector(provenance, options);
  if (is_outside(options)) provenance.input("version", version);
  return provenance.identity();
}

void add_data(Provenance& provenance, const fs::path& data, std::span<const std::string> ids,
              Cameras cameras) {
  provenance.input("data", frames_hash(data, ids, cameras));
  provenance.record("data", written_path(data, ""));
  provenance.record("data_hash", provenance.input("data"));
  provenance.record("frames", ids.size());
}

void add_frames(Provenance& provenance, const FrameSource& source, std::span<const HostId> hosts) {
  add_frames(provenance, source, host_frames(hosts));
}

void add_frames(Provenance& provenance, const FrameSource& source, std::span<const std::string> ids) {
  add_data(provenance, source.data, ids, source.cameras);
  provenance.add(source);
  provenance.set("rig", place_free(source.rig));
  provenance.set("depth", place_free(source.depth));
  provenance.set("rooftop", place_free(source.rooftop));
  provenance.set("placement", content_of(source.placement));
  provenance.input("lidar", lidar_identity(lidar_of(source.data, source.rig)));
  provenance.input("depth", depth_identity({source.depth}));
  provenance.input("rooftop", rooftop_identity(source.rooftop));
  if (!source.sensors.empty()) {
    provenance.set("sensors", "");  // their plugins count by content
    provenance.input("sensors", sensors_identity(source.sensors));
  }
}

void add_detector(Provenance& provenance, const DetectorOptions& options) {
  provenance.add(options);
  provenance.set("detector", place_free(options.detector));
  provenance.set("precision", usable_precision(options.precision));
  provenance.set("network_parts", options.parts);
  provenance.set("fresh", options.fresh);
  provenance.set("detector_rig", options.rig);
  if (options.classes != kCars) provenance.set("detector_classes", options.classes);
  fs::path weights;
  if (is_outside(options)) {
    if (is_program(options.detector)) {
      provenance.set("detector", "exec");             // its words count by content
      provenance.set("detector_seed", options.seed);  // which it is told
    }
    provenance.input("weights", outside_content(options));
  } else {
    provenance.file("plugin", plugin_file(options));
    weights = weights_file(options);
    provenance.input("weights", options.fresh ? "" : weights_hash(options));
    for (const DetectorOptions& auxiliary : auxiliary_detectors(options)) {
      Provenance its;
      add_detector(its, auxiliary);
      provenance.input("witness_" + auxiliary.detector, its.identity());
    }
  }
  for (const std::string& word : read_defense(options.defense).around)
    if (ceiling_height(word) > 0)  // height over the road below that unit
      provenance.input("unit_height", nlohmann::json(unit_height_of(options)).dump());
  provenance.record("detector", escape_name(options.detector));
  provenance.record("weights", weights.empty() ? "" : written_path(weights, ""));
  provenance.record("weights_hash", provenance.input("weights"));
  provenance.record("defense", options.defense);
}

}  // namespace mirage
