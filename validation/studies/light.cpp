// How far the light-weight light models are from Cycles, front-lit and back-lit:
//
//     mirage_light_study DATA MESH.glb OUT [VEHICLES [SAMPLES [VARIANTS]]]
//
// The mesh ("random": a random one a vehicle) stands on the VEHICLES nearest cars of DATA, one a frame, lit
// by the default light with the sun 40° up, 30° beside the line behind the camera (front) or beyond the
// vehicle (back). Each is rendered by Cycles with everything but specular and with everything ("all": sun of
// 0.53° with shadows, occluded sky, 4 bounces, specular; host and road as unseen surroundings). Error: mean
// |Δ| of scene-linear RGB over the pixels that the object covers by more than half, over the mean radiance of
// all those in Cycles; in brackets the mean difference, by the same. The rasteriser draws with hard edges and
// 8×8 samples a pixel. VARIANTS: "models" (default) or "all", which varies the model's settings.
#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <limits>
#include <map>
#include <memory>

#include "attack/adversary.h"
#include "base/angles.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "exchange/gltf.h"
#include "exchange/host_proxy.h"
#include "frames/hosts.h"
#include "scene/data/read_frames.h"
#include "sensors/light_nodes.h"
#include "validation/blender/host_scene.h"
#include "validation/fidelity/picture_errors.h"

namespace mirage {
namespace {

struct Variant {
  std::string name;
  SimulationSettings settings;
  bool uniform = false;   ///< the hemisphere's light from everywhere
  bool as_faces = false;  ///< every texel a face of its own
};

std::vector<Variant> variants(bool all) {
  SimulationSettings hard = hard_limit({}, false);
  hard.supersampling = 8;
  SimulationSettings visible = hard;
  visible.light = LightModel::visible;
  SimulationSettings fine = hard;
  fine.light = LightModel::fine;
  Variant coarse{"visible, whole faces", visible};
  coarse.settings.visible_light.node_angle = std::numeric_limits<double>::infinity();
  std::vector<Variant> list = {
      {"ambient + sun", hard, true}, {"plain", hard}, coarse, {"visible", visible}, {"fine", fine}};
  if (!all) return list;
  const auto add = [&](const std::string& name, const auto& change) {
    Variant variant{name, visible};
    change(variant.settings.visible_light);
    list.push_back(variant);
  };
  for (int k : {16, 64, 128, 2048}) add(fmt::format("{} directions", k), [&](auto& s) { s.directions = k; });
  for (int k : {32, 512})
    add(fmt::format("{} rough directions", k), [&](auto& s) { s.rough_directions = k; });
  for (int b : {0, 1, 2, 3, 8}) add(fmt::format("{} bounces", b), [&](auto& s) { s.bounces = b; });
  for (int n : {1, 3, 5, 20}) add(fmt::format("{} sun samples", n), [&](auto& s) { s.sun_samples = n; });
  add("matt", [](auto& s) { s.glossy = false; });
  for (double angle : {0.0, 3e-6, 6e-6, 3e-5, 6e-5})
    add(fmt::format("nodes of {} sr", angle), [&](auto& s) { s.node_angle = angle; });
  for (int k : {32, 128}) {
    add(fmt::format("texels as faces, {} directions", k),
        [&](auto& s) { s.directions = k, s.sun_samples = 1; });
    list.back().as_faces = true;
  }
  add("everything fine", [](auto& s) {
    s.directions = 1024, s.rough_directions = 256, s.bounces = 8, s.sun_samples = 20;
    s.node_angle = 0, s.sun_angle = 1e-9, s.cell = 0.1;
  });
  for (double angle : {1e-6, 1.6e-5, 1.0})
    add(fmt::format("shadows' borders to {} sr", angle), [&](auto& s) { s.sun_angle = angle; });
  for (double cell : {0.1, 5.0})
    add(fmt::format("roof cells of {} m", cell), [&](auto& s) { s.cell = cell; });
  return list;
}

Vec3d towards_sun(bool front) {
  const double up = 40 * kDegree, side = 30 * kDegree, sign = front ? -1 : 1;
  return {sign * std::cos(up) * std::cos(side), std::cos(up) * std::sin(side), std::sin(up)};
}

struct Place {
  HostId id;
  double range = 0;
};

/// The nearest usable car of each frame, nearest first.
std::vector<Place> places(FrameStore& store, const std::filesystem::path& data, int count) {
  std::vector<Place> nearest;
  for (const std::string& id : list_frames(data)) {
    Place best{{id, -1}, 1e9};
    for (const Host& host : find_hosts(store, id, {2, 60, -40, 40}, {}, 0.95)) {
      const auto held = store.get(id);
      const BevBox& box = label_of(held->frame, host.id).box.bev;
      if (const double range = std::hypot(box.x, box.y); range < best.range) best = {host.id, range};
    }
    if (best.id.label >= 0) nearest.push_back(best);
  }
  std::sort(nearest.begin(), nearest.end(), [](const Place& a, const Place& b) { return a.range < b.range; });
  if (static_cast<int>(nearest.size()) > count) nearest.resize(static_cast<std::size_t>(count));
  return nearest;
}

struct Sum {
  double error = 0, bias = 0, mean = 0;
};

int study(const std::filesystem::path& data, const std::string& mesh, const std::filesystem::path& out,
          int vehicles, int samples, bool all) {
  make_output_folder(out);
  FrameStore store(FrameSource{.data = data});
  BlenderWorker blender(out / "blender.log");
  std::map<std::string, std::map<std::string, Sum>> sums;  // light and reference; variant
  const auto list = variants(all);
  std::uint64_t seed = 0;
  for (const Place& place_of : places(store, data, vehicles)) {
    ++seed;
    for (bool front : {true, false}) {
      PreparedFrame prepared = *store.get(place_of.id.frame);
      prepared.frame.lighting.to_sun_velo = towards_sun(front);
      HostScene scene;
      scene.prepared = &prepared;
      scene.host = &label_of(prepared.frame, place_of.id);
      scene.rooftop = store.rooftop(place_of.id);
      scene.adversary = mesh == "random" ? random_adversary(seed) : read_adversary(mesh);
      scene.placed = place(scene.adversary, scene.rooftop);
      scene.samples = samples;
      scene.seed = seed;
      const std::string name = host_name(place_of.id) + (front ? "_front" : "_back");
      scene.glb = out / (name + ".glb");
      scene.scratch = out;
      write_scene(scene.glb, host_scene(prepared.frame, *scene.host, scene.rooftop, scene.adversary, name));
      const Simulated first = simulate_host(scene, list.front().settings);
      const PixelRect rect = first.rect;
      const ImageF photograph = crop(prepared.frame.image, rect);
      for (bool specular : {false, true}) {
        RenderJob job = job_for(scene, rect);
        job.effects = full_effects();
        job.effects.specular = specular;
        job.effects.surroundings = RenderEffects::Surroundings::unseen;
        const Rendered rendered = render(blender, job);
        ImageF reference = photograph;
        composite(rendered, {}, reference);
        const ImageF mask = alpha_mask(rendered.rgba);
        const double mean = mean_absolute_error(reference, ImageF(mask.width, mask.height, 3), mask);
        const std::string key =
            std::string(front ? "front" : "back") + (specular ? ", all" : ", no specular");
        const std::string picture = name + (specular ? "_all" : "_diffuse");
        write_exr(out / (picture + ".exr"), reference);
        write_srgb(out / (picture + ".png"), reference);
        std::string line = fmt::format("{} {:5.1f} m {:5d} px {:18s} mean {:.3f}", host_name(place_of.id),
                                       place_of.range, first.adversary_pixels, key, mean);
        for (const Variant& variant : list) {
          PreparedFrame lit = prepared;
          if (variant.uniform) {
            lit.frame.lighting.ambient += lit.frame.lighting.hemisphere / 2;
            lit.frame.lighting.hemisphere.setZero();
          }
          HostScene drawn = scene;
          drawn.prepared = &lit;
          if (variant.as_faces) {
            drawn.adversary = texels_as_faces(scene.adversary);
            drawn.placed = place(drawn.adversary, drawn.rooftop);
          }
          const Simulated simulated = simulate_host(drawn, variant.settings);
          ImageF ours = photograph;
          for (int v = 0; v < ours.height; ++v)
            for (int u = 0; u < ours.width; ++u)
              for (int c = 0; c < 3; ++c)
                ours.at(u, v, c) = static_cast<float>(rgba_at(simulated, rect.u0 + u, rect.v0 + v, c));
          const double error = mean_absolute_error(ours, reference, mask);
          Sum& sum = sums[key][variant.name];
          sum.error += error;
          sum.bias += mean_absolute_error(ours, ImageF(mask.width, mask.height, 3), mask) - mean;
          sum.mean += mean;
          line += fmt::format(" {:.1f}", 100 * error / mean);
          if (!specular && (variant.name == "visible" || variant.name == "plain")) {
            write_exr(out / (name + "_" + variant.name + ".exr"), ours);
            write_srgb(out / (name + "_" + variant.name + ".png"), ours);
          }
        }
        std::printf("%s\n", line.c_str());
        std::fflush(stdout);
      }
    }
  }
  nlohmann::json result;
  for (const Variant& variant : list) {
    std::string line = fmt::format("{:24s}", variant.name);
    for (const auto& [key, by_variant] : sums) {
      const Sum& sum = by_variant.at(variant.name);
      result[variant.name][key] = sum.error / sum.mean;
      line += fmt::format("  {}: {:5.2f} % ({:+.1f})", key, 100 * sum.error / sum.mean,
                          100 * sum.bias / sum.mean);
    }
    std::printf("%s\n", line.c_str());
  }
  write_json(out / "result.json", result);
  return 0;
}

}  // namespace
}  // namespace mirage

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fprintf(stderr, "mirage_light_study DATA MESH.glb|random OUT [VEHICLES [SAMPLES [models|all]]]\n");
    return 2;
  }
  try {
    return mirage::study(argv[1], argv[2], argv[3], argc > 4 ? std::stoi(argv[4]) : 4,
                         argc > 5 ? std::stoi(argv[5]) : 64, argc > 6 && std::string(argv[6]) == "all");
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
