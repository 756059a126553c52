// Hostile scenes and meshes: nesting depth, and files that are no scenes at all.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <cstdlib>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/sizes.h"
#include "documents.h"
#include "exchange/gltf.h"
#include "exchange/gltf_model.h"
#include "exchange/mesh_files.h"
#include "support/files.h"
#include "support/heard.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::error_text;
using test::triangle_bytes;
using test::triangle_document;
using test::write_glb;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

/// Reads `document` as an adversary and as a mesh, .glb and .gltf; all errors must name `field`.
void expect_refused(const json& document, const std::string& field) {
  const test::TemporaryFolder folder;
  write_glb(folder / "bad.glb", document);
  write_file(folder / "bad.gltf", document.dump());
  const auto names_field = AllOf(HasSubstr(field), Not(HasSubstr("\n")));
  EXPECT_THAT(error_text<InputError>([&] { read_adversary(folder / "bad.glb"); }),
              AllOf(HasSubstr("bad.glb"), names_field));
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "bad.glb"); }),
              AllOf(HasSubstr("bad.glb"), names_field));
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "bad.gltf"); }),
              AllOf(HasSubstr("bad.gltf"), names_field));
}

TEST(GltfDepth, DeeplyNestedJsonIsRefusedBeforeAnyReader) {
  const test::TemporaryFolder folder;
  for (int levels : {129, 20000, 3000000}) {
    const std::string deep = std::string(as_size(levels), '[') + std::string(as_size(levels), ']');
    std::string text = triangle_document("a.bin").dump();
    text.insert(1, "\"extras\":" + deep + ",");
    write_file(folder / "deep.gltf", text);
    EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "deep.gltf"); }),
                AllOf(HasSubstr("JSON"), HasSubstr("deeper than 128")));
    text.append((4 - text.size() % 4) % 4, ' ');
    std::string glb = "glTF";
    for (std::size_t word : {std::size_t{2}, 20 + text.size(), text.size(), std::size_t{0x4E4F534A}})
      for (int byte = 0; byte < 4; ++byte) glb.push_back(static_cast<char>(word >> (8 * byte) & 0xff));
    write_file(folder / "deep.glb", glb + text);
    EXPECT_THAT(error_text<InputError>([&] { read_adversary(folder / "deep.glb"); }),
                HasSubstr("deeper than 128"));
  }
  // Brackets in strings do not count.
  json document = triangle_document("a.bin");
  document["extras"] = std::string(1000, '[') + "\\\"" + std::string(1000, '{');
  write_file(folder / "a.bin", triangle_bytes());
  write_glb(folder / "text.glb", document);
  EXPECT_EQ(read_adversary(folder / "text.glb").mesh.faces.size(), 1u);
}

/// triangle_document with its bytes inside, changed by `change`.
template <class Change>
json changed(const Change& change) {
  json document = triangle_document(
      "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA");
  change(document);
  return document;
}

TEST(GltfNodes, EachHasOneParentAndTheTreeIsBounded) {
  EXPECT_EQ(changed([](json&) {}).at("nodes").size(), 1u);
  // 60 nodes that each name the next one twice: 2^60 visits.
  expect_refused(changed([](json& d) {
                   d["nodes"] = json::array();
                   for (int n = 0; n < 60; ++n) d["nodes"].push_back({{"children", {n + 1, n + 1}}});
                   d["nodes"].push_back({{"mesh", 0}});
                 }),
                 "nodes[0].children[1]");
  expect_refused(changed([](json& d) { d["nodes"] = {{{"mesh", 0}, {"children", {0}}}}; }), "nodes[0]");
  expect_refused(changed([](json& d) {
                   d["nodes"] = {{{"mesh", 0}}, {{"children", {2}}}, {{"children", {1}}}};
                 }),
                 "nodes[1].children");
  expect_refused(changed([](json& d) {
                   d["nodes"] = json::array();
                   for (int n = 0; n < 5000; ++n) d["nodes"].push_back({{"children", {n + 1}}});
                   d["nodes"].push_back({{"mesh", 0}});
                 }),
                 "nodes[256]");
  expect_refused(changed([](json& d) { d["scenes"][0]["nodes"] = {0, 0}; }), "scenes[0].nodes[1]");
  expect_refused(changed([](json& d) { d["nodes"][0]["children"] = {7}; }), "nodes[0].children[0]");
  expect_refused(changed([](json& d) { d["nodes"][0]["children"] = {-1}; }), "nodes[0].children[0]");
  // One mesh at many nodes.
  expect_refused(changed([](json& d) {
                   d["accessors"][0]["count"] = 1 << 20;
                   d["nodes"] = json::array();
                   for (int n = 0; n < 40; ++n) d["nodes"].push_back({{"mesh", 0}});
                 }),
                 "nodes[32].mesh");
}

TEST(GltfDemands, WhatChangesTheShapeAndIsNotReadIsRefusedByName) {
  const auto requires_it = [](const char* name) {
    return changed([&](json& d) { d["extensionsUsed"] = d["extensionsRequired"] = {name}; });
  };
  for (const char* name : {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization",
                           "VENDOR_invented_tomorrow"})
    expect_refused(requires_it(name), fmt::format("extensionsRequired[0]: {} is not read", name));
  expect_refused(changed([](json& d) { d["asset"]["minVersion"] = "2.1"; }), "asset.minVersion: is 2.1");
  expect_refused(changed([](json& d) {
                   d["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"] = {{"attributes", json::object()}};
                 }),
                 "nodes[0].extensions.EXT_mesh_gpu_instancing");
  expect_refused(changed([](json& d) {
                   d["nodes"][0]["extensions"]["KHR_node_visibility"] = {{"visible", false}};
                 }),
                 "nodes[0].extensions.KHR_node_visibility");
  expect_refused(changed([](json& d) { d["nodes"][0]["skin"] = 0; }), "nodes[0].skin");
  expect_refused(
      changed([](json& d) {
        d["accessors"][0].erase("bufferView");
        d["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"] = {{"bufferView", 0}};
      }),
      "meshes[0].primitives[0].extensions.KHR_draco_mesh_compression");
  expect_refused(changed([](json& d) { d["nodes"][0]["weights"] = {0, 0.5}; }), "nodes[0].weights");
  expect_refused(changed([](json& d) { d["meshes"][0]["weights"] = {1}; }), "meshes[0].weights");
  const test::TemporaryFolder folder;
  for (const json& good :
       {requires_it("KHR_lights_punctual"), changed([](json& d) { d["asset"]["minVersion"] = "2.0"; }),
        changed([](json& d) { d["extensionsUsed"] = {"KHR_draco_mesh_compression"}; }), changed([](json& d) {
          d["meshes"][0]["weights"] = {0, 0};
        }),
        changed([](json& d) { d["meshes"][0]["weights"] = {1}, d["nodes"][0]["weights"] = {0}; })}) {
    write_glb(folder / "good.glb", good);
    EXPECT_EQ(read_adversary(folder / "good.glb").mesh.faces.size(), 1u) << good.dump();
  }
}

TEST(GltfColours, WhatIsNotReadIsNamedOnce) {
  const test::TemporaryFolder folder;
  write_glb(folder / "painted.glb", changed([](json& d) {
              d["accessors"].push_back(
                  {{"bufferView", 0}, {"componentType", 5126}, {"count", 3}, {"type", "VEC3"}});
              d["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = 1;
              d["meshes"][0]["primitives"][0]["material"] = 0;
              d["materials"] = {{{"alphaMode", "MASK"},
                                 {"extensions", {{"KHR_materials_pbrSpecularGlossiness", json::object()}}}}};
              d["nodes"].push_back({{"mesh", 0}});
              d["scenes"][0]["nodes"] = {0, 1};
            }));
  const test::Heard heard;
  EXPECT_EQ(read_adversary(folder / "painted.glb").mesh.faces.size(), 2u);
  const std::string said = heard.text();
  for (const char* name :
       {"painted.glb", "vertex colours (COLOR_0)", "alphaMode MASK", "KHR_materials_pbrSpecularGlossiness"})
    EXPECT_THAT(said, HasSubstr(name));
  EXPECT_EQ(heard.warnings(), 1);
}

TEST(GltfValues, RubbishIsRefusedWithItsField) {
  const test::TemporaryFolder folder;
  write_glb(folder / "good.glb", changed([](json&) {}));
  EXPECT_EQ(read_adversary(folder / "good.glb").mesh.faces.size(), 1u);
  const auto node = [](const char* key, const json& value) {
    return changed([&](json& d) { d["nodes"][0][key] = value; });
  };
  expect_refused(node("scale", {1e38, 1, 1}), "nodes[0].scale");
  expect_refused(node("scale", {0, 0, 0}), "nodes[0].scale");
  expect_refused(node("scale", {1, 0, 1}), "nodes[0].scale");
  expect_refused(node("scale", {1, 1}), "nodes[0].scale");
  expect_refused(node("translation", {0, 0, 1e38}), "nodes[0].translation");
  expect_refused(node("rotation", {0, 0, 0, 0}), "nodes[0].rotation");
  expect_refused(node("matrix", std::vector<double>(16, 0.0)), "nodes[0].matrix");
  expect_refused(node("matrix", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1}), "nodes[0].matrix");
  expect_refused(node("matrix", {1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}), "nodes[0].matrix");
  expect_refused(node("matrix", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, "1"}), "nodes[0].matrix");
  expect_refused(node("mesh", 9), "nodes[0].mesh");
  expect_refused(node("camera", 0), "nodes[0].camera");
  for (const json& mode : {json(7), json(-2), json(1.5), json("4")})
    expect_refused(changed([&](json& d) { d["meshes"][0]["primitives"][0]["mode"] = mode; }),
                   "meshes[0].primitives[0].mode");
  const auto view = [](const char* key, const json& value) {
    return changed([&](json& d) { d["bufferViews"][0][key] = value; });
  };
  expect_refused(view("byteOffset", -4), "bufferViews[0].byteOffset");
  expect_refused(view("byteOffset", 4), "bufferViews[0]");
  expect_refused(view("byteOffset", 1e300), "bufferViews[0].byteOffset");
  expect_refused(view("byteLength", 1e300), "bufferViews[0].byteLength");
  expect_refused(view("buffer", 3), "bufferViews[0].buffer");
  expect_refused(changed([](json& d) { d["accessors"][0]["byteOffset"] = -12; }), "accessors[0].byteOffset");
  expect_refused(changed([](json& d) { d["accessors"][0]["count"] = -3; }), "accessors[0].count");
  expect_refused(changed([](json& d) {
                   d["materials"] = {{{"pbrMetallicRoughness", {{"baseColorFactor", {1e300, 0, 0, 1}}}}}};
                 }),
                 "materials[0].pbrMetallicRoughness.baseColorFactor");
  expect_refused(changed([](json& d) { d["asset"]["version"] = "1.0"; }), "asset.version");
  expect_refused(changed([](json& d) { d["nodes"] = 5; }), "nodes");
  expect_refused(changed([](json& d) { d["scene"] = 4; }), "scene");
  // Positions of 1e38: the fourth corner's x is 0x7e967699 = 1e38.
  expect_refused(
      changed([](json& d) {
        d["buffers"][0]["uri"] =
            "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAmXaWfgAAAAAAAAAAAAAAAAAAgD8AAAAA";
      }),
      "vertex 1");
  expect_refused(
      changed([](json& d) {  // infinity
        d["buffers"][0]["uri"] =
            "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAfwAAAAAAAAAAAAAAAAAAgD8AAAAA";
      }),
      "vertex 1");
}

TEST(GltfValues, StripsAndFansAreWoundAsTheFormatHasIt) {
  const test::TemporaryFolder folder;
  const std::vector<float> places = {0, 0, 0,  1, 0, 0,
                                     0, 0, -1, 1, 0, -1};  // x right, z towards us: a square
  const std::vector<float> around = {0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1};
  for (const auto& [mode, corners] : {std::pair{5, places}, std::pair{6, around}}) {
    GltfBuilder gltf;
    const nlohmann::json primitive = {{"attributes", {{"POSITION", gltf.add_floats(corners, 3)}}},
                                      {"mode", mode}};
    gltf.add_node({{"mesh", gltf.add("meshes", {{"primitives", nlohmann::json::array({primitive})}})}});
    write_file(folder / "square.glb", gltf.glb());
    const Mesh mesh = read_adversary(folder / "square.glb").mesh;
    ASSERT_EQ(mesh.faces.size(), 2u);
    for (const Vec3d& normal : face_normals(mesh)) EXPECT_LT((normal - Vec3d(0, 0, 1)).norm(), 1e-6) << mode;
  }
}

TEST(GltfValues, NumbersBeyondDoubleAreRefused) {
  const test::TemporaryFolder folder;
  std::string text = changed([](json& d) { d["nodes"][0]["scale"] = {1, 1, 1}; }).dump();
  text.replace(text.find("\"scale\":[1,1,1]"), 15, "\"scale\":[1e999,1,1]");
  write_file(folder / "bad.gltf", text);
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "bad.gltf"); }), HasSubstr("JSON"));
}

json lit_scene() {
  return changed([](json& d) {
    d["scenes"][0]["extras"]["mirage"] = {{"camera",
                                           {{"fx", 100},
                                            {"fy", 100},
                                            {"cx", 32},
                                            {"cy", 16},
                                            {"width", 64},
                                            {"height", 32},
                                            {"velo_from_camera", {0, 0, 1, 0, -1, 0, 0, 0, 0, -1, 0, 0}}}},
                                          {"lighting",
                                           {{"to_sun_velo", {0, 0, 1}},
                                            {"sun", {1, 1, 1}},
                                            {"ambient", {0, 0, 0}},
                                            {"hemisphere", {0, 0, 0}}}}};
  });
}

TEST(GltfScenes, SingularCamerasAndAbsurdLightsAreRefused) {
  const test::TemporaryFolder folder;
  write_glb(folder / "scene.glb", lit_scene());
  EXPECT_EQ(read_scene(folder / "scene.glb").camera.width, 64);
  const auto expect = [&](const char* part, const char* key, const json& value) {
    json document = lit_scene();
    document["scenes"][0]["extras"]["mirage"][part][key] = value;
    write_glb(folder / "bad.glb", document);
    EXPECT_THAT(
        error_text<InputError>([&] { read_scene(folder / "bad.glb"); }),
        AllOf(HasSubstr("bad.glb"), HasSubstr(std::string("extras.mirage.") + part), Not(HasSubstr("\n"))))
        << key << " " << value;
  };
  for (const json& pose :
       {json(std::vector<double>(12, 0.0)), json({0, 0, 1, 0, 0, 0, 1, 0, 0, -1, 0, 0}),
        json({0, 0, 1e300, 0, -1, 0, 0, 0, 0, -1, 0, 0}), json({0, 0, 1, 1e38, -1, 0, 0, 0, 0, -1, 0, 0}),
        json({0, 0, 2, 0, -2, 0, 0, 0, 0, -2, 0, 0})})
    expect("camera", "velo_from_camera", pose);
  expect("camera", "fx", 0);
  expect("camera", "fx", 1e300);
  expect("camera", "cx", -1e300);
  expect("camera", "width", 1e300);
  expect("camera", "height", 3000000);
  expect("lighting", "to_sun_velo", {0, 0, 0});
  expect("lighting", "to_sun_velo", {1e300, 0, 0});
  expect("lighting", "sun", {1e300, 0, 0});
  expect("lighting", "sun", {-1, 0, 0});
  expect("lighting", "ambient", {0, 0, 1e9});
}

TEST(GltfScenes, CamerasAndLightsOfNodesAreCheckedToo) {
  const test::TemporaryFolder folder;
  const auto expect = [&](const json& document, const char* field) {
    write_glb(folder / "bad.glb", document);
    EXPECT_THAT(error_text<InputError>([&] { read_scene(folder / "bad.glb", 64, 32); }),
                AllOf(HasSubstr(field), Not(HasSubstr("\n"))));
  };
  const auto with_camera = [](const json& yfov, const json& scale) {
    return changed([&](json& d) {
      d["cameras"] = {{{"type", "perspective"}, {"perspective", {{"yfov", yfov}, {"znear", 0.1}}}}};
      d["nodes"].push_back({{"camera", 0}, {"scale", scale}});
      d["scenes"][0]["nodes"].push_back(1);
    });
  };
  write_glb(folder / "good.glb", with_camera(0.8, {2, 2, 2}));
  EXPECT_EQ(read_scene(folder / "good.glb", 64, 32).camera.height, 32);
  expect(with_camera(0, {1, 1, 1}), "cameras[0].perspective.yfov");
  expect(with_camera(4, {1, 1, 1}), "cameras[0].perspective.yfov");
  expect(with_camera(0.8, {1, 0, 1}), "nodes[1]");
  const auto with_light = [&](const json& intensity, const json& scale) {
    json document = with_camera(0.8, {1, 1, 1});
    document["extensions"]["KHR_lights_punctual"]["lights"] = {
        {{"type", "directional"}, {"intensity", intensity}}};
    document["nodes"].push_back(
        {{"scale", scale}, {"extensions", {{"KHR_lights_punctual", {{"light", 0}}}}}});
    document["scenes"][0]["nodes"].push_back(2);
    return document;
  };
  write_glb(folder / "good.glb", with_light(3, {1, 1, 1}));
  EXPECT_NEAR(read_scene(folder / "good.glb", 64, 32).lighting.sun.x(), 3 / M_PI, 1e-12);
  expect(with_light(1e300, {1, 1, 1}), "lights[0].intensity");
  expect(with_light(-1, {1, 1, 1}), "lights[0].intensity");
  expect(with_light(1, {1, 1, 0}), "nodes[2]");
}

TEST(GltfScenes, APhotographIsJudgedByItsHeader) {
  const test::TemporaryFolder folder;
  json document = lit_scene();
  GltfBuilder gltf;
  gltf.json() = document;
  gltf.json().erase("buffers");
  gltf.json().erase("bufferViews");
  gltf.json().erase("accessors");
  gltf.json().erase("meshes");
  gltf.json()["nodes"] = json::array({json::object()});
  const std::string png = encode_srgb_png(ImageF(65, 32, 3, 0.5f));
  const int view = gltf.add_view(png.data(), png.size());
  gltf.add("images", {{"mimeType", "image/png"}, {"bufferView", view}});
  gltf.json()["scenes"][0]["extras"]["mirage"]["photograph"] = 0;
  write_file(folder / "other.glb", gltf.glb());
  EXPECT_THAT(error_text<InputError>([&] { read_scene(folder / "other.glb"); }),
              AllOf(HasSubstr("photograph"), HasSubstr("65×32"), HasSubstr("64×32")));
}

// Loading polls the flag that Ctrl-C sets.
TEST(GltfInterruptDeathTest, ASignalEndsTheLoading) {
  const test::TemporaryFolder folder;
  write_glb(folder / "scene.glb", lit_scene());
  for (const bool mesh : {false, true})
    EXPECT_EXIT(
        {
          watch_for_interrupt();
          std::raise(SIGTERM);
          try {
            if (mesh)
              read_mesh(folder / "scene.glb");
            else
              read_scene(folder / "scene.glb");
          } catch (const Interrupted&) {
            std::_Exit(7);
          }
          std::_Exit(8);
        },
        testing::ExitedWithCode(7), "");
}

}  // namespace
}  // namespace mirage
