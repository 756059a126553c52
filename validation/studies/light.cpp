// How far the light-weight light models are from Cycles, front-lit and back-lit:
//
//     mirage_light_study DATA MESHES OUT [VEHICLES [SAMPLES]]
//
// MESHES: adversaries (.glb) with commas between them, of which the vehicles take one each in turn, or
// "random": another random mesh for each. VEHICLES (4): the nearest cars of DATA, one a frame; "all": every
// usable car of every frame; "1/5": of all, nearest first, each fifth. They are lit by the default light with
// the sun 40° up, 30° beside the line behind the camera (front) or beyond the vehicle (back). Cycles renders
// each with everything (sun of 0.53° with shadows, occluded sky, 4 bounces, specular; host and road as unseen
// surroundings), as two independent halves of SAMPLES (64). The rasteriser draws with hard edges and 8×8
// samples a pixel. A vehicle's measurements are kept in OUT and reused while their provenance is the same
// (base/provenance.h): program, frame, mesh, models' settings.
//
// Over the pixels that the object covers by more than half, of scene-linear RGB, all as shares of the
// object's mean radiance in Cycles:
//     mean |Δ|    from the mean of the halves, whose noise is in it, and in brackets the mean difference
//     no noise    mean |Δ| at twice that noise (from either half), extrapolated linearly to none: an upper
//                 bound, because the error grows more slowly the more noise there is
//     noise       mean |half − other half| / 2: what a perfect picture would have
//     RMS         of the noise-free difference, by both halves (validation/reference/unbiased_error.h), the
//                 mean square over vehicles, with 95 % over frames
#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "attack/adversary.h"
#include "attack/evaluation.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/image.h"
#include "base/intervals.h"
#include "base/sizes.h"
#include "base/types.h"
#include "exchange/gltf.h"
#include "exchange/mesh_files.h"
#include "frames/frame_provenance.h"
#include "frames/hosts.h"
#include "scene/data/read_frames.h"
#include "validation/blender/blender_process.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/reference/host_scene.h"
#include "validation/reference/unbiased_error.h"

namespace mirage {
namespace {

struct Variant {
  std::string name;
  SimulationSettings settings;
};

std::vector<Variant> variants() {
  SimulationSettings hard = hard_limit({}, false);
  hard.supersampling = 8;
  SimulationSettings visible = hard, fine = hard;
  visible.light = LightModel::visible;
  fine.light = LightModel::fine;
  return {{"plain", hard}, {"visible", visible}, {"fine", fine}};
}

Vec3d towards_sun(bool front) {
  const double up = 40 * kDegree, side = 30 * kDegree, sign = front ? -1 : 1;
  return {sign * std::cos(up) * std::cos(side), std::cos(up) * std::sin(side), std::sin(up)};
}

/// A vehicle, and how far it is (m).
struct Place {
  HostId id;
  double range = 0;
};

/// Which vehicles.
struct Choice {
  std::optional<int> nearest = 4;  ///< this many, at most one a frame
  int every = 1;                   ///< without `nearest`: each one of so many, nearest first
};
/// VEHICLES, as the first lines say.
Choice choice_of(const std::string& text) {
  if (text == "all") return {std::nullopt, 1};
  const bool share = text.starts_with("1/");
  const auto number = static_cast<int>(parse_number(share ? text.substr(2) : text, "VEHICLES"));
  if (number < 1) throw InputError("VEHICLES", text, "is less than one", "give a number, all or 1/N");
  return share ? Choice{std::nullopt, number} : Choice{number, 1};
}

/// Usable cars of DATA, nearest first.
std::vector<Place> places(FrameStore& store, const std::filesystem::path& data, const Choice& choice) {
  std::vector<Place> found;
  for (const std::string& id : list_frames(data)) {
    std::vector<Place> of_frame;
    for (const Host& host : find_hosts(store, id, {2, 60, -40, 40}, {}, 0.95)) {
      const BevBox& box = label_of(store.get(id)->frame, host.id).box.bev;
      of_frame.push_back({host.id, horizontal_distance(box)});
    }
    std::ranges::sort(of_frame, {}, &Place::range);
    if (choice.nearest && of_frame.size() > 1) of_frame.resize(1);
    found.insert(found.end(), of_frame.begin(), of_frame.end());
  }
  std::ranges::stable_sort(found, {}, &Place::range);
  std::vector<Place> chosen;
  for (std::size_t i = 0; i < found.size(); i += as_size(choice.every))
    if (!choice.nearest || static_cast<int>(i) < *choice.nearest) chosen.push_back(found[i]);
  return chosen;
}

/// Cycles' render of one vehicle under one sun.
struct Reference {
  Halves halves;
  ImageF mean, mask;
  double pixels = 0, radiance = 0;  ///< of the object: how many, and their mean
};

Reference render_reference(ReferenceRenderer& renderer, const HostScene& scene, const PixelRect& rect,
                           const ImageF& photograph) {
  RenderJob job = job_for(scene, rect);
  job.effects = full_effects(RenderEffects::Surroundings::unseen);
  const RenderedHalves rendered = render_halves(renderer, job, scene.seed, RenderStream::reference);
  Reference reference{over(rendered, {}, photograph), {}, coverage_of(rendered, {})};
  reference.mean = reference.halves.mean();
  reference.pixels = static_cast<double>(
      std::ranges::count_if(reference.mask.data, [](float covered) { return covered > 0.5f; }));
  reference.radiance = mean_of(reference.mean, reference.mask);
  return reference;
}

/// Of one variant on one vehicle; all but the squares in scene-linear radiance.
nlohmann::json errors_of(const ImageF& ours, const Reference& reference) {
  const auto& [halves, mean, mask, pixels, radiance] = reference;
  return {
      {"error", mean_absolute_error(ours, mean, mask)},
      {"error_twice_the_noise",
       (mean_absolute_error(ours, halves.first, mask) + mean_absolute_error(ours, halves.second, mask)) / 2},
      {"difference", mean_of(ours, mask) - radiance},
      {"squared", squared_error({ours, {}}, halves, mask, pixels, radiance).unbiased}};
}

/// Every variant on one vehicle under one sun; null where the object covers no pixel.
nlohmann::json measure(ReferenceRenderer& renderer, const PreparedFrame& frame, HostScene scene, bool front,
                       const std::vector<Variant>& list, const std::filesystem::path& out,
                       const std::string& name) {
  PreparedFrame prepared = frame;
  prepared.frame.lighting.to_sun_velo = towards_sun(front);
  scene.prepared = &prepared;
  scene.glb = out / (name + ".glb");
  write_scene(scene.glb, host_scene(prepared.frame, scene.placement, scene.adversary, name));
  const Simulated first = simulate_host(scene, list.front().settings);
  if (first.rect.empty()) return nullptr;
  const ImageF photograph = crop(prepared.frame.image, first.rect);
  const Reference reference = render_reference(renderer, scene, first.rect, photograph);
  if (reference.pixels == 0) return nullptr;
  write_srgb(out / (name + ".png"), reference.mean);
  nlohmann::json result = {
      {"pixels", reference.pixels},
      {"radiance", reference.radiance},
      {"noise", mean_absolute_error(reference.halves.first, reference.halves.second, reference.mask) / 2}};
  for (const Variant& variant : list) {
    const ImageF ours = radiance_of(simulate_host(scene, variant.settings), prepared.frame.image, first.rect);
    result["variants"][variant.name] = errors_of(ours, reference);
    if (variant.name == "visible" || variant.name == "plain")
      write_srgb(out / (name + "_" + variant.name + ".png"), ours);
  }
  return result;
}

/// One variant's figures over vehicles: rows of measure(), with their frames.
nlohmann::json pooled(const std::vector<std::pair<std::string, nlohmann::json>>& rows,
                      const std::string& variant) {
  double error = 0, twice = 0, difference = 0, radiance = 0, noise = 0;
  ClusteredShare squared;
  for (const auto& [frame, row] : rows) {
    const nlohmann::json& of = row.at("variants").at(variant);
    error += of.at("error").get<double>(), twice += of.at("error_twice_the_noise").get<double>();
    difference += of.at("difference").get<double>(), radiance += row.at("radiance").get<double>();
    noise += row.at("noise").get<double>();
    squared.add(frame, of.at("squared").get<double>());
  }
  const Interval rms = signed_root(squared.mean_interval());
  return {{"vehicles", rows.size()},
          {"error", error / radiance},
          {"no_noise", (2 * error - twice) / radiance},
          {"difference", difference / radiance},
          {"noise", noise / radiance},
          {"rms", to_json(rms)}};
}

void print(const nlohmann::json& of, const std::string& variant, const std::string& side) {
  const auto percent = [&](const nlohmann::json& value) { return 100 * value.get<double>(); };
  std::printf("%s\n", fmt::format("{:28s} {:5s} {:4d} vehicles  mean |Δ| {:5.2f} % ({:+.1f})  no noise "
                                  "{:5.2f} %  noise {:4.2f} %  RMS {:5.1f} % ({:.1f} to {:.1f})",
                                  variant, side, of.at("vehicles").get<int>(), percent(of.at("error")),
                                  percent(of.at("difference")), percent(of.at("no_noise")),
                                  percent(of.at("noise")), percent(of.at("rms").at("value")),
                                  percent(of.at("rms").at("low")), percent(of.at("rms").at("high")))
                          .c_str());
}

struct Options {
  std::filesystem::path data, out;
  std::vector<std::string> meshes;  ///< files, or "random"
  Choice vehicles;
  int samples = 64;
};

int study(const Options& options) {
  const FrameSource source{.data = options.data};
  FrameStore store(source);
  const std::unique_ptr<ReferenceRenderer> renderer = start_blender(options.out);
  const auto list = variants();
  std::map<std::string, std::vector<std::pair<std::string, nlohmann::json>>> rows;  // by side
  std::uint64_t seed = 0;
  for (const Place& place_of : places(store, options.data, options.vehicles)) {
    const std::string mesh = options.meshes[seed % options.meshes.size()];
    ++seed;
    for (bool front : {true, false}) {
      const std::string side = front ? "front" : "back", name = host_name(place_of.id) + "_" + side;
      Provenance provenance;
      add_frames(provenance, source, {&place_of.id.frame, 1});
      provenance.set("side", side);
      provenance.set("seed", seed);
      provenance.set("samples", options.samples);
      if (mesh == "random")
        provenance.set("mesh", mesh);
      else
        provenance.input("mesh", hash_of(read_object(mesh)));
      renderer->identity().add_to(provenance);
      for (const Variant& variant : list) {
        Provenance its;
        its.add(variant.settings);
        provenance.input(variant.name, its.identity());
      }
      const std::string identity = provenance.identity();
      const std::filesystem::path file = options.out / (name + ".json");
      nlohmann::json record = std::filesystem::exists(file) ? read_json(file) : nlohmann::json::object();
      if (record.value("identity", "") != identity) {
        const auto frame = store.get(place_of.id.frame);
        HostScene scene = scene_of({*frame, place_of.id, store.placement(place_of.id), {}},
                                   mesh == "random" ? random_adversary(seed) : read_object(mesh));
        scene.samples = options.samples;
        scene.seed = seed;
        scene.scratch = options.out;
        record = {{"identity", identity},
                  {"measured", measure(*renderer, *frame, scene, front, list, options.out, name)}};
        write_json(file, record);
      }
      const nlohmann::json& row = record.at("measured");
      if (row.is_null()) continue;
      rows[side].emplace_back(place_of.id.frame, row);
      std::string line = fmt::format("{:16s} {:5s} {:5.1f} m {:5.0f} px radiance {:.3f} noise {:.1f} |",
                                     host_name(place_of.id), side, place_of.range,
                                     row.at("pixels").get<double>(), row.at("radiance").get<double>(),
                                     100 * row.at("noise").get<double>() / row.at("radiance").get<double>());
      for (const Variant& variant : list)
        line += fmt::format(" {:.1f}", 100 * row.at("variants").at(variant.name).at("error").get<double>() /
                                           row.at("radiance").get<double>());
      std::printf("%s\n", line.c_str());
      std::fflush(stdout);
    }
  }
  nlohmann::json result;
  for (const Variant& variant : list)
    for (const auto& [side, of_side] : rows) {
      result[variant.name][side] = pooled(of_side, variant.name);
      print(result[variant.name][side], variant.name, side);
      if (variant.name == "visible") result["light_error_" + side] = result[variant.name][side]["no_noise"];
    }
  write_json(options.out / "result.json", result);
  return 0;
}

}  // namespace
}  // namespace mirage

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fprintf(stderr, "mirage_light_study DATA MESH.glb[,…]|random OUT [VEHICLES|all|1/N [SAMPLES]]\n");
    return 2;
  }
  try {
    mirage::Options options;
    options.data = argv[1], options.meshes = mirage::listed_words(argv[2]), options.out = argv[3];
    if (argc > 4) options.vehicles = mirage::choice_of(argv[4]);
    if (argc > 5) options.samples = std::stoi(argv[5]);
    return mirage::study(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
