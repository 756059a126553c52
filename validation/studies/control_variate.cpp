// How far a mesh may move before `mirage attack --renderer cycles` has to draw it anew
// (attack/rendered_pictures.h):
//
//     mirage_control_variate_study DATA MESH.glb OUT [VEHICLES [SAMPLES [LIGHT]]]
//
// The mesh ("random": a random one a vehicle) stands on the VEHICLES first hosts of DATA, one a frame. Its
// coordinates each move by d / √3 up or down, d = 2.5 mm to 8 cm, and its texels by 4 d / m, as Adam's first
// steps at the rates of the experiments do. Error: mean |Δ| from a Cycles picture of the moved mesh (8 times
// SAMPLES, other random numbers) over the pixels that the object covers by more than half before or after,
// over their mean value there. Of: the rasteriser (LIGHT plain or visible), a new Cycles picture (its own
// noise), the Cycles picture from before the move, and that with the rasteriser as its control variate.
// OUT/*.png: of the first vehicle, what is seen before the move, and the correction (grey is none).
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "attack/adversary.h"
#include "attack/rendered_pictures.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/random.h"
#include "exchange/mesh_files.h"
#include "scene/data/read_frames.h"
#include "simulation/object_window.h"
#include "simulation/render_scene.h"
#include "validation/blender/cycles_renderer.h"
#include "validation/fidelity/picture_errors.h"

namespace mirage {
namespace {

constexpr double kMoves[] = {0, 0.0025, 0.005, 0.01, 0.02, 0.04, 0.08};  // m

TexturedMesh moved_by(const TexturedMesh& mesh, double distance, std::uint64_t seed) {
  RandomStream random(seed, "control variate study");
  TexturedMesh moved = mesh;
  const auto sign = [&] { return random.uniform() < 0.5 ? -1.0 : 1.0; };
  for (Vec3d& v : moved.mesh.vertices) v += Vec3d(sign(), sign(), sign()) * (distance / std::sqrt(3.0));
  for (Vec3d& t : moved.atlas.texels)
    t = (t + Vec3d(sign(), sign(), sign()) * (4 * distance)).cwiseMax(0).cwiseMin(1);
  return moved;
}

struct Errors {
  double raster = 0, fresh = 0, stale = 0, corrected = 0, mean = 0;
};

ImageF shown(const Simulated& simulated, const PixelRect& rect) {
  return crop(simulated.image, rect);
}

int study(const std::filesystem::path& data, const std::string& mesh, const std::filesystem::path& out,
          int vehicles, int samples, const std::string& light) {
  make_output_folder(out);
  FrameStore store(FrameSource{.data = data});
  CyclesRenderer renderer({out, samples, 1, "blender"}), many({out / "many", 8 * samples, 1, "blender"});
  SimulationSettings settings;
  settings.light = parse_word<LightModel>(light, "light");
  std::vector<Errors> sums(std::size(kMoves));
  std::uint64_t seed = 0;
  for (const std::string& frame : list_frames(data)) {
    const auto hosts = find_hosts(store, frame, {2, 60, -40, 40}, {}, 0.95);
    if (hosts.empty() || static_cast<int>(seed) >= vehicles) continue;
    ++seed;
    Host host = hosts.front();
    host.rooftop = store.rooftop(host.id);
    const auto prepared = store.get(frame);
    const Label& label = label_of(prepared->frame, host.id);
    const HostInWorld world{*prepared, host, host.rooftop, settings};
    const TexturedMesh before = mesh == "random" ? random_adversary(seed) : read_object(mesh);
    const auto raster_of = [&](const TexturedMesh& of) {
      return simulate(*prepared, label, host.rooftop, of, settings);
    };
    const auto drawn = [&](CyclesRenderer& by, const TexturedMesh& of, const Simulated& at,
                           std::uint64_t with, const PixelRect& rect) {
      Simulated cycles = at;
      const auto window = by.draw(world, of, at, with);
      ImageF difference = window.picture;
      const ImageF raster = radiance_of(at, prepared->frame.image, window.rect);
      for (std::size_t i = 0; i < raster.data.size(); ++i) difference.data[i] -= raster.data[i];
      add_to_picture(difference, window.rect, cycles);
      return shown(cycles, rect);
    };
    const Simulated first = raster_of(before);
    for (std::size_t k = 0; k < std::size(kMoves); ++k) {
      const TexturedMesh after = moved_by(before, kMoves[k], seed);
      const Simulated now = raster_of(after);
      const PixelRect rect = united(first.rect, now.rect);
      ImageF mask(rect.width(), rect.height(), 1);
      for (int v = rect.v0; v < rect.v1; ++v)
        for (int u = rect.u0; u < rect.u1; ++u)
          mask.at(u - rect.u0, v - rect.v0) =
              std::max(rgba_at(first, u, v, 3), rgba_at(now, u, v, 3)) > 0.5 ? 1.0f : 0.0f;
      RenderedPictures pictures(renderer, seed);
      Simulated corrected = now;
      pictures.correct(world, after, {0, before}, corrected);
      const ImageF truth = drawn(many, after, now, 1000 + seed, rect),
                   stale = drawn(renderer, before, first, seed, rect),
                   fresh = drawn(renderer, after, now, 2000 + seed, rect);
      Errors& sum = sums[k];
      sum.mean += mean_absolute_error(truth, ImageF(mask.width, mask.height, 3), mask);
      sum.raster += mean_absolute_error(truth, shown(now, rect), mask);
      sum.fresh += mean_absolute_error(truth, fresh, mask);
      sum.stale += mean_absolute_error(truth, stale, mask);
      sum.corrected += mean_absolute_error(truth, shown(corrected, rect), mask);
      if (seed > 1) continue;
      const std::string name = fmt::format("{:g}mm_", 1e3 * kMoves[k]);
      write_srgb(out / (name + "raster.png"), shown(now, rect));
      write_srgb(out / (name + "cycles.png"), truth);
      write_srgb(out / (name + "stale.png"), stale);
      write_srgb(out / (name + "corrected.png"), shown(corrected, rect));
      ImageF difference = shown(corrected, rect);
      const ImageF plain = shown(now, rect);
      for (std::size_t i = 0; i < plain.data.size(); ++i)
        difference.data[i] = std::clamp(0.2f + difference.data[i] - plain.data[i], 0.0f, 1.0f);
      write_srgb(out / (name + "correction.png"), difference);
    }
  }
  fmt::print("{} vehicles, {} samples, light {}; % of the object's mean value\n", seed, samples, light);
  fmt::print("moved by | rasteriser | Cycles, new | Cycles, before the move | with control variate\n");
  for (std::size_t k = 0; k < sums.size(); ++k) {
    const Errors& s = sums[k];
    const auto share = [&](double error) { return 100 * error / s.mean; };
    fmt::print("{:g} mm | {:.1f} | {:.1f} | {:.1f} | {:.1f}\n", 1e3 * kMoves[k], share(s.raster),
               share(s.fresh), share(s.stale), share(s.corrected));
  }
  return 0;
}

}  // namespace
}  // namespace mirage

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fputs("usage: mirage_control_variate_study DATA MESH.glb OUT [VEHICLES [SAMPLES [LIGHT]]]\n",
               stderr);
    return 2;
  }
  try {
    return mirage::study(argv[1], argv[2], argv[3], argc > 4 ? std::atoi(argv[4]) : 8,
                         argc > 5 ? std::atoi(argv[5]) : 16, argc > 6 ? argv[6] : "plain");
  } catch (const std::exception& error) {
    fmt::print(stderr, "{}\n", error.what());
    return 1;
  }
}
