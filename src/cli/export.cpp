// mirage export: the adversary and scenes of a run as glTF, the adversary as FBX and OBJ too.
#include <fmt/format.h>

#include <memory>
#include <optional>

#include "attack/run.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/progress.h"
#include "cli/command.h"
#include "cli/options.h"
#include "cli/table.h"
#include "exchange/gltf.h"
#include "exchange/host_proxy.h"
#include "exchange/mesh_files.h"
#include "frames/hosts.h"
#include "frames/made_of.h"
#include "validation/blender/blender_process.h"
#include "validation/fidelity/validate.h"

namespace mirage::cli {
namespace {

struct ExportOptions {
  std::filesystem::path run;
  Overrides asked;
  TrustRun trust = TrustRun::no;
  int frames = 1;
  bool fbx = false, obj = false;
};

nlohmann::json run(const ExportOptions& options, const Common& common) {
  Run run = read_run(options.run, options.trust);
  override_settings(run, options.asked, common.seed);
  std::optional<BlenderWorker> blender;  // first: where it is missing, say so now
  if (options.fbx) {
    require_text_path(common.out);
    blender.emplace(common.out / "blender.log");
  }
  write_adversary(common.out / "adversary.glb", run.adversary);
  const std::vector<HostId> hosts = shown_hosts(run, options.frames);
  run.settings.cameras = Cameras::all;  // labels keep their numbers
  FrameStore store(run.settings);
  common.made_of->add(run.settings);
  add_frames(*common.made_of, run.settings, hosts);
  RoofCount rooftops;
  Progress progress("export", hosts.size(), common.quiet);
  auto files = nlohmann::json::array({"adversary.glb"});
  if (options.obj) {
    write_obj(common.out / "adversary.obj", standing_on_origin(run.adversary));
    for (const char* file : {"adversary.obj", "adversary.mtl", "adversary.png"}) files.push_back(file);
  }
  if (blender) {
    blender->write_fbx(common.out / "adversary.fbx", run.adversary);
    blender.reset();
    files.push_back("adversary.fbx");
  }
  std::size_t scenes = 0, learned = 0, others = 0;
  if (hosts.empty())
    throw InputError((options.run / "run.json").string(), "test", "no test vehicles to export",
                     "give --frames N, which goes on with those that it learned on");
  for (const HostId& id : hosts) {
    throw_if_interrupted("the files written so far are complete");
    const auto held = store.get(id.frame);
    const PreparedFrame& prepared = *held;
    const Placement placement = store.placement(id);
    rooftops.add(placement.carrier->from_box);
    const std::string name = host_name(id);
    ExportScene scene = host_scene(prepared.frame, placement, run.adversary, name);
    scene.learned_on = learned_on(run, id);
    learned += *scene.learned_on ? 1 : 0;
    others += scene.others.size();
    write_scene(common.out / (name + ".glb"), scene);
    files.push_back(name + ".glb");
    progress.update(++scenes);
  }
  const auto& [mesh, atlas] = run.adversary;
  print_table({{"adversary", fmt::format("{} vertices, {} faces, {}×{} texels a face", mesh.vertices.size(),
                                         mesh.faces.size(), atlas.resolution, atlas.resolution)},
               {"scenes", fmt::format("{} ({} of vehicles learned on)", hosts.size(), learned)},
               {"roofs", roofs(rooftops.fitted, rooftops.from_box)},
               {"folder", common.out.string()}});
  nlohmann::json result = {{"scenes", hosts.size()},
                           {"learned_on", learned},
                           {"rooftops", to_json(rooftops)},
                           {"placement", text_of(run.settings.placement)},
                           {"files", files}};
  if (others > 0) result["other_cameras"] = others;
  return result;
}

}  // namespace

Command export_command() {
  auto options = std::make_shared<ExportOptions>();
  return Command{
      .name = "export",
      .help = "writes the adversary and scenes of a run as .glb (and .fbx, .obj)",
      .default_out = "out/export",
      .example = "mirage export --run out/attack --frames 0 --fbx",
      .options =
          [options](CLI::App& app) {
            app.add_option("--run", options->run, "folder of a finished mirage attack")->required();
            add_overrides<FrameSource>(app, options->asked);
            add_trust_option(app, options->trust);
            app.add_option("--frames", options->frames,
                           "export N frames of the run, test frames first. 0: all test frames")
                ->check(within(kNotNegative))
                ->capture_default_str();
            app.add_flag("--fbx", options->fbx,
                         "also write adversary.fbx (by Blender) for engines: metres, pivot on the roof "
                         "socket, embedded texels");
            app.add_flag("--obj", options->obj,
                         "also write adversary.obj with .mtl and .png: metres, x forward, z up");
          },
      .run = [options](const Common& common) { return run(*options, common); },
  };
}

}  // namespace mirage::cli
