// mirage zoo: makes the objects that ship in scenes/objects, and measures what they do.
#include "attack/zoo.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <map>
#include <set>
#include <sstream>

#include "attack/adversary.h"
#include "attack/baseline.h"
#include "attack/evaluate_run.h"
#include "base/fields.h"
#include "base/files.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "exchange/gltf.h"

namespace mirage::cli {
namespace {

struct ZooOptions {
  std::string learned =
      "lidar,camera,painted,fusion,late,refined,lidar:free,fusion:free,late:free,fusion:image,fusion:lidar,"
      "late:lidar,lidar:xenith,camera:xenith,fusion:xenith,late:xenith";
  std::string judges = "lidar,camera,painted,fusion,late,refined";
  int frames = 24, judged = 20, iterations = 60;
  std::string quality = "draft";
};

constexpr const char *kFirstRig = "kitti64", *kReference = "fusion";

/// An object that is learned, by its words: "fusion", "late:free:xenith".
struct Recipe {
  std::string detector, target = "both", rig = kFirstRig;
  bool free = false;  ///< of the rules of what can be built

  std::string name() const {
    return detector + (target == "both" ? "" : "-" + target) + (free ? "-free" : "") +
           (rig == kFirstRig ? "" : "-" + rig);
  }
  std::string what() const {
    return "learned against " + detector + (target == "both" ? "" : " by its " + target + " alone") +
           (rig == kFirstRig ? "" : " on frames of " + rig) + (free ? ", no solid" : "");
  }
};

/// Not yet a file.
struct ZooObject {
  std::string name;
  TexturedMesh mesh;
  std::string kind, what;             ///< "learned", "shape" or "load"
  std::string detector = kReference;  ///< that it was learned against, or that it is judged by
  std::string rig = kFirstRig;        ///< whose frames it was learned on and is judged on
  nlohmann::json made = nullptr;      ///< how it was learned
};

constexpr const char* kLicence = "Apache-2.0";
constexpr int kTexels = 3;  ///< C of what ships: a file stays under 300 kB

void add_options(CLI::App& app, ZooOptions& options) {
  add_defaulted(app, "--learn", options.learned,
                "objects to learn, by the names of detectors. Append \":free\" for a mesh that need not be "
                "buildable, \":image\" or \":lidar\" for one sensor's gradient, \":RIG\" for another rig. "
                "none: only shapes and loads");
  add_defaulted(app, "--judges", options.judges,
                "detectors that judge every object; own: each object's own alone");
  add_defaulted(app, "--frames", options.frames, "generated frames to learn on");
  add_defaulted(app, "--judged", options.judged, "generated frames to judge on");
  add_defaulted(app, "--iterations", options.iterations, "optimisation steps of each attack");
  add_defaulted(app, "--quality", options.quality,
                "quality of the rendered pictures while learning: draft or default");
}

/// FieldError for an unknown word.
Recipe recipe_of(const std::string& text) {
  const std::vector<std::string> rigs = shipped_names("scenes/rigs", ".toml");
  Recipe recipe;
  std::istringstream words(text);
  std::getline(words, recipe.detector, ':');
  for (std::string word; std::getline(words, word, ':');) {
    if (word == "free")
      recipe.free = true;
    else if (word == "image" || word == "lidar")
      recipe.target = word;
    else if (std::ranges::find(rigs, word) != rigs.end())
      recipe.rig = word;
    else
      throw FieldError("learn", text, word + " is not a word for an object",
                       fmt::format("use free, image, lidar, or a rig: {}", fmt::join(rigs, ", ")));
  }
  return recipe;
}

std::vector<ZooObject> made_without_learning(std::uint64_t seed) {
  std::vector<ZooObject> objects;
  objects.push_back(
      {"random", random_adversary(seed), "shape", "a random mesh of 1.2 × 1.2 × 0.75 m, random texels"});
  for (const Baseline kind : {Baseline::ellipsoid, Baseline::cuboid}) {
    TexturedMesh mesh = filling_shape(kind, {}, {.on = false});
    paint_patches(mesh, 12, seed);
    objects.push_back({to_word(kind), std::move(mesh), "shape",
                       std::string(to_word(kind)) + " of 1.6 × 1.6 × 1 m, twelve random patches"});
  }
  for (const CarriedLoad& load : carried_loads())
    objects.push_back({load.name, carried_load(load.name), "load", load.what});
  return objects;
}

ZooObject learn(const Recipe& recipe, const ZooOptions& options, const Common& common,
                const std::filesystem::path& data) {
  const std::filesystem::path run = common.out / "runs" / recipe.name();
  NamedSettings settings = {{"data", data.string()},
                            {"detector", recipe.detector},
                            {"target", recipe.target},
                            {"quality", options.quality},
                            {"iterations", std::to_string(options.iterations)},
                            {"seed", std::to_string(common.seed)},
                            {"threads", std::to_string(common.threads)},
                            {"quiet", fmt::format("{}", common.quiet)},
                            {"out", run.string()}};
  if (recipe.free) settings["free"] = "true";
  const nlohmann::json result = run_command("attack", settings, "mirage zoo");
  const Run learned = read_run(run);
  return {recipe.name(),
          learned.adversary,
          "learned",
          recipe.what(),
          recipe.detector,
          recipe.rig,
          {{"identity", result.at("provenance").at("identity")},
           {"iterations", options.iterations},
           {"vehicles", learned.train.size()},
           {"quality", options.quality},
           {"buildable", result.at("buildable")}}};
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
  if (object.kind == "learned") json["learned"]["rig"] = object.rig;
  return json;
}

/// Vanished shares of the files by one detector, by name.
std::map<std::string, nlohmann::json> judge(const std::vector<std::filesystem::path>& files,
                                            const std::string& detector, const std::filesystem::path& data,
                                            const Common& common) {
  EvaluationRequest request;
  request.meshes = files;
  request.overrides["data"] = data.string();
  request.detector.detector = detector;
  take_common(request.detector, common);
  request.settings.quiet = common.quiet;
  const RunEvaluation evaluation = evaluate_run(request);
  std::map<std::string, nlohmann::json> shares;
  for (const ObjectEvaluation& entry : evaluation.each) {
    nlohmann::json& share = shares[std::filesystem::path(entry.name).stem().string()];
    share = fields_json(entry.evaluation.hiding.vanished);
    share["clusters"] = to_json(entry.evaluation.clusters);
    share["detector"] = detector;
  }
  return shares;
}

nlohmann::json run(const ZooOptions& options, const Common& common) {
  const std::filesystem::path folder = common.out / "objects";
  for (const auto& [option, count] : {std::pair("frames", options.frames), {"judged", options.judged}})
    if (count < 1) throw FieldError(option, std::to_string(count), "is too few", "use at least 1");
  // Frames of seeds that no shipped detector was trained on, and of two different ones; made when asked for.
  std::set<std::filesystem::path> generated;
  const auto frames_of = [&](const std::string& rig, bool judged) {
    std::filesystem::path out = common.out / ((judged ? "judged-" : "data-") + rig);
    if (!generated.insert(out).second) return out;
    run_command("generate",
                {{"rig", rig},
                 {"frames", std::to_string(judged ? options.judged : options.frames)},
                 {"seed", std::to_string(common.seed + (judged ? 90002 : 90001))},
                 {"threads", std::to_string(common.threads)},
                 {"quiet", fmt::format("{}", common.quiet)},
                 {"out", out.string()}},
                "mirage zoo");
    return out;
  };
  std::vector<Recipe> recipes;
  if (options.learned != "none")
    for (const std::string& word : listed_words(options.learned)) recipes.push_back(recipe_of(word));
  std::vector<ZooObject> objects = made_without_learning(common.seed);
  for (const Recipe& recipe : recipes)
    objects.push_back(learn(recipe, options, common, frames_of(recipe.rig, false)));

  using Judge = std::pair<std::string, std::string>;  // rig, detector
  std::map<Judge, std::vector<std::filesystem::path>> files;
  std::set<std::string> judges;
  if (options.judges != "own")
    for (const std::string& word : listed_words(options.judges)) judges.insert(word);
  nlohmann::json list = nlohmann::json::array();
  for (ZooObject& object : objects) {
    if (object.mesh.atlas.resolution > kTexels) object.mesh = resampled(object.mesh, kTexels);
    const std::filesystem::path file = folder / (object.name + ".glb");
    list.push_back(about(object, common));
    write_adversary(file, object.mesh, list.back());
    files[{object.rig, object.detector}].push_back(file);
    for (const std::string& word : judges)
      if (Judge(kFirstRig, word) != Judge(object.rig, object.detector))
        files[{kFirstRig, word}].push_back(file);
  }
  for (const auto& [who, its] : files) {
    const auto& [rig, detector] = who;
    const auto shares = judge(its, detector, frames_of(rig, true), common);
    for (std::size_t i = 0; i < objects.size(); ++i) {
      const auto share = shares.find(objects[i].name);
      if (share == shares.end()) continue;
      if (rig == objects[i].rig && detector == objects[i].detector) list[i]["vanished"] = share->second;
      if (rig == kFirstRig && judges.contains(detector)) list[i]["judged_by"][detector] = share->second;
    }
  }
  Rows rows;
  for (const nlohmann::json& object : list) {
    const nlohmann::json& share = object.at("vanished");
    rows.push_back({object.at("name"),
                    fmt::format("{}: {} of {} cars vanish by {}", object.at("what").get<std::string>(),
                                percent(Interval{share.at("value"), share.at("low"), share.at("high")}),
                                share.at("vehicles").get<int>(), share.at("detector").get<std::string>())});
  }
  write_json(folder / "zoo.json",
             {{"command", fmt::format("mirage zoo --seed {} --learn {} --judges {} --frames {} --judged {} "
                                      "--iterations {} --quality {}",
                                      common.seed, options.learned, options.judges, options.frames,
                                      options.judged, options.iterations, options.quality)},
              {"objects", list}});
  print_table(rows);
  return {{"objects", list}};
}

}  // namespace

Command zoo_command() {
  return command_of<ZooOptions>({
      .name = "zoo",
      .help = "makes the objects that ship in scenes/objects: shapes, loads, and objects learned on "
              "generated frames",
      .example = "mirage zoo --learn none --out out/zoo",
  });
}

}  // namespace mirage::cli
