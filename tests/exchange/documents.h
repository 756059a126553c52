// Small glTF documents that tests damage.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "base/files.h"
#include "exchange/gltf_model.h"

namespace mirage::test {

/// A triangle's positions as float32: 36 bytes.
inline std::string triangle_bytes() {
  const float values[] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  return {reinterpret_cast<const char*>(values), sizeof values};
}

/// A triangle whose buffer has the given `uri`.
inline nlohmann::json triangle_document(const nlohmann::json& uri) {
  return {{"asset", {{"version", "2.0"}}},
          {"buffers", {{{"byteLength", 36}, {"uri", uri}}}},
          {"bufferViews", {{{"buffer", 0}, {"byteLength", 36}}}},
          {"accessors",
           {{{"bufferView", 0},
             {"componentType", 5126},
             {"count", 3},
             {"type", "VEC3"},
             {"min", {0, 0, 0}},
             {"max", {1, 1, 0}}}}},
          {"meshes", {{{"primitives", {{{"attributes", {{"POSITION", 0}}}}}}}}},
          {"nodes", {{{"mesh", 0}}}},
          {"scenes", {{{"nodes", {0}}}}},
          {"scene", 0}};
}

inline void write_glb(const std::filesystem::path& file, const nlohmann::json& document) {
  GltfBuilder gltf;
  gltf.json() = document;
  write_file(file, gltf.glb());
}

}  // namespace mirage::test
