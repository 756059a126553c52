// Vectorised over samples: a vector holds a block of neighbouring samples, 4 × (lanes / 4). For each face in
// turn, two passes over its blocks (Covered): the face's constants stay in registers, the first pass's
// results and the samples' state in the first-level cache.
#include "sensors/raster/kernel.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <span>

#include "sensors/simd_targets.h"

// Also the emulated target, which every machine can run; tests compare with it.
#define HWY_COMPILE_ALL_ATTAINABLE
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sensors/raster/kernel.cpp"
// clang-format off
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wpedantic"
#pragma GCC diagnostic ignored "-Wshadow"
#include <hwy/foreach_target.h>  // this file again for each set: it must come first
#include <hwy/highway.h>
#pragma GCC diagnostic pop

// A value that a setting skips is neither computed nor read; the compiler does not see that.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#include "sensors/raster/draw-inl.h"
#include "sensors/raster/vjp-inl.h"
// clang-format on

#if HWY_ONCE
namespace mirage::raster {

HWY_EXPORT(SampleOrder);
HWY_EXPORT(DrawTile);
HWY_EXPORT(DrawTileVjp);
HWY_EXPORT(InstructionSet);

void sample_order(int supersampling, int tile_pixels, std::int32_t* pixel_of) {
  HWY_DYNAMIC_DISPATCH(SampleOrder)(supersampling, tile_pixels, pixel_of);
}
void draw_tile(const TileJob& job) {
  HWY_DYNAMIC_DISPATCH(DrawTile)(job);
}
void draw_tile_vjp(const TileJob& job) {
  HWY_DYNAMIC_DISPATCH(DrawTileVjp)(job);
}
const char* instruction_set() {
  return HWY_DYNAMIC_DISPATCH(InstructionSet)();
}

}  // namespace mirage::raster
#endif
