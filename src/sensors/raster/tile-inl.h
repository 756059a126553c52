// A tile's samples: their order, the blocks that a face may touch, and what forward and backward both ask.
// Compiled once for each instruction set (hence the guard that toggles).
#if defined(MIRAGE_SENSORS_RASTER_TILE_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef MIRAGE_SENSORS_RASTER_TILE_INL_H_
#undef MIRAGE_SENSORS_RASTER_TILE_INL_H_
#else
#define MIRAGE_SENSORS_RASTER_TILE_INL_H_
#endif

#include "sensors/raster/fragment-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mirage::raster::HWY_NAMESPACE {

void SampleOrder(int supersampling, int tile_pixels, std::int32_t* pixel_of) {
  for (int y = 0; y < kTile; ++y)
    for (int x = 0; x < kTile; ++x) {
      const int block = (y / kBlockHeight) * kBlockColumns + x / kBlockWidth;
      const int lane = (y % kBlockHeight) * kBlockWidth + x % kBlockWidth;
      const int u = x / supersampling, v = y / supersampling;
      const bool in_tile = u < tile_pixels && v < tile_pixels;
      pixel_of[block * kLanes + lane] = in_tile ? v * tile_pixels + u : tile_pixels * tile_pixels;
    }
}

const char* InstructionSet() {
  return hwy::TargetName(HWY_TARGET);
}

/// Calls visit(first sample of the block, px, py) for each block of the tile that the face may touch.
template <class Visit>
HWY_INLINE void ForEachBlock(const TileJob& job, const LocalFace& local, V lane_x, V lane_y,
                             const Visit& visit) {
  const FaceSetup& face = *local.face;
  const int last_column = (job.width - 1) / kBlockWidth, last_row = (job.height - 1) / kBlockHeight;
  const auto place = [](double at, int size, int last) {
    return static_cast<int>(std::clamp(std::floor(at / size), -1.0, last + 1.0));
  };
  const int c0 = std::max(0, place(face.low_x - job.x0, kBlockWidth, last_column)),
            c1 = std::min(last_column, place(face.high_x - job.x0, kBlockWidth, last_column)),
            r0 = std::max(0, place(face.low_y - job.y0, kBlockHeight, last_row)),
            r1 = std::min(last_row, place(face.high_y - job.y0, kBlockHeight, last_row));
  constexpr float kMidX = (kBlockWidth - 1) / 2.f, kMidY = (kBlockHeight - 1) / 2.f;
  // A block whose middle is further outside an edge's line than this holds no sample of the face.
  const float radius =
      static_cast<float>(job.setup->reach) + 1e-3f + std::sqrt(kMidX * kMidX + kMidY * kMidY);
  for (int r = r0; r <= r1; ++r)
    for (int c = c0; c <= c1; ++c) {
      const float x = static_cast<float>(c * kBlockWidth), y = static_cast<float>(r * kBlockHeight);
      float outside = std::numeric_limits<float>::infinity();
      for (int e = 0; e < 3; ++e)
        outside = std::min(outside, local.nx[e] * (x + kMidX) + local.ny[e] * (y + kMidY) + local.c[e]);
      if (outside < -radius) continue;
      visit((r * kBlockColumns + c) * kLanes, hn::Add(lane_x, Set(x)), hn::Add(lane_y, Set(y)));
    }
}

HWY_INLINE void LanePlaces(V& lane_x, V& lane_y) {
  alignas(64) float x[kLanes], y[kLanes];
  for (int i = 0; i < kLanes; ++i) {
    x[i] = static_cast<float>(i % kBlockWidth);
    y[i] = static_cast<float>(i / kBlockWidth);
  }
  lane_x = hn::Load(D(), x);
  lane_y = hn::Load(D(), y);
}

/// Samples behind whose fragments all of the face lies by more than `distance` (in units of γ).
HWY_INLINE M Behind(const Constants& k, const FaceSetup& face, V top, V sum, float distance) {
  const V behind = hn::Mul(hn::Sub(top, Set(face.front)), Set(k.inv_gamma));
  return hn::And(hn::Gt(sum, Set(kEnough)), hn::Gt(behind, Set(distance)));
}

/// The fragment of a face at a block, with all that drops samples of it. `behind`: depth and colour do not
/// matter. False where none is left by distance.
template <bool kPlain>
HWY_INLINE bool Meet(const TileJob& job, const LocalFace& local, int first, V px, V py, bool behind,
                     Fragment& f) {
  const Constants& k = *job.constants;
  if (!Cover<kPlain>(local, k, px, py, f)) return false;
  if (!behind || job.limit || !kPlain)
    Place(local, k, f);
  else
    PlaceNowhere(f);
  if (job.limit) {
    const VI pixel = hn::LoadU(DI(), job.pixel_of + first);
    const M near = hn::Ge(f.key, hn::GatherIndex(D(), job.limit, pixel));
    f.keep = hn::And(f.keep, near);
    f.colored = hn::And(f.colored, near);
  }
  return true;
}

HWY_INLINE V Silhouette(const Constants& k, V clear) {
  return k.hard ? clear : hn::Sub(Set(1), clear);
}

/// Samples that some face gives colour.
HWY_INLINE M Any(const Constants& k, const TileTape& tape, int first) {
  return k.hard ? hn::Ge(hn::Load(D(), tape.top + first), Zero())
                : hn::Gt(hn::Load(D(), tape.sum + first), Zero());
}

/// Of the photograph, what the tape's colour takes the place of. Where no face gives colour it stays,
/// whatever S says; a logit's photograph is in that colour.
HWY_INLINE V Share(const Constants& k, const TileTape& tape, int first, V silhouette) {
  return k.logit ? Set(1) : hn::IfThenElseZero(Any(k, tape, first), silhouette);
}

}  // namespace mirage::raster::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif  // guard
