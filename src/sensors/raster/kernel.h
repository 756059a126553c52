// One tile of the fast soft rasteriser: the part that is vectorised.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensors/raster/setup.h"

namespace mirage::raster {

inline constexpr int kSamples = kTile * kTile;
inline constexpr int kTableTexels = 32;

/// Stride of a face with that many texels (or corner colours): kTableTexels if they fit.
constexpr int texel_stride(int texels) {
  return texels > kTableTexels ? texels : kTableTexels;
}

/// A job's settings as the kernel reads them.
struct Constants {
  bool hard = false;  ///< the nearest face that contains the sample, S is 0 or 1; otherwise soft
  bool vertex_texture = false;
  bool logit = false;         ///< the background competes with the faces: a fragment of D = 1, not in S
  float background_key = 0;   ///< the background's key
  float distance_scale = 1;   ///< 1 / σ in sample units
  float distance_scale2 = 0;  ///< −log₂ e times that, for powers of 2
  float cut = 0;              ///< T in the units of the distance
  float inv_gamma = 1;
  float key_scale = 1;              ///< middle / (far − near)
  float key_low = 0, key_high = 1;  ///< keys of far and near
  /// By face, from starts on, three planes (r, g, b) of texel_stride() values.
  const float* texels = nullptr;
  const std::size_t* texel_starts = nullptr;
  const ScreenMesh<double>* mesh = nullptr;
  /// Soft, whole faces with atlas, all between near and far, and close enough in depth that float holds
  /// exp((key − reference_key) / γ) of each: the case of insertions. Needs no running maximum.
  bool plain = false;
  float reference_key = 0;                   ///< of the nearest corner, or of a nearer background
  float depth_scale2 = 0, depth_start2 = 0;  ///< (key − reference_key) log₂ e / γ = scale2 · φ + start2
};

/// Values of a tile's samples, six a sample; for each vector of samples one field after the other, for
/// locality.
struct TileSamples {
  alignas(64) float values[6 * kSamples];
};

/// The forward pass's state of a tile.
struct TileTape : TileSamples {
  enum Field {
    kTop,    ///< not plain: largest key of a coloured fragment (hard colour: its face's index)
    kSum,    ///< Σ D exp((key − top) / γ); plain: (key − reference_key)
    kClear,  ///< Π (1 − D); hard: 1 where S = 1
    kColor,  ///< three: colour among faces
  };
  std::uint64_t touched[kSamples / 64];  ///< a bit for each vector of samples that a face may touch
};

struct TexelGradient {
  int texel = 0;
  float r = 0, g = 0, b = 0;
};

/// Pixel arrays have tile_pixels² values, row by row, and one more for samples outside.
struct TileJob {
  const Setup* setup = nullptr;
  const Constants* constants = nullptr;
  const std::uint32_t* faces = nullptr;  ///< into setup->faces, the nearest first
  int count = 0;
  double x0 = 0, y0 = 0;                   ///< sample coordinates of the tile's first sample
  int width = 0, height = 0;               ///< samples in the window
  int supersampling = 1;                   ///< samples along a pixel's side
  const std::int32_t* pixel_of = nullptr;  ///< pixel of each sample, in the kernel's order
  TileTape* tape = nullptr;

  const float* background[3] = {};
  const float* limit = nullptr;  ///< keys below which fragments are dropped, or null
  /// Forward, sums over samples: the object's colour (S · C), S, and the covered share of the photograph.
  float* out[5] = {};

  const float* d_out[4] = {};        ///< backward: d loss / d (I, S) of one sample
  FaceGradientSums* sums = nullptr;  ///< backward: one for each of `faces`
  std::vector<TexelGradient>* texel_gradients = nullptr;
};

/// Fills kSamples pixel indices for `supersampling`, in the order of the instruction set in use.
void sample_order(int supersampling, int tile_pixels, std::int32_t* pixel_of);
void draw_tile(const TileJob& job);
void draw_tile_vjp(const TileJob& job);
const char* instruction_set();

}  // namespace mirage::raster
