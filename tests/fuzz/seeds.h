// Small whole files for every parser, written by the program's own writers: where the fuzzer begins.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "attack/attack_settings.h"
#include "geometry/mesh.h"
#include "scene/frame.h"

namespace mirage::fuzz {

struct Seed {
  std::string parser, name, bytes;
};
/// At least one for every parser; all are taken by it.
std::vector<Seed> seeds();

/// A tetrahedron with one texel a face.
TexturedMesh seed_mesh();
/// KITTI's camera, 1242×375.
Calibration seed_calibration();
/// nuScenes' tables of one sample with one car.
const nlohmann::json& seed_tables();
/// What a checkpoint is asked to agree with.
nlohmann::json seed_identity();
/// Of the run that it tells of.
AttackSettings seed_settings();
/// The mesh that its run starts from: a real one has forty thousand numbers, and all of the fuzzer's time
/// goes into reading them.
TexturedMesh seed_start();
/// A checkpoint after so many steps of a run from seed_start(); with what it held out after the first.
std::string seed_checkpoint(long steps);

/// Makes the file, and its folder, or writes it anew: thousands of times a second, without the care for full
/// disks and killed processes that base/files.h takes. Nobody else may replace it.
void write_bytes(const std::filesystem::path& file, std::string_view bytes);

}  // namespace mirage::fuzz
