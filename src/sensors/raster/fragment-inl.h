// What one face does at one block of samples: coverage, depth, place in the texture, colour.
// Compiled once for each instruction set (hence the guard that toggles).
#if defined(MIRAGE_SENSORS_RASTER_FRAGMENT_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef MIRAGE_SENSORS_RASTER_FRAGMENT_INL_H_
#undef MIRAGE_SENSORS_RASTER_FRAGMENT_INL_H_
#else
#define MIRAGE_SENSORS_RASTER_FRAGMENT_INL_H_
#endif

#include "sensors/raster/vector-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mirage::raster::HWY_NAMESPACE {

/// A face's constants relative to its tile.
struct LocalFace {
  float nx[3], ny[3], c[3];            ///< s = nx x + ny y + c
  float ex[3], ey[3], g[3], g_end[3];  ///< r = ex x + ey y + g; g_end: from the edge's end
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
  const Constants& constants = *job.constants;
  const ScreenMesh<double>& mesh = *constants.mesh;
  const auto f = static_cast<std::size_t>(face.face);
  const auto owner = mesh.texel_face.empty() ? f : static_cast<std::size_t>(mesh.texel_face[f]);
  local.resolution = mesh.resolution_of(owner);
  local.first_texel = static_cast<int>(mesh.first_texel(owner));
  local.texel_stride =
      constants.vertex_texture ? texel_stride(3) : texel_stride(local.resolution * local.resolution);
  local.texels = constants.texels + constants.texel_starts[owner];
  local.corners = mesh.corner_barycentrics.empty() ? nullptr : &mesh.corner_barycentrics[f];
  return local;
}

/// What one face does at the samples of one block.
struct Fragment {
  V s[3], r[3], h[3], q[3];  ///< see FaceSetup; h: the part of r beyond the edge; q = s² + h²
  V b[3], clipped[3];        ///< barycentrics, and clamped to [0, 1] (not normalised)
  V d2;                      ///< squared distance
  V coverage, open;          ///< D and 1 − D, each without cancellation
  V rcp;                     ///< 1 / Σ clipped_k (1 + delta_k)
  V phi, key;                ///< (middle − z) / middle, (middle − z) / (far − near)
  V lookup[3];               ///< barycentrics of the texture
  M keep, inside, colored;
};

/// Distance and coverage. False where no sample of the block counts.
template <bool kPlain>
HWY_INLINE bool Cover(const LocalFace& local, const Constants& k, V px, V py, Fragment& f) {
  const D d;
  const FaceSetup& face = *local.face;
  for (int e = 0; e < 3; ++e)
    f.s[e] = hn::MulAdd(Set(local.nx[e]), px, hn::MulAdd(Set(local.ny[e]), py, Set(local.c[e])));
  f.inside = hn::Ge(hn::Min(f.s[0], hn::Min(f.s[1], f.s[2])), Zero());
  for (int e = 0; e < 3; ++e) f.b[e] = hn::Mul(f.s[(e + 1) % 3], Set(face.inv_altitude[e]));
  if (kPlain || !k.hard) {
    for (int e = 0; e < 3; ++e) {
      const V along = hn::MulAdd(Set(local.ex[e]), px, hn::Mul(Set(local.ey[e]), py));
      f.r[e] = hn::Add(along, Set(local.g[e]));
      f.h[e] = hn::Max(hn::Add(along, Set(local.g_end[e])), hn::Min(f.r[e], Zero()));
      f.q[e] = hn::MulAdd(f.h[e], f.h[e], hn::Mul(f.s[e], f.s[e]));
    }
    f.d2 = hn::Min(f.q[0], hn::Min(f.q[1], f.q[2]));
    f.keep = hn::Or(f.inside, hn::Lt(f.d2, Set(k.cut)));
  } else {
    f.d2 = Zero();
    f.keep = f.inside;
  }
  if (hn::AllFalse(d, f.keep)) return false;

  if (kPlain || !k.hard) {
    const V e = Exp2(hn::Mul(f.d2, Set(-k.distance_scale * kLog2E)));
    const V large = Reciprocal(hn::Add(Set(1), e)), small = hn::Mul(e, large);
    f.coverage = hn::IfThenElse(f.inside, large, small);
    f.open = hn::IfThenElse(f.inside, small, large);
  } else {
    f.coverage = Set(1);
    f.open = Zero();
  }
  return true;
}

/// Depth and place in the texture.
HWY_INLINE void Place(const LocalFace& local, const Constants& k, Fragment& f) {
  const FaceSetup& face = *local.face;
  V weighted = Zero(), y[3];
  for (int e = 0; e < 3; ++e) {
    f.clipped[e] = Clamp01(f.b[e]);
    weighted = hn::MulAdd(f.clipped[e], Set(face.delta[e]), weighted);
    y[e] = hn::Mul(f.clipped[e], Set(1 + face.delta[e]));
  }
  // The sum is 1 at least, but for needles whose barycentrics are all rounding.
  f.rcp = Reciprocal(hn::Max(hn::Add(y[0], hn::Add(y[1], y[2])), Set(1e-5f)));
  f.phi = hn::Mul(weighted, f.rcp);
  f.key = hn::Mul(f.phi, Set(k.key_scale));
  for (int e = 0; e < 3; ++e) f.lookup[e] = hn::Mul(y[e], f.rcp);
  f.colored = hn::And(f.keep, hn::And(hn::Ge(f.key, Set(k.key_low)), hn::Le(f.key, Set(k.key_high))));
}

/// In place of Place, where neither depth nor colour matters.
HWY_INLINE void PlaceNowhere(Fragment& f) {
  f.rcp = f.phi = f.key = Zero();
  for (int e = 0; e < 3; ++e) f.clipped[e] = f.lookup[e] = Zero();
  f.colored = hn::Lt(Zero(), Zero());
}

/// Index of the texel at the looked-up barycentrics (TexelAtlas; texel_index is its plain form).
template <bool kPlain>
HWY_INLINE VI TexelIndex(const LocalFace& local, const Fragment& f) {
  const D d;
  const DI di;
  V b0 = f.lookup[0], b1 = f.lookup[1];
  if (!kPlain && local.corners) {
    V m[2];
    for (int c = 0; c < 2; ++c) {
      m[c] = Zero();
      for (int e = 0; e < 3; ++e)
        m[c] = hn::MulAdd(f.lookup[e], Set(static_cast<float>((*local.corners)[e][c])), m[c]);
    }
    b0 = m[0], b1 = m[1];
  }
  const int resolution = local.resolution;
  const V size = Set(static_cast<float>(resolution));
  const V x = hn::Mul(b0, size), y = hn::Mul(b1, size);
  const VI last = hn::Set(di, resolution - 1), zero = hn::Zero(di);
  const VI ix = hn::Min(hn::Max(hn::ConvertTo(di, x), zero), last);
  const VI iy = hn::Min(hn::Max(hn::ConvertTo(di, y), zero), last);
  const VI index = hn::Add(hn::Mul(iy, hn::Set(di, resolution)), ix);
  const V excess = hn::Sub(hn::Add(x, y), hn::ConvertTo(d, hn::Add(ix, iy)));
  const float tolerance = 64 * std::numeric_limits<float>::epsilon() * static_cast<float>(resolution);
  const M lower = hn::Le(excess, Set(1 + tolerance));
  const VI mirrored = hn::Sub(hn::Set(di, resolution * resolution - 1), index);
  return hn::IfThenElse(hn::RebindMask(di, lower), index, mirrored);
}

struct Color {
  V c[3];
};

HWY_INLINE Color VertexColor(const LocalFace& local, const Fragment& f) {
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
