#include "fuzz/seeds.h"

#include <fcntl.h>
#include <unistd.h>

#include <cmath>
#include <map>
#include <stdexcept>

#include "attack/checkpoint.h"
#include "base/files.h"
#include "base/image.h"
#include "base/sizes.h"
#include "exchange/gltf.h"
#include "exchange/mesh_files.h"
#include "fuzz/parsers.h"
#include "plugins/tensor_file.h"
#include "scene/data/kitti.h"
#include "scene/shape/shape_model.h"
#include "support/layouts.h"
#include "support/print_profile.h"

namespace mirage::fuzz {
namespace {

namespace fs = std::filesystem;

/// The bytes that `write` writes to a file of this name.
template <class Write>
std::string written(const char* name, const Write& write) {
  const fs::path file = scratch() / name;
  write(file);
  return read_file(file);
}

ImageF picture() {
  ImageF image(5, 3, 3);
  for (std::size_t i = 0; i < image.data.size(); ++i) image.data[i] = static_cast<float>(i) / 45;
  return image;
}

std::vector<Label> seed_labels() {
  Label car, any;
  car.type = "Car";
  car.box = {{11, -0.5, 3.9, 1.6, 0.1}, -1.73, 1.5};
  car.left = 90, car.top = 20, car.right = 150, car.bottom = 60, car.truncated = 0.25;
  any.type = "DontCare";
  any.right = 100, any.bottom = 50;
  return {car, any};
}

Frame seed_frame() {
  Frame frame;
  frame.calibration = seed_calibration();
  frame.labels = seed_labels();
  return frame;
}

/// A unit of two lasers; `more` is added to its table.
std::string rig(const char* head, const char* more) {
  return std::string(head) +
         "[camera]\nwidth = 62\nheight = 19\nfx = 36\nfy = 36\ncx = 31\ncy = 9\n"
         "camera_from_velo = [0, -1, 0, 0, 0, 0, -1, -0.08, 1, 0, 0, -0.27]\n"
         "[lidar]\nname = \"two\"\nbeams = [[2, 0.2, 0, 0], [-24.5, 0.1, 0.01, -1e0]]\n"
         "azimuth_step = 0.5\nencoder_step = 0.09\nazimuth = [-45, 45]\nrange = [1, 120]\nrate = 10\n"
         "velo_from_lidar = [0, 0, 0, 0, 0, 0]\nheight = 1.73\n" +
         more;
}

std::string shape() {
  ShapeModel model;
  model.layout.origin = {-1, 0, 0};
  model.layout.spacing = Vec3d::Ones();
  model.layout.count = {3, 2, 3};
  model.reference = {4.3, 1.75, 1.52};
  model.cut = 0.3;
  model.dimension = 1;
  model.vehicles = 3;
  model.explained = {1.0};
  model.prior_mean = Eigen::VectorXd::Zero(4);
  model.prior_covariance = Eigen::MatrixXd::Identity(4, 4);
  model.sources = {{"family", 3}};
  for (std::size_t i = 0; i < 2 * model.layout.size(); ++i)
    model.values.push_back(static_cast<float>(0.3 * std::sin(static_cast<double>(i))));
  return written("seed.shape", [&](const fs::path& file) { write_shape_model(file, model); });
}

std::string scene() {
  ExportScene scene;
  scene.name = "seed";
  scene.adversary = seed_mesh();
  scene.proxies = {{"host", "box", seed_mesh().mesh, Vec3d(0.3, 0.3, 0.3)}};
  scene.calibration = seed_calibration();
  scene.calibration.camera = {36, 36, 2, 1, 5, 3};
  scene.photograph = picture();
  return written("seed-scene.glb", [&](const fs::path& file) { write_scene(file, scene); });
}

/// A .glb without Mirage's extras: a triangle by indices, a camera and a sun.
std::string foreign() {
  std::string text =
      R"({"asset":{"version":"2.0"},"extensionsUsed":["KHR_lights_punctual"],)"
      R"("extensions":{"KHR_lights_punctual":{"lights":[{"type":"directional","intensity":2}]}},)"
      R"("scene":0,"scenes":[{"nodes":[0,1]}],"nodes":[{"mesh":0,"children":[2],"scale":[1,2,1]},)"
      R"({"camera":0,"translation":[0,1,5]},)"
      R"({"rotation":[0,0,0,1],"extensions":{"KHR_lights_punctual":{"light":0}}}],)"
      R"("cameras":[{"type":"perspective","perspective":{"yfov":0.9,"znear":0.1}}],)"
      R"("materials":[{"pbrMetallicRoughness":{"baseColorFactor":[0.5,0.25,1,1]}}],)"
      R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1,"material":0,"mode":4}]}],)"
      R"("accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},)"
      R"({"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}],)"
      R"("bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":36},)"
      R"({"buffer":0,"byteOffset":36,"byteLength":6}],"buffers":[{"byteLength":44}]})";
  text.resize((text.size() + 3) / 4 * 4, ' ');
  constexpr float corners[] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  constexpr std::uint16_t indices[] = {0, 1, 2, 0};
  const auto word = [](std::size_t value) {
    const auto number = static_cast<std::uint32_t>(value);
    return std::string(reinterpret_cast<const char*>(&number), sizeof number);
  };
  const std::string binary = std::string(reinterpret_cast<const char*>(corners), sizeof corners) +
                             std::string(reinterpret_cast<const char*>(indices), sizeof indices);
  return "glTF" + word(2) + word(12 + 8 + text.size() + 8 + binary.size()) + word(text.size()) + "JSON" +
         text + word(binary.size()) + std::string("BIN\0", 4) + binary;
}

/// Three tensors, and with `parts` two files whose tensors count, too.
std::string weights(bool parts) {
  constexpr float kKernel[] = {0.5f, -1, 2, 0, 1e-3f, 8};
  constexpr std::uint16_t kHalves[] = {0x3c00, 0x8000};
  constexpr std::int64_t kSteps = 70'000;
  const auto bytes = [](const auto& values) {
    return std::string_view(reinterpret_cast<const char*>(&values), sizeof values);
  };
  Facts facts = {{"format", "some network 1"}, {"detector", "lidar"}};
  if (parts)
    facts["parts"] = std::string(64, '0') + "  a-kitti64.weights\n" + std::string(64, 'f') + "  b.weights\n";
  return tensor_file_bytes(facts, {{"stem.conv.weight", {Element::float32, {2, 3}, bytes(kKernel)}},
                                   {"stem.conv.bias", {Element::float16, {2}, bytes(kHalves)}},
                                   {"training.steps", {Element::int64, {}, bytes(kSteps)}}});
}

std::string gamut_profile() {
  std::vector<Vec3d> overprints;
  for (int inks = 0; inks < 16; ++inks)
    overprints.emplace_back(inks & 1 ? 0.1 : 0.8, inks & 2 ? 0.1 : 0.9, inks & 4 ? 0.05 : 0.7);
  for (std::size_t black = 8; black < 16; ++black) overprints[black] *= 0.05;
  return test::print_profile(overprints);
}

std::string run() {
  return R"({"batch": 2, "buildable": [0.002, 0.05, 0.05, 0.9], "data": "data", "depth": "ip-basic",
 "defense": "none", "parts": "both", "sun": "frame",
 "detector": "lidar", "fp_top_k": 50, "lambda_fp": 1.0, "lambda_laplacian": 0.001, "limits": [0.8, 0.8, 0.5], "min_view": 0.7,
 "relevant_score": 0.1, "rooftop": "shape", "seed": 7,
 "simulation": {"sigma": 5e-07, "gamma": 0.01, "epsilon": 0.001, "dist_eps": 0.0001, "supersampling": 2,
  "camera_effects": [0.7, 7e-05, 0.00125], "lidar_gradient": "silhouette", "lidar_reflectivity": 0.5, "occlusion_margin": 0.3, "grazing_cosine": 0.05},
 "target": "both", "test": [{"frame": "000003", "label": 1}],
 "train": [{"frame": "000001", "label": 0}, {"frame": "000002", "label": 3}], "vertex_rate": 0.001,
 "texel_rate": 0.004, "weights": "", "weights_hash": "0123456789abcdef"})";
}

}  // namespace

TexturedMesh seed_mesh() {
  TexturedMesh textured;
  textured.mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  textured.mesh.faces = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
  textured.atlas.resolution = 1;
  textured.atlas.texels.assign(4, Vec3d(0.25, 0.5, 0.75));
  return textured;
}

Calibration seed_calibration() {
  Calibration calibration;
  calibration.camera = {721.5, 721.5, 609.5, 172.8, 1242, 375};
  calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  calibration.camera_from_velo.translation() = Vec3d(0.06, -0.08, -0.27);
  calibration.camera_from_rect.translation() = Vec3d(0.06, 0, 0);
  return calibration;
}

const nlohmann::json& seed_tables() {
  static const nlohmann::json tables = test::nuscenes_tables({seed_frame()});
  return tables;
}

nlohmann::json seed_identity() {
  return {{"limits", {0.8, 0.8, 0.5}}, {"vertex_rate", 1e-3}, {"texel_rate", 4e-3}, {"train", {"host"}}};
}

AttackSettings seed_settings() {
  AttackSettings settings;
  settings.limits.half = {0.8, 0.8, 0.5};
  settings.vertex_rate = 1e-3;
  settings.texel_rate = 4e-3;
  return settings;
}

TexturedMesh seed_start() {
  TexturedMesh start = seed_mesh();
  for (Vec3d& v : start.mesh.vertices) v *= 0.5;
  return start;
}

std::string seed_checkpoint(long steps) {
  AttackState state;
  state.adversary = seed_start();
  state.iteration = state.vertices.step_count = state.texels.step_count = steps;
  if (steps > 0) {
    state.vertices.first.assign(3 * state.adversary.mesh.vertices.size(), 0.125);
    state.texels.first.assign(3 * state.adversary.atlas.texels.size(), -0.125);
    state.vertices.second = state.vertices.first;
    state.texels.second.assign(state.texels.first.size(), 0.5);
    state.held_out.add(0, 1.5, state.adversary);
    state.held_out.add(steps, 1.25, state.adversary);
  }
  state.losses.assign(as_size(steps), {1, 0.5, 0.25, 1});
  return written("seed-checkpoint.json",
                 [&](const fs::path& file) { write_checkpoint(file, state, seed_identity()); });
}

std::vector<Seed> seeds() {
  const auto calibration = seed_calibration();
  ImageF depth(4, 3, 1, 12.5f);
  depth.data[2] = 0;
  std::vector<Seed> all = {
      {"calibration", "kitti",
       written("seed.txt", [&](const fs::path& file) { write_calibration(file, calibration); })},
      {"labels", "two",
       written("seed.txt", [&](const fs::path& file) { write_labels(file, seed_labels(), calibration); })},
      {"tracks", "three", "0\n-1\r\n12\n"},
      {"tracking", "two", test::tracking_labels(scratch(), 0, seed_frame())},
      {"tracklets", "one", test::tracklets({seed_frame()})},
      {"nuscenes", "change",
       R"({"sample_annotation": [], "category": [{"token": "category-Car", "name": "vehicle.truck"}]})"},
      {"nuscenes", "whole", seed_tables().dump()},
      {"detections", "two",
       R"({"frames": [{"frame": "000000", "detections": [{"x": 20, "y": -3, "length": 4, "width": 1.7, "yaw": 0.1,)"
       R"( "score": 0.75, "picture": {"left": 1, "top": 2, "right": 30, "bottom": 40}},)"
       R"( {"left": 100, "top": 200, "right": 300, "bottom": 250, "score": 0.5}], "vehicles": []}]})"},
      {"sweep", "three",
       written("seed.bin",
               [](const fs::path& file) {
                 write_sweep(file, {{5, 0, -1.7f, 0.3f}, {0, 60, 1, 0}, {1, 2, 3, 1}});
               })},
      {"lighting", "default",
       written("seed.json", [](const fs::path& file) { write_json(file, to_json(Lighting())); })},
      {"png", "colour", encode_srgb_png(picture())},
      {"png", "depth", written("seed.png", [&](const fs::path& file) { write_depth_png(file, depth); })},
      {"gltf", "scene", scene()},
      {"gltf", "foreign", foreign()},
      {"ply", "binary",
       written("seed.ply", [](const fs::path& file) { write_mesh(file, seed_mesh().mesh); })},
      {"ply", "text",
       "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
       "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0.5\n3 0 1 "
       "2\n"},
      {"obj", "corner",
       "o corner\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0.5\nvn 0 0 1\nusemtl none\nf 1/1/1 2/1 "
       "3//1\nf 1 2 3 4\n"},
      {"toml", "kinds",
       "a = 1\nb = -2.5e3\nc = [true, 'x', {d = \"\\u00e9\\n\"}]\n[t.u]\n\"v w\" = 0x1f # note\n[[l]]\nm = "
       "nan\n"},
      {"rig", "two-lasers", rig("", "")},
      {"rig", "all-keys",
       rig("look = \"american\"\n",
           "rotation = \"clockwise\"\nfiring_time = [0, 2.3]\ndivergence = [3, 1.5]\n")},
      {"placement", "neighbour",
       "what = \"kerb\"\nanchor = \"right\"\noffset = [0, -1.2, 0.1]\nyaw = 30\nvolume = [1, 1, 2]\nbox = "
       "\"as "
       "labelled\"\nvictim = \"neighbour\"\nwithin = 12\n"},
      {"placement", "grown",
       "what = \"rack\"\nanchor = \"rear\"\noffset = [-0.5, 0, 0.5]\nyaw = -90\nvolume = [0.8, 1, 1]\nbox = "
       "\"grown\"\nvictim = \"carrier\"\n"},
      {"gamut", "xyz", read_file(shipped_file("scenes/prints/fogra39.ti3"))},
      {"gamut", "lab",
       "IT8.7/4\nORIGINATOR \"nobody\"\nNUMBER_OF_FIELDS 5\nBEGIN_DATA_FORMAT\nSAMPLE_ID SAMPLE_NAME LAB_L "
       "LAB_A "
       "LAB_B\nEND_DATA_FORMAT\nNUMBER_OF_SETS 5\nBEGIN_DATA\n1 A1 95 0 -2\n2 A2 55 -37 -50\n3 A3 48 74 "
       "-3\n4 \"A 4\" 89 -5 93\n5 A5 16 0 0\nEND_DATA\n"},
      {"gamut", "profile", gamut_profile()},
      {"shape", "small", shape()},
      {"weights", "whole", weights(false)},
      {"weights", "with-parts", weights(true)},
      {"run", "whole", run()},
      {"checkpoint-fields", "none", "{}"},
      {"checkpoint-fields", "some", R"({"losses":[1,2,3,4,5,6],"hidden":[1,0],"found":[1,1]})"},
      {"checkpoint", "fresh", seed_checkpoint(0)},
      {"checkpoint", "whole", seed_checkpoint(2)}};
  return all;
}

void write_bytes(const fs::path& file, std::string_view bytes) {
  static std::map<std::string, int> open_files;  // until the process ends: opening costs as much as reading
  auto found = open_files.find(file.native());
  if (found == open_files.end()) {
    fs::create_directories(file.parent_path());
    const int descriptor = ::open(file.c_str(), O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0600);
    found = open_files.emplace(file.native(), descriptor).first;
  }
  if (::pwrite(found->second, bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size()) ||
      ::ftruncate(found->second, static_cast<off_t>(bytes.size())) != 0)
    throw std::runtime_error(file.string() + " cannot be written");
}

const fs::path& scratch() {
  struct Folder {
    Folder() {
      const fs::path memory = "/dev/shm";
      path = (::access(memory.c_str(), W_OK) == 0 ? memory : fs::temp_directory_path()) /
             ("mirage-fuzz-" + std::to_string(getpid()));
      fs::create_directories(path);
    }
    ~Folder() {
      std::error_code ignored;
      fs::remove_all(path, ignored);
    }
    fs::path path;
  };
  static const Folder folder;
  return folder.path;
}

}  // namespace mirage::fuzz
