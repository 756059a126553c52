#include <fmt/format.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/logging.h"
#include "exchange/gltf.h"
#include "exchange/gltf_builder.h"
#include "exchange/tessellation.h"
#include "tiny_gltf.h"

namespace mirage {
namespace {

class Reader {
 public:
  explicit Reader(std::filesystem::path file) : file_(std::move(file)) { load(); }

  TexturedMesh read() const {
    for (std::size_t m = 0; m < model_.meshes.size(); ++m) {
      const tinygltf::Value& extras = model_.meshes[m].extras;
      if (extras.IsObject() && extras.Has("mirage"))
        return exact(extras.Get("mirage"), fmt::format("meshes[{}].extras.mirage", m));
    }
    return foreign();
  }

  RenderScene read_scene(int width, int height) const {
    RenderScene scene;
    for_each_root([&](int root) {
      walk(root, Eigen::Affine3d::Identity(), 0,
           [&](const auto& node, const auto& field, const auto& placed) {
             if (node.mesh >= 0) scene.things.push_back(thing(node, field, placed));
           });
    });
    const tinygltf::Value* extras = scene_extras();
    if (extras && extras->Has("camera"))
      read_camera(extras->Get("camera"), "scenes[].extras.mirage.camera", scene);
    else if (!find_camera(scene, width, height))
      fail("cameras", "the scene has no camera", "add a camera, or export the scene with mirage export");
    if (extras && extras->Has("lighting")) {
      const tinygltf::Value& light = extras->Get("lighting");
      const std::string field = "scenes[].extras.mirage.lighting";
      scene.lighting.to_sun_velo = triple(light, "to_sun_velo", field).normalized();
      scene.lighting.sun = triple(light, "sun", field);
      scene.lighting.ambient = triple(light, "ambient", field);
      scene.lighting.hemisphere = triple(light, "hemisphere", field);
    } else {
      find_sun(scene.lighting);
    }
    if (extras && extras->Has("photograph")) {
      const std::string field = "scenes[].extras.mirage.photograph";
      const int image = extras->Get("photograph").GetNumberAsInt();
      if (image < 0 || static_cast<std::size_t>(image) >= model_.images.size())
        fail(field, fmt::format("image {} of {}", image, model_.images.size()));
      const auto [data, size] = view(model_.images[image].bufferView, field);
      scene.photograph = decode_srgb({reinterpret_cast<const char*>(data), size}, file_.string(), field);
      if (scene.photograph.width != scene.camera.width || scene.photograph.height != scene.camera.height)
        fail(field, fmt::format("is {}×{}, the camera {}×{}", scene.photograph.width, scene.photograph.height,
                                scene.camera.width, scene.camera.height));
    }
    return scene;
  }

 private:
  [[noreturn]] void fail(const std::string& field, const std::string& problem,
                         const std::string& fix = "export the file again") const {
    throw InputError(file_.string(), field, problem, fix);
  }

  void load() {
    const std::string bytes = read_file(file_);
    const auto u32 = [&](std::size_t at) {
      std::uint32_t value = 0;
      std::memcpy(&value, bytes.data() + at, sizeof value);
      return value;
    };
    if (bytes.size() < 20) fail("header", fmt::format("{} bytes are too few for a .glb file", bytes.size()));
    if (bytes.compare(0, 4, "glTF") != 0)
      fail("magic", "is not \"glTF\"", "give a binary glTF 2.0 file (.glb)");
    if (u32(4) != 2) fail("version", fmt::format("{}", u32(4)), "give a glTF 2.0 file");
    if (u32(8) > bytes.size())
      fail("length", fmt::format("truncated: {} of {} bytes", bytes.size(), u32(8)),
           "restore the file or export it again");
    tinygltf::TinyGLTF loader;
    // Textures of foreign files are not used, and ours come from the exact texels: no image is decoded.
    loader.SetImageLoader([](tinygltf::Image*, const int, std::string*, std::string*, int, int,
                             const unsigned char*, int, void*) { return true; },
                          nullptr);
    std::string error, warning;
    bool loaded = false;
    try {
      loaded = loader.LoadBinaryFromMemory(&model_, &error, &warning,
                                           reinterpret_cast<const unsigned char*>(bytes.data()),
                                           static_cast<unsigned>(bytes.size()));
    } catch (const std::exception& exception) {
      error = exception.what();
    }
    if (!loaded) {
      while (!error.empty() && (error.back() == '\n' || error.back() == ' ')) error.pop_back();
      for (char& c : error)
        if (c == '\n') c = ' ';
      fail(error.find("uffer") != std::string::npos ? "buffers" : "JSON",
           error.empty() ? "not readable" : error);
    }
  }

  /// Bytes of a buffer view, checked.
  std::pair<const unsigned char*, std::size_t> view(int index, const std::string& field) const {
    if (index < 0 || static_cast<std::size_t>(index) >= model_.bufferViews.size())
      fail(field, fmt::format("buffer view {} of {}", index, model_.bufferViews.size()));
    const tinygltf::BufferView& view = model_.bufferViews[index];
    if (view.buffer < 0 || static_cast<std::size_t>(view.buffer) >= model_.buffers.size())
      fail(field, fmt::format("buffer {} is missing", view.buffer));
    const auto& data = model_.buffers[view.buffer].data;
    if (view.byteOffset > data.size() || view.byteLength > data.size() - view.byteOffset)
      fail(field, fmt::format("buffer view {} runs past its buffer ({} bytes)", index, data.size()));
    return {data.data() + view.byteOffset, view.byteLength};
  }

  template <class T>
  std::vector<T> values(const tinygltf::Value& parent, const std::string& key,
                        const std::string& field) const {
    const std::string name = field + "." + key;
    if (!parent.Has(key) || !parent.Get(key).IsInt()) fail(name, "missing");
    const auto [data, size] = view(parent.Get(key).GetNumberAsInt(), name);
    if (size % (3 * sizeof(T)) != 0) fail(name, fmt::format("{} bytes are not whole triples", size));
    std::vector<T> result(size / sizeof(T));
    if (size > 0) std::memcpy(result.data(), data, size);
    return result;
  }

  TexturedMesh exact(const tinygltf::Value& source, const std::string& field) const {
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
    return textured;
  }

  /// Reads one element of an accessor as doubles.
  struct Column {
    const unsigned char* data = nullptr;
    std::size_t stride = 0, count = 0;
    int type = 0;
    double at(std::size_t row, int column) const {
      const unsigned char* p = data + row * stride;
      const auto load = [&]<class T>(T value) {
        std::memcpy(&value, p + column * sizeof(T), sizeof(T));
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

  Column column(int index, int components, bool floating, const std::string& field) const {
    if (index < 0 || static_cast<std::size_t>(index) >= model_.accessors.size())
      fail(field, fmt::format("accessor {} of {}", index, model_.accessors.size()));
    const tinygltf::Accessor& accessor = model_.accessors[index];
    if (accessor.sparse.isSparse)
      fail(field, "sparse accessors are not read", "export without sparse accessors");
    const int type = accessor.componentType;
    const bool is_float = type == TINYGLTF_COMPONENT_TYPE_FLOAT;
    const bool is_index = type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT ||
                          type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
                          type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE;
    if (tinygltf::GetNumComponentsInType(accessor.type) != components || (floating ? !is_float : !is_index))
      fail(field, "has an unexpected type", "export positions as float32 and indices as unsigned integers");
    const auto [data, size] = view(accessor.bufferView, field);
    const std::size_t element = components * tinygltf::GetComponentSizeInBytes(type);
    const std::size_t step = model_.bufferViews[accessor.bufferView].byteStride;
    const std::size_t stride = step != 0 ? step : element;
    if (accessor.byteOffset > size ||
        (accessor.count > 0 && (accessor.count - 1 > (size - accessor.byteOffset) / stride ||
                                (accessor.count - 1) * stride + element > size - accessor.byteOffset)))
      fail(field, "accessor runs past its buffer view");
    return {data + accessor.byteOffset, stride, accessor.count, type};
  }

  static Eigen::Affine3d transform(const tinygltf::Node& node) {
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

  template <class Visit>
  void for_each_root(const Visit& at_root) const {
    const std::size_t scene = model_.defaultScene >= 0 ? model_.defaultScene : 0;
    if (scene < model_.scenes.size())
      for (int node : model_.scenes[scene].nodes) at_root(node);
  }

  /// Calls enter(node, field, gltf_from_node) for a node and all below it.
  template <class Enter>
  void walk(int index, const Eigen::Affine3d& parent, int depth, const Enter& enter) const {
    const std::string field = fmt::format("nodes[{}]", index);
    if (index < 0 || static_cast<std::size_t>(index) >= model_.nodes.size()) fail(field, "missing");
    if (depth > 64) fail(field, "the node tree is too deep or has a cycle");
    const tinygltf::Node& node = model_.nodes[index];
    const Eigen::Affine3d gltf_from_node = parent * transform(node);
    enter(node, field, gltf_from_node);
    for (int child : node.children) walk(child, gltf_from_node, depth + 1, enter);
  }

  void append_mesh(const tinygltf::Node& node, const std::string& field,
                   const Eigen::Affine3d& gltf_from_node, TexturedMesh& out) const {
    if (node.mesh < 0) return;
    if (static_cast<std::size_t>(node.mesh) >= model_.meshes.size()) fail(field + ".mesh", "missing");
    const auto& primitives = model_.meshes[node.mesh].primitives;
    for (std::size_t p = 0; p < primitives.size(); ++p)
      append_primitive(primitives[p], fmt::format("meshes[{}].primitives[{}]", node.mesh, p), gltf_from_node,
                       out);
  }

  void append_primitive(const tinygltf::Primitive& primitive, const std::string& field,
                        const Eigen::Affine3d& gltf_from_node, TexturedMesh& out) const {
    if (primitive.mode != TINYGLTF_MODE_TRIANGLES && primitive.mode != -1) return;  // points and lines
    const auto position = primitive.attributes.find("POSITION");
    if (position == primitive.attributes.end()) fail(field + ".attributes.POSITION", "missing");
    const Column points = column(position->second, 3, true, field + ".attributes.POSITION");
    const int first = static_cast<int>(out.mesh.vertices.size());
    const Eigen::Affine3d velo_from_node = Eigen::Affine3d(gltf_from_velo().transpose()) * gltf_from_node;
    for (std::size_t i = 0; i < points.count; ++i)
      out.mesh.vertices.push_back(velo_from_node * Vec3d(points.at(i, 0), points.at(i, 1), points.at(i, 2)));
    Column indices;
    if (primitive.indices >= 0) indices = column(primitive.indices, 1, false, field + ".indices");
    const std::size_t corners = primitive.indices >= 0 ? indices.count : points.count;
    const auto corner = [&](std::size_t i) {
      const double at = primitive.indices >= 0 ? indices.at(i, 0) : static_cast<double>(i);
      if (at >= static_cast<double>(points.count))
        fail(field + ".indices", fmt::format("vertex {} of {}", at, points.count));
      return first + static_cast<int>(at);
    };
    Vec3d color = Vec3d::Ones();
    if (primitive.material >= 0 && static_cast<std::size_t>(primitive.material) < model_.materials.size()) {
      const auto& factor = model_.materials[primitive.material].pbrMetallicRoughness.baseColorFactor;
      if (factor.size() >= 3) color = Vec3d(factor[0], factor[1], factor[2]);
    }
    const bool mirrored = gltf_from_node.linear().determinant() < 0;
    for (std::size_t i = 0; i + 2 < corners; i += 3) {
      Face face = {corner(i), corner(i + 1), corner(i + 2)};
      if (mirrored) std::swap(face[1], face[2]);
      out.mesh.faces.push_back(face);
      out.atlas.texels.insert(out.atlas.texels.end(), out.atlas.per_face(), color);
    }
  }

  TexturedMesh foreign() const {
    TexturedMesh textured;
    textured.atlas.resolution = 1;
    for_each_root([&](int root) {
      walk(root, Eigen::Affine3d::Identity(), 0,
           [&](const auto& node, const auto& field, const auto& placed) {
             append_mesh(node, field, placed, textured);
           });
    });
    if (textured.mesh.faces.empty()) fail("meshes", "no triangles", "give a .glb with a triangle mesh");
    check_mesh(textured, file_.string());
    return textured;
  }

  // The rest is for read_scene.

  RenderScene::Thing thing(const tinygltf::Node& node, const std::string& field,
                           const Eigen::Affine3d& gltf_from_node) const {
    RenderScene::Thing result{node.name, "", {}};
    if (node.extras.IsObject() && node.extras.Has("mirage_role") && node.extras.Get("mirage_role").IsString())
      result.role = node.extras.Get("mirage_role").Get<std::string>();
    if (static_cast<std::size_t>(node.mesh) >= model_.meshes.size()) fail(field + ".mesh", "missing");
    const tinygltf::Mesh& mesh = model_.meshes[node.mesh];
    if (mesh.extras.IsObject() && mesh.extras.Has("mirage")) {
      result.textured = exact(mesh.extras.Get("mirage"), fmt::format("meshes[{}].extras.mirage", node.mesh));
      const Eigen::Affine3d turn(gltf_from_velo());
      const Eigen::Affine3d velo_from_mesh = turn.inverse() * gltf_from_node * turn;
      if (!velo_from_mesh.isApprox(Eigen::Affine3d::Identity(), 0)) {
        for (Vec3d& v : result.textured.mesh.vertices) v = velo_from_mesh * v;
        if (velo_from_mesh.linear().determinant() < 0)
          fail(field, "mirrors a mesh with exact texels", "apply the node's scale before exporting");
      }
      return result;
    }
    result.textured.atlas.resolution = 1;
    append_mesh(node, field, gltf_from_node, result.textured);
    for (const tinygltf::Primitive& primitive : mesh.primitives)
      if (primitive.material >= 0 && static_cast<std::size_t>(primitive.material) < model_.materials.size() &&
          model_.materials[primitive.material].pbrMetallicRoughness.baseColorTexture.index >= 0) {
        spdlog::warn("{}: {}: its texture is left out: only Mirage's own texels are read", file_.string(),
                     field);
        break;
      }
    check_mesh(result.textured, fmt::format("{}: {}", file_.string(), field));
    return result;
  }

  const tinygltf::Value* scene_extras() const {
    const std::size_t scene = model_.defaultScene >= 0 ? model_.defaultScene : 0;
    if (scene >= model_.scenes.size()) return nullptr;
    const tinygltf::Value& extras = model_.scenes[scene].extras;
    if (!extras.IsObject() || !extras.Has("mirage") || !extras.Get("mirage").IsObject()) return nullptr;
    return &extras.Get("mirage");
  }

  double number(const tinygltf::Value& parent, const char* key, const std::string& field) const {
    if (!parent.IsObject() || !parent.Has(key) || !parent.Get(key).IsNumber())
      fail(field + "." + key, "is not a number");
    return parent.Get(key).GetNumberAsDouble();
  }

  std::vector<double> numbers(const tinygltf::Value& parent, const char* key, std::size_t count,
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

  Vec3d triple(const tinygltf::Value& parent, const char* key, const std::string& field) const {
    return Vec3d(numbers(parent, key, 3, field).data());
  }

  void read_intrinsics(const tinygltf::Value& from, const std::string& field, PinholeCamera& camera) const {
    camera = {number(from, "fx", field),
              number(from, "fy", field),
              number(from, "cx", field),
              number(from, "cy", field),
              0,
              0};
    const double width = number(from, "width", field), height = number(from, "height", field);
    if (!(width >= 1 && width <= 32768 && height >= 1 && height <= 32768 && camera.fx > 0 && camera.fy > 0))
      fail(field, "needs fx, fy > 0 and a width and height of 1 to 32768");
    camera.width = static_cast<int>(width);
    camera.height = static_cast<int>(height);
  }

  void read_camera(const tinygltf::Value& from, const std::string& field, RenderScene& scene) const {
    read_intrinsics(from, field, scene.camera);
    const auto rows = numbers(from, "velo_from_camera", 12, field);
    Transform velo_from_camera = Transform::Identity();
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 4; ++c) velo_from_camera.matrix()(r, c) = rows[4 * r + c];
    scene.camera_from_velo = velo_from_camera.inverse();
  }

  /// The first camera node; false without one.
  bool find_camera(RenderScene& scene, int width, int height) const {
    bool found = false;
    const auto enter = [&](const tinygltf::Node& node, const std::string& field,
                           const Eigen::Affine3d& placed) {
      if (found || node.camera < 0) return;
      if (static_cast<std::size_t>(node.camera) >= model_.cameras.size()) fail(field + ".camera", "missing");
      const tinygltf::Camera& camera = model_.cameras[node.camera];
      const std::string name = fmt::format("cameras[{}]", node.camera);
      if (camera.type != "perspective") fail(name + ".type", camera.type, "give a perspective camera");
      if (camera.extras.IsObject() && camera.extras.Has("fx")) {
        read_intrinsics(camera.extras, name + ".extras", scene.camera);
      } else {
        if (width < 1 || height < 1) fail(name, "has no intrinsics in extras", "give --size WIDTHxHEIGHT");
        const double f = height / (2 * std::tan(camera.perspective.yfov / 2));
        if (!(f > 0) || !std::isfinite(f)) fail(name + ".perspective.yfov", "is no field of view");
        scene.camera = {f, f, (width - 1) / 2.0, (height - 1) / 2.0, width, height};
      }
      // glTF's camera looks along −z with y up; ours along +z with y down. A node's scale does not count.
      Eigen::Matrix3d turn = gltf_from_velo().transpose() * placed.linear();
      for (int k = 0; k < 3; ++k) turn.col(k).normalize();
      Transform velo_from_camera = Transform::Identity();
      velo_from_camera.linear() = turn * Vec3d(1, -1, -1).asDiagonal();
      velo_from_camera.translation() = gltf_from_velo().transpose() * placed.translation();
      scene.camera_from_velo = velo_from_camera.inverse();
      found = true;
    };
    for_each_root([&](int root) { walk(root, Eigen::Affine3d::Identity(), 0, enter); });
    return found;
  }

  /// The first directional light; without one the default stays.
  void find_sun(Lighting& lighting) const {
    bool found = false;
    const auto enter = [&](const tinygltf::Node& node, const std::string&, const Eigen::Affine3d& placed) {
      const auto extension = node.extensions.find("KHR_lights_punctual");
      if (found || extension == node.extensions.end() || !extension->second.Has("light")) return;
      const int index = extension->second.Get("light").GetNumberAsInt();
      if (index < 0 || static_cast<std::size_t>(index) >= model_.lights.size()) return;
      const tinygltf::Light& light = model_.lights[index];
      if (light.type != "directional") return;
      const Vec3d color =
          light.color.size() == 3 ? Vec3d(light.color[0], light.color[1], light.color[2]) : Vec3d::Ones();
      lighting.sun = color * light.intensity / std::numbers::pi;
      lighting.to_sun_velo = (gltf_from_velo().transpose() * placed.linear() * Vec3d::UnitZ()).normalized();
      found = true;
    };
    for_each_root([&](int root) { walk(root, Eigen::Affine3d::Identity(), 0, enter); });
  }

  std::filesystem::path file_;
  tinygltf::Model model_;
};

}  // namespace

TexturedMesh read_adversary(const std::filesystem::path& file) {
  return Reader(file).read();
}

RenderScene read_scene(const std::filesystem::path& file, int width, int height) {
  return Reader(file).read_scene(width, height);
}

}  // namespace mirage
