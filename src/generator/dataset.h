// A whole generated data set on disk.
#pragma once

#include <functional>
#include <nlohmann/json.hpp>

#include "generator/generator.h"
#include "scene/data/truth_files.h"

namespace mirage {

/// Changes whenever the same seed gives other frames.
inline constexpr int kGeneratorVersion = 5;

/// Counts over the frames written in this run.
struct DatasetSummary {
  int written = 0, kept = 0, cars = 0, others = 0;
  std::size_t points = 0;
};

/// Makes the folder with rig.toml and dataset.json (`about`), or takes it up again; InputError if it was made
/// of another rig or with other fields.
void begin_dataset(const Rig& rig, const nlohmann::json& about, const std::filesystem::path& out);

/// Writes frames [first, first + count) of (rig, seed) to `out` and dataset.json. Frames whose files are as
/// recorded (frame_record.h) are kept (a set made with less truth can be given more later: the other files
/// come out the same); a folder made with another rig, seed or generator version is refused (InputError).
/// Several frames are made at once. After Ctrl-C the frames in hand are finished and Interrupted is thrown.
DatasetSummary generate_dataset(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                                const std::filesystem::path& out,
                                const std::function<void(std::size_t done)>& tell, Truth truth = Truth::none);

}  // namespace mirage
