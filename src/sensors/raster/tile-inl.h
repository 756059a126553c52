// A tile's samples: their order, the blocks that a face may touch, and code shared by forward and backward
// pass. Compiled once for each instruction set (hence the guard that toggles).
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

inline constexpr int kBlocks = kSamples / kLanes, kWords = (kBlocks + 63) / 64;  ///< a bit for each block

/// A field of the block whose first sample is `first`.
HWY_INLINE float* At(TileSamples& samples, int first, int field) {
  return samples.values + 6 * first + field * kLanes;
}
HWY_INLINE V Read(const TileSamples& samples, int first, int field) {
  return hn::Load(D(), samples.values + 6 * first + field * kLanes);
}

/// Calls visit(block) for each bit.
template <class Visit>
HWY_INLINE void ForEachBit(const std::uint64_t* words, const Visit& visit) {
  for (int w = 0; w < kWords; ++w)
    for (std::uint64_t bits = words[w]; bits; bits &= bits - 1) visit(64 * w + std::countr_zero(bits));
}

/// Positions of samples in their block, and of the first sample of each block.
struct Grid {
  V lane_x, lane_y;
  alignas(64) float x[kBlocks], y[kBlocks];

  Grid() {
    alignas(64) float lanes[2][kLanes];
    for (int i = 0; i < kLanes; ++i) {
      lanes[0][i] = static_cast<float>(i % kBlockWidth);
      lanes[1][i] = static_cast<float>(i / kBlockWidth);
    }
    lane_x = hn::Load(D(), lanes[0]);
    lane_y = hn::Load(D(), lanes[1]);
    for (int i = 0; i < kBlocks; ++i) {
      x[i] = static_cast<float>(i % kBlockColumns * kBlockWidth);
      y[i] = static_cast<float>(i / kBlockColumns * kBlockHeight);
    }
  }
};

/// Not inlined: in a shared library each access to it would be a call.
HWY_NOINLINE const Grid& TileGrid() {
  static const Grid grid;
  return grid;
}

/// A bit for each block that the face may touch.
HWY_INLINE void TouchedBlocks(const TileJob& job, const LocalFace& local, const Grid& grid,
                              std::uint64_t* words) {
  const D d;
  const FaceSetup& face = *local.face;
  constexpr float kSlack = 1e-3f, kLastX = kBlockWidth - 1, kLastY = kBlockHeight - 1;
  const auto in_tile = [](double at) { return static_cast<float>(std::clamp(at, -1e4, 1e4)); };
  const V low_x = Set(in_tile(face.low_x - job.x0) - kLastX - kSlack),
          low_y = Set(in_tile(face.low_y - job.y0) - kLastY - kSlack),
          high_x = Set(std::min(in_tile(face.high_x - job.x0) + kSlack, static_cast<float>(job.width - 1))),
          high_y = Set(std::min(in_tile(face.high_y - job.y0) + kSlack, static_cast<float>(job.height - 1)));
  // A block whose middle is further outside an edge's line than this holds no sample of the face.
  const V radius =
      Set(-static_cast<float>(job.setup->reach) - kSlack - std::sqrt(kLastX * kLastX + kLastY * kLastY) / 2);
  // StoreMaskBits may write 8 bytes.
  std::uint8_t bytes[kWords * 8 + 8] = {};
  for (int i = 0; i < kBlocks; i += kLanes) {
    const V x = hn::Load(d, grid.x + i), y = hn::Load(d, grid.y + i);
    const V middle_x = hn::Add(x, Set(kLastX / 2)), middle_y = hn::Add(y, Set(kLastY / 2));
    M touched =
        hn::And(hn::And(hn::Ge(x, low_x), hn::Le(x, high_x)), hn::And(hn::Ge(y, low_y), hn::Le(y, high_y)));
    for (int e = 0; e < 3; ++e) {
      const V s =
          hn::MulAdd(Set(local.nx[e]), middle_x, hn::MulAdd(Set(local.ny[e]), middle_y, Set(local.c[e])));
      touched = hn::And(touched, hn::Ge(s, radius));
    }
    if constexpr (kLanes >= 8) {
      hn::StoreMaskBits(d, touched, bytes + i / 8);
    } else {
      std::uint8_t few[8];
      hn::StoreMaskBits(d, touched, few);
      bytes[i / 8] = static_cast<std::uint8_t>(bytes[i / 8] | (few[0] & ((1 << kLanes) - 1)) << i % 8);
    }
  }
  std::memcpy(words, bytes, kWords * 8);
}

/// First pass over the face's blocks: fills `list` and returns its length. Blocks in which the face has at
/// most e^-distance / kEnough of a sample's weight are skipped or marked as behind.
template <bool kPlain, bool kVjp>
HWY_INLINE int CoverBlocks(const TileJob& job, const LocalFace& local, const Grid& grid, float distance,
                           Covered* list) {
  const D d;
  const FaceSetup& face = *local.face;
  const Constants& k = *job.constants;
  TileTape& tape = *job.tape;
  const bool hard = !kPlain && k.hard;
  std::uint64_t words[kWords];
  TouchedBlocks(job, local, grid, words);
  const float behind = (face.front - k.reference_key) * k.inv_gamma + distance;
  const V enough = Set(kPlain ? kEnough * std::exp(std::min(behind, 80.f)) : kEnough);
  int count = 0;
  for (int w = 0; !kVjp && w < kWords; ++w) tape.touched[w] |= words[w];
  ForEachBit(
      words, [&](int block) HWY_ATTR __attribute__((always_inline)) {
        Covered& at = list[count];
        at.first = block * kLanes;
        M hidden = hn::Gt(Read(tape, at.first, TileTape::kSum), enough);
        if (!kPlain) {
          const V depth = hn::Sub(Read(tape, at.first, TileTape::kTop), Set(face.front));
          hidden = hn::And(hidden, hn::Gt(hn::Mul(depth, Set(k.inv_gamma)), Set(distance)));
        }
        at.behind = !hard && hn::AllTrue(d, hidden);
        if (at.behind && hn::AllTrue(d, hn::Lt(Read(tape, at.first, TileTape::kClear), Set(kClosed)))) return;
        count += Cover<kPlain, kVjp>(local, k, hn::Add(grid.lane_x, Set(grid.x[block])),
                                     hn::Add(grid.lane_y, Set(grid.y[block])), at);
      });
  return count;
}

/// Drops the fragments that the scene hides.
HWY_INLINE void Limit(const TileJob& job, const Covered& at, const Place& p, V& coverage, V& open) {
  const VI pixel = hn::LoadU(DI(), job.pixel_of + at.first);
  const V key = hn::Mul(p.phi, Set(job.constants->key_scale));
  const M near = hn::Ge(key, hn::GatherIndex(D(), job.limit, pixel));
  coverage = hn::IfThenElseZero(near, coverage);
  open = hn::IfThenElse(near, open, Set(1));
}

/// Not plain: samples to which the face gives colour.
HWY_INLINE M Drawn(const Constants& k, V coverage, V key) {
  return hn::And(hn::Gt(coverage, Zero()),
                 hn::And(hn::Ge(key, Set(k.key_low)), hn::Le(key, Set(k.key_high))));
}

HWY_INLINE V Silhouette(const Constants& k, V clear) {
  return k.hard ? clear : hn::Sub(Set(1), clear);
}

/// Samples to which some face gives colour.
HWY_INLINE M Any(const Constants& k, const TileTape& tape, int first) {
  return k.hard ? hn::Ge(Read(tape, first, TileTape::kTop), Zero())
                : hn::Gt(Read(tape, first, TileTape::kSum), Zero());
}

/// Share of the photograph that the tape's colour replaces. Without a face that gives colour it is 0,
/// whatever S is; with a logit the tape's colour contains the photograph.
HWY_INLINE V Share(const Constants& k, const TileTape& tape, int first, V silhouette) {
  return k.logit ? Set(1) : hn::IfThenElseZero(Any(k, tape, first), silhouette);
}

}  // namespace mirage::raster::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif  // guard
