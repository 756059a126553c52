// Backward pass over a tile.
// Compiled once for each instruction set (hence the guard that toggles).
#if defined(MIRAGE_SENSORS_RASTER_VJP_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef MIRAGE_SENSORS_RASTER_VJP_INL_H_
#undef MIRAGE_SENSORS_RASTER_VJP_INL_H_
#else
#define MIRAGE_SENSORS_RASTER_VJP_INL_H_
#endif

#include "base/sizes.h"
#include "sensors/raster/tile-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mirage::raster::HWY_NAMESPACE {

/// d loss / d the values that the fragments of a sample share.
struct SampleGradients : TileSamples {
  enum Field {
    kMean,    ///< d loss / d colour among faces, times that colour
    kClear,   ///< d loss / d S · Π(1 − D); hard: 0
    kInvSum,  ///< 1 / TileTape::kSum
    kColor,   ///< three: d loss / d colour among faces
  };
};

void BeginVjp(const TileJob& job, SampleGradients& g) {
  const D d;
  const Constants& k = *job.constants;
  const TileTape& tape = *job.tape;
  ForEachBit(tape.touched, [&](int block) HWY_ATTR {
    const int first = block * kLanes;
    const VI pixel = hn::LoadU(DI(), job.pixel_of + first);
    const V clear = Read(tape, first, TileTape::kClear), silhouette = Silhouette(k, clear);
    const V sum = Read(tape, first, TileTape::kSum);
    V d_silhouette = hn::GatherIndex(d, job.d_out[3], pixel), mean = Zero(), background = Zero();
    const V share = Share(k, tape, first, silhouette);
    for (int c = 0; c < 3; ++c) {
      const V d_image = hn::GatherIndex(d, job.d_out[c], pixel),
              color = Read(tape, first, TileTape::kColor + c);
      const V step = hn::Sub(color, hn::GatherIndex(d, job.background[c], pixel));
      background = hn::MulAdd(d_image, step, background);
      const V d_color = hn::Mul(d_image, share);
      hn::Store(d_color, d, At(g, first, SampleGradients::kColor + c));
      mean = hn::MulAdd(d_color, color, mean);
    }
    if (!k.logit) d_silhouette = hn::Add(d_silhouette, hn::IfThenElseZero(Any(k, tape, first), background));
    hn::Store(mean, d, At(g, first, SampleGradients::kMean));
    hn::Store(k.hard ? Zero() : hn::Mul(d_silhouette, clear), d, At(g, first, SampleGradients::kClear));
    hn::Store(hn::IfThenElseZero(hn::Gt(sum, Zero()), hn::Div(Set(1), sum)), d,
              At(g, first, SampleGradients::kInvSum));
  });
}

/// Texel gradients of one face in one tile, accumulated densely and returned as a list. Neighbouring lanes
/// often hit the same texel: they add to different banks, so that no addition waits for the one before.
class TexelSums {
 public:
  void Begin(int texels) {
    const std::size_t size = 4 * kBanks * as_size(texels);
    if (sums_.size() < size) sums_.assign(size, 0);
  }
  /// Lanes without weight add 0, which is faster than skipping them.
  HWY_INLINE void Add(VI index, V weight, const V (&d_color)[3]) {
    const D d;
    const hn::CappedTag<float, 4> quad;
    alignas(64) std::int32_t places[kLanes];
    alignas(64) float values[4 * kLanes];
    hn::Store(hn::ShiftLeft<4>(index), DI(), places);
    hn::StoreInterleaved4(hn::Mul(weight, d_color[0]), hn::Mul(weight, d_color[1]),
                          hn::Mul(weight, d_color[2]), Zero(), d, values);
    float* const sums = sums_.data();
    for (int lane = 0; lane < kLanes; ++lane) {
      float* sum = sums + places[lane] + 4 * (lane % kBanks);
      if constexpr (kLanes >= 4) {
        hn::StoreU(hn::Add(hn::LoadU(quad, sum), hn::Load(quad, values + 4 * lane)), quad, sum);
      } else {
        for (int c = 0; c < 3; ++c) sum[c] += values[4 * lane + c];
      }
    }
  }
  void End(int texels, int first, std::vector<TexelGradient>& list) {
    for (int texel = 0; texel < texels; ++texel) {
      float* s = sums_.data() + 4 * kBanks * texel;
      TexelGradient total{first + texel, 0, 0, 0};
      for (int bank = 0; bank < kBanks; ++bank)
        total.r += s[4 * bank], total.g += s[4 * bank + 1], total.b += s[4 * bank + 2];
      if (total.r == 0 && total.g == 0 && total.b == 0) continue;
      std::fill(s, s + 4 * kBanks, 0.f);
      list.push_back(total);
    }
  }

 private:
  static constexpr int kBanks = 4;
  std::vector<float> sums_;  // texels × banks × (r, g, b, 0)
};

struct Scratch {
  Covered list[kBlocks];
  SampleGradients samples;
  TexelSums texels;
};

/// Not inlined: in a shared library each access to a thread's variable would be a call.
HWY_NOINLINE Scratch& ThreadScratch() {
  static thread_local Scratch scratch;
  return scratch;
}

/// Running sums of a face, a vector each.
struct Sums {
  V x[3], y[3], delta[3];
  V corner[3][3];  ///< d loss / d colour c of corner e, [e][c]; vertex texture
};

HWY_INLINE float Total(V v) {
  return hn::GetLane(hn::SumOfLanes(D(), v));
}

template <bool kPlain>
void DrawFacesVjp(const TileJob& job) {
  const D d;
  const Constants& k = *job.constants;
  const TileTape& tape = *job.tape;
  Scratch& scratch = ThreadScratch();
  SampleGradients& samples = scratch.samples;
  TexelSums& texel_sums = scratch.texels;
  BeginVjp(job, samples);
  const bool hard = !kPlain && k.hard;
  const Grid& grid = TileGrid();
  for (int i = 0; i < job.count; ++i) {
    const FaceSetup& face = job.setup->faces[job.faces[i]];
    const LocalFace local = Localise(job, face);
    const int texels = local.resolution * local.resolution;
    const bool by_vertex = !kPlain && k.vertex_texture;
    if (!by_vertex) texel_sums.Begin(texels);
    // ∇b_e, bounded for faces seen edge-on.
    float slope_x[3], slope_y[3];
    for (int e = 0; e < 3; ++e) {
      const float steep = face.inv_altitude[e] * static_cast<float>(face.slope_bound);
      slope_x[e] = steep * local.nx[(e + 1) % 3];
      slope_y[e] = steep * local.ny[(e + 1) % 3];
    }
    Sums sums;
    for (int e = 0; e < 3; ++e) {
      sums.x[e] = sums.y[e] = sums.delta[e] = Zero();
      for (int c = 0; c < 3; ++c) sums.corner[e][c] = Zero();
    }
    const int count = CoverBlocks<kPlain, true>(job, local, grid, kMaxWeightedExponent, scratch.list);
    for (const Covered& at : std::span(scratch.list, as_size(count))) {
      const auto load = [&](int field) HWY_ATTR { return Read(samples, at.first, field); };
      const bool colored = !at.behind && face.colored;
      V coverage = hn::Load(d, at.coverage), open = hn::Load(d, at.open);
      Place p;
      if (colored || job.limit) p = PlaceOf(local, at);
      if (job.limit) Limit(job, at, p, coverage, open);
      // x = δ d² / σ: d D / d x = D (1 − D), and through the product d S / d x_j = D_j Π(1 − D).
      V d_x = hn::Mul(load(SampleGradients::kClear), coverage);
      if (colored) {
        V weight;
        if (kPlain) {
          const V depth = Exp2(hn::MulAdd(p.phi, Set(k.depth_scale2), Set(k.depth_start2)));
          weight = hn::Mul(hn::Mul(coverage, depth), load(SampleGradients::kInvSum));
        } else {
          const V key = hn::Mul(p.phi, Set(k.key_scale)), top = Read(tape, at.first, TileTape::kTop);
          const M drawn = Drawn(k, coverage, key);
          if (hard) {
            weight = hn::IfThenElseZero(hn::Eq(top, Set(static_cast<float>(job.faces[i]))), Set(1));
          } else {
            const V depth = Exp2(hn::Min(Zero(), hn::Mul(hn::Sub(key, top), Set(k.inv_gamma * kLog2E))));
            weight = hn::Mul(hn::Mul(coverage, depth), load(SampleGradients::kInvSum));
          }
          weight = hn::IfThenElseZero(drawn, weight);
        }
        if (!hn::AllFalse(d, hn::Gt(weight, Set(kNoWeight)))) {
          V d_color[3], d_bary[3];
          for (int c = 0; c < 3; ++c) d_color[c] = load(SampleGradients::kColor + c);
          VI index;
          if (!by_vertex) {
            index = TexelIndex<kPlain>(local, p);
            texel_sums.Add(index, weight, d_color);
          }
          if (by_vertex) {
            // lookup_e = y_e / Σ y, y_e = c_e (1 + delta_e), c the clamped barycentrics.
            V d_lookup[3], mean = Zero();
            for (int e = 0; e < 3; ++e) {
              d_lookup[e] = Zero();
              const V share = hn::Mul(weight, p.lookup[e]);
              for (int c = 0; c < 3; ++c) {
                sums.corner[e][c] = hn::MulAdd(share, d_color[c], sums.corner[e][c]);
                d_lookup[e] =
                    hn::MulAdd(d_color[c], Set(local.texels[local.texel_stride * c + e]), d_lookup[e]);
              }
              d_lookup[e] = hn::Mul(weight, d_lookup[e]);
              mean = hn::MulAdd(d_lookup[e], p.lookup[e], mean);
            }
            for (int e = 0; e < 3; ++e) {
              const V d_y = hn::Mul(p.rcp, hn::Sub(d_lookup[e], mean));
              sums.delta[e] = hn::MulAdd(d_y, p.clipped[e], sums.delta[e]);
              d_bary[e] = hn::Mul(d_y, Set(1 + face.delta[e]));
            }
          }
          if (!hard) {
            const Color color = by_vertex ? VertexColor(local, p) : TexelColor(local, index);
            V advantage = hn::Neg(load(SampleGradients::kMean));
            for (int c = 0; c < 3; ++c) advantage = hn::MulAdd(d_color[c], color.c[c], advantage);
            const V gain = hn::Mul(weight, advantage);
            d_x = hn::MulAdd(gain, open, d_x);
            // Depth: φ = Σ c_k delta_k / Σ c_k (1 + delta_k), c the clamped barycentrics.
            const V d_phi = hn::Mul(gain, Set(k.key_scale * k.inv_gamma));
            const V u = hn::Mul(d_phi, p.rcp), by_phi = hn::Mul(u, p.phi), rest = hn::Sub(u, by_phi);
            for (int e = 0; e < 3; ++e) {
              sums.delta[e] = hn::MulAdd(rest, p.clipped[e], sums.delta[e]);
              const V by_depth = hn::MulSub(rest, Set(face.delta[e]), by_phi);
              d_bary[e] = by_vertex ? hn::Add(d_bary[e], by_depth) : by_depth;
            }
          }
          if (!hard || by_vertex) {
            // The barycentrics solve Σ b_m v_m = p, Σ b_m = 1, so that d b_e / d v_m = −b_m ∇b_e.
            V x = Zero(), y = Zero();
            for (int e = 0; e < 3; ++e) {
              const M free = hn::And(hn::Gt(p.b[e], Zero()), hn::Lt(p.b[e], Set(1)));
              const V d_b = hn::IfThenElseZero(free, d_bary[e]);
              x = hn::MulAdd(d_b, Set(slope_x[e]), x);
              y = hn::MulAdd(d_b, Set(slope_y[e]), y);
            }
            for (int m = 0; m < 3; ++m) {
              sums.x[m] = hn::NegMulAdd(x, p.b[m], sums.x[m]);
              sums.y[m] = hn::NegMulAdd(y, p.b[m], sums.y[m]);
            }
          }
        }
      }
      if (!hard) {
        const V f = hn::Mul(d_x, Set(2 * k.distance_scale));
        const V push_x = hn::Mul(f, hn::Load(d, at.away[0])), push_y = hn::Mul(f, hn::Load(d, at.away[1]));
        for (int e = 0; e < 3; ++e) {
          const V share = hn::Load(d, at.share[e]);
          sums.x[e] = hn::MulAdd(share, push_x, sums.x[e]);
          sums.y[e] = hn::MulAdd(share, push_y, sums.y[e]);
        }
      }
    }
    FaceGradientSums& out = job.sums[i];
    for (int e = 0; e < 3; ++e) {
      out.x[e] = Total(sums.x[e]);
      out.y[e] = Total(sums.y[e]);
      out.delta[e] = Total(sums.delta[e]);
    }
    if (!by_vertex) {
      texel_sums.End(texels, local.first_texel, *job.texel_gradients);
      continue;
    }
    for (int e = 0; e < 3; ++e)
      job.texel_gradients->push_back(
          {3 * face.face + e, Total(sums.corner[e][0]), Total(sums.corner[e][1]), Total(sums.corner[e][2])});
  }
}

void DrawTileVjp(const TileJob& job) {
  if (job.constants->plain)
    DrawFacesVjp<true>(job);
  else
    DrawFacesVjp<false>(job);
}

}  // namespace mirage::raster::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif  // guard
