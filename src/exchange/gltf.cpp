// The two ways of reading a glTF file: as one adversary, or as a scene to draw.
#include "exchange/gltf.h"

#include <fmt/format.h>

#include <cmath>
#include <numbers>
#include <optional>
#include <set>
#include <tuple>

#include "base/files.h"
#include "base/image.h"
#include "base/names.h"
#include "base/sizes.h"
#include "exchange/gltf_document.h"
#include "exchange/gltf_model.h"
#include "scene/data/kitti.h"
#include "scene/recorded_light.h"
#include "simulation/camera_pass.h"

namespace mirage {
namespace {

using namespace gltf_limits;

/// The node's role by Mirage's extras; empty if they name no role.
std::string role_of(const tinygltf::Node& node) {
  const bool told =
      node.extras.IsObject() && node.extras.Has("mirage_role") && node.extras.Get("mirage_role").IsString();
  return told ? node.extras.Get("mirage_role").Get<std::string>() : "";
}

class SceneReader {
 public:
  explicit SceneReader(const std::filesystem::path& file) : gltf_(file), model_(gltf_.model()) {}

  RenderScene read(int width, int height) const {
    RenderScene scene;
    gltf_.walk([&](const auto& node, const auto& field, const auto& placed) {
      if (node.mesh >= 0) scene.things.push_back(thing(node, field, placed));
    });
    gltf_.warn_of_what_is_left_out();
    const tinygltf::Value* extras = gltf_.scene_extras();
    if (extras && extras->Has("camera")) {
      check_camera(scene, read_camera(extras->Get("camera"), "scenes[].extras.mirage.camera", scene), true);
    } else if (!find_camera(scene, width, height)) {
      gltf_.fail("cameras", "the scene has no camera",
                 "add a camera, or export the scene with mirage export");
    }
    if (extras && extras->Has("lighting")) {
      read_lighting(extras->Get("lighting"), "scenes[].extras.mirage.lighting", scene.lighting);
      check_sun(scene.lighting);
    } else {
      find_sun(scene.lighting);
    }
    if (extras && extras->Has("photograph"))
      read_photograph(extras->Get("photograph"), "scenes[].extras.mirage.photograph", scene);
    if (extras && extras->Has("others")) read_others(extras->Get("others"), scene);
    return scene;
  }

 private:
  void read_lighting(const tinygltf::Value& light, const std::string& field, Lighting& lighting) const {
    lighting.to_sun_velo = gltf_.triple(light, "to_sun_velo", field, -1e3, 1e3);
    if (lighting.to_sun_velo.norm() < 1e-6)
      gltf_.fail(field + ".to_sun_velo", "has no length", "give the direction towards the sun");
    lighting.to_sun_velo.normalize();
    lighting.sun = gltf_.triple(light, "sun", field, 0, kBrightest);
    lighting.ambient = gltf_.triple(light, "ambient", field, 0, kBrightest);
    lighting.hemisphere = gltf_.triple(light, "hemisphere", field, 0, kBrightest);
  }

  /// Cameras beside the first, each as the first's intrinsics and pose, its name and its photograph.
  void read_others(const tinygltf::Value& list, RenderScene& scene) const {
    constexpr std::size_t kMaxCameras = 64;
    const std::string field = "scenes[].extras.mirage.others";
    if (!list.IsArray() || list.ArrayLen() > kMaxCameras)
      gltf_.fail(field, fmt::format("is not a list of at most {} cameras", kMaxCameras));
    std::set<std::string> names = {scene.name};
    for (std::size_t i = 0; i < list.ArrayLen(); ++i) {
      const tinygltf::Value& from = list.Get(static_cast<int>(i));
      const std::string at = fmt::format("{}[{}]", field, i);
      if (!from.IsObject()) gltf_.fail(at, "is not an object");
      SceneCamera& camera = scene.others.emplace_back();
      check_camera(camera, read_camera(from, at, camera), false);
      if (!names.insert(camera.name).second)
        gltf_.fail(at + ".name", "is another camera's", "give each camera a name of its own");
      if (from.Has("photograph")) read_photograph(from.Get("photograph"), at + ".photograph", camera);
    }
  }

  void read_photograph(const tinygltf::Value& value, const std::string& field, SceneCamera& scene) const {
    const int index = value.GetNumberAsInt();
    const tinygltf::Image* image = entry(model_.images, index);
    if (!image) gltf_.fail(field, fmt::format("image {} of {}", index, model_.images.size()));
    scene.photograph = decode_srgb(gltf_.view(image->bufferView, field), gltf_.file().string(), field,
                                   {scene.camera.width, scene.camera.height});
  }

  RenderScene::Thing thing(const tinygltf::Node& node, const std::string& field,
                           const Eigen::Affine3d& gltf_from_node) const {
    RenderScene::Thing result{node.name, role_of(node), {}};
    if (auto exact = gltf_.exact(node, field, gltf_from_node)) {
      result.textured = std::move(*exact);
      return result;
    }
    result.textured.atlas.resolution = 1;
    gltf_.append_mesh(node, field, gltf_from_node, result.textured);
    check_mesh(result.textured, fmt::format("{}: {}", gltf_.file().string(), field));
    return result;
  }

  void read_intrinsics(const tinygltf::Value& from, const std::string& field, PinholeCamera& camera) const {
    camera = {gltf_.number(from, "fx", field),
              gltf_.number(from, "fy", field),
              gltf_.number(from, "cx", field),
              gltf_.number(from, "cy", field),
              0,
              0};
    const double width = gltf_.number(from, "width", field), height = gltf_.number(from, "height", field);
    if (!(width >= 1 && height >= 1 && width * height <= static_cast<double>(kMaxPixels)))
      gltf_.fail(field, fmt::format("width and height are not of a picture of 1 to {} pixels", kMaxPixels));
    const double reach = 1e3 * (width + height);  // px; beyond it a lens is none
    if (!(camera.fx > 0 && camera.fx <= reach && camera.fy > 0 && camera.fy <= reach))
      gltf_.fail(field, "fx, fy are not focal lengths in pixels");
    if (!(std::abs(camera.cx) <= reach && std::abs(camera.cy) <= reach))
      gltf_.fail(field, "cx, cy are not a principal point in pixels");
    camera.width = static_cast<int>(width);
    camera.height = static_cast<int>(height);
  }

  /// Returns velo_from_camera.
  Transform read_camera(const tinygltf::Value& from, const std::string& field, SceneCamera& scene) const {
    read_intrinsics(from, field, scene.camera);
    const auto rows = gltf_.numbers(from, "velo_from_camera", 12, field);
    Transform velo_from_camera = Transform::Identity();
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 4; ++c) velo_from_camera.matrix()(r, c) = rows[as_size(4 * r + c)];
    check_pose(velo_from_camera, field + ".velo_from_camera");
    scene.camera_from_velo = velo_from_camera.inverse();
    if (!from.Has("name")) return velo_from_camera;
    scene.name = from.Get("name").IsString() ? from.Get("name").Get<std::string>() : "";
    if (!frame_id_problem(scene.name).empty())  // pictures are named after cameras
      gltf_.fail(field + ".name", "cannot be a picture's name", "name the camera, e.g. \"CAM_BACK\"");
    return velo_from_camera;
  }

  void check_pose(const Transform& velo_from_camera, const std::string& field) const {
    const Eigen::Matrix3d turn = velo_from_camera.linear();
    if (!(velo_from_camera.translation().cwiseAbs().maxCoeff() <= kMaxCoordinate))
      gltf_.fail(field, fmt::format("the camera is not within {:g} m", kMaxCoordinate), "place it in metres");
    if (!((turn * turn.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() <= 1e-3) ||
        turn.determinant() < 0)
      gltf_.fail(field, "does not place a camera: its 3x3 part is not a rotation",
                 "write an orthonormal, right-handed [R | t]");
  }

  /// The pose of a camera's node. glTF's camera looks along −z with y up; ours along +z with y down. A node's
  /// scale does not count.
  static Transform pose_of(const Eigen::Affine3d& placed) {
    Eigen::Matrix3d turn = gltf_from_velo().transpose() * placed.linear();
    for (int k = 0; k < 3; ++k) turn.col(k).normalize();
    Transform velo_from_camera = Transform::Identity();
    velo_from_camera.linear() = turn * Vec3d(1, -1, -1).asDiagonal();
    velo_from_camera.translation() = gltf_from_velo().transpose() * placed.translation();
    return velo_from_camera;
  }

  /// Throws for an edited camera: its node, which editors change, has another pose or field of view than the
  /// extras say. `first`: the first camera, else one of the others by name. Passes if it has no node.
  void check_camera(const SceneCamera& camera, const Transform& velo_from_camera, bool first) const {
    constexpr double kSamePlace = 1e-4, kSameTurn = 1e-4;  // m, each 1 + of its distance; radians
    std::optional<std::tuple<std::string, Transform, int>> found;
    bool named = false;
    const auto enter = [&](const tinygltf::Node& node, const std::string& field,
                           const Eigen::Affine3d& placed) {
      if (node.camera < 0 || named) return;
      const std::string role = role_of(node);
      named = first ? role == "camera" : role == "other camera" && node.name == camera.name;
      // Without a role the first camera is meant, as without extras.
      if (named || (first && !found && role != "other camera"))
        found.emplace(field, pose_of(placed), node.camera);
    };
    gltf_.walk(enter);
    if (!found) return;
    const auto& [field, pose, index] = *found;
    // As add_camera turns it: extras may be no rotation to the last digit, and the node's is one.
    Eigen::Affine3d node = Eigen::Affine3d::Identity();
    node.linear() =
        Eigen::Quaterniond(gltf_from_velo() * velo_from_camera.linear() * Vec3d(1, -1, -1).asDiagonal())
            .normalized()
            .toRotationMatrix();
    const Eigen::Matrix3d turn = pose_of(node).linear();
    double angle = 0;
    if (const tinygltf::Camera* lens = entry(model_.cameras, index); lens && lens->type == "perspective")
      angle = lens->perspective.yfov - 2 * std::atan(camera.camera.height / (2 * camera.camera.fy));
    if (!((pose.linear() - turn).cwiseAbs().maxCoeff() <= kSameTurn && std::abs(angle) <= kSameTurn &&
          (pose.translation() - velo_from_camera.translation()).norm() <=
              kSamePlace * (1 + velo_from_camera.translation().norm())))
      gltf_.fail(field, "is another camera than scenes[].extras.mirage has, its exact copy",
                 "delete extras.mirage of the scene if the camera was edited");
  }

  /// The same of the sun.
  void check_sun(const Lighting& exact) const {
    constexpr double kSame = 1e-4;
    Lighting drawn;
    const std::string field = find_sun(drawn);
    if (field.empty()) return;
    if (!((drawn.to_sun_velo - exact.to_sun_velo).norm() <= kSame &&
          (drawn.sun - exact.sun).cwiseAbs().maxCoeff() <= kSame * (1e-6 + exact.sun.maxCoeff())))
      gltf_.fail(field, "is another sun than scenes[].extras.mirage has, its exact copy",
                 "delete extras.mirage of the scene if the light was edited");
  }

  /// The first camera node; false without one.
  bool find_camera(RenderScene& scene, int width, int height) const {
    bool found = false;
    const auto enter = [&](const tinygltf::Node& node, const std::string& field,
                           const Eigen::Affine3d& placed) {
      if (found || node.camera < 0) return;
      const tinygltf::Camera* lens = entry(model_.cameras, node.camera);
      if (!lens) gltf_.fail(field + ".camera", "missing");
      const tinygltf::Camera& camera = *lens;
      const std::string name = fmt::format("cameras[{}]", node.camera);
      if (camera.type != "perspective") gltf_.fail(name + ".type", camera.type, "give a perspective camera");
      if (camera.extras.IsObject() && camera.extras.Has("fx")) {
        read_intrinsics(camera.extras, name + ".extras", scene.camera);
      } else {
        if (width < 1 || height < 1)
          gltf_.fail(name, "has no intrinsics in extras", "give --size WIDTHxHEIGHT");
        const double f = height / (2 * std::tan(camera.perspective.yfov / 2));
        if (!(f > 0) || !std::isfinite(f)) gltf_.fail(name + ".perspective.yfov", "is not a field of view");
        scene.camera = {f, f, (width - 1) / 2.0, (height - 1) / 2.0, width, height};
      }
      const Transform velo_from_camera = pose_of(placed);
      check_pose(velo_from_camera, field);
      scene.camera_from_velo = velo_from_camera.inverse();
      found = true;
    };
    gltf_.walk(enter);
    return found;
  }

  /// The first directional light, and its node; without one the default stays, and it is empty.
  std::string find_sun(Lighting& lighting) const {
    std::string found;
    const auto enter = [&](const tinygltf::Node& node, const std::string& field,
                           const Eigen::Affine3d& placed) {
      const auto extension = node.extensions.find("KHR_lights_punctual");
      if (!found.empty() || extension == node.extensions.end() || !extension->second.Has("light")) return;
      const tinygltf::Light* light = entry(model_.lights, extension->second.Get("light").GetNumberAsInt());
      if (!light || light->type != "directional") return;
      const Vec3d color = light->color.size() == 3 ? Vec3d(light->color.data()) : Vec3d::Ones();
      lighting.sun = color * light->intensity / std::numbers::pi;
      lighting.to_sun_velo = gltf_from_velo().transpose() * placed.linear() * Vec3d::UnitZ();
      const double length = lighting.to_sun_velo.norm();
      if (!(length > 1e-6 && std::isfinite(length)))
        gltf_.fail(field, "turns its light nowhere", "give the light's node a rotation and no scale");
      lighting.to_sun_velo /= length;
      found = field;
    };
    gltf_.walk(enter);
    return found;
  }

  GltfModel gltf_;
  const tinygltf::Model& model_;
};

using nlohmann::json;

json vector_json(const Vec3d& v) {
  return {v.x(), v.y(), v.z()};
}

void append_position(std::vector<float>& positions, const Vec3d& p_velo) {
  const Vec3d p = gltf_from_velo() * p_velo;
  for (int k = 0; k < 3; ++k) positions.push_back(static_cast<float>(p[k]));
}

json flat_material(const std::string& name, const Vec3d& color) {
  return {{"name", name},
          {"pbrMetallicRoughness",
           {{"baseColorFactor", {color.x(), color.y(), color.z(), 1.0}},
            {"metallicFactor", 0.0},
            {"roughnessFactor", 0.5}}}};
}

/// A picture inside the file; its index among the images.
int add_picture(GltfBuilder& gltf, const std::string& name, const ImageF& linear) {
  const std::string png = encode_srgb_png(linear);
  const int view = gltf.add_view(png.data(), png.size());
  return gltf.add("images", {{"name", name}, {"mimeType", "image/png"}, {"bufferView", view}});
}

/// The texels as a picture for viewers; its index among the textures.
int add_texture(GltfBuilder& gltf, const TexelAtlas& atlas) {
  const int image = add_picture(gltf, "texels", texel_picture(atlas));
  const int sampler = gltf.add("samplers", {{"magFilter", TINYGLTF_TEXTURE_FILTER_NEAREST},
                                            {"minFilter", TINYGLTF_TEXTURE_FILTER_NEAREST},
                                            {"wrapS", TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE},
                                            {"wrapT", TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE}});
  return gltf.add("textures", {{"source", image}, {"sampler", sampler}});
}

/// Adds the exact mesh for read_adversary, without loss: float64 and int32, little endian.
json add_exact(GltfBuilder& gltf, const TexturedMesh& textured) {
  const auto& [mesh, atlas] = textured;
  const auto flat = [](const std::vector<Vec3d>& vectors) {
    std::vector<double> values;
    values.reserve(3 * vectors.size());
    for (const Vec3d& v : vectors) values.insert(values.end(), v.data(), v.data() + 3);
    return values;
  };
  std::vector<std::int32_t> indices;
  for (const Face& f : mesh.faces) indices.insert(indices.end(), f.begin(), f.end());
  json exact = {{"version", 1},
                {"vertices", gltf.add_view(flat(mesh.vertices))},
                {"faces", gltf.add_view(indices)},
                {"resolution", atlas.resolution}};
  if (!atlas.texels.empty()) {
    const TextureLayout layout(atlas.texels.size());
    exact["texels"] = gltf.add_view(flat(atlas.texels));
    exact["texture_size"] = {layout.width, layout.height};
  }
  return exact;
}

/// The adversary as a node. Positions are used as they are, so `velo` or the adversary's frame.
void add_adversary(GltfBuilder& gltf, const TexturedMesh& textured) {
  const auto& [mesh, atlas] = textured;
  const bool colored = !atlas.texels.empty();
  const TextureLayout layout(atlas.texels.size());
  const auto triangles = atlas_triangles(colored ? atlas.resolution : 1);
  std::vector<float> positions, uvs;
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const auto face = mesh.corners(mesh.faces[f]);
    for (const AtlasTriangle& triangle : triangles) {
      const Vec2d uv = layout.centre(f * atlas.per_face() + as_size(triangle.texel));
      for (const Vec3d& corner : triangle.on(face)) {
        append_position(positions, corner);
        if (colored) uvs.insert(uvs.end(), {static_cast<float>(uv.x()), static_cast<float>(uv.y())});
      }
    }
  }
  const json exact = add_exact(gltf, textured);
  json material = flat_material("adversary", colored ? Vec3d::Ones() : Vec3d::Constant(0.5));
  json attributes = {{"POSITION", gltf.add_floats(positions, 3)}};
  if (colored) {
    attributes["TEXCOORD_0"] = gltf.add_floats(uvs, 2);
    material["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", add_texture(gltf, atlas)}};
  }
  material["doubleSided"] = true;
  json primitive = {{"attributes", attributes}, {"material", gltf.add("materials", material)}};
  const int drawn = gltf.add(
      "meshes",
      {{"name", "adversary"}, {"primitives", json::array({primitive})}, {"extras", {{"mirage", exact}}}});
  gltf.add_node({{"name", "adversary"}, {"mesh", drawn}, {"extras", {{"mirage_role", "adversary"}}}});
}

void add_proxy(GltfBuilder& gltf, const ExportScene::Proxy& proxy) {
  std::vector<float> positions;  // no NORMAL: flat shading
  for (const Vec3d& v : proxy.mesh.vertices) append_position(positions, v);
  const int indices = gltf.add_corners(proxy.mesh.faces);
  const int material = gltf.add("materials", flat_material(proxy.name, proxy.color));
  json primitive = {{"attributes", {{"POSITION", gltf.add_floats(positions, 3)}}},
                    {"indices", indices},
                    {"material", material}};
  const int mesh = gltf.add("meshes", {{"name", proxy.name}, {"primitives", json::array({primitive})}});
  json extras = {{"mirage_role", proxy.name}};
  if (!proxy.shape.empty()) extras["mirage_shape"] = proxy.shape;
  gltf.add_node({{"name", proxy.name}, {"mesh", mesh}, {"extras", extras}});
}

json rotation_json(const Eigen::Matrix3d& rotation) {
  const Eigen::Quaterniond q = Eigen::Quaterniond(rotation).normalized();
  return {q.x(), q.y(), q.z(), q.w()};
}

/// The camera's node and its extras. `role`: the node's.
json add_camera(GltfBuilder& gltf, const std::string& name, const Calibration& calibration,
                const std::string& role) {
  const PinholeCamera& camera = calibration.camera;
  const Transform velo_from_camera = calibration.camera_from_velo.inverse();
  json intrinsics = {{"fx", camera.fx}, {"fy", camera.fy},       {"cx", camera.cx},
                     {"cy", camera.cy}, {"width", camera.width}, {"height", camera.height}};
  const int index =
      gltf.add("cameras", {{"name", name},
                           {"type", "perspective"},
                           {"perspective",
                            {{"yfov", 2 * std::atan(camera.height / (2 * camera.fy))},
                             {"aspectRatio", (camera.width / camera.fx) / (camera.height / camera.fy)},
                             {"znear", 0.01}}},
                           {"extras", intrinsics}});
  // glTF's camera looks along −z with y up; ours along +z with y down.
  const Eigen::Matrix3d rotation =
      gltf_from_velo() * velo_from_camera.linear() * Vec3d(1, -1, -1).asDiagonal();
  gltf.add_node({{"name", name},
                 {"camera", index},
                 {"rotation", rotation_json(rotation)},
                 {"translation", vector_json(gltf_from_velo() * velo_from_camera.translation())},
                 {"extras", {{"mirage_role", role}}}});
  json rows = json::array();
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) rows.push_back(velo_from_camera.matrix()(r, c));
  intrinsics["velo_from_camera"] = rows;
  if (name != ExportScene().camera) intrinsics["name"] = name;
  return intrinsics;
}

void add_sun(GltfBuilder& gltf, const Lighting& lighting) {
  const double strongest = std::max(1e-12, lighting.sun.maxCoeff());
  // Lighting::sun is irradiance / π; a directional light's intensity is irradiance.
  json light = {{"name", "sun"},
                {"type", "directional"},
                {"color", vector_json((lighting.sun / strongest).cwiseMax(0.0).cwiseMin(1.0))},
                {"intensity", std::numbers::pi * strongest}};
  gltf.json()["extensionsUsed"] = {"KHR_lights_punctual"};
  gltf.json()["extensions"]["KHR_lights_punctual"]["lights"] = json::array({light});
  const Eigen::Quaterniond q =
      Eigen::Quaterniond::FromTwoVectors(Vec3d::UnitZ(), gltf_from_velo() * lighting.to_sun_velo);
  gltf.add_node({{"name", "sun"},
                 {"rotation", rotation_json(q.toRotationMatrix())},
                 {"extensions", {{"KHR_lights_punctual", {{"light", 0}}}}},
                 {"extras", {{"mirage_role", "sun"}}}});
}

}  // namespace

TexturedMesh read_adversary(const std::filesystem::path& file) {
  return GltfModel(file).object();
}

RenderScene read_scene(const std::filesystem::path& file, int width, int height) {
  return SceneReader(file).read(width, height);
}

void write_adversary(const std::filesystem::path& file, const TexturedMesh& adversary, const json& about) {
  check_mesh(adversary, file.string());
  GltfBuilder gltf;
  add_adversary(gltf, adversary);
  if (!about.is_null()) {
    json& asset = gltf.json()["asset"];
    asset["extras"] = {{"mirage_object", about}};
    if (about.contains("licence")) asset["copyright"] = about.at("licence");
  }
  write_file(file, gltf.glb());
}

void write_scene(const std::filesystem::path& file, const ExportScene& scene) {
  check_mesh(scene.adversary, file.string());
  GltfBuilder gltf;
  add_adversary(gltf, scene.adversary);
  for (const ExportScene::Proxy& proxy : scene.proxies) add_proxy(gltf, proxy);
  const json camera = add_camera(gltf, scene.camera, scene.calibration, "camera");
  add_sun(gltf, scene.lighting);
  json extras = {{"camera", camera}, {"lighting", to_json(scene.lighting)}};
  if (scene.learned_on) extras["learned_on"] = *scene.learned_on;
  if (!scene.photograph.empty()) extras["photograph"] = add_picture(gltf, "photograph", scene.photograph);
  for (const SideCamera& other : scene.others) {
    json about = add_camera(gltf, other.name, other.calibration, "other camera");
    about["photograph"] = add_picture(gltf, other.name, other.image.get());
    extras["others"].push_back(about);
  }
  gltf.json()["scenes"][0]["name"] = scene.name;
  gltf.json()["scenes"][0]["extras"]["mirage"] = extras;
  write_file(file, gltf.glb());
}

Mesh ground_proxy(const Vec3d& centre) {
  constexpr double reach = 40;  // m
  Mesh ground;
  for (const Vec2d& corner :
       {Vec2d(reach, reach), Vec2d(-reach, reach), Vec2d(-reach, -reach), Vec2d(reach, -reach)})
    ground.vertices.push_back(centre + Vec3d(corner.x(), corner.y(), 0));
  ground.faces = {{0, 1, 2}, {0, 2, 3}};
  return ground;
}

ExportScene host_scene(const Frame& frame, const Placement& placement, const TexturedMesh& adversary,
                       const std::string& name) {
  ExportScene scene;
  scene.name = name;
  scene.adversary = place(adversary, placement);
  if (const auto& carrier = placement.carrier) {
    const Box3& box = carrier->label.box;
    const auto vehicle = shape_of(*carrier);
    const double ground = bounds(*vehicle).min().z();
    scene.proxies.push_back(
        {"host", carrier->shape ? "fitted" : "box", *vehicle, vehicle_paint(frame, carrier->label)});
    scene.proxies.push_back(
        {"ground", "", ground_proxy({box.bev.x, box.bev.y, ground}), Vec3d::Constant(kRoadAlbedo)});
  }
  scene.camera = frame.camera;
  scene.calibration = frame.calibration;
  scene.lighting = frame.lighting;
  scene.photograph = frame.image;
  for (const SideCamera& camera : frame.others)
    if (may_see(camera.calibration, scene.adversary.mesh, {})) scene.others.push_back(camera);
  return scene;
}

}  // namespace mirage
