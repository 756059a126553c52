// Vectors of samples, and arithmetic that the library lacks or does more slowly.
// Compiled once for each instruction set (hence the guard that toggles).
#if defined(MIRAGE_SENSORS_RASTER_VECTOR_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef MIRAGE_SENSORS_RASTER_VECTOR_INL_H_
#undef MIRAGE_SENSORS_RASTER_VECTOR_INL_H_
#else
#define MIRAGE_SENSORS_RASTER_VECTOR_INL_H_
#endif

HWY_BEFORE_NAMESPACE();
namespace mirage::raster::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<float, 16>;
using DI = hn::RebindToSigned<D>;
using V = hn::Vec<D>;
using VI = hn::Vec<DI>;
using M = hn::Mask<D>;

inline constexpr int kLanes = static_cast<int>(HWY_LANES(float) < 16 ? HWY_LANES(float) : 16);
inline constexpr int kBlockWidth = kLanes < 4 ? kLanes : 4;
inline constexpr int kBlockHeight = kLanes / kBlockWidth;
inline constexpr int kBlockColumns = kTile / kBlockWidth;

// A face further behind a sample's fragments than kMaxDepthExponent changes its colour by a share below
// e^-18.4 / 0.1 = 1e-7 and, if Π(1 − D) is below kClosed, its S by less than that. A face further behind than
// kMaxWeightedExponent has less weight than kNoWeight.
inline constexpr float kEnough = 0.1f, kMaxDepthExponent = 18.4f, kMaxWeightedExponent = 16.1f,
                       kClosed = 1e-8f;
inline constexpr float kNoKey = -1e30f, kLog2E = 1.44269504f;
// Fragments of less weight give no gradient through colour and depth.
inline constexpr float kNoWeight = 1e-6f;
// Logarithm of the least weight of a background that competes with plain faces.
inline constexpr float kFaintest = -75;

HWY_INLINE V Zero() {
  return hn::Zero(D());
}
HWY_INLINE V Set(float x) {
  return hn::Set(D(), x);
}

inline constexpr float kExp2[6] = {
    1, 6.931469776e-1f, 2.402224209e-1f, 5.550733744e-2f, 9.671512654e-3f, 1.326472711e-3f};

/// 2^x for x ≤ 0, relative error 2e-7 (below 2^-125: 2^-125). Cheaper than a general exponential; its two
/// calls a fragment are a fifth of the work.
HWY_INLINE V Exp2(V x) {
  const D d;
  const DI di;
  // Adding 1.5 · 2^23 rounds to an integer in the lowest bits.
  const V shifted = hn::Add(hn::Max(x, Set(-125)), Set(12582912));
  const V f = hn::Sub(hn::Max(x, Set(-125)), hn::Sub(shifted, Set(12582912)));
  // Minimax on [-1/2, 1/2] with 2^0 = 1.
  const V low = hn::MulAdd(f, Set(kExp2[1]), Set(1)), middle = hn::MulAdd(f, Set(kExp2[3]), Set(kExp2[2])),
          high = hn::MulAdd(f, Set(kExp2[5]), Set(kExp2[4])), f2 = hn::Mul(f, f);
  const V p = hn::MulAdd(f2, hn::MulAdd(f2, high, middle), low);
  const VI exponent = hn::ShiftLeft<23>(hn::BitCast(di, shifted));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), exponent));
}

HWY_INLINE V Clamp01(V x) {
  return hn::Min(hn::Max(x, Zero()), Set(1));
}

}  // namespace mirage::raster::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif  // guard
