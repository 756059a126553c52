#include "fuzz/parsers.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <map>
#include <stdexcept>

#include "attack/buildable.h"
#include "attack/checkpoint.h"
#include "attack/run.h"
#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/sizes.h"
#include "detection/detect.h"
#include "exchange/gltf.h"
#include "exchange/mesh_files.h"
#include "fuzz/seeds.h"
#include "generator/generator.h"
#include "plugins/tensor_file.h"
#include "scene/data/data_rig.h"
#include "scene/data/kitti.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"
#include "scene/place_choice.h"
#include "scene/shape/shape_model.h"

namespace mirage::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 1242, kHeight = 375;
/// Upper limits for a picture, a rig or a mesh: above them the program would be killed instead of refusing.
constexpr double kMaxPixels = 1 << 26, kMaxRays = 1 << 23;

constexpr auto kReplaceBadUtf8 = nlohmann::json::error_handler_t::replace;

void check(const Transform& transform) {
  demand(transform.matrix().allFinite(), "a pose is not finite");
  const Eigen::Matrix3d r = transform.linear();
  demand((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() < 1e-2,
         "a pose is no rigid one");
}

void check(const PinholeCamera& camera) {
  demand(std::isfinite(camera.fx + camera.fy + camera.cx + camera.cy), "a camera is not finite");
  demand(camera.fx > 0 && camera.fy > 0, "a focal length is not positive");
  demand(camera.width > 0 && camera.height > 0 &&
             static_cast<double>(camera.width) * camera.height <= kMaxPixels,
         "a picture's size is out of bounds");
}

void check(const ImageF& image) {
  demand(static_cast<double>(image.width) * image.height <= kMaxPixels, "a picture is too large");
  for (const float value : image.data) demand(std::isfinite(value), "a pixel is not finite");
}

void check(const TexturedMesh& textured) {
  check_mesh(textured, "what was read");
  for (const Vec3d& texel : textured.atlas.texels) demand(texel.allFinite(), "a texel is not finite");
  demand(std::isfinite(signed_volume(textured.mesh)), "a mesh is too large to compute with");
}

void check(const LidarModel& lidar) {
  demand(!lidar.beams.empty() && lidar.azimuth_count() >= 1, "a LiDAR without rays");
  demand(static_cast<double>(lidar.beams.size()) * lidar.azimuth_count() <= kMaxRays, "too many rays");
  for (const int column : {0, lidar.azimuth_count() - 1}) {
    const LidarRay ray = lidar.ray(static_cast<int>(lidar.beams.size()) - 1, column);
    demand(ray.origin.allFinite() && std::abs(ray.direction.norm() - 1) < 1e-6, "a ray is none");
  }
}

void calibration(const fs::path& file) {
  const Calibration read = read_calibration(file, kWidth, kHeight);
  check(read.camera);
  check(read.camera_from_velo);
  check(read.rect_from_velo());
}

void check(const Box3& box) {
  demand(std::isfinite(box.bev.x + box.bev.y + box.bev.yaw + box.bottom), "a box is not finite");
  demand(box.bev.length > 0 && box.bev.width > 0 && box.height > 0, "a box without size");
  demand(std::isfinite(box.bev.length * box.bev.width * box.height), "a box of any size");
}

void check(const std::vector<Label>& labels) {
  for (const Label& label : labels) {
    demand(std::isfinite(label.truncated + label.left + label.top + label.right + label.bottom),
           "a label is not finite");
    demand(label.left <= label.right && label.top <= label.bottom,
           "a label's box in the picture is turned over");
    if (has_box(label)) check(label.box);
  }
}

void labels(const fs::path& file) {
  static const Calibration known = seed_calibration();
  check(read_labels(file, known));
}

void check(const Annotations& known) {
  check(known.calibration.camera);
  check(known.calibration.camera_from_velo);
  check(known.labels);
}

void tracking(const fs::path& file) {
  static const Calibration known = seed_calibration();
  LabelNotes notes;
  check(read_tracking_labels(file, 0, 0, known, notes));
}

void tracklets(const fs::path& file) {
  static const Calibration known = seed_calibration();
  check(read_tracklets(file, 0, 0, known));
}

/// The bytes are a JSON merge patch on all tables of a set of one sample: {"sample_data": …, …}. Tables
/// without a patch stay as they are on disk.
void nuscenes(const fs::path& file) {
  static std::map<std::string, std::string> patched;  // by table name, as dumped; empty: as in the seed
  const nlohmann::json patch = read_json(file);
  const fs::path folder = scratch() / "nuscenes/v1.0-fuzz";
  if (!patch.is_object()) return;
  fs::create_directories(folder);
  static const bool files_are_there = [&] {  // a sample without its files is none
    for (const nlohmann::json& row : seed_tables().at("sample_data")) {
      const fs::path place = folder.parent_path() / row.at("filename").get<std::string>();
      fs::create_directories(place.parent_path());
      std::ofstream(place) << "not read here";
    }
    return true;
  }();
  if (!files_are_there) return;
  for (const auto& [name, rows] : seed_tables().items()) {
    const auto change = patch.find(name);
    const std::string wanted = change == patch.end() ? "" : change->dump(-1, ' ', false, kReplaceBadUtf8);
    const auto [before, first] = patched.try_emplace(name);
    if (!first && before->second == wanted) continue;
    // A new file, not the same one with the same time stamp: changed tables are read again.
    fs::remove(folder / (name + ".json"));
    nlohmann::json table = rows;
    if (change != patch.end()) table.merge_patch(*change);
    if (!table.is_null())
      std::ofstream(folder / (name + ".json")) << table.dump(-1, ' ', false, kReplaceBadUtf8);
    before->second = wanted;
  }
  const auto set = open_data_set(folder.parent_path());
  for (const std::string& id : set->frames()) {
    const fs::path picture = set->source_files(id).at(1).file.lexically_relative(folder.parent_path());
    demand(!picture.empty() && *picture.begin() != "..", "a picture outside the data set");
    check(set->annotations(id, kWidth, kHeight));
  }
}

void detections(const fs::path& file) {
  Frame frame;
  frame.id = "000000";
  for (const KittiDetection& found : DetectionFiles(file).of(frame)) {
    demand(std::isfinite(found.score), "a score is not finite");
    demand(found.box || found.picture, "a detection without a box");
    if (found.box) check(*found.box);
  }
}

void tracks(const fs::path& file) {
  const auto all = open_data_set(file.parent_path().parent_path().parent_path())->tracks(file.stem());
  for (const int track : *all) demand(track >= -1, "an identity below -1");
}

void sweep(const fs::path& file) {
  for (const LidarPoint& point : read_sweep(file))
    demand(point.position().allFinite() && std::isfinite(point.reflectance), "a return is not finite");
}

void lighting(const fs::path& file) {
  const Lighting light = read_lighting(file);
  demand(std::abs(light.to_sun_velo.norm() - 1) < 1e-9, "a direction of another length");
  demand((light.sun + light.ambient + light.hemisphere).allFinite(), "a light is not finite");
}

/// Reads the picture in both ways, so that a refusal by the first does not hide the second.
void png(const fs::path& file) {
  try {
    check(read_depth_png(file));
  } catch (const InputError&) {
    check(read_srgb(file));
  }
}

void gltf(const fs::path& file) {
  const TexturedMesh mesh = read_adversary(file);
  check(mesh);
  const RenderScene scene = read_scene(file, 64, 48);
  check(scene.camera);
  check(scene.camera_from_velo);
  check(scene.photograph);
  demand((scene.lighting.sun + scene.lighting.to_sun_velo + scene.lighting.ambient).allFinite(),
         "a light is not finite");
  for (const RenderScene::Thing& thing : scene.things) check(thing.textured);
}

/// Meshes of other programs.
void mesh(const fs::path& file) {
  check_mesh({read_mesh(file), {}}, "what was read");
}

void toml(const fs::path& file) {
  const nlohmann::json once = read_toml(file);
  // Dates are read as null, which TOML cannot express.
  if (once.dump(-1, ' ', false, kReplaceBadUtf8).find("null") != std::string::npos) return;
  demand(parse_toml(toml_text(once), "written") == once, "what is written reads as something else");
}

void rig(const fs::path& file) {
  const Rig read = read_rig(file);
  check(read.calibration.camera);
  check(read.calibration.camera_from_velo);
  check(read.lidar);
}

void placement(const fs::path& file) {
  PlaceChoice place;
  set_from_text(file.string(), place);
  demand(
      place.at.allFinite() && place.at.cwiseAbs().maxCoeff() <= kMaxPlaceDistance && std::isfinite(place.yaw),
      "the object stands nowhere");
  demand(place.volume.minCoeff() > 0 && place.volume.allFinite(), "there is no room for an object");
  demand((place.victim == Victim::neighbour) == (place.within > 0), "a neighbour is nowhere");
  demand(to_json(read_place(to_json(place), file, "placed", place.name)) == to_json(place),
         "what a run says of it reads as something else");
}

void gamut(const fs::path& file) {
  const PrintGamut read = read_gamut(file, "print");
  for (const Vec3d& colour : read.colours())
    demand(colour.minCoeff() >= 0 && colour.maxCoeff() <= 1, "a colour that no texture holds");
  for (const Vec3d& texel : {Vec3d(0, 0, 0), Vec3d(1, 0, 0), Vec3d(0.2, 0.9, 1)})
    demand(read.holds(read.nearest(texel)), "the nearest colour is outside");
  const PrintGamut again = read_gamut(to_json(read), file, "gamut_colours", "print");
  demand(again.nearest({1, 0, 0}) == read.nearest({1, 0, 0}),
         "what a run says of it reads as something else");
}

void shape(const fs::path& file) {
  const ShapeModel model = read_shape_model(file);
  for (const float value : model.values) demand(std::isfinite(value), "a distance is not finite");
  demand(model.prior_mean.allFinite() && model.prior_covariance.allFinite(), "the prior is not finite");
  ShapeParameters mean;
  mean.code = Eigen::VectorXd::Zero(model.dimension);
  const Eigen::VectorXd q = mean.packed();
  const double d = model.distance(q.data(), {0.1, 0.2, 0.3});
  demand(std::isfinite(d), "a distance read between the nodes is not finite");
}

void run(const fs::path& file) {
  // A run folder's other files do not change.
  static const bool made = [] {
    write_adversary(scratch() / "adversary.glb", seed_mesh());
    write_adversary(scratch() / "random.glb", seed_mesh());
    return true;
  }();
  static_cast<void>(made);
  const Run read = read_run(file.parent_path());
  demand(std::isfinite(read.settings.min_view) && read.settings.limits.half.allFinite(),
         "a number is not finite");
  const auto& raster = read.settings.simulation.raster;
  demand(std::isfinite(raster.sigma + raster.gamma + raster.epsilon + raster.dist_eps),
         "a number is not finite");
  for (const auto* hosts : {&read.train, &read.test})
    for (const HostId& host : *hosts) {
      demand(host.label >= 0, "a host's label is negative");
      demand(host.frame.find('/') == std::string::npos, "a frame's name leaves the data set");
    }
}

void check(const AttackState& state) {
  demand(state.iteration >= 0 && state.vertices.step_count >= 0, "a count is negative");
  check(state.adversary);
  for (const Adam* adam : {&state.vertices, &state.texels})
    for (const auto* moments : {&adam->first, &adam->second})
      for (const double value : *moments) demand(std::isfinite(value), "a moment is not finite");
}

void checkpoint(const fs::path& file) {
  check(read_checkpoint(file, seed_identity(), seed_settings(), seed_start()));
}

/// The bytes are a JSON merge patch (RFC 7386) on a whole checkpoint: mutations of its text would cut most
/// fields at once.
void checkpoint_fields(const fs::path& file) {
  static const nlohmann::json whole = nlohmann::json::parse(seed_checkpoint(2));
  nlohmann::json patched = whole;
  patched.merge_patch(read_json(file));
  const fs::path place = scratch() / "patched-checkpoint.json";
  write_bytes(place, patched.dump(-1, ' ', false, kReplaceBadUtf8));
  check(read_checkpoint(place, seed_identity(), seed_settings(), seed_start()));
}

/// A weights file without the files that it names.
void weights(const fs::path& file) {
  const std::string bytes = read_file(file);
  TensorFile read;
  try {
    read = parse_tensor_file(bytes);
  } catch (const std::runtime_error& refused) {
    throw InputError(file.string(), "", refused.what(), "train anew");
  }
  std::size_t all = 0;
  for (const auto& [name, tensor] : read.tensors) {
    std::size_t size = element_size(tensor.element);
    for (const std::int64_t side : tensor.shape) size *= as_size(side);
    demand(size == tensor.data.size(), "a tensor's shape is not that of its data");
    demand(tensor.data.data() >= bytes.data() &&
               tensor.data.data() + tensor.data.size() <= bytes.data() + bytes.size(),
           "a tensor leaves its file");
    float value = 0;
    if (tensor.element == Element::float32)
      for (std::size_t at = 0; at < size; at += sizeof value) {
        std::memcpy(&value, tensor.data.data() + at, sizeof value);
        demand(std::isfinite(value), "a weight is not finite");
      }
    all += size;
  }
  demand(all < bytes.size(), "tensors overlap");
  demand(read.parts.size() <= kMaxParts, "parts without end");
  for (const NamedPart& part : read.parts)
    demand(part.file.find('/') == std::string::npos, "a part lies elsewhere");
}

constexpr Parser kParsers[] = {{"calibration", "calib.txt", calibration},
                               {"labels", "label.txt", labels},
                               {"tracks", "training/track_2/000000.txt", tracks},
                               {"tracking", "sequence.txt", tracking},
                               {"tracklets", "tracklet_labels.xml", tracklets},
                               {"nuscenes", "tables.json", nuscenes},
                               {"detections", "detections.json", detections},
                               {"sweep", "sweep.bin", sweep},
                               {"lighting", "lighting.json", lighting},
                               {"png", "picture.png", png},
                               {"gltf", "mesh.glb", gltf},
                               {"ply", "mesh.ply", mesh},
                               {"obj", "mesh.obj", mesh},
                               {"toml", "any.toml", toml},
                               {"rig", "rig.toml", rig},
                               {"placement", "place.toml", placement},
                               {"gamut", "print.icc", gamut},
                               {"shape", "cars.shape", shape},
                               {"weights", "some.weights", weights},
                               {"run", "run.json", run},
                               {"checkpoint", "checkpoint.json", checkpoint},
                               {"checkpoint-fields", "patch.json", checkpoint_fields}};

}  // namespace

std::span<const Parser> parsers() {
  return kParsers;
}

const Parser& parser_named(const std::string& name) {
  std::string known;
  for (const Parser& parser : kParsers) {
    if (name == parser.name) return parser;
    known += std::string(" ") + parser.name;
  }
  throw std::invalid_argument("no parser '" + name + "'; there are:" + known);
}

void demand(bool good, const char* what) {
  if (!good) throw std::logic_error(std::string("accepted: ") + what);
}

std::string read_bytes(const Parser& parser, std::string_view bytes) {
  const fs::path file = scratch() / parser.file;
  write_bytes(file, bytes);
  try {
    parser.read(file);
    return "";
  } catch (const InputError& refused) {
    const std::string line = refused.what();
    if (line.find_first_of("\n\r") != std::string::npos)
      throw std::logic_error("refused in more than one line: " + line);
    if (line.size() > bytes.size() + 2000) throw std::logic_error("refused in a line without end: " + line);
    return line.empty() ? "?" : line;
  }
}

}  // namespace mirage::fuzz
