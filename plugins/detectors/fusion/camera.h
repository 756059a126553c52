// The camera network: vehicles in the photograph alone, at its full size.
//
// YOLOX-nano (Ge et al., "YOLOX: Exceeding YOLO Series in 2021", arXiv 2107.08430): a CSPDarknet of depthwise
// convolutions, a path-aggregation neck and decoupled heads at strides 8, 16 and 32, one class; its norms are
// folded into the convolutions, so that every layer is local and affine between its activations. Beside it
// Mirage's own head gives the logit of "shows a vehicle" for every place of 4 × 4 pixels: painted and
// continuous fusion read it. The network may start from COCO's weights (read_coco).
#pragma once

#include <torch/torch.h>

#include <array>
#include <string>
#include <vector>

namespace mirage::fusion {

inline constexpr int kMaskStride = 4, kFeatureStride = 8;  // pixels a side of a place
inline constexpr std::int64_t kCameraFeatures = 64;        // channels of CameraOutput::features

/// Convolution with bias and SiLU. Padding keeps the size at stride 1.
struct ConvSiluImpl : torch::nn::Module {
  ConvSiluImpl(int in, int out, int kernel, int stride = 1, int groups = 1);
  torch::Tensor forward(const torch::Tensor& x);
  torch::nn::Conv2d conv{nullptr};
};
TORCH_MODULE(ConvSilu);

/// 3 × 3 convolution of each channel, then 1 × 1 across them.
struct DepthwiseImpl : torch::nn::Module {
  DepthwiseImpl(int in, int out, int stride = 1);
  torch::Tensor forward(const torch::Tensor& x);
  ConvSilu each{nullptr}, across{nullptr};
};
TORCH_MODULE(Depthwise);

/// Cross-stage partial block: half of the channels through `depth` bottlenecks, half past them.
struct CspImpl : torch::nn::Module {
  CspImpl(int in, int out, int depth, bool shortcut);
  torch::Tensor forward(const torch::Tensor& x);
  ConvSilu through{nullptr}, past{nullptr}, join{nullptr};
  std::vector<ConvSilu> narrow;
  std::vector<Depthwise> wide;
  bool shortcut_;
};
TORCH_MODULE(Csp);

/// Class, box and objectness of one scale.
struct PictureHeadImpl : torch::nn::Module {
  explicit PictureHeadImpl(int in);
  /// 1 × 6 × h × w: dx, dy, log w, log h (in strides), objectness, class.
  torch::Tensor forward(const torch::Tensor& x);
  ConvSilu stem{nullptr};
  Depthwise class1{nullptr}, class2{nullptr}, box1{nullptr}, box2{nullptr};
  torch::nn::Conv2d class_out{nullptr}, box_out{nullptr}, object_out{nullptr};
};
TORCH_MODULE(PictureHead);

/// The network's output for a picture of H × W pixels.
struct CameraOutput {
  torch::Tensor features;  ///< 1 × 64 × ⌈H/8⌉ × ⌈W/8⌉ (up to the next multiple of 32 pixels)
  torch::Tensor mask;      ///< 1 × 1 at stride 4: logit of "shows a vehicle"
  torch::Tensor boxes;     ///< N × 4: left, top, right, bottom, pixels (centre of the first pixel at 0, 0)
  torch::Tensor logits;    ///< N: score = sigmoid = objectness × class probability (boxes, logits: if asked)
  bool defined() const { return mask.defined(); }
};

/// The source of a row of CameraOutput::boxes: the centre of its place (pixels) and its stride.
struct Place {
  float x, y, stride;
};
/// Of a picture of that size, in the order of CameraOutput::boxes.
std::vector<Place> places_of(std::int64_t height, std::int64_t width);

/// `size` up to the next multiple of 32, to which pictures are padded.
std::int64_t padded_size(std::int64_t size);
/// linear: h × w × 3. 1 × 3 × rows × columns, BGR of 0 to 255 as 8-bit pictures hold them, with grey to the
/// right and below. Differentiable.
torch::Tensor network_picture(const torch::Tensor& linear, std::int64_t rows, std::int64_t columns);
/// Every place doubled along both axes.
torch::Tensor twice(const torch::Tensor& x);
/// The four pixels of each 2 × 2 block as channels.
torch::Tensor focus(const torch::Tensor& x);
/// Boxes and logits from the heads' rows (N × 6, in the order of places_of) into `output`.
void decode_rows(const torch::Tensor& rows, std::int64_t height, std::int64_t width, CameraOutput& output);

/// Maxima of 5, 9 and 13 places a side: each from the previous one, with a fourth of the comparisons.
inline constexpr int kPoolings = 3, kPooledSide = 5;

struct CameraNetImpl : torch::nn::Module {
  CameraNetImpl();
  /// picture: H × W × 3, scene-linear RGB. Differentiable in it. Without `with_boxes` features and mask
  /// alone, which need neither the bottom-up path nor the heads.
  CameraOutput forward(const torch::Tensor& picture, bool with_boxes = true);

  ConvSilu stem{nullptr};
  Depthwise down4{nullptr}, down8{nullptr}, down16{nullptr}, down32{nullptr};
  Csp group4{nullptr}, group8{nullptr}, group16{nullptr}, group32{nullptr};
  ConvSilu pool_in{nullptr}, pool_out{nullptr};
  ConvSilu lateral16{nullptr}, lateral8{nullptr};
  Csp top16{nullptr}, top8{nullptr}, bottom16{nullptr}, bottom32{nullptr};
  Depthwise up16{nullptr}, up32{nullptr};
  std::array<PictureHead, 3> heads{nullptr, nullptr, nullptr};
  ConvSilu mask_fine{nullptr}, mask_coarse{nullptr}, mask_join{nullptr};
  torch::nn::Conv2d mask_out{nullptr};
};
TORCH_MODULE(CameraNet);

/// The logit of σ(a) σ(b), without overflow at any a and b: −log(e^−a + e^−b + e^(−a−b)).
torch::Tensor logit_of_product(const torch::Tensor& a, const torch::Tensor& b);

/// Copies the weights of a TorchScript YOLOX-nano trained on COCO (BGR, 0–255, norms folded) into `network`,
/// its class "car" for ours; the mask head stays. std::runtime_error if the file is not such a network.
void read_coco(CameraNetImpl& network, const std::string& file);

}  // namespace mirage::fusion
