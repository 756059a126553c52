// An object as a file that says where it comes from.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

#include "geometry/mesh.h"

namespace mirage {

/// As write_adversary (exchange/gltf.h), with `about` in the asset's extras as "mirage_object"; its
/// "licence", if it has one, is the asset's copyright.
void write_object(const std::filesystem::path& file, const TexturedMesh& object, const nlohmann::json& about);

}  // namespace mirage
