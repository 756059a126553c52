#include "exchange/gltf_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "base/logging.h"
#include "base/memory.h"
#include "exchange/gltf_document.h"

namespace mirage {

TextureLayout::TextureLayout(std::size_t texels) {
  const std::size_t count = std::max<std::size_t>(1, texels);
  width = static_cast<int>(std::ceil(std::sqrt(static_cast<double>(count))));
  height = static_cast<int>((count + as_size(width) - 1) / as_size(width));
}

Vec2d TextureLayout::centre(std::size_t texel) const {
  return {(static_cast<double>(texel % as_size(width)) + 0.5) / width,
          (static_cast<double>(texel / as_size(width)) + 0.5) / height};
}

ImageF texel_picture(const TexelAtlas& atlas) {
  const TextureLayout layout(atlas.texels.size());
  ImageF picture(layout.width, layout.height, 3, 1.0f);
  for (std::size_t t = 0; t < atlas.texels.size(); ++t)
    for (int c = 0; c < 3; ++c) picture.data[3 * t + as_size(c)] = static_cast<float>(atlas.texels[t][c]);
  return picture;
}

namespace {

void append_u32(std::string& out, std::uint32_t value) {
  for (int byte = 0; byte < 4; ++byte) out.push_back(static_cast<char>(value >> (8 * byte) & 0xff));
}

std::string padded(std::string bytes, std::size_t to, char with) {
  bytes.append((to - bytes.size() % to) % to, with);
  return bytes;
}

using Files = std::map<std::string, std::string>;

/// The URI of a file of open_gltf as tinygltf decodes it: percent sequences decoded, + as a blank.
std::string tinygltf_name(std::string uri) {
  std::ranges::replace(uri, '+', ' ');
  return percent_decoded(uri).value();
}

/// tinygltf opens no file itself: it is given the buffers that open_gltf has read, and nothing else exists.
/// It is a template, so that a member that tinygltf's version lacks can be tested for.
template <typename Callbacks = tinygltf::FsCallbacks>
Callbacks only(Files& files) {
  Callbacks callbacks{};
  callbacks.FileExists = [](const std::string& name, void* file_map) {
    return static_cast<Files*>(file_map)->contains(name);
  };
  callbacks.ExpandFilePath = [](const std::string& name, void*) { return name; };
  callbacks.ReadWholeFile = [](std::vector<unsigned char>* out, std::string*, const std::string& name,
                               void* file_map) {
    const std::string& bytes = static_cast<Files*>(file_map)->at(name);
    out->assign(bytes.begin(), bytes.end());
    return true;
  };
  callbacks.WriteWholeFile = [](std::string*, const std::string&, const std::vector<unsigned char>&, void*) {
    return false;
  };
  if constexpr (requires { callbacks.GetFileSizeInBytes; })  // tinygltf 2.9
    callbacks.GetFileSizeInBytes = [](std::size_t* size, std::string*, const std::string& name,
                                      void* file_map) {
      *size = static_cast<Files*>(file_map)->at(name).size();
      return true;
    };
  callbacks.user_data = &files;
  return callbacks;
}

/// White, as glTF has it, where there is no material.
Vec3d base_color(const tinygltf::Material* material) {
  if (!material || material->pbrMetallicRoughness.baseColorFactor.size() < 3) return Vec3d::Ones();
  return Vec3d(material->pbrMetallicRoughness.baseColorFactor.data());
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

int GltfBuilder::add_floats(const std::vector<float>& values, int components) {
  nlohmann::json accessor = {{"bufferView", add_view(values, TINYGLTF_TARGET_ARRAY_BUFFER)},
                             {"componentType", TINYGLTF_COMPONENT_TYPE_FLOAT},
                             {"count", values.size() / as_size(components)},
                             {"type", components == 3 ? "VEC3" : "VEC2"}};
  if (components == 3) {
    std::vector<float> low(3, std::numeric_limits<float>::max()),
        high(3, std::numeric_limits<float>::lowest());
    for (std::size_t i = 0; i < values.size(); ++i) {
      low[i % 3] = std::min(low[i % 3], values[i]);
      high[i % 3] = std::max(high[i % 3], values[i]);
    }
    accessor["min"] = low;
    accessor["max"] = high;
  }
  return add("accessors", std::move(accessor));
}

int GltfBuilder::add_corners(const std::vector<Face>& faces) {
  std::vector<std::uint32_t> corners;
  for (const Face& f : faces) corners.insert(corners.end(), f.begin(), f.end());
  return add("accessors", {{"bufferView", add_view(corners, TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER)},
                           {"componentType", TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT},
                           {"count", corners.size()},
                           {"type", "SCALAR"}});
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

GltfModel::GltfModel(std::filesystem::path file) : file_(std::move(file)) {
  const GltfDocument document = open_gltf(file_);
  Files files;
  for (std::size_t b = 0; b < document.buffers.size(); ++b)
    if (!document.buffers[b].empty())
      files[tinygltf_name(document.json["buffers"][b]["uri"].get<std::string>())] = document.buffers[b];
  tinygltf::TinyGLTF loader;
  loader.SetFsCallbacks(only(files));
  // Textures of foreign files are not used, and ours come from the exact texels: no image is decoded.
  loader.SetImageLoader([](tinygltf::Image*, const int, std::string*, std::string*, int, int,
                           const unsigned char*, int, void*) { return true; },
                        nullptr);
  std::string error, warning;
  bool loaded = false;
  try {
    const auto size = static_cast<unsigned>(document.bytes.size());
    loaded =
        document.binary
            ? loader.LoadBinaryFromMemory(&model_, &error, &warning,
                                          reinterpret_cast<const unsigned char*>(document.bytes.data()), size)
            : loader.LoadASCIIFromString(&model_, &error, &warning, document.bytes.data(), size, "");
  } catch (const std::exception& exception) {
    error = exception.what();
  }
  if (loaded) return;
  while (!error.empty() && (error.back() == '\n' || error.back() == ' ')) error.pop_back();
  for (char& c : error)
    if (c == '\n') c = ' ';
  fail(error.find("uffer") != std::string::npos ? "buffers" : "JSON", error.empty() ? "not readable" : error);
}

void GltfModel::fail(const std::string& field, const std::string& problem, const std::string& fix) const {
  throw InputError(file_.string(), field, problem, fix);
}

std::string_view GltfModel::view(int index, const std::string& field) const {
  const tinygltf::BufferView* view = entry(model_.bufferViews, index);
  if (!view) fail(field, fmt::format("buffer view {} of {}", index, model_.bufferViews.size()));
  const tinygltf::Buffer* buffer = entry(model_.buffers, view->buffer);
  if (!buffer) fail(field, fmt::format("buffer {} is missing", view->buffer));
  const auto& data = buffer->data;
  if (view->byteOffset > data.size() || view->byteLength > data.size() - view->byteOffset)
    fail(field, fmt::format("buffer view {} runs past its buffer ({} bytes)", index, data.size()));
  return {reinterpret_cast<const char*>(data.data()) + view->byteOffset, view->byteLength};
}

template <class T>
std::vector<T> GltfModel::values(const tinygltf::Value& parent, const std::string& key,
                                 const std::string& field) const {
  const std::string name = field + "." + key;
  if (!parent.Has(key) || !parent.Get(key).IsInt()) fail(name, "missing");
  const std::string_view bytes = view(parent.Get(key).GetNumberAsInt(), name);
  if (bytes.size() % (3 * sizeof(T)) != 0)
    fail(name, fmt::format("{} bytes are not whole triples", bytes.size()));
  std::vector<T> result(bytes.size() / sizeof(T));
  copy_bytes(result.data(), bytes.data(), bytes.size());
  return result;
}

std::optional<TexturedMesh> GltfModel::exact(const tinygltf::Node& node, const std::string& field,
                                             const Eigen::Affine3d& gltf_from_node) const {
  const tinygltf::Mesh* mesh = entry(model_.meshes, node.mesh);
  if (!mesh || !mesh->extras.IsObject() || !mesh->extras.Has("mirage")) return std::nullopt;
  TexturedMesh textured =
      exact(mesh->extras.Get("mirage"), fmt::format("meshes[{}].extras.mirage", node.mesh));
  const Eigen::Affine3d turn(gltf_from_velo());
  const Eigen::Affine3d velo_from_mesh = turn.inverse() * gltf_from_node * turn;
  if (!velo_from_mesh.isApprox(Eigen::Affine3d::Identity(), 0)) {
    for (Vec3d& v : textured.mesh.vertices) v = velo_from_mesh * v;
    if (velo_from_mesh.linear().determinant() < 0)
      fail(field, "mirrors a mesh with exact texels", "apply the node's scale before exporting");
    check_reach(textured.mesh, 0, field);
  }
  check_unchanged(textured, node, field, gltf_from_node);
  return textured;
}

void GltfModel::check_unchanged(const TexturedMesh& exact, const tinygltf::Node& node,
                                const std::string& field, const Eigen::Affine3d& gltf_from_node) const {
  const std::string name = fmt::format("meshes[{}]", node.mesh);
  const auto refuse = [&](const char* what) {
    fail(name, fmt::format("has other {} than extras.mirage, its exact copy", what),
         "delete extras.mirage if the mesh was edited");
  };
  TexturedMesh drawn;
  append_mesh(node, field, gltf_from_node, drawn);
  // Mirage draws a face by a triangle a texel (write_scene), its Blender add-on by one (glb.py).
  const auto& [mesh, atlas] = exact;
  const std::size_t faces = mesh.faces.size(), triangles = drawn.mesh.faces.size();
  const bool whole = triangles == faces;
  if (!whole && (atlas.texels.empty() || triangles != faces * atlas.per_face())) refuse("triangles");
  double reach = 0;
  for (const Vec3d& v : mesh.vertices) reach = std::max(reach, v.cwiseAbs().maxCoeff());
  const double tolerance = 1e-5 * reach;  // m; positions are float32, and an editor may have turned them
  const std::vector<AtlasTriangle> parts = atlas_triangles(whole ? 1 : atlas.resolution);
  for (std::size_t i = 0; i < triangles; ++i) {
    const auto expected = parts[i % parts.size()].on(mesh.corners(mesh.faces[i / parts.size()]));
    const auto is = drawn.mesh.corners(drawn.mesh.faces[i]);
    bool same = false;
    for (std::size_t first = 0; first < 3 && !same; ++first) {  // the same triangle may begin elsewhere
      same = true;
      for (std::size_t k = 0; k < 3; ++k)
        same = same && (is[k] - expected[(k + first) % 3]).cwiseAbs().maxCoeff() <= tolerance;
    }
    if (!same) refuse("triangles");
  }
  for (const tinygltf::Primitive& primitive : model_.meshes[as_size(node.mesh)].primitives)
    if (!draws(atlas, primitive, name)) refuse("colours");
}

bool GltfModel::draws(const TexelAtlas& atlas, const tinygltf::Primitive& primitive,
                      const std::string& field) const {
  constexpr double kSameFactor = 1e-3;
  const tinygltf::Material* material = entry(model_.materials, primitive.material);
  const int texture = material ? material->pbrMetallicRoughness.baseColorTexture.index : -1;
  Vec3d expected = Vec3d::Constant(0.5);  // grey: without texels
  if (texture >= 0) {
    expected.setOnes();
  } else if (!atlas.texels.empty()) {  // the add-on's: the mean of all
    expected.setZero();
    for (const Vec3d& texel : atlas.texels) expected += texel / static_cast<double>(atlas.texels.size());
    expected = expected.cwiseMax(0).cwiseMin(1);
  }
  if (!((base_color(material) - expected).cwiseAbs().maxCoeff() <= kSameFactor)) return false;
  if (texture < 0) return true;
  if (atlas.texels.empty()) return false;
  const tinygltf::Texture* drawn = entry(model_.textures, texture);
  const tinygltf::Image* source = drawn ? entry(model_.images, drawn->source) : nullptr;
  if (!source) return false;
  if (source->bufferView < 0) {
    spdlog::warn("{}: {}: its texture lies outside the file and is not read; extras.mirage has its colours",
                 file_.string(), field);
    return true;
  }
  const TextureLayout layout(atlas.texels.size());
  const std::string name = field + ".extras.mirage.texels, drawn by baseColorTexture";
  const ImageF picture =
      decode_srgb(view(source->bufferView, name), file_.string(), name, {layout.width, layout.height});
  const auto level = [](double linear) {
    return std::lround(255 * srgb_from_linear(static_cast<float>(linear)));
  };
  for (std::size_t t = 0; t < atlas.texels.size(); ++t)
    for (std::size_t c = 0; c < 3; ++c)
      if (std::abs(level(picture.data[3 * t + c]) - level(atlas.texels[t][static_cast<Eigen::Index>(c)])) > 1)
        return false;
  return true;
}

TexturedMesh GltfModel::exact(const tinygltf::Value& source, const std::string& field) const {
  if (!source.IsObject()) fail(field, "is not an object");
  const auto vectors = [&](const char* key) {
    const auto flat = values<double>(source, key, field);
    std::vector<Vec3d> result(flat.size() / 3);
    for (std::size_t i = 0; i < result.size(); ++i)
      result[i] = Vec3d(flat[3 * i], flat[3 * i + 1], flat[3 * i + 2]);
    return result;
  };
  TexturedMesh textured;
  textured.mesh.vertices = vectors("vertices");
  const auto indices = values<std::int32_t>(source, "faces", field);
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3)
    textured.mesh.faces.push_back({indices[i], indices[i + 1], indices[i + 2]});
  const int resolution = source.Has("resolution") ? source.Get("resolution").GetNumberAsInt() : 0;
  if (resolution < 1 || resolution > 1024) fail(field + ".resolution", fmt::format("{}", resolution));
  textured.atlas.resolution = resolution;
  if (source.Has("texels")) textured.atlas.texels = vectors("texels");
  check_mesh(textured, file_.string());
  check_reach(textured.mesh, 0, field + ".vertices");
  for (std::size_t t = 0; t < textured.atlas.texels.size(); ++t)
    if (textured.atlas.texels[t].cwiseAbs().maxCoeff() > gltf_limits::kBrightest)
      fail(field + ".texels", fmt::format("texel {} is not an albedo", t));
  return textured;
}

void GltfModel::check_reach(const Mesh& mesh, std::size_t first, const std::string& field) const {
  for (std::size_t v = first; v < mesh.vertices.size(); ++v)
    if (!(mesh.vertices[v].cwiseAbs().maxCoeff() <= gltf_limits::kMaxCoordinate))
      fail(field, fmt::format("vertex {} is not within {:g} m", v - first, gltf_limits::kMaxCoordinate),
           "export the mesh in metres");
}

/// Reads one element of an accessor as doubles.
struct GltfModel::Column {
  const char* data = nullptr;
  std::size_t stride = 0, count = 0;
  int type = 0;
  double at(std::size_t row, int column) const {
    const char* p = data + row * stride;
    const auto load = [&]<class T>(T value) {
      std::memcpy(&value, p + as_size(column) * sizeof(T), sizeof(T));
      return static_cast<double>(value);
    };
    switch (type) {
      case TINYGLTF_COMPONENT_TYPE_FLOAT:
        return load(float{});
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
        return load(std::uint32_t{});
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return load(std::uint16_t{});
      default:
        return load(std::uint8_t{});
    }
  }
};

GltfModel::Column GltfModel::column(int index, int components, bool floating,
                                    const std::string& field) const {
  const tinygltf::Accessor* found = entry(model_.accessors, index);
  if (!found) fail(field, fmt::format("accessor {} of {}", index, model_.accessors.size()));
  const tinygltf::Accessor& accessor = *found;
  if (accessor.sparse.isSparse)
    fail(field, "sparse accessors are not read", "export without sparse accessors");
  const int type = accessor.componentType;
  const bool is_float = type == TINYGLTF_COMPONENT_TYPE_FLOAT;
  const bool is_index = type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT ||
                        type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
                        type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE;
  if (tinygltf::GetNumComponentsInType(static_cast<std::uint32_t>(accessor.type)) != components ||
      (floating ? !is_float : !is_index))
    fail(field, "has an unexpected type", "export positions as float32 and indices as unsigned integers");
  const std::string_view bytes = view(accessor.bufferView, field);
  const std::size_t element =
      as_size(components * tinygltf::GetComponentSizeInBytes(static_cast<std::uint32_t>(type)));
  const std::size_t step = model_.bufferViews[as_size(accessor.bufferView)].byteStride;
  const std::size_t stride = step != 0 ? step : element;
  if (accessor.byteOffset > bytes.size() ||
      (accessor.count > 0 && (accessor.count - 1 > (bytes.size() - accessor.byteOffset) / stride ||
                              (accessor.count - 1) * stride + element > bytes.size() - accessor.byteOffset)))
    fail(field, "accessor runs past its buffer view");
  return {bytes.data() + accessor.byteOffset, stride, accessor.count, type};
}

Eigen::Affine3d GltfModel::transform(const tinygltf::Node& node) {
  Eigen::Affine3d result = Eigen::Affine3d::Identity();
  if (node.matrix.size() == 16) {
    result.matrix() = Eigen::Map<const Eigen::Matrix4d>(node.matrix.data());
    return result;
  }
  if (node.translation.size() == 3)
    result.translate(Vec3d(node.translation[0], node.translation[1], node.translation[2]));
  if (node.rotation.size() == 4)
    result.rotate(Eigen::Quaterniond(node.rotation[3], node.rotation[0], node.rotation[1], node.rotation[2])
                      .normalized());
  if (node.scale.size() == 3) result.scale(Vec3d(node.scale[0], node.scale[1], node.scale[2]));
  return result;
}

void GltfModel::append_mesh(const tinygltf::Node& node, const std::string& field,
                            const Eigen::Affine3d& gltf_from_node, TexturedMesh& out) const {
  if (node.mesh < 0) return;
  const tinygltf::Mesh* mesh = entry(model_.meshes, node.mesh);
  if (!mesh) fail(field + ".mesh", "missing");
  for (std::size_t p = 0; p < mesh->primitives.size(); ++p)
    append_primitive(mesh->primitives[p], fmt::format("meshes[{}].primitives[{}]", node.mesh, p),
                     gltf_from_node, out);
}

void GltfModel::append_primitive(const tinygltf::Primitive& primitive, const std::string& field,
                                 const Eigen::Affine3d& gltf_from_node, TexturedMesh& out) const {
  if (primitive.mode >= TINYGLTF_MODE_POINTS && primitive.mode <= TINYGLTF_MODE_LINE_STRIP) return;
  const auto position = primitive.attributes.find("POSITION");
  if (position == primitive.attributes.end()) fail(field + ".attributes.POSITION", "missing");
  const Column points = column(position->second, 3, true, field + ".attributes.POSITION");
  const int first = static_cast<int>(out.mesh.vertices.size());
  const Eigen::Affine3d velo_from_node = Eigen::Affine3d(gltf_from_velo().transpose()) * gltf_from_node;
  for (std::size_t i = 0; i < points.count; ++i)
    out.mesh.vertices.push_back(velo_from_node * Vec3d(points.at(i, 0), points.at(i, 1), points.at(i, 2)));
  check_reach(out.mesh, as_size(first), field + ".attributes.POSITION");
  Column indices;
  if (primitive.indices >= 0) indices = column(primitive.indices, 1, false, field + ".indices");
  const std::size_t corners = primitive.indices >= 0 ? indices.count : points.count;
  const auto corner = [&](std::size_t i) {
    const double at = primitive.indices >= 0 ? indices.at(i, 0) : static_cast<double>(i);
    if (at >= static_cast<double>(points.count))
      fail(field + ".indices", fmt::format("vertex {} of {}", at, points.count));
    return first + static_cast<int>(at);
  };
  const Vec3d color = base_color(entry(model_.materials, primitive.material));
  const bool mirrored = gltf_from_node.linear().determinant() < 0;
  const bool strip = primitive.mode == TINYGLTF_MODE_TRIANGLE_STRIP,
             fan = primitive.mode == TINYGLTF_MODE_TRIANGLE_FAN;
  for (std::size_t i = 0; i + 2 < corners; i += strip || fan ? 1 : 3) {
    // glTF 2.0, section 3.7.2.1
    Face face =
        fan ? Face{corner(i + 1), corner(i + 2), corner(0)}
            : Face{corner(i), corner(strip ? i + 1 + i % 2 : i + 1), corner(strip ? i + 2 - i % 2 : i + 2)};
    if (mirrored) std::swap(face[1], face[2]);
    out.mesh.faces.push_back(face);
    out.atlas.texels.insert(out.atlas.texels.end(), out.atlas.per_face(), color);
  }
}

TexturedMesh GltfModel::triangles() const {
  TexturedMesh textured;
  textured.atlas.resolution = 1;
  walk([&](const auto& node, const auto& field, const auto& placed) {
    append_mesh(node, field, placed, textured);
  });
  if (textured.mesh.faces.empty()) fail("meshes", "no triangles", "give a glTF file with a triangle mesh");
  check_mesh(textured, file_.string());
  warn_of_what_is_left_out();
  return textured;
}

TexturedMesh GltfModel::object() const {
  std::optional<TexturedMesh> own;
  int others = 0;
  walk([&](const auto& node, const auto& field, const auto& placed) {
    if (auto mesh = own ? std::nullopt : exact(node, field, placed))
      own = std::move(mesh);
    else
      others += node.mesh >= 0;
  });
  if (!own) return triangles();
  if (others > 0 && !scene_extras())  // a scene of Mirage's has the car and the ground beside it
    fail("nodes", fmt::format("{} meshes beside the one that Mirage wrote", others),
         "delete them, or extras.mirage of that one if all are the object");
  return std::move(*own);
}

void GltfModel::warn_of_what_is_left_out() const {
  std::set<std::string> names;
  const auto look_at = [&](const tinygltf::Material& material) {
    if (material.pbrMetallicRoughness.baseColorTexture.index >= 0)
      names.insert("textures (baseColorTexture)");
    if (material.alphaMode != "OPAQUE") names.insert("transparency (alphaMode " + material.alphaMode + ")");
    if (material.emissiveTexture.index >= 0 ||
        std::any_of(material.emissiveFactor.begin(), material.emissiveFactor.end(),
                    [](double e) { return e > 0; }))
      names.insert("emission (emissiveFactor)");
    for (const auto& [name, value] : material.extensions) names.insert(name);
  };
  for (const tinygltf::Mesh& mesh : model_.meshes) {
    if (mesh.extras.IsObject() && mesh.extras.Has("mirage")) continue;
    for (const tinygltf::Primitive& primitive : mesh.primitives) {
      if (primitive.extensions.contains("KHR_materials_variants")) names.insert("KHR_materials_variants");
      for (const auto& [name, accessor] : primitive.attributes)
        if (name.starts_with("COLOR_")) names.insert("vertex colours (" + name + ")");
      if (primitive.mode >= TINYGLTF_MODE_POINTS && primitive.mode <= TINYGLTF_MODE_LINE_STRIP)
        names.insert("points and lines");
      if (const tinygltf::Material* material = entry(model_.materials, primitive.material))
        look_at(*material);
    }
  }
  if (!model_.animations.empty()) names.insert("animations");
  if (!names.empty())
    spdlog::warn("{}: left out: {}; each face has its material's baseColorFactor", file_.string(),
                 fmt::join(names, ", "));
}

const tinygltf::Value* GltfModel::scene_extras() const {
  const tinygltf::Scene* scene = default_scene();
  if (!scene || !scene->extras.IsObject() || !scene->extras.Has("mirage")) return nullptr;
  const tinygltf::Value& extras = scene->extras.Get("mirage");
  return extras.IsObject() ? &extras : nullptr;
}

double GltfModel::number(const tinygltf::Value& parent, const char* key, const std::string& field) const {
  if (!parent.IsObject() || !parent.Has(key) || !parent.Get(key).IsNumber())
    fail(field + "." + key, "is not a number");
  return parent.Get(key).GetNumberAsDouble();
}

std::vector<double> GltfModel::numbers(const tinygltf::Value& parent, const char* key, std::size_t count,
                                       const std::string& field) const {
  const std::string name = field + "." + key;
  if (!parent.IsObject() || !parent.Has(key) || !parent.Get(key).IsArray() ||
      parent.Get(key).ArrayLen() != count)
    fail(name, fmt::format("is not a list of {} numbers", count));
  std::vector<double> result;
  for (std::size_t i = 0; i < count; ++i) {
    const tinygltf::Value& value = parent.Get(key).Get(static_cast<int>(i));
    if (!value.IsNumber()) fail(name, "holds something that is not a number");
    result.push_back(value.GetNumberAsDouble());
  }
  return result;
}

Vec3d GltfModel::triple(const tinygltf::Value& parent, const char* key, const std::string& field, double low,
                        double high) const {
  const Vec3d values(numbers(parent, key, 3, field).data());
  if (!(values.minCoeff() >= low && values.maxCoeff() <= high))
    fail(field + "." + key, "is out of range", fmt::format("write numbers from {:g} to {:g}", low, high));
  return values;
}

}  // namespace mirage
