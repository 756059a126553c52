// Forward pass over a tile.
// Compiled once for each instruction set (hence the guard that toggles).
#if defined(MIRAGE_SENSORS_RASTER_DRAW_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef MIRAGE_SENSORS_RASTER_DRAW_INL_H_
#undef MIRAGE_SENSORS_RASTER_DRAW_INL_H_
#else
#define MIRAGE_SENSORS_RASTER_DRAW_INL_H_
#endif

#include "sensors/raster/tile-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mirage::raster::HWY_NAMESPACE {

template <bool kPlain>
void DrawFaces(const TileJob& job) {
  const D d;
  const Constants& k = *job.constants;
  TileTape& tape = *job.tape;
  const bool hard = !kPlain && k.hard;
  V lane_x, lane_y;
  LanePlaces(lane_x, lane_y);
  for (int i = 0; i < job.count; ++i) {
    const FaceSetup& face = job.setup->faces[job.faces[i]];
    const LocalFace local = Localise(job, face);
    ForEachBlock(
        job, local, lane_x, lane_y, [&](int first, V px, V py) HWY_ATTR __attribute__((always_inline)) {
          V clear = hn::Load(d, tape.clear + first), top = hn::Load(d, tape.top + first),
            sum = hn::Load(d, tape.sum + first);
          const bool behind = !hard && hn::AllTrue(d, Behind(k, face, top, sum, kFarBehind));
          if (behind && hn::AllTrue(d, hn::Lt(clear, Set(kClosed)))) return;
          Fragment f;
          if (!Meet<kPlain>(job, local, first, px, py, behind, f)) return;
          clear = hard ? hn::IfThenElse(f.keep, Set(1), clear)
                       : hn::IfThenElse(f.keep, hn::Mul(clear, f.open), clear);
          hn::Store(clear, d, tape.clear + first);
          if (behind || !face.colored || hn::AllFalse(d, f.colored)) return;

          const auto color_here = [&]() HWY_ATTR __attribute__((always_inline)) {
            return !kPlain && k.vertex_texture ? VertexColor(local, f)
                                               : TexelColor(local, TexelIndex<kPlain>(local, f));
          };
          if (hard) {
            // sum holds the key of the nearest so far, top the number of its face.
            const Color color = color_here();
            const M nearer = hn::And(f.colored, hn::Gt(f.key, sum));
            hn::Store(hn::IfThenElse(nearer, f.key, sum), d, tape.sum + first);
            hn::Store(hn::IfThenElse(nearer, Set(static_cast<float>(job.faces[i])), top), d,
                      tape.top + first);
            for (int c = 0; c < 3; ++c)
              hn::Store(hn::IfThenElse(nearer, color.c[c], hn::Load(d, tape.color[c] + first)), d,
                        tape.color[c] + first);
            return;
          }
          const M higher = hn::And(f.colored, hn::Gt(f.key, top));
          if (!hn::AllFalse(d, higher)) {  // seldom: faces come from front to back
            const V raised = hn::IfThenElse(higher, f.key, top);
            const V fade = Exp2(hn::Mul(hn::Sub(top, raised), Set(k.inv_gamma * kLog2E)));
            sum = hn::Mul(sum, fade);
            for (int c = 0; c < 3; ++c)
              hn::Store(hn::Mul(hn::Load(d, tape.color[c] + first), fade), d, tape.color[c] + first);
            top = raised;
            hn::Store(top, d, tape.top + first);
            hn::Store(sum, d, tape.sum + first);
          }
          const V depth = Exp2(hn::Min(Zero(), hn::Mul(hn::Sub(f.key, top), Set(k.inv_gamma * kLog2E))));
          const V weight = hn::IfThenElseZero(f.colored, hn::Mul(f.coverage, depth));
          // Too little to change any sample's colour in float.
          if (hn::AllTrue(d, hn::Le(weight, hn::Mul(sum, Set(kClosed))))) return;
          const Color color = color_here();
          hn::Store(hn::Add(sum, weight), d, tape.sum + first);
          for (int c = 0; c < 3; ++c)
            hn::Store(hn::MulAdd(weight, color.c[c], hn::Load(d, tape.color[c] + first)), d,
                      tape.color[c] + first);
        });
  }
}

/// Starts the samples' state.
void Begin(const TileJob& job) {
  const D d;
  TileTape& tape = *job.tape;
  const Constants& k = *job.constants;
  for (int i = 0; i < kSamples; i += kLanes) {
    hn::Store(Set(k.hard ? -1 : k.logit ? k.background_key : kNoKey), d, tape.top + i);
    hn::Store(Set(k.hard ? kNoKey : k.logit ? 1 : 0), d, tape.sum + i);
    hn::Store(Set(k.hard ? 0 : 1), d, tape.clear + i);
    const VI pixel = hn::LoadU(DI(), job.pixel_of + i);
    for (int c = 0; c < 3; ++c)
      hn::Store(k.logit ? hn::GatherIndex(d, job.background[c], pixel) : Zero(), d, tape.color[c] + i);
  }
}

/// Normalises the colours and sums the samples of each pixel.
void End(const TileJob& job) {
  const D d;
  const Constants& k = *job.constants;
  TileTape& tape = *job.tape;
  alignas(64) float out[4][kLanes];
  for (int i = 0; i < kSamples; i += kLanes) {
    const V silhouette = Silhouette(k, hn::Load(d, tape.clear + i));
    V scale = Set(1);
    if (!k.hard) {
      const V sum = hn::Load(d, tape.sum + i);
      scale = hn::IfThenElseZero(hn::Gt(sum, Zero()), hn::Div(Set(1), sum));
    }
    const V share = Share(k, tape, i, silhouette);
    for (int c = 0; c < 3; ++c) {
      const V color = hn::Mul(hn::Load(d, tape.color[c] + i), scale);
      hn::Store(color, d, tape.color[c] + i);
      hn::Store(hn::Mul(share, color), d, out[c]);
    }
    hn::Store(silhouette, d, out[3]);
    alignas(64) float shares[kLanes];
    hn::Store(share, d, shares);
    for (int lane = 0; lane < kLanes; ++lane) {
      const int pixel = job.pixel_of[i + lane];
      for (int c = 0; c < 4; ++c) job.out[c][pixel] += out[c][lane];
      job.out[4][pixel] += shares[lane];
    }
  }
}

void DrawTile(const TileJob& job) {
  Begin(job);
  if (job.constants->plain())
    DrawFaces<true>(job);
  else
    DrawFaces<false>(job);
  End(job);
}

}  // namespace mirage::raster::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif  // guard
