// Forward pass over a tile.
// Compiled once for each instruction set (hence the guard that toggles).
#if defined(MIRAGE_SENSORS_RASTER_DRAW_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef MIRAGE_SENSORS_RASTER_DRAW_INL_H_
#undef MIRAGE_SENSORS_RASTER_DRAW_INL_H_
#else
#define MIRAGE_SENSORS_RASTER_DRAW_INL_H_
#endif

#include "base/sizes.h"
#include "sensors/raster/tile-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mirage::raster::HWY_NAMESPACE {

template <bool kPlain>
void DrawFaces(const TileJob& job) {
  const D d;
  const Constants& k = *job.constants;
  TileTape& tape = *job.tape;
  const bool hard = !kPlain && k.hard;
  const Grid& grid = TileGrid();
  Covered list[kBlocks];
  for (int i = 0; i < job.count; ++i) {
    const FaceSetup& face = job.setup->faces[job.faces[i]];
    const LocalFace local = Localise(job, face);
    const int count = CoverBlocks<kPlain, false>(job, local, grid, kMaxDepthExponent, list);
    for (const Covered& at : std::span(list, as_size(count))) {
      const auto load = [&](int field) HWY_ATTR { return Read(tape, at.first, field); };
      const auto store = [&](V v, int field) HWY_ATTR { hn::Store(v, d, At(tape, at.first, field)); };
      const bool colored = !at.behind && face.colored;
      V coverage = hn::Load(d, at.coverage), open = hn::Load(d, at.open);
      Place p;
      if (colored || job.limit) p = PlaceOf(local, at);
      if (job.limit) Limit(job, at, p, coverage, open);
      const V clear = load(TileTape::kClear);
      store(hard ? hn::Max(clear, coverage) : hn::Mul(clear, open), TileTape::kClear);
      if (!colored) continue;
      const Color color = !kPlain && k.vertex_texture ? VertexColor(local, p)
                                                      : TexelColor(local, TexelIndex<kPlain>(local, p));
      V weight, fade;
      if (kPlain) {
        weight = hn::Mul(coverage, Exp2(hn::MulAdd(p.phi, Set(k.depth_scale2), Set(k.depth_start2))));
        fade = Set(1);
      } else {
        const V key = hn::Mul(p.phi, Set(k.key_scale)), top = load(TileTape::kTop);
        const M drawn = Drawn(k, coverage, key);
        if (hard) {
          // The sum's place has the key of the nearest so far.
          const V nearest = load(TileTape::kSum);
          const M nearer = hn::And(drawn, hn::Gt(key, nearest));
          store(hn::IfThenElse(nearer, key, nearest), TileTape::kSum);
          store(hn::IfThenElse(nearer, Set(static_cast<float>(job.faces[i])), top), TileTape::kTop);
          for (int c = TileTape::kColor; c < TileTape::kColor + 3; ++c)
            store(hn::IfThenElse(nearer, color.c[c - TileTape::kColor], load(c)), c);
          continue;
        }
        const V raised = hn::IfThenElse(drawn, hn::Max(key, top), top);
        store(raised, TileTape::kTop);
        fade = Exp2(hn::Mul(hn::Sub(top, raised), Set(k.inv_gamma * kLog2E)));
        const V depth = Exp2(hn::Min(Zero(), hn::Mul(hn::Sub(key, raised), Set(k.inv_gamma * kLog2E))));
        weight = hn::IfThenElseZero(drawn, hn::Mul(coverage, depth));
      }
      store(hn::MulAdd(load(TileTape::kSum), fade, weight), TileTape::kSum);
      for (int c = 0; c < 3; ++c) {
        const V so_far = hn::Mul(load(TileTape::kColor + c), fade);
        store(hn::MulAdd(weight, color.c[c], so_far), TileTape::kColor + c);
      }
    }
  }
}

/// Starts the samples' state.
void Begin(const TileJob& job) {
  const D d;
  TileTape& tape = *job.tape;
  const Constants& k = *job.constants;
  std::fill(std::begin(tape.touched), std::end(tape.touched), k.logit ? ~std::uint64_t{0} : 0);
  const float behind = (k.background_key - k.reference_key) * k.inv_gamma;
  const float weight = !k.logit ? 0 : k.plain ? std::exp(std::max(behind, kFaintest)) : 1;
  for (int i = 0; i < kSamples; i += kLanes) {
    hn::Store(Set(k.hard ? -1 : k.logit ? k.background_key : kNoKey), d, At(tape, i, TileTape::kTop));
    hn::Store(Set(k.hard ? kNoKey : weight), d, At(tape, i, TileTape::kSum));
    hn::Store(Set(k.hard ? 0 : 1), d, At(tape, i, TileTape::kClear));
    const VI pixel = hn::LoadU(DI(), job.pixel_of + i);
    for (int c = 0; c < 3; ++c) {
      const V color = k.logit ? hn::GatherIndex(d, job.background[c], pixel) : Zero();
      hn::Store(hn::Mul(Set(weight), color), d, At(tape, i, TileTape::kColor + c));
    }
  }
}

/// Normalises the colours and sums the samples of each pixel.
void End(const TileJob& job) {
  const D d;
  const Constants& k = *job.constants;
  TileTape& tape = *job.tape;
  // Neighbours that share a pixel are added before they are added to it.
  const int step_x = job.supersampling % 2 == 0 ? std::min(2, kBlockWidth) : 1,
            step_y = job.supersampling % 2 == 0 ? std::min(2, kBlockHeight) : 1;
  ForEachBit(tape.touched, [&](int block) HWY_ATTR {
    const int first = block * kLanes;
    const V silhouette = Silhouette(k, Read(tape, first, TileTape::kClear));
    V scale = Set(1);
    if (!k.hard) {
      const V sum = Read(tape, first, TileTape::kSum);
      scale = hn::IfThenElseZero(hn::Gt(sum, Zero()), hn::Div(Set(1), sum));
    }
    const V share = Share(k, tape, first, silhouette);
    alignas(64) float out[5][kLanes];
    for (int c = 0; c < 3; ++c) {
      const V color = hn::Mul(Read(tape, first, TileTape::kColor + c), scale);
      hn::Store(color, d, At(tape, first, TileTape::kColor + c));
      hn::Store(hn::Mul(share, color), d, out[c]);
    }
    hn::Store(silhouette, d, out[3]);
    hn::Store(share, d, out[4]);
    for (int y = 0; y < kBlockHeight; y += step_y)
      for (int x = 0; x < kBlockWidth; x += step_x) {
        const int lane = y * kBlockWidth + x, right = step_x - 1, below = (step_y - 1) * kBlockWidth;
        const int pixel = job.pixel_of[first + lane];
        for (int c = 0; c < 5; ++c) {
          const float* at = out[c] + lane;
          float sum = at[0];
          if (right) sum += at[right];
          if (below) sum += at[below] + at[below + right];
          job.out[c][pixel] += sum;
        }
      }
  });
}

void DrawTile(const TileJob& job) {
  Begin(job);
  if (job.constants->plain)
    DrawFaces<true>(job);
  else
    DrawFaces<false>(job);
  End(job);
}

}  // namespace mirage::raster::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif  // guard
