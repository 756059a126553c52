// The fast soft rasteriser: the definition of soft_rasterizer.h in float, vectorised (Highway, instruction
// set chosen at run time), in tiles, for many objects at once. It draws soft (the defaults, with any
// background) and hard (coverage, colour and silhouette), with perspective texture. A job with other options
// takes the plain loop in double.
//
// Faces are set up in double and binned into tiles of 32 × 32 samples; within a tile they are drawn from
// front to back, and a block of samples that later faces cannot change is skipped (error below 1e-7 of the
// colour). Threads share the tiles of all jobs; sums run in tile order, so that image and gradient are bit
// for bit the same for any number of threads and in every run.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "sensors/soft_rasterizer.h"

namespace mirage {

/// Whether the kernel draws these settings; otherwise the plain loop does.
bool in_kernel(const SoftRasterSettings<double>& settings);

/// One object in one window. The caller owns the data behind the pointers. The VJP must get the same data
/// again, possibly at other addresses.
struct RasterJob {
  const ScreenMesh<double>* mesh = nullptr;
  const SoftRasterSettings<double>* settings = nullptr;
  const RasterTarget<float>* target = nullptr;
};

/// Data of a forward pass for its VJP. Reuse one object for many calls: its memory is kept, proportional to
/// the samples in the touched tiles.
class RasterTape {
 public:
  RasterTape();
  ~RasterTape();
  /// Takes the other's memory.
  RasterTape(RasterTape&&) noexcept;
  /// Takes the other's memory.
  RasterTape& operator=(RasterTape&&) noexcept;

  ImageF rgba;  ///< window-sized: I and S

  struct State;
  std::unique_ptr<State> state;
};

/// Draws every job; tapes.size() == jobs.size().
void rasterize_batch(std::span<const RasterJob> jobs, std::span<RasterTape> tapes);

/// VJP of the last rasterize_batch into these tapes, one at a time for each tape. d_rgba[i] is window-sized
/// RGBA.
void rasterize_batch_vjp(std::span<const RasterJob> jobs, std::span<const ImageF> d_rgba,
                         std::span<RasterTape> tapes, std::span<ScreenGradient<double>> gradients);

/// The same values in double, for the plain loop.
Image<double> to_double(const ImageF& image);
/// Its inverse.
ImageF to_float(const Image<double>& image);
/// The same values in double.
RasterTarget<double> to_double(const RasterTarget<float>& target);

/// Name of the instruction set in use ("AVX3", "AVX2", …, "EMU128"/"SCALAR").
const char* raster_instruction_set();

}  // namespace mirage
