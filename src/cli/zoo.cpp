// mirage zoo: makes the objects that ship in scenes/objects, and measures what they do.
#include "attack/zoo.h"

#include <fmt/ranges.h>

#include <memory>

#include "attack/adversary.h"
#include "attack/baseline.h"
#include "attack/evaluate_run.h"
#include "base/error.h"
#include "base/files.h"
#include "base/provenance.h"
#include "base/words.h"
#include "cli/command.h"
#include "cli/named_settings.h"
#include "cli/options.h"
#include "cli/table.h"
#include "exchange/object_file.h"

namespace mirage::cli {
namespace {

struct ZooOptions {
  std::string learned = "lidar,camera,painted,fusion,late,refined,fusion:buildable";
  int frames = 24, judged = 40, iterations = 60;
  std::string quality = "draft";
};

/// Not yet a file.
struct ZooObject {
  std::string name;
  TexturedMesh mesh;
  std::string kind, what;           ///< "learned", "shape" or "load"
  std::string detector = "fusion";  ///< that it was learned against, or that it is judged by
  nlohmann::json made = nullptr;    ///< how it was learned
};

constexpr const char* kLicence = "Apache-2.0";
constexpr int kTexels = 3;  ///< C of what ships: a file stays under 300 kB

void add_options(CLI::App& app, ZooOptions& options) {
  app.add_option(
         "--learn", options.learned,
         "objects to learn: detectors by their words, \":buildable\" after those that shall be printable; "
         "none: shapes and loads alone")
      ->capture_default_str();
  app.add_option("--frames", options.frames, "generated frames to learn on")->capture_default_str();
  app.add_option("--judged", options.judged, "generated frames to judge on")->capture_default_str();
  app.add_option("--iterations", options.iterations, "attack steps of each")->capture_default_str();
  app.add_option("--quality", options.quality, "of the attacks' pictures: draft or default")
      ->capture_default_str();
}

std::vector<ZooObject> made_without_learning(std::uint64_t seed) {
  std::vector<ZooObject> objects;
  objects.push_back(
      {"random", random_adversary(seed), "shape", "a random mesh of 1.2 × 1.2 × 0.75 m, random texels"});
  for (const Baseline kind : {Baseline::ellipsoid, Baseline::cuboid}) {
    TexturedMesh mesh = filling_shape(kind, {}, {});
    paint_patches(mesh, 12, seed);
    objects.push_back({to_string(kind), std::move(mesh), "shape",
                       to_string(kind) + " of 1.6 × 1.6 × 1 m, twelve random patches"});
  }
  for (const CarriedLoad& load : carried_loads())
    objects.push_back({load.name, carried_load(load.name), "load", load.what});
  return objects;
}

/// Learns an object against "fusion" or "fusion:buildable".
ZooObject learn(const std::string& word, const ZooOptions& options, const Common& common,
                const std::filesystem::path& data) {
  const auto colon = word.find(':');
  const std::string detector = word.substr(0, colon),
                    how = colon == std::string::npos ? "" : word.substr(colon + 1);
  if (!how.empty() && how != "buildable")
    throw FieldError("learn", word, "asks for an object that is no kind",
                     "use DETECTOR or DETECTOR:buildable");
  const std::string name = detector + (how.empty() ? "" : "-" + how);
  const std::filesystem::path run = common.out / "runs" / name;
  NamedSettings settings = {{"data", data.string()},
                            {"detector", detector},
                            {"quality", options.quality},
                            {"iterations", std::to_string(options.iterations)},
                            {"seed", std::to_string(common.seed)},
                            {"threads", std::to_string(common.threads)},
                            {"quiet", fmt::format("{}", common.quiet)},
                            {"out", run.string()}};
  if (!how.empty()) settings["buildable"] = "true";
  const nlohmann::json result = run_command("attack", settings, "mirage zoo");
  const Run learned = read_run(run);
  return {name,
          learned.adversary,
          "learned",
          "learned against " + detector + (how.empty() ? "" : ", printable"),
          detector,
          {{"identity", result.at("provenance").at("identity")},
           {"iterations", options.iterations},
           {"vehicles", learned.train.size()},
           {"quality", options.quality}}};
}

nlohmann::json about(const ZooObject& object, const Common& common) {
  const Vec3d size = bounds(object.mesh.mesh).sizes();
  nlohmann::json json = {{"name", object.name},
                         {"kind", object.kind},
                         {"what", object.what},
                         {"seed", common.seed},
                         {"licence", kLicence},
                         {"program", program_version()},
                         {"extents_m", {size.x(), size.y(), size.z()}},
                         {"faces", object.mesh.mesh.faces.size()}};
  if (!object.made.is_null()) json["learned"] = object.made;
  if (object.kind == "learned") json["learned"]["detector"] = object.detector;
  return json;
}

/// Vanished shares of the files by one detector, by name.
std::map<std::string, nlohmann::json> judge(const std::vector<std::filesystem::path>& files,
                                            const std::string& detector, const std::filesystem::path& data,
                                            const Common& common) {
  EvaluationRequest request;
  request.meshes = files;
  request.asked["data"] = data.string();
  request.detector.detector = detector;
  request.detector.seed = common.seed;
  request.detector.threads = common.threads;
  request.settings.quiet = common.quiet;
  const RunEvaluation evaluation = evaluate_run(request);
  std::map<std::string, nlohmann::json> shares;
  for (const ObjectArm& arm : evaluation.each) {
    nlohmann::json& share = shares[std::filesystem::path(arm.name).stem().string()];
    share = to_json(arm.evaluation.hiding.vanished.share);
    share["vehicles"] = arm.evaluation.hiding.vanished.vehicles;
    share["clusters"] = to_json(arm.evaluation.clusters);
    share["detector"] = detector;
  }
  return shares;
}

nlohmann::json run(const ZooOptions& options, const Common& common) {
  const std::filesystem::path data = common.out / "data", judged = common.out / "judged",
                              folder = common.out / "objects";
  const auto generate = [&](const std::filesystem::path& where, int frames, std::uint64_t seed) {
    if (frames < 1) throw FieldError("frames", std::to_string(frames), "is too few", "use at least 1");
    run_command("generate",
                {{"rig", "kitti64"},
                 {"frames", std::to_string(frames)},
                 {"seed", std::to_string(seed)},
                 {"threads", std::to_string(common.threads)},
                 {"quiet", fmt::format("{}", common.quiet)},
                 {"out", where.string()}},
                "mirage zoo");
  };
  std::vector<ZooObject> objects = made_without_learning(common.seed);
  const std::vector<std::string> words =
      options.learned == "none" ? std::vector<std::string>() : listed_words(options.learned);
  // Frames of seeds that no shipped detector was trained on, and of two different ones.
  generate(judged, options.judged, common.seed + 90002);
  if (!words.empty()) generate(data, options.frames, common.seed + 90001);
  for (const std::string& word : words) objects.push_back(learn(word, options, common, data));

  std::map<std::string, std::vector<std::filesystem::path>> files;  // by detector
  nlohmann::json list = nlohmann::json::array();
  for (ZooObject& object : objects) {
    if (object.mesh.atlas.resolution > kTexels) object.mesh = resampled(object.mesh, kTexels);
    const std::filesystem::path file = folder / (object.name + ".glb");
    list.push_back(about(object, common));
    write_object(file, object.mesh, list.back());
    files[object.detector].push_back(file);
  }
  Rows rows;
  for (const auto& [detector, its] : files) {
    const auto shares = judge(its, detector, judged, common);
    for (nlohmann::json& object : list)
      if (const auto share = shares.find(object.at("name")); share != shares.end())
        object["vanished"] = share->second;
  }
  for (const nlohmann::json& object : list) {
    const nlohmann::json& share = object.at("vanished");
    rows.push_back({object.at("name"),
                    fmt::format("{}: {} of {} cars vanish by {}", object.at("what").get<std::string>(),
                                percent(share.at("value"), share.at("low"), share.at("high")),
                                share.at("vehicles").get<int>(), share.at("detector").get<std::string>())});
  }
  write_json(
      folder / "zoo.json",
      {{"command",
        fmt::format("mirage zoo --seed {} --learn {} --frames {} --judged {} --iterations {} --quality {}",
                    common.seed, options.learned, options.frames, options.judged, options.iterations,
                    options.quality)},
       {"objects", list}});
  print_table(rows);
  return {{"objects", list}};
}

}  // namespace

Command zoo_command() {
  auto options = std::make_shared<ZooOptions>();
  return Command{
      .name = "zoo",
      .help =
          "makes the objects that ship in scenes/objects: shapes, loads, and objects learned on generated "
          "frames",
      .default_out = "out/zoo",
      .example = "mirage zoo --learn none --out out/zoo",
      .options = [options](CLI::App& app) { add_options(app, *options); },
      .run = [options](const Common& common) { return run(*options, common); },
  };
}

}  // namespace mirage::cli
