// glTF: lossless round trip, exact colours in every viewer, Khronos' validator, malformed files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <cstring>
#include <functional>
#include <utility>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "base/sizes.h"
#include "exchange/gltf.h"
#include "exchange/gltf_model.h"
#include "exchange/mesh_files.h"
#include "geometry/mesh.h"
#include "sensors/soft_rasterizer.h"
#include "support/files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

fs::path scratch(const std::string& name) {
  const fs::path folder = fs::path(MIRAGE_BUILD) / "test-exchange";
  fs::create_directories(folder);
  return folder / name;
}

/// A noisy adversary in the open: awkward doubles everywhere.
TexturedMesh noisy_adversary(int resolution = 5) {
  RandomStream random(7, "noisy adversary");
  TexturedMesh textured{icosphere(2), {resolution, {}}};
  for (Vec3d& v : textured.mesh.vertices)
    v = v.cwiseProduct(Vec3d(0.7, 0.6, 0.4)) * (1 + 0.2 * random.normal() / 3) + Vec3d(1e-17, 1.0 / 3, 0.1);
  textured.atlas.texels.resize(textured.mesh.faces.size() * textured.atlas.per_face());
  for (Vec3d& t : textured.atlas.texels) t = Vec3d{random.uniform(), random.uniform(), random.uniform()};
  return textured;
}

/// The host as its labelled box, or as a fitted vehicle.
ExportScene scene(bool fitted = false) {
  const Vec3d half(2.0, 0.8, 0.7);
  Frame frame;
  frame.image = ImageF(1242, 375, 3, 0.2f);
  frame.calibration.camera = {721.5377, 721.5377, 609.5593, 172.854, 1242, 375};
  frame.calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  frame.calibration.camera_from_velo.translation() = Vec3d(0.06, -0.08, -0.27);
  Label host;
  host.left = 500, host.top = 150, host.right = 640, host.bottom = 220;
  host.box = {{12, 1, 4.1, 1.7, 0.3}, -1.7, 1.5};
  Carrier carrier = BoxRoofFinder().find(frame, host);
  if (fitted) {
    Mesh vehicle = icosphere(3);
    for (Vec3d& v : vehicle.vertices) v = velo_from_box(host.box) * (v.cwiseProduct(half) + Vec3d(0, 0, 0.7));
    carrier.from_box = false;
    carrier.shape = std::make_shared<const Mesh>(vehicle);
  }
  return host_scene(frame, on_roof(carrier), noisy_adversary(), "test scene");
}

/// A .glb's JSON, and the offset of its binary data.
std::pair<nlohmann::json, std::size_t> parts_of(const std::string& bytes) {
  std::uint32_t length = 0;
  std::memcpy(&length, bytes.data() + 12, sizeof(length));
  return {nlohmann::json::parse(bytes.substr(20, length)), 28 + length};
}

/// The node of a role in a scene's JSON, and its mesh's first primitive.
struct Part {
  nlohmann::json node, primitive, accessors;
};
Part part_of(const fs::path& file, const std::string& role) {
  const nlohmann::json json = parts_of(read_file(file)).first;
  for (const auto& node : json.at("nodes"))
    if (node.at("extras").at("mirage_role") == role)
      return {node, json.at("meshes").at(node.at("mesh").get<std::size_t>()).at("primitives").at(0),
              json.at("accessors")};
  return {};
}

void expect_identical(const TexturedMesh& a, const TexturedMesh& b) {
  ASSERT_EQ(a.mesh.vertices.size(), b.mesh.vertices.size());
  ASSERT_EQ(a.atlas.texels.size(), b.atlas.texels.size());
  EXPECT_EQ(a.atlas.resolution, b.atlas.resolution);
  EXPECT_EQ(a.mesh.faces, b.mesh.faces);
  const auto same_bits = [](const std::vector<Vec3d>& x, const std::vector<Vec3d>& y) {
    return x.empty() || std::memcmp(x.data(), y.data(), x.size() * sizeof(Vec3d)) == 0;
  };
  EXPECT_TRUE(same_bits(a.mesh.vertices, b.mesh.vertices));
  EXPECT_TRUE(same_bits(a.atlas.texels, b.atlas.texels));
}

TEST(Gltf, AdversaryComesBackBitIdentical) {
  for (int resolution : {1, 2, 5}) {
    const TexturedMesh adversary = noisy_adversary(resolution);
    write_adversary(scratch("adversary.glb"), adversary);
    expect_identical(adversary, read_adversary(scratch("adversary.glb")));
  }
}

TEST(Gltf, MeshWithoutTexelsComesBack) {
  TexturedMesh plain{icosphere(1), {5, {}}};
  write_adversary(scratch("plain.glb"), plain);
  expect_identical(plain, read_adversary(scratch("plain.glb")));
}

TEST(Gltf, AdversaryOfASceneComesBack) {
  const ExportScene source = scene();
  write_scene(scratch("scene.glb"), source);
  expect_identical(source.adversary, read_adversary(scratch("scene.glb")));
  EXPECT_THAT(test::error_text<InputError>([&] { read_object(scratch("scene.glb")); }),
              testing::HasSubstr("is a whole scene"));
}

/// The file with its JSON changed.
void edit(const fs::path& file, const std::function<void(nlohmann::json&)>& change) {
  const std::string bytes = read_file(file);
  auto [json, data] = parts_of(bytes);
  change(json);
  std::string text = json.dump();
  text.resize((text.size() + 3) / 4 * 4, ' ');
  const std::string rest = bytes.substr(data - 8);
  const std::uint32_t sizes[] = {static_cast<std::uint32_t>(20 + text.size() + rest.size()),
                                 static_cast<std::uint32_t>(text.size())};
  std::string head = bytes.substr(0, 20);
  std::memcpy(head.data() + 8, sizes, sizeof sizes);
  write_file(file, head + text + rest);
}

// Editors move, scale and extend a file, and some of them preserve the extras.
TEST(Gltf, AnEditedAdversaryIsReadAsItIsEdited) {
  const TexturedMesh adversary = noisy_adversary();
  const fs::path file = scratch("edited.glb");
  const auto edited = [&](const std::function<void(nlohmann::json&)>& change) {
    write_adversary(file, adversary);
    edit(file, change);
  };
  edited([](nlohmann::json& json) {
    json["nodes"][0]["scale"] = {0.5, 0.5, 0.5};
    json["nodes"][0]["translation"] = {1, 2, 3};
  });
  const TexturedMesh placed = read_adversary(file);
  EXPECT_EQ(placed.atlas.texels, adversary.atlas.texels);
  for (std::size_t v = 0; v < adversary.mesh.vertices.size(); ++v)  // glTF (x, y, z) is `velo` (x, −z, y)
    EXPECT_LT((placed.mesh.vertices[v] - 0.5 * adversary.mesh.vertices[v] - Vec3d(1, -3, 2)).norm(), 1e-12);
  edited([](nlohmann::json& json) {
    json["nodes"].push_back({{"mesh", 0}, {"translation", {2, 0, 0}}});
    json["scenes"][0]["nodes"].push_back(json["nodes"].size() - 1);
  });
  EXPECT_THAT(test::error_text<InputError>([&] { read_adversary(file); }),
              testing::AllOf(HasSubstr("1 meshes beside"), HasSubstr("delete")));
  write_adversary(file, adversary);
  std::string bytes = read_file(file);
  const auto [json, data] = parts_of(bytes);
  const auto& view =
      json["bufferViews"][json["meshes"][0]["extras"]["mirage"]["vertices"].get<std::size_t>()];
  for (std::size_t i = 0; i < view["byteLength"]; i += sizeof(double)) {
    char* at = bytes.data() + data + view.value("byteOffset", std::size_t{0}) + i;
    double value = 0;
    std::memcpy(&value, at, sizeof value);
    value *= 1.01;
    std::memcpy(at, &value, sizeof value);
  }
  write_file(file, bytes);
  EXPECT_THAT(test::error_text<InputError>([&] { read_adversary(file); }),
              testing::AllOf(HasSubstr("other triangles"), HasSubstr("extras.mirage")));
}

/// The error of reading the file as an object.
std::string complaint(const fs::path& file) {
  return test::error_text<InputError>([&] { read_adversary(file); });
}

// The visible corners are compared one by one: smoothing in an editor can leave the bounding box unchanged.
TEST(Gltf, AnEditInsideTheBoundsIsNotOverlooked) {
  const fs::path file = scratch("smoothed.glb");
  write_adversary(file, noisy_adversary());
  std::string bytes = read_file(file);
  const auto [json, data] = parts_of(bytes);
  const auto& accessor =
      json["accessors"][json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].get<std::size_t>()];
  const auto& view = json["bufferViews"][accessor["bufferView"].get<std::size_t>()];
  for (std::size_t i = 0; i < accessor["count"].get<std::size_t>(); ++i) {
    char* at = bytes.data() + data + view.value("byteOffset", std::size_t{0}) + 12 * i;
    float p[3];
    std::memcpy(p, at, sizeof p);
    bool inside = true;
    for (std::size_t k = 0; k < 3; ++k)
      inside = inside && p[k] > accessor["min"][k].get<float>() + 0.1f &&
               p[k] < accessor["max"][k].get<float>() - 0.1f;
    if (!inside) continue;
    for (float& value : p) value *= 0.9f;
    std::memcpy(at, p, sizeof p);
  }
  write_file(file, bytes);
  EXPECT_THAT(complaint(file), testing::AllOf(HasSubstr("meshes[0]: has other triangles than extras.mirage"),
                                              HasSubstr("delete extras.mirage")));
}

TEST(Gltf, OtherColoursThanItsTexelsAreNotOverlooked) {
  const TexturedMesh adversary = noisy_adversary();
  const fs::path file = scratch("painted.glb");
  TexturedMesh other = adversary;
  std::swap(other.atlas.texels[0], other.atlas.texels[1]);
  write_adversary(file, adversary);
  edit(file, [](nlohmann::json& json) {
    json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = {1, 0.2, 0.2, 1};
  });
  EXPECT_THAT(complaint(file), HasSubstr("other colours"));
  // A picture of the same size with other pixels: the file's exact texels are replaced.
  write_adversary(file, adversary);
  std::string bytes = read_file(file);
  const auto [json, data] = parts_of(bytes);
  const auto& view = json["bufferViews"][json["meshes"][0]["extras"]["mirage"]["texels"].get<std::size_t>()];
  std::memcpy(bytes.data() + data + view.value("byteOffset", std::size_t{0}), other.atlas.texels.data(),
              2 * sizeof(Vec3d));
  write_file(file, bytes);
  EXPECT_THAT(complaint(file), HasSubstr("other colours"));
  write_adversary(file, adversary);
  edit(file, [](nlohmann::json& whole) {
    whole["materials"][0]["pbrMetallicRoughness"].erase("baseColorTexture");
  });
  EXPECT_THAT(complaint(file), HasSubstr("other colours"));
}

TEST(Gltf, ACameraOrSunThatWasMovedIsNotOverlooked) {
  const fs::path file = scratch("moved.glb");
  const auto node_of = [](nlohmann::json& json, const std::string& role) -> nlohmann::json& {
    for (auto& node : json["nodes"])
      if (node["extras"]["mirage_role"] == role) return node;
    return json["nodes"][0];
  };
  const auto edited = [&](const std::function<void(nlohmann::json&)>& change) {
    write_scene(file, scene());
    edit(file, change);
  };
  const auto refused = [&] { return test::error_text<InputError>([&] { read_scene(file); }); };
  edited([](nlohmann::json&) {});
  EXPECT_NO_THROW(read_scene(file));
  edited([&](nlohmann::json& json) { node_of(json, "camera")["translation"] = {1, 2, 3}; });
  EXPECT_THAT(refused(),
              testing::AllOf(HasSubstr("nodes["), HasSubstr("another camera"), HasSubstr("delete")));
  edited([&](nlohmann::json& json) { node_of(json, "camera")["rotation"] = {0, 0, 0, 1}; });
  EXPECT_THAT(refused(), HasSubstr("another camera"));
  edited([](nlohmann::json& json) { json["cameras"][0]["perspective"]["yfov"] = 1.0; });
  EXPECT_THAT(refused(), HasSubstr("another camera"));
  edited([&](nlohmann::json& json) { node_of(json, "sun")["rotation"] = {0.6, 0, 0, 0.8}; });
  EXPECT_THAT(refused(), HasSubstr("another sun"));
  const auto brighter = [](nlohmann::json& json) {
    json["extensions"]["KHR_lights_punctual"]["lights"][0]["intensity"] = 50.0;
  };
  edited(brighter);
  EXPECT_THAT(refused(), HasSubstr("another sun"));
  edited([&](nlohmann::json& json) {
    brighter(json);
    json["scenes"][0]["extras"]["mirage"].erase("lighting");
  });
  EXPECT_NEAR(read_scene(file).lighting.sun.maxCoeff(), 50 / M_PI, 1e-9);
}

TEST(Gltf, SameSceneGivesTheSameBytes) {
  write_scene(scratch("once.glb"), scene());
  write_scene(scratch("twice.glb"), scene());
  EXPECT_EQ(read_file(scratch("once.glb")), read_file(scratch("twice.glb")));
}

TEST(Tessellation, CoversTheFaceOnceWithTheRasterisersTexels) {
  RandomStream random(3, "barycentrics");
  for (int resolution : {1, 2, 3, 5, 8}) {
    const auto triangles = atlas_triangles(resolution);
    ASSERT_EQ(triangles.size(), as_size(resolution) * as_size(resolution));
    const auto cross = [](const Vec2d& a, const Vec2d& b) { return a.x() * b.y() - a.y() * b.x(); };
    for (const AtlasTriangle& t : triangles)  // wound as the face, and congruent
      EXPECT_NEAR(cross(t.corners[1] - t.corners[0], t.corners[2] - t.corners[0]),
                  1.0 / (resolution * resolution), 1e-12);
    for (int i = 0; i < 2000; ++i) {
      Vec2d b{random.uniform(), random.uniform()};
      if (b.sum() > 1) b = Vec2d::Ones() - b;
      int found = -1, count = 0;
      for (const AtlasTriangle& t : triangles) {
        double least = 1;
        for (std::size_t k = 0; k < 3; ++k)
          least = std::min(least, cross(t.corners[(k + 1) % 3] - t.corners[k], b - t.corners[k]));
        if (least > 1e-9) found = t.texel, ++count;
      }
      if (count == 0) continue;  // on a border between two
      EXPECT_EQ(count, 1);
      EXPECT_EQ(found, texel_index(b.x(), b.y(), resolution))
          << "at " << b.transpose() << ", C = " << resolution;
    }
  }
}

TEST(HostProxy, IsClosedAndItsRoofIsTheBoxsTop) {
  const Box3 box{{10, -3, 4.2, 1.8, 0.7}, -1.6, 1.5};
  const Mesh car = car_proxy(box);
  EXPECT_TRUE(is_watertight(car));
  EXPECT_GT(signed_volume(car), 2.0);
  EXPECT_NEAR(bounds(car).max().z(), -0.1, 1e-12);
  EXPECT_NEAR(bounds(car).min().z(), -1.6, 1e-12);
  for (const Vec3d& v : car.vertices) EXPECT_TRUE(contains(box, v, 1e-9));
  const Mesh ground = ground_proxy({10, -3, -1.6});
  for (const Vec3d& n : face_normals(ground)) EXPECT_GT(n.z(), 0);
}

TEST(HostScene, HoldsTheFittedVehicleAndSaysSo) {
  const ExportScene fitted = scene(true), by_box = scene();
  const Mesh& vehicle = fitted.proxies.at(0).mesh;
  EXPECT_EQ(vehicle.faces.size(), icosphere(3).faces.size());
  EXPECT_EQ(by_box.proxies.at(0).mesh.faces.size(), car_proxy({}).faces.size());
  EXPECT_NEAR(bounds(fitted.proxies.at(1).mesh).max().z(), bounds(vehicle).min().z(), 1e-12);
  EXPECT_NEAR(bounds(by_box.proxies.at(1).mesh).max().z(), -1.7, 1e-12);
  for (const auto& [source, shape] : {std::pair(fitted, "fitted"), std::pair(by_box, "box")}) {
    write_scene(scratch("host.glb"), source);
    const Part host = part_of(scratch("host.glb"), "host");
    EXPECT_EQ(host.node.at("extras").at("mirage_shape"), shape);
    // Shared corners: a watertight mesh stays watertight.
    const auto count = [&](const nlohmann::json& accessor) {
      return host.accessors.at(accessor.get<std::size_t>()).at("count").get<std::size_t>();
    };
    const Mesh& mesh = source.proxies.at(0).mesh;
    EXPECT_EQ(count(host.primitive.at("indices")), 3 * mesh.faces.size());
    EXPECT_EQ(count(host.primitive.at("attributes").at("POSITION")), mesh.vertices.size());
  }
}

/// Runs Khronos' validator on the files; skips without node or the package.
TEST(Gltf, ValidatorFindsNothing) {
  const std::string folder = MIRAGE_BUILD "/gltf-validator";
  if (!fs::exists(folder + "/node_modules/gltf-validator")) {
    fs::create_directories(folder);
    const std::string install = "npm install --silent --no-audit --no-fund --prefix '" + folder +
                                "' gltf-validator@2.0.0-dev.3.10 >/dev/null 2>&1";
    if (std::system(install.c_str()) != 0) GTEST_SKIP() << "gltf-validator cannot be installed (npm)";
  }
  write_adversary(scratch("validated-adversary.glb"), noisy_adversary());
  write_scene(scratch("validated-scene.glb"), scene());
  write_scene(scratch("validated-fitted.glb"), scene(true));
  write_file(folder + "/check.js", R"(
const fs = require('fs'), validator = require(process.argv[2] + '/node_modules/gltf-validator');
(async () => {
  let bad = 0;
  for (const file of process.argv.slice(3)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
    console.log(file, JSON.stringify(report.issues));
    bad += report.issues.numErrors + report.issues.numWarnings;
  }
  process.exit(bad === 0 ? 0 : 1);
})();
)");
  const std::string check = "node '" + folder + "/check.js' '" + folder + "' '" +
                            scratch("validated-adversary.glb").string() + "' '" +
                            scratch("validated-scene.glb").string() + "' '" +
                            scratch("validated-fitted.glb").string() + "'";
  EXPECT_EQ(std::system(check.c_str()), 0);
}

TEST(Gltf, ForeignFileIsReadAsAPlainMesh) {
  GltfBuilder gltf;
  const int position = gltf.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, 3);
  const std::vector<std::uint16_t> indices = {0, 1, 2, 0, 2, 3};
  const int index = gltf.add("accessors", {{"bufferView", gltf.add_view(indices)},
                                           {"componentType", 5123},
                                           {"count", indices.size()},
                                           {"type", "SCALAR"}});
  const int material =
      gltf.add("materials", {{"pbrMetallicRoughness", {{"baseColorFactor", {0.25, 0.5, 0.75, 1.0}}}}});
  nlohmann::json primitive = {
      {"attributes", {{"POSITION", position}}}, {"indices", index}, {"material", material}};
  const int mesh = gltf.add("meshes", {{"primitives", nlohmann::json::array({primitive})}});
  gltf.add_node({{"mesh", mesh}, {"translation", {1.0, 2.0, 3.0}}, {"scale", {2.0, 2.0, 2.0}}});
  write_file(scratch("foreign.glb"), gltf.glb());
  const TexturedMesh read = read_adversary(scratch("foreign.glb"));
  ASSERT_EQ(read.mesh.vertices.size(), 4u);
  ASSERT_EQ(read.mesh.faces.size(), 2u);
  // glTF (x, y, z) is `velo` (x, −z, y).
  EXPECT_TRUE(read.mesh.vertices[0].isApprox(Vec3d(1, -3, 2)));
  EXPECT_TRUE(read.mesh.vertices[3].isApprox(Vec3d(1, -5, 2)));
  EXPECT_EQ(read.atlas.texels.at(0), Vec3d(0.25, 0.5, 0.75));
}

void expect_input_error(const std::string& bytes, const std::string& field) {
  const fs::path file = scratch("malformed.glb");
  write_file(file, bytes);
  try {
    read_adversary(file);
    ADD_FAILURE() << "no error for " << field;
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("malformed.glb"));
    EXPECT_THAT(error.what(), HasSubstr(field));
    EXPECT_THAT(error.what(), ::testing::Not(HasSubstr("\n")));
  }
}

TEST(Gltf, MalformedFilesNameFileAndField) {
  write_adversary(scratch("good.glb"), noisy_adversary());
  const std::string good = read_file(scratch("good.glb"));
  expect_input_error("", "header");
  expect_input_error("glTF", "header");
  expect_input_error("PK\x03\x04" + good.substr(4), "magic");
  expect_input_error(good.substr(0, good.size() / 2), "length");
  std::string version = good;
  version[4] = 1;
  expect_input_error(version, "version");
  std::string broken = good;
  broken[20] = '[';
  expect_input_error(broken, "JSON");
  // A file whose length field agrees but whose binary chunk is gone.
  GltfBuilder gltf;
  gltf.add("buffers", {{"byteLength", 100}});
  gltf.add("bufferViews", {{"buffer", 0}, {"byteLength", 100}});
  expect_input_error(gltf.glb(), "buffers");
}

TEST(Gltf, BadReferencesNameTheField) {
  const auto with = [](const nlohmann::json& exact) {
    GltfBuilder gltf;
    gltf.add_view(std::vector<double>(9, 0.5));
    const int position = gltf.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, 3);
    nlohmann::json primitive = {{"attributes", {{"POSITION", position}}}};
    const int mesh = gltf.add(
        "meshes", {{"primitives", nlohmann::json::array({primitive})}, {"extras", {{"mirage", exact}}}});
    gltf.add_node({{"mesh", mesh}});
    return gltf.glb();
  };
  expect_input_error(with({{"vertices", 0}, {"resolution", 5}}), "extras.mirage.faces");
  expect_input_error(with({{"vertices", 99}, {"faces", 0}, {"resolution", 5}}), "extras.mirage.vertices");
  expect_input_error(with({{"vertices", 0}, {"faces", 0}, {"resolution", 0}}), "extras.mirage.resolution");
  expect_input_error(with({{"vertices", 0}, {"faces", 0}, {"resolution", 5}}), "vertex index");
}

TEST(Gltf, RandomDamageNeverCrashes) {
  write_adversary(scratch("good.glb"),
                  TexturedMesh{icosphere(0), {1, std::vector<Vec3d>(20, Vec3d::Ones())}});
  const std::string good = read_file(scratch("good.glb"));
  RandomStream random(1, "damage");
  for (int i = 0; i < 100; ++i) {
    std::string bytes = good;
    for (int k = 0; k < 4; ++k)
      bytes[as_size(random.below(static_cast<int>(bytes.size())))] = static_cast<char>(random.below(256));
    write_file(scratch("damaged.glb"), bytes);
    try {
      read_adversary(scratch("damaged.glb"));
    } catch (const InputError&) {
    }
  }
}

}  // namespace
}  // namespace mirage
