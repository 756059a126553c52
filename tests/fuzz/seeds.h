// Small complete files for every parser, written by the program's own writers: the fuzzer's start corpus.
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
/// At least one for every parser; each parser accepts its own.
std::vector<Seed> seeds();

/// A tetrahedron with one texel per face.
TexturedMesh seed_mesh();
/// KITTI's camera, 1242×375.
Calibration seed_calibration();
/// nuScenes' tables of one sample with one car.
const nlohmann::json& seed_tables();
/// The identity that a checkpoint must match.
nlohmann::json seed_identity();
/// The settings of that run.
AttackSettings seed_settings();
/// The mesh that its run starts from. A real one has forty thousand numbers, and reading them would take all
/// of the fuzzer's time.
TexturedMesh seed_start();
/// A checkpoint after `steps` steps of a run from seed_start(); after the first step with its held-out part.
std::string seed_checkpoint(long steps);

/// Writes the file, and makes its folder: thousands of times a second, without the protection from full disks
/// and killed processes of base/files.h. No other process may replace it.
void write_bytes(const std::filesystem::path& file, std::string_view bytes);

}  // namespace mirage::fuzz
