// One face at one block of samples: coverage, depth, texture coordinates, colour.
// Compiled once for each instruction set (hence the guard that toggles).
#if defined(MIRAGE_SENSORS_RASTER_FRAGMENT_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef MIRAGE_SENSORS_RASTER_FRAGMENT_INL_H_
#undef MIRAGE_SENSORS_RASTER_FRAGMENT_INL_H_
#else
#define MIRAGE_SENSORS_RASTER_FRAGMENT_INL_H_
#endif

#include "base/sizes.h"
#include "sensors/raster/vector-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mirage::raster::HWY_NAMESPACE {

/// A face's constants relative to its tile.
struct LocalFace {
  float nx[3], ny[3], c[3];            ///< s = nx x + ny y + c
  float ex[3], ey[3], g[3], g_end[3];  ///< r = ex x + ey y + g; g_end: from the edge's end
  float turn;                          ///< from n to e: −1 or 1, by the face's winding
  const FaceSetup* face;
  int resolution, first_texel;  ///< of its texture's face
  int texel_stride;
  const float* texels;                         ///< 3 planes of texel_stride
  const std::array<Vec3<double>, 3>* corners;  ///< of a clipped part, or null
};

inline LocalFace Localise(const TileJob& job, const FaceSetup& face) {
  LocalFace local;
  local.face = &face;
  for (int k = 0; k < 3; ++k) {
    const double dx = job.x0 - face.x[k], dy = job.y0 - face.y[k];
    local.nx[k] = static_cast<float>(face.nx[k]);
    local.ny[k] = static_cast<float>(face.ny[k]);
    local.c[k] = static_cast<float>(face.nx[k] * dx + face.ny[k] * dy);
    local.ex[k] = static_cast<float>(face.ex[k]);
    local.ey[k] = static_cast<float>(face.ey[k]);
    local.g[k] = static_cast<float>(face.ex[k] * dx + face.ey[k] * dy);
    // Not g − length in float: for an edge that ends here and begins far away both are large.
    const int next = (k + 1) % 3;
    local.g_end[k] =
        static_cast<float>(face.ex[k] * (job.x0 - face.x[next]) + face.ey[k] * (job.y0 - face.y[next]));
  }
  local.turn = local.nx[0] * local.ey[0] > local.ny[0] * local.ex[0] ? -1.f : 1.f;
  const Constants& constants = *job.constants;
  const ScreenMesh<double>& mesh = *constants.mesh;
  const auto f = as_size(face.face);
  const auto owner = mesh.texel_face.empty() ? f : as_size(mesh.texel_face[f]);
  local.resolution = mesh.resolution_of(owner);
  local.first_texel = static_cast<int>(mesh.first_texel(owner));
  local.texel_stride =
      constants.vertex_texture ? texel_stride(3) : texel_stride(local.resolution * local.resolution);
  local.texels = constants.texels + constants.texel_starts[owner];
  local.corners = mesh.corner_barycentrics.empty() ? nullptr : &mesh.corner_barycentrics[f];
  return local;
}

/// A face at one block of samples, from the first pass over its blocks (distance and coverage) to the second
/// (depth, colour, sums). In a single pass the dependency chain would exceed the processor's look-ahead.
struct alignas(64) Covered {
  float coverage[kLanes], open[kLanes];  ///< D and 1 − D, each without cancellation; 0 and 1: no fragment
  float b[3][kLanes];                    ///< barycentrics
  float away[2][kLanes];                 ///< VJP: δ (p − q), q the nearest point of the outline
  float share[3][kLanes];                ///< VJP: of each vertex in q
  int first;                             ///< the block's first sample
  bool behind;                           ///< neither its depth nor its colour matters
};

/// Distance and coverage. False if no sample of the block counts.
template <bool kPlain, bool kVjp>
HWY_INLINE bool Cover(const LocalFace& local, const Constants& k, V px, V py, Covered& out) {
  const D d;
  const FaceSetup& face = *local.face;
  V s[3];
  for (int e = 0; e < 3; ++e) {
    s[e] = hn::MulAdd(Set(local.nx[e]), px, hn::MulAdd(Set(local.ny[e]), py, Set(local.c[e])));
    hn::Store(hn::Mul(s[e], Set(face.inv_altitude[(e + 2) % 3])), d, out.b[(e + 2) % 3]);
  }
  const M inside = hn::Ge(hn::Min(s[0], hn::Min(s[1], s[2])), Zero());
  if (!kPlain && k.hard) {
    hn::Store(hn::IfThenElseZero(inside, Set(1)), d, out.coverage);
    hn::Store(hn::IfThenZeroElse(inside, Set(1)), d, out.open);
    return !hn::AllFalse(d, inside);
  }
  V r[3], h[3], q[3];  // see FaceSetup; h: the part of r beyond the edge; q = s² + h²
  for (int e = 0; e < 3; ++e) {
    const V along = hn::MulAdd(Set(local.ex[e]), px, hn::Mul(Set(local.ey[e]), py));
    r[e] = hn::Add(along, Set(local.g[e]));
    h[e] = hn::Max(hn::Add(along, Set(local.g_end[e])), hn::Min(r[e], Zero()));
    q[e] = hn::MulAdd(h[e], h[e], hn::Mul(s[e], s[e]));
  }
  const V d2 = hn::Min(q[0], hn::Min(q[1], q[2]));
  const M keep = hn::Or(inside, hn::Lt(d2, Set(k.cut)));
  const V e = Exp2(hn::Mul(d2, Set(k.distance_scale2)));
  const V large = hn::Div(Set(1), hn::Add(Set(1), e)), small = hn::Mul(e, large);
  hn::Store(hn::IfThenElse(inside, large, hn::IfThenElseZero(keep, small)), d, out.coverage);
  hn::Store(hn::IfThenElse(inside, small, hn::IfThenElse(keep, large, Set(1))), d, out.open);
  if constexpr (kVjp) {
    // d² = |p − q|² with q = (1 − a) v_e + a v_{e+1} on the nearest edge e; a is constant by the envelope
    // theorem, so d d² / d v_e = −2 (1 − a) (p − q), p − q = s n + h e.
    const M first_edge = hn::Eq(q[0], d2), second_edge = hn::Eq(q[1], d2);
    const auto choose = [&](V a, V b, V c) HWY_ATTR {
      return hn::IfThenElse(first_edge, a, hn::IfThenElse(second_edge, b, c));
    };
    const auto choose_constant = [&](const float(&c)[3])
                                     HWY_ATTR { return choose(Set(c[0]), Set(c[1]), Set(c[2])); };
    const V a = Clamp01(hn::Mul(choose(r[0], r[1], r[2]), choose_constant(face.inv_length)));
    const V sign = hn::IfThenElse(inside, Set(-1), Set(1));
    const V across = hn::Mul(sign, choose(s[0], s[1], s[2])), along = hn::Mul(sign, choose(h[0], h[1], h[2]));
    // e is n turned by a right angle, in the direction of the face's winding.
    const V nx = choose_constant(local.nx), ny = choose_constant(local.ny),
            turned = hn::Mul(along, Set(local.turn));
    hn::Store(hn::MulAdd(across, nx, hn::Mul(turned, ny)), d, out.away[0]);
    hn::Store(hn::NegMulAdd(turned, nx, hn::Mul(across, ny)), d, out.away[1]);
    const V rest = hn::Sub(Set(1), a);
    hn::Store(choose(rest, Zero(), a), d, out.share[0]);
    hn::Store(choose(a, rest, Zero()), d, out.share[1]);
    hn::Store(choose(Zero(), a, rest), d, out.share[2]);
  }
  return !hn::AllFalse(d, keep);
}

/// Depth and texture coordinates.
struct Place {
  V b[3], clipped[3];  ///< barycentrics, and clamped to [0, 1] (not normalised)
  V rcp;               ///< 1 / Σ clipped_k (1 + delta_k)
  V phi;               ///< (middle − z) / middle
  V lookup[3];         ///< barycentrics of the texture
};

HWY_INLINE Place PlaceOf(const LocalFace& local, const Covered& at) {
  const FaceSetup& face = *local.face;
  Place p;
  V weighted = Zero(), y[3];
  for (int e = 0; e < 3; ++e) {
    p.b[e] = hn::Load(D(), at.b[e]);
    p.clipped[e] = Clamp01(p.b[e]);
    weighted = hn::MulAdd(p.clipped[e], Set(face.delta[e]), weighted);
    y[e] = hn::Mul(p.clipped[e], Set(1 + face.delta[e]));
  }
  // The sum is at least 1, except for needles whose barycentrics are rounding errors.
  p.rcp = hn::Div(Set(1), hn::Max(hn::Add(y[0], hn::Add(y[1], y[2])), Set(1e-5f)));
  p.phi = hn::Mul(weighted, p.rcp);
  for (int e = 0; e < 3; ++e) p.lookup[e] = hn::Mul(y[e], p.rcp);
  return p;
}

/// Index of the texel at the looked-up barycentrics (TexelAtlas; texel_index is its plain form).
template <bool kPlain>
HWY_INLINE VI TexelIndex(const LocalFace& local, const Place& f) {
  const DI di;
  V b0 = f.lookup[0], b1 = f.lookup[1];
  if (!kPlain && local.corners) {
    V m[2];
    for (int c = 0; c < 2; ++c) {
      m[c] = Zero();
      for (int e = 0; e < 3; ++e)
        m[c] = hn::MulAdd(f.lookup[e], Set(static_cast<float>((*local.corners)[as_size(e)][c])), m[c]);
    }
    b0 = m[0], b1 = m[1];
  }
  // Integers up to 2^23: adding 2^23 puts them into the lowest bits.
  const float resolution = static_cast<float>(local.resolution);
  const V size = Set(resolution), last = Set(resolution - 1);
  const V x = hn::Mul(b0, size), y = hn::Mul(b1, size);
  const V column = hn::Min(hn::Floor(x), last), row = hn::Min(hn::Floor(y), last);
  const V index = hn::MulAdd(row, size, column), excess = hn::Sub(hn::Add(x, y), hn::Add(column, row));
  const float tolerance = 64 * std::numeric_limits<float>::epsilon() * resolution;
  const V texel = hn::IfThenElse(hn::Le(excess, Set(1 + tolerance)), index,
                                 hn::Sub(Set(resolution * resolution - 1), index));
  return hn::And(hn::BitCast(di, hn::Add(texel, Set(8388608))), hn::Set(di, 0x7fffff));
}

struct Color {
  V c[3];
};

HWY_INLINE Color VertexColor(const LocalFace& local, const Place& f) {
  Color color;
  for (int c = 0; c < 3; ++c) {
    color.c[c] = Zero();
    for (int e = 0; e < 3; ++e)
      color.c[c] = hn::MulAdd(f.lookup[e], Set(local.texels[local.texel_stride * c + e]), color.c[c]);
  }
  return color;
}

/// Up to kTableTexels texels a face fit in registers and are looked up there: gathers are several times
/// slower.
HWY_INLINE Color TexelColor(const LocalFace& local, VI index) {
  const D d;
  const DI di;
  Color color;
  if (kLanes >= 8 && local.texel_stride == kTableTexels) {
    const auto lane = hn::IndicesFromVec(d, hn::And(index, hn::Set(di, kLanes - 1)));
    const M upper = hn::RebindMask(d, hn::TestBit(index, hn::Set(di, kTableTexels / 2)));
    for (int c = 0; c < 3; ++c) {
      const float* plane = local.texels + kTableTexels * c;
      V half[2];
      for (int n = 0; n < 2; ++n) {
        const float* start = plane + n * kTableTexels / 2;
        half[n] = hn::TableLookupLanes(hn::LoadU(d, start), lane);
        if constexpr (kLanes == 8) {
          const M odd = hn::RebindMask(d, hn::TestBit(index, hn::Set(di, 8)));
          half[n] = hn::IfThenElse(odd, hn::TableLookupLanes(hn::LoadU(d, start + 8), lane), half[n]);
        }
      }
      color.c[c] = hn::IfThenElse(upper, half[1], half[0]);
    }
    return color;
  }
  for (int c = 0; c < 3; ++c) color.c[c] = hn::GatherIndex(d, local.texels + local.texel_stride * c, index);
  return color;
}

}  // namespace mirage::raster::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif  // guard
