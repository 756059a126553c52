#include "sensors/raster_batch.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "base/parallel.h"
#include "base/sizes.h"
#include "sensors/raster/kernel.h"

namespace mirage {

bool in_kernel(const SoftRasterSettings<double>& settings) {
  const bool soft = settings.coverage == Coverage::euclidean && settings.color == ColorBlend::softmax &&
                    settings.silhouette == SilhouetteBlend::product;
  const bool hard = settings.coverage == Coverage::hard && settings.color == ColorBlend::hard &&
                    settings.silhouette == SilhouetteBlend::hard;
  return (soft || (hard && settings.background == Background::silhouette)) && settings.perspective_texture &&
         !settings.frozen_barycentrics;
}

namespace {

using raster::kSamples;
using raster::kTile;

/// Room for a tile's pixels (one sample a pixel at least) and one more.
inline constexpr int kPixels = kTile * kTile + 1;

}  // namespace

struct RasterTape::State {
  /// A touched tile of a job.
  struct TouchedTile {
    int job = 0, tile = 0;
  };

  raster::Setup setup;
  raster::Constants constants;
  std::vector<float> texels;  ///< see Constants
  std::vector<std::size_t> texel_starts;
  std::vector<std::int32_t> pixel_of;          ///< the kernel's order of samples
  std::vector<int> tape_of;                    ///< tile → its tape, −1 without a face
  std::vector<raster::TileTape> tapes;         ///< touched tiles, row by row
  std::vector<raster::FaceGradientSums> sums;  ///< as setup.binned
  std::vector<std::vector<raster::TexelGradient>> texel_gradients;  ///< by tape
  std::vector<TouchedTile> work;  ///< tiles of all jobs; in the first job's tape

  void prepare(const RasterJob& job);
};

RasterTape::RasterTape() : state(std::make_unique<State>()) {}
RasterTape::~RasterTape() = default;
RasterTape::RasterTape(RasterTape&&) noexcept = default;
RasterTape& RasterTape::operator=(RasterTape&&) noexcept = default;

namespace {

/// Every face's texels (or its corners' colours) in planes, and their start indices.
void lay_out_texels(const ScreenMesh<double>& mesh, std::vector<float>& texels,
                    std::vector<std::size_t>& starts) {
  const bool vertex = mesh.texture == Texture::vertex;
  const std::size_t faces = vertex ? mesh.texels.size() / 3 : mesh.faces_with(mesh.texels.size());
  starts.assign(1, 0);
  for (std::size_t f = 0; f < faces; ++f)
    starts.push_back(starts.back() +
                     3 * as_size(raster::texel_stride(vertex ? 3 : static_cast<int>(mesh.texels_of(f)))));
  texels.assign(starts.back(), 0);
  for (std::size_t f = 0; f < faces; ++f) {
    const std::size_t first = vertex ? 3 * f : mesh.first_texel(f), count = vertex ? 3 : mesh.texels_of(f),
                      stride = (starts[f + 1] - starts[f]) / 3;
    for (std::size_t t = 0; t < count; ++t)
      for (std::size_t c = 0; c < 3; ++c)
        texels[starts[f] + c * stride + t] = static_cast<float>(mesh.texels[first + t][static_cast<int>(c)]);
  }
}

raster::Constants constants_of(const RasterJob& job, const raster::Setup& setup) {
  const auto& settings = *job.settings;
  const auto& mesh = *job.mesh;
  raster::Constants k;
  k.hard = settings.coverage == Coverage::hard;
  k.vertex_texture = mesh.texture == Texture::vertex;
  // Clamping to float's range changes nothing: coverage is 0 or 1 long before.
  const auto bounded = [](double value) { return static_cast<float>(std::clamp(value, -1e30, 1e30)); };
  const double units = setup.samples_per_ndc * setup.samples_per_ndc, cut = cut_off(settings);
  k.distance_scale = bounded(1 / (settings.sigma * units));
  k.cut = bounded(cut * units);
  k.inv_gamma = bounded(1 / settings.gamma);
  k.key_scale = bounded(setup.middle / setup.depth_range);
  // Keys are rounded: a face exactly at near or far is still drawn.
  constexpr double kSlack = 1e-6;
  k.key_low = bounded((setup.middle - settings.far) / setup.depth_range - kSlack);
  k.key_high = bounded((setup.middle - settings.near) / setup.depth_range + kSlack);
  k.logit = settings.background != Background::silhouette;
  k.background_key = bounded(background_logit(settings) - (settings.far - setup.middle) / setup.depth_range);
  k.mesh = &mesh;
  constexpr double kLog2E = std::numbers::log2e;
  k.distance_scale2 = bounded(-kLog2E / (settings.sigma * units));
  const double near_key = (setup.middle - setup.nearest) / setup.depth_range;
  const double reference = k.logit ? std::max(near_key, double(k.background_key)) : near_key;
  k.reference_key = bounded(reference);
  k.depth_scale2 = bounded(kLog2E * setup.middle / setup.depth_range / settings.gamma);
  k.depth_start2 = bounded(-kLog2E * reference / settings.gamma);
  // Logarithm of the least weight of a fragment; float must hold it with digits to spare.
  const double farthest_key = (setup.middle - setup.farthest) / setup.depth_range;
  const double least = (farthest_key - reference) / settings.gamma + std::log(settings.dist_eps);
  k.plain = !k.hard && !k.vertex_texture && mesh.corner_barycentrics.empty() &&
            least > (k.logit ? -60 : -80) && setup.nearest >= settings.near && setup.farthest <= settings.far;
  return k;
}

/// The window's pixels in a tile.
PixelRect pixels_of(const raster::Setup& setup, const RasterTarget<float>& target, int tile) {
  const int size = setup.tile_pixels, u = tile % setup.columns * size, v = tile / setup.columns * size;
  return {u, v, std::min(u + size, target.rect.width()), std::min(v + size, target.rect.height())};
}

struct TilePixels {
  float background[3][kPixels], limit[kPixels], values[5][kPixels];
};

/// The common part of the jobs of draw_tile and draw_tile_vjp.
raster::TileJob tile_job(const RasterJob& job, RasterTape::State& state, int tile, TilePixels& pixels) {
  const raster::Setup& setup = state.setup;
  const RasterTarget<float>& target = *job.target;
  const PixelRect part = pixels_of(setup, target, tile);
  const int size = setup.tile_pixels, s = target.supersampling;
  raster::TileJob out;
  out.setup = &setup;
  out.constants = &state.constants;
  out.faces = setup.binned.data() + setup.first[as_size(tile)];
  out.count = setup.first[as_size(tile + 1)] - setup.first[as_size(tile)];
  out.x0 = double(s) * (target.rect.u0 + part.u0);
  out.y0 = double(s) * (target.rect.v0 + part.v0);
  out.width = s * part.width();
  out.height = s * part.height();
  out.supersampling = s;
  out.pixel_of = state.pixel_of.data();
  out.tape = &state.tapes[as_size(state.tape_of[as_size(tile)])];
  for (auto& channel : pixels.background) std::fill(channel, channel + size * size + 1, 0.f);
  for (int v = part.v0; v < part.v1; ++v)
    for (int u = part.u0; u < part.u1; ++u)
      for (int c = 0; c < 3; ++c)
        pixels.background[c][(v - part.v0) * size + u - part.u0] = target.background.at(u, v, c);
  for (int c = 0; c < 3; ++c) out.background[c] = pixels.background[c];
  if (!target.depth_limit.empty()) {
    std::fill(pixels.limit, pixels.limit + size * size + 1, -1e30f);
    for (int v = part.v0; v < part.v1; ++v)
      for (int u = part.u0; u < part.u1; ++u) {
        const double key = (setup.middle - double(target.depth_limit.at(u, v))) / setup.depth_range;
        pixels.limit[(v - part.v0) * size + u - part.u0] = static_cast<float>(std::max(key, -1e30));
      }
    out.limit = pixels.limit;
  }
  return out;
}

void draw(const RasterJob& job, RasterTape& tape, int tile) {
  static thread_local TilePixels pixels;
  RasterTape::State& state = *tape.state;
  const int size = state.setup.tile_pixels, s = job.target->supersampling;
  raster::TileJob work = tile_job(job, state, tile, pixels);
  for (int c = 0; c < 5; ++c) {
    std::fill(pixels.values[c], pixels.values[c] + size * size + 1, 0.f);
    work.out[c] = pixels.values[c];
  }
  raster::draw_tile(work);
  const PixelRect part = pixels_of(state.setup, *job.target, tile);
  const float mean = 1 / static_cast<float>(s * s);
  for (int v = part.v0; v < part.v1; ++v)
    for (int u = part.u0; u < part.u1; ++u) {
      const int i = (v - part.v0) * size + u - part.u0;
      float* rgba = tape.rgba.pixel(u, v);
      const float photograph = 1 - mean * pixels.values[4][i];
      for (int c = 0; c < 3; ++c) rgba[c] = mean * pixels.values[c][i] + photograph * pixels.background[c][i];
      rgba[3] = mean * pixels.values[3][i];
    }
}

void draw_vjp(const RasterJob& job, const ImageF& d_rgba, RasterTape& tape, int tile) {
  static thread_local TilePixels pixels;
  RasterTape::State& state = *tape.state;
  const int size = state.setup.tile_pixels, s = job.target->supersampling;
  raster::TileJob work = tile_job(job, state, tile, pixels);
  const PixelRect part = pixels_of(state.setup, *job.target, tile);
  const float mean = 1 / static_cast<float>(s * s);
  for (int c = 0; c < 4; ++c) {
    std::fill(pixels.values[c], pixels.values[c] + size * size + 1, 0.f);
    for (int v = part.v0; v < part.v1; ++v)
      for (int u = part.u0; u < part.u1; ++u)
        pixels.values[c][(v - part.v0) * size + u - part.u0] = mean * d_rgba.at(u, v, c);
    work.d_out[c] = pixels.values[c];
  }
  work.sums = state.sums.data() + state.setup.first[as_size(tile)];
  auto& list = state.texel_gradients[as_size(state.tape_of[as_size(tile)])];
  list.clear();
  work.texel_gradients = &list;
  raster::draw_tile_vjp(work);
}

/// Touched tiles of all jobs, those with the most faces first, so that threads finish together.
const std::vector<RasterTape::State::TouchedTile>& touched_tiles(std::span<RasterTape> tapes) {
  using TouchedTile = RasterTape::State::TouchedTile;
  std::vector<TouchedTile>& list = tapes[0].state->work;
  list.clear();
  const auto faces = [&](const TouchedTile& t) {
    const auto& first = tapes[as_size(t.job)].state->setup.first;
    return first[as_size(t.tile) + 1] - first[as_size(t.tile)];
  };
  for (std::size_t j = 0; j < tapes.size(); ++j) {
    const auto& of = tapes[j].state->tape_of;
    for (std::size_t t = 0; t < of.size(); ++t)
      if (of[t] >= 0) list.push_back({static_cast<int>(j), static_cast<int>(t)});
  }
  std::sort(list.begin(), list.end(), [&](const TouchedTile& a, const TouchedTile& b) {
    const int fa = faces(a), fb = faces(b);
    return fa != fb ? fa > fb : a.job != b.job ? a.job < b.job : a.tile < b.tile;
  });
  return list;
}

void sum_gradient(const RasterJob& job, const RasterTape::State& state, ScreenGradient<double>& gradient) {
  const auto& mesh = *job.mesh;
  gradient.faces.assign(mesh.faces.size(),
                        {Vec3<double>::Zero(), Vec3<double>::Zero(), Vec3<double>::Zero()});
  gradient.texels.assign(mesh.texels.size(), Vec3<double>::Zero());
  const auto& setup = state.setup;
  for (std::size_t tile = 0; tile < state.tape_of.size(); ++tile) {
    if (state.tape_of[tile] < 0) continue;
    for (int i = setup.first[tile]; i < setup.first[tile + 1]; ++i) {
      const raster::FaceSetup& face = setup.faces[setup.binned[as_size(i)]];
      const raster::FaceGradientSums& sums = state.sums[as_size(i)];
      const auto f = as_size(face.face);
      raster::add_face_gradient(setup, face, sums, gradient.faces[f]);
    }
    for (const auto& t : state.texel_gradients[as_size(state.tape_of[tile])])
      gradient.texels[as_size(t.texel)] += Vec3<double>(t.r, t.g, t.b);
  }
}

}  // namespace

void RasterTape::State::prepare(const RasterJob& job) {
  raster::set_up(*job.mesh, *job.settings, *job.target, setup);
  constants = constants_of(job, setup);
  lay_out_texels(*job.mesh, texels, texel_starts);
  constants.texels = texels.data();
  constants.texel_starts = texel_starts.data();
  pixel_of.resize(kSamples);
  raster::sample_order(job.target->supersampling, setup.tile_pixels, pixel_of.data());
  const auto tiles = setup.first.size() - 1;
  tape_of.assign(tiles, -1);
  int touched = 0;
  for (std::size_t t = 0; t < tiles; ++t)
    if (setup.first[t + 1] > setup.first[t]) tape_of[t] = touched++;
  if (tapes.size() < as_size(touched)) {
    tapes.resize(as_size(touched));
    texel_gradients.resize(as_size(touched));
  }
  sums.resize(setup.binned.size());
}

void rasterize_batch(std::span<const RasterJob> jobs, std::span<RasterTape> tapes) {
  parallel_for(jobs.size(), [&](std::size_t j) {
    const RasterTarget<float>& target = *jobs[j].target;
    if (!in_kernel(*jobs[j].settings)) {
      tapes[j].state->tape_of.clear();
      tapes[j].rgba = to_float(rasterize(*jobs[j].mesh, *jobs[j].settings, to_double(target)));
      return;
    }
    tapes[j].state->prepare(jobs[j]);
    ImageF& rgba = tapes[j].rgba;
    rgba.width = target.rect.width();
    rgba.height = target.rect.height();
    rgba.channels = 4;
    rgba.data.resize(as_size(rgba.width) * as_size(rgba.height) * 4);
    for (int v = 0; v < rgba.height; ++v)
      for (int u = 0; u < rgba.width; ++u) {
        for (int c = 0; c < 3; ++c) rgba.at(u, v, c) = target.background.at(u, v, c);
        rgba.at(u, v, 3) = 0;
      }
  });
  if (jobs.empty()) return;
  const auto& tiles = touched_tiles(tapes);
  parallel_for(tiles.size(), [&](std::size_t i) {
    const auto j = as_size(tiles[i].job);
    draw(jobs[j], tapes[j], tiles[i].tile);
  });
}

void rasterize_batch_vjp(std::span<const RasterJob> jobs, std::span<const ImageF> d_rgba,
                         std::span<RasterTape> tapes, std::span<ScreenGradient<double>> gradients) {
  if (jobs.empty()) return;
  // The caller may have moved the jobs' data.
  for (std::size_t j = 0; j < jobs.size(); ++j) tapes[j].state->constants.mesh = jobs[j].mesh;
  const auto& tiles = touched_tiles(tapes);
  parallel_for(tiles.size(), [&](std::size_t i) {
    const auto j = as_size(tiles[i].job);
    if (in_kernel(*jobs[j].settings)) draw_vjp(jobs[j], d_rgba[j], tapes[j], tiles[i].tile);
  });
  parallel_for(jobs.size(), [&](std::size_t j) {
    const RasterJob& job = jobs[j];
    if (in_kernel(*job.settings))
      sum_gradient(job, *tapes[j].state, gradients[j]);
    else
      gradients[j] = rasterize_vjp(*job.mesh, *job.settings, to_double(*job.target), to_double(d_rgba[j]));
  });
}

Image<double> to_double(const ImageF& image) {
  Image<double> out(image.width, image.height, image.channels);
  std::copy(image.data.begin(), image.data.end(), out.data.begin());
  return out;
}

ImageF to_float(const Image<double>& image) {
  ImageF out(image.width, image.height, image.channels);
  std::transform(image.data.begin(), image.data.end(), out.data.begin(),
                 [](double value) { return static_cast<float>(value); });
  return out;
}

RasterTarget<double> to_double(const RasterTarget<float>& target) {
  return {target.width,
          target.height,
          target.rect,
          target.supersampling,
          to_double(target.background),
          to_double(target.depth_limit)};
}

const char* raster_instruction_set() {
  return raster::instruction_set();
}

}  // namespace mirage
