#include "features.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "scene/depth_completion.h"

namespace mirage::guided {
namespace {

namespace fn = torch::nn::functional;

constexpr int kReach = 2;              // columns that a return fills to its sides
constexpr float kNearest = 0.5f;       // m; bounds the inverse depth
constexpr float kHalfDistance = 8;     // pixels at which a distance reads 1/2; beams lie about 5 apart
constexpr float kEnclosed = 12;        // pixels
constexpr float kMeanLogDepth = 2.8f;  // about 16 m
constexpr float kToneMean = 0.45f, kToneSpread = 0.28f;

/// Inverse depth of the returns, each widened over gaps at its sides: the nearest column wins, then the
/// nearest depth.
std::vector<float> widened(const MirageDepthInput& input) {
  const int w = input.width, h = input.height;
  std::vector<float> wide(static_cast<std::size_t>(w) * h);
  for (int v = 0; v < h; ++v) {
    const float* row = input.sparse + static_cast<std::size_t>(v) * w;
    for (int u = 0; u < w; ++u)
      for (int reach = 0; reach <= kReach; ++reach) {
        const float left = u >= reach ? row[u - reach] : 0, right = u + reach < w ? row[u + reach] : 0;
        const float depth = left > 0 && right > 0 ? std::min(left, right) : std::max(left, right);
        if (!(depth > 0)) continue;
        wide[static_cast<std::size_t>(v) * w + u] = 1 / std::max(depth, kNearest);
        break;
      }
  }
  return wide;
}

/// Carries each return along the columns, downwards (first row to last) or upwards.
void carry(const std::vector<float>& wide, int width, int height, bool downwards, float* inverse,
           float* distance) {
  std::vector<float> value(static_cast<std::size_t>(width)), away(static_cast<std::size_t>(width), 1e9f);
  for (int i = 0; i < height; ++i) {
    const std::size_t row = static_cast<std::size_t>(downwards ? i : height - 1 - i) * width;
    for (int u = 0; u < width; ++u) {
      const float here = wide[row + u];
      value[u] = here > 0 ? here : value[u];
      away[u] = here > 0 ? 0 : away[u] + 1;
      inverse[row + u] = value[u];
      distance[row + u] = away[u] / (away[u] + kHalfDistance);
    }
  }
}

}  // namespace

Features make_features(const MirageDepthInput& input) {
  const int w = input.width, h = input.height;
  const auto area = static_cast<std::size_t>(w) * h;
  Features features;
  features.candidates = torch::zeros({kCandidates, h, w});
  torch::Tensor values = torch::empty({kFeatures, h, w});
  float* out = values.data_ptr<float>();
  for (std::size_t i = 0; i < area; ++i)
    for (int c = 0; c < 3; ++c)  // a square root spreads the shadows much as sRGB does
      out[c * area + i] = (std::sqrt(std::clamp(input.image[3 * i + c], 0.f, 4.f)) - kToneMean) / kToneSpread;

  float* inverse = features.candidates.data_ptr<float>();
  float* distance = out + (3 + kCandidates) * area;
  const std::vector<float> wide = widened(input);
  carry(wide, w, h, true, inverse + kAbove * area, distance + kAbove * area);
  carry(wide, w, h, false, inverse + kBelow * area, distance + kBelow * area);
  const torch::Tensor far = values.narrow(0, 3 + kCandidates, 2).amax(0);
  features.enclosed = far <= kEnclosed / (kEnclosed + kHalfDistance);
  ImageF sparse(w, h, 1);
  std::copy_n(input.sparse, area, sparse.data.begin());
  const ImageF prior = complete_depth(sparse);
  for (std::size_t i = 0; i < area; ++i) {
    const bool known = prior.data[i] < kFarDepth;
    inverse[kPrior * area + i] = known ? 1 / std::max(prior.data[i], kNearest) : 0;
    distance[kPrior * area + i] = known ? 0.f : 1.f;
  }
  const torch::Tensor q = features.candidates;
  values.narrow(0, 3, kCandidates)
      .copy_(torch::where(q > 0, -torch::log(q.clamp_min(1e-6)) - kMeanLogDepth, 0.0));
  const auto padding = [](int side) { return (kStride - side % kStride) % kStride; };
  features.values =
      fn::pad(values.unsqueeze(0), fn::PadFuncOptions({0, padding(w), 0, padding(h)}).mode(torch::kReplicate))
          .contiguous(at::MemoryFormat::ChannelsLast);
  return features;
}

}  // namespace mirage::guided
