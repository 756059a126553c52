#include "attack/cached_reliance.h"

#include <memory>

#include "base/disk_cache.h"
#include "base/progress.h"
#include "frames/made_of.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

constexpr const char* kKind = "reliance";

std::string key_of(const std::string& identity, const std::filesystem::path& data,
                   const std::vector<std::string>& ids) {
  Provenance made_of;
  made_of.input("detector", identity);
  made_of.input("data", frames_hash(data, ids));
  return made_of.made_of().dump();
}

}  // namespace

Reliance cached_reliance(const DetectorPool& detectors, const std::string& identity,
                         const std::filesystem::path& data, bool quiet) {
  const std::vector<std::string> ids = spread_evenly(list_frames(data), kAuditFrames);
  const auto measure = [&] {
    std::vector<Detector*> instances;
    for (const auto& detector : detectors) instances.push_back(detector.get());
    std::unique_ptr<Progress> progress;
    return measure_reliance(instances, data, ids, [&](std::size_t done, std::size_t total) {
      if (!progress) progress = std::make_unique<Progress>("use of the picture", total, quiet);
      progress->update(done);
    });
  };
  const auto disk = DiskCache::from_environment();
  if (identity.empty() || !disk->on() || !reads_picture(*detectors.front())) return measure();
  const std::string key = key_of(identity, data, ids);
  if (const auto bytes = disk->read(kKind, key)) try {
      const nlohmann::json json = nlohmann::json::parse(*bytes);
      return reliance_from_json({kKind, json, "it is measured again"});
    } catch (const std::exception&) {
      disk->report_damaged(kKind, key);
    }
  const Reliance reliance = measure();
  disk->write(kKind, key, to_json(reliance).dump());
  return reliance;
}

}  // namespace mirage
