// mirage export: the adversary and scenes of a run as glTF, the adversary as FBX and OBJ too.
#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <set>

#include "attack/evaluate_run.h"
#include "attack/run.h"
#include "base/child_process.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/logging.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "cli/options.h"
#include "exchange/gltf.h"
#include "exchange/mesh_files.h"
#include "frames/frame_provenance.h"
#include "frames/hosts.h"
#include "geometry/mesh.h"
#include "validation/blender/blender_process.h"
#include "validation/fidelity/validate.h"

namespace mirage::cli {
namespace {

struct ExportOptions {
  std::filesystem::path run;
  Overrides overrides;
  TrustRun trust = TrustRun::no;
  int frames = 1;
  bool fbx = false, obj = false, kit = false;
  std::vector<double> bed = {0.35, 0.35, 0.35};
  std::string sheet = "A0";
};

/// Writes the kit of the adversary: parts for a printer, its skin as paper sheets, a plate. Returns kit.json.
nlohmann::json write_kit(const ExportOptions& options, const Run& run, BlenderWorker& blender,
                         const std::filesystem::path& out) {
  constexpr double kTimeout = 600;  // s; it takes a few
  const TexturedMesh object = standing_on_origin(run.adversary);
  if (!is_watertight(object.mesh))
    throw InputError((options.run / "adversary.glb").string(), "mesh",
                     "is not watertight, so it has no inside", "learn it without --free");
  make_output_folder(out);
  nlohmann::json vertices = nlohmann::json::array(), texels = vertices, triangles = vertices;
  const nlohmann::json faces = object.mesh.faces;
  for (const Vec3d& v : object.mesh.vertices) vertices.push_back({v.x(), v.y(), v.z()});
  for (const Vec3d& t : object.atlas.texels) {
    const auto byte = [](double linear) { return srgb_from_linear(static_cast<float>(linear)); };
    texels.push_back({byte(t.x()), byte(t.y()), byte(t.z())});
  }
  for (const AtlasTriangle& triangle : atlas_triangles(object.atlas.resolution)) {
    nlohmann::json corners = nlohmann::json::array();
    for (const Vec2d& b : triangle.corners) corners.push_back({b.x(), b.y()});
    triangles.push_back({{"corners", corners}, {"texel", triangle.texel}});
  }
  const nlohmann::json cut = blender.request({{"job", "kit"},
                                              {"vertices", vertices},
                                              {"faces", faces},
                                              {"bed", options.bed},
                                              {"out", std::filesystem::absolute(out).string()}},
                                             kTimeout);
  write_json(out / "object.json", {{"name", options.run.filename().string()},
                                   {"vertices", vertices},
                                   {"faces", faces},
                                   {"texels", texels},
                                   {"triangles", triangles},
                                   {"bed", options.bed},
                                   {"sheet", options.sheet},
                                   {"parts", cut.at("parts")},
                                   {"judged_shape_m", run.settings.expectation.shape}});
  std::string output;
  const int status = run_script("validation/report/kit_sheets.py", out, &output);
  if (status == 3) throw FieldError("sheet", options.sheet, output, "use a larger one");
  if (status != 0)
    throw Failure("kit", output.empty() ? "no sheets were made" : output,
                  "install python3-matplotlib and python3-pil");
  return read_json(out / "kit.json");
}

Rows kit_rows(const nlohmann::json& kit) {
  Rows rows = {{"kit", fmt::format("{} parts, {} sheets of {}", kit.at("parts").size(),
                                   kit.at("sheets").get<int>(), kit.at("sheet").get<std::string>())}};
  for (const nlohmann::json& mass : kit.at("masses"))
    rows.push_back({fmt::format("mass of {}", mass.at("made_of").get<std::string>()),
                    fmt::format("{:.1f} kg", mass.at("kg").get<double>())});
  rows.push_back({"drag at 50 km/h", fmt::format("{:.0f} N", kit.at("drag_at_50_kmh_n").get<double>())});
  rows.push_back({"straps hold", fmt::format("{:.0f} N", kit.at("strap_force_n").get<double>())});
  return rows;
}

/// Removes the files that an earlier export wrote into this folder, by the list in its result: its other
/// scenes and formats would pass for this object's.
void remove_earlier_scenes(const std::filesystem::path& folder) {
  const nlohmann::json before = earlier_result(folder);
  if (!before.is_object() || !before.contains("files") || !before.at("files").is_array()) return;
  for (const nlohmann::json& name : before.at("files")) {
    if (!name.is_string()) continue;
    const std::filesystem::path path = name.get<std::string>();
    const bool inside = path.is_relative() && std::find(path.begin(), path.end(), "..") == path.end();
    std::error_code ignored;  // a name that is a folder's by now
    if (inside && std::filesystem::is_regular_file(folder / path, ignored))
      std::filesystem::remove(folder / path, ignored);
  }
}

nlohmann::json run(const ExportOptions& options, const Common& common) {
  Run run = read_run(options.run, options.trust);
  override_settings(run, options.overrides, common.seed);
  std::optional<BlenderWorker> blender;  // first: where it is missing, say so now
  if (options.fbx || options.kit) {
    require_text_path(common.out);
    blender.emplace(common.out / "blender.log");
  }
  std::vector<HostId> hosts = shown_hosts(run, options.frames);
  require_unchanged(run, hosts);
  run.settings.cameras = Cameras::all;  // labels keep their numbers
  FrameStore store(run.settings);
  if (options.overrides.contains("placement")) {
    const SkippedHosts left_out = leave_out(store, hosts);
    if (hosts.empty()) refuse_left_out(store.place(), left_out);
    warn_of_left_out(store.place(), left_out);
  }
  if (hosts.empty())
    throw InputError((options.run / "run.json").string(), "test", "no test vehicles to export",
                     "give --frames N, which goes on with those that it learned on");
  const auto known = hosts_learned_on(run, run.settings, hosts, frames_learned_on(run, run.settings.data));
  const std::set<HostId> learned(known.begin(), known.end());
  common.provenance->add(run.settings);
  add_frames(*common.provenance, run.settings, hosts);
  remove_earlier_scenes(common.out);
  write_adversary(common.out / "adversary.glb", run.adversary);
  RoofCount rooftops;
  Progress progress("export", hosts.size(), common.quiet);
  auto files = nlohmann::json::array({"adversary.glb"});
  if (options.obj) {
    write_obj(common.out / "adversary.obj", standing_on_origin(run.adversary));
    for (const char* file : {"adversary.obj", "adversary.mtl", "adversary.png"}) files.push_back(file);
  }
  nlohmann::json kit;
  if (options.kit) {
    kit = write_kit(options, run, *blender, common.out / "kit");
    for (const char* file : {"kit/kit.json", "kit/object.3mf", "kit/sheets.pdf", "kit/plate.svg"})
      files.push_back(file);
    for (const nlohmann::json& part : kit.at("parts"))
      files.push_back("kit/" + part.at("file").get<std::string>());
  }
  if (options.fbx) {
    blender->write_fbx(common.out / "adversary.fbx", run.adversary);
    files.push_back("adversary.fbx");
  }
  blender.reset();
  std::size_t others = 0;
  for (const HostId& id : hosts) {
    throw_if_interrupted("the files written so far are complete");
    const auto frame_handle = store.get(id.frame);
    const PreparedFrame& prepared = *frame_handle;
    const Placement placement = store.placement(id);
    rooftops.add(placement.carrier->from_box);
    const std::string name = host_name(id);
    ExportScene scene = host_scene(prepared.frame, placement, run.adversary, name);
    scene.learned_on = learned.contains(id);
    others += scene.others.size();
    write_scene(common.out / (name + ".glb"), scene);
    files.push_back(name + ".glb");
    progress.add();
  }
  const auto& [mesh, atlas] = run.adversary;
  print_table({{"adversary", fmt::format("{} vertices, {} faces, {}×{} texels a face", mesh.vertices.size(),
                                         mesh.faces.size(), atlas.resolution, atlas.resolution)},
               {"scenes", fmt::format("{} ({} of vehicles learned on)", hosts.size(), learned.size())},
               {"roofs", roofs(rooftops.fitted, rooftops.from_box)},
               {"folder", common.out.string()}});
  if (!kit.is_null()) print_table(kit_rows(kit));
  nlohmann::json result = {{"scenes", hosts.size()},
                           {"learned_on", learned.size()},
                           {"rooftops", to_json(rooftops)},
                           {"placement", text_of(run.settings.placement)},
                           {"placed", to_json(run.settings.placement)},
                           {"files", files}};
  if (others > 0) result["other_cameras"] = others;
  if (!kit.is_null()) result["kit"] = kit;
  return result;
}

void add_options(CLI::App& app, ExportOptions& options) {
  app.add_option("--run", options.run, "folder of a finished mirage attack")->required();
  // Without "cameras": labels keep their numbers only where all are read, and each that shows the object is
  // written.
  add_overrides<FrameSource>(app, options.overrides,
                             {"data", "rig", "depth", "rooftop", "placement", "sensors", "classes", "sun"});
  add_trust_option(app, options.trust);
  add_defaulted(app, "--frames", options.frames,
                "export N frames of the run, test frames first. 0: all test frames")
      ->check(within(kNotNegative));
  app.add_flag("--fbx", options.fbx,
               "also write adversary.fbx (by Blender) for engines: metres, pivot on the roof "
               "socket, embedded texels");
  app.add_flag("--obj", options.obj, "also write adversary.obj with .mtl and .png: metres, x forward, z up");
  auto* kit =
      app.add_flag("--kit", options.kit,
                   "also write what builds it (by Blender): parts as .stl and .3mf, its skin as .pdf at true "
                   "scale, a plate to mount it on");
  add_defaulted(app, "--bed", options.bed, "the printer's bed X,Y,Z, m; each part fits it")
      ->delimiter(',')
      ->expected(3)
      ->check(within({0.05, 10}))
      ->needs(kit);
  add_defaulted(app, "--sheet", options.sheet, "paper of the skin")
      ->check(one_of({"A0", "A1", "A2", "A3", "A4"}))
      ->needs(kit);
}

}  // namespace

Command export_command() {
  return command_of<ExportOptions>({
      .name = "export",
      .help = "writes the adversary and scenes of a run as .glb (and .fbx, .obj)",
      .example = "mirage export --run out/attack --frames 0 --fbx",
  });
}

}  // namespace mirage::cli
