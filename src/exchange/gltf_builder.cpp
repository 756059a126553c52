#include "exchange/gltf_builder.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace mirage {

TextureLayout::TextureLayout(std::size_t texels) {
  const std::size_t count = std::max<std::size_t>(1, texels);
  width = static_cast<int>(std::ceil(std::sqrt(static_cast<double>(count))));
  height = static_cast<int>((count + width - 1) / width);
}

Vec2d TextureLayout::centre(std::size_t texel) const {
  return {(static_cast<double>(texel % width) + 0.5) / width,
          (static_cast<double>(texel / width) + 0.5) / height};
}

namespace {

constexpr int kFloat = 5126;         // GL component type
constexpr int kArrayBuffer = 34962;  // GL target of vertex data

void append_u32(std::string& out, std::uint32_t value) {
  for (int byte = 0; byte < 4; ++byte) out.push_back(static_cast<char>(value >> (8 * byte) & 0xff));
}

std::string padded(std::string bytes, std::size_t to, char with) {
  bytes.append((to - bytes.size() % to) % to, with);
  return bytes;
}

}  // namespace

GltfBuilder::GltfBuilder() {
  json_["asset"] = {{"version", "2.0"}, {"generator", "Mirage"}};
  json_["scene"] = 0;
  json_["scenes"] = nlohmann::json::array({nlohmann::json{{"nodes", nlohmann::json::array()}}});
}

int GltfBuilder::add(const char* array, nlohmann::json value) {
  nlohmann::json& list = json_[array];
  list.push_back(std::move(value));
  return static_cast<int>(list.size()) - 1;
}

int GltfBuilder::add_node(nlohmann::json value) {
  const int node = add("nodes", std::move(value));
  json_["scenes"][0]["nodes"].push_back(node);
  return node;
}

int GltfBuilder::add_view(const void* data, std::size_t bytes, int target) {
  binary_ = padded(std::move(binary_), 8, '\0');
  nlohmann::json view = {{"buffer", 0}, {"byteOffset", binary_.size()}, {"byteLength", bytes}};
  if (target != 0) view["target"] = target;
  binary_.append(static_cast<const char*>(data), bytes);
  return add("bufferViews", std::move(view));
}

int GltfBuilder::add_floats(const std::vector<float>& values, int components, bool with_bounds) {
  static const char* const kTypes[] = {"", "SCALAR", "VEC2", "VEC3", "VEC4"};
  nlohmann::json accessor = {{"bufferView", add_view(values, kArrayBuffer)},
                             {"componentType", kFloat},
                             {"count", values.size() / components},
                             {"type", kTypes[components]}};
  if (with_bounds) {
    std::vector<float> low(components, std::numeric_limits<float>::max()), high(components);
    for (float& value : high) value = std::numeric_limits<float>::lowest();
    for (std::size_t i = 0; i < values.size(); ++i) {
      low[i % components] = std::min(low[i % components], values[i]);
      high[i % components] = std::max(high[i % components], values[i]);
    }
    accessor["min"] = low;
    accessor["max"] = high;
  }
  return add("accessors", std::move(accessor));
}

std::string GltfBuilder::glb() const {
  nlohmann::json document = json_;
  if (!binary_.empty())
    document["buffers"] = nlohmann::json::array({nlohmann::json{{"byteLength", binary_.size()}}});
  const std::string text = padded(document.dump(), 4, ' '), binary = padded(binary_, 4, '\0');
  std::string file = "glTF";
  append_u32(file, 2);
  append_u32(file,
             static_cast<std::uint32_t>(12 + 8 + text.size() + (binary.empty() ? 0 : 8 + binary.size())));
  append_u32(file, static_cast<std::uint32_t>(text.size()));
  append_u32(file, 0x4E4F534A);  // "JSON"
  file += text;
  if (!binary.empty()) {
    append_u32(file, static_cast<std::uint32_t>(binary.size()));
    append_u32(file, 0x004E4942);  // "BIN"
    file += binary;
  }
  return file;
}

}  // namespace mirage
