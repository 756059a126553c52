// The network: LiDAR voxels and image features, joined by continuous fusion, to one proposal a cell.
// After Liang et al., "Deep Continuous Fusion" (ECCV 2018) and "Multi-Task Multi-Sensor Fusion" (CVPR 2019),
// made small enough to train on two cores. Nothing between input and logit stops a gradient: the feature of a
// cell also moves with the pixel that its point projects to.
#pragma once

#include "nearest.h"
#include "torch_headers.h"

namespace mirage::fusion {

/// Channels of the output, one proposal a cell.
enum Output { kLogit, kDx, kDy, kLogLength, kLogWidth, kSin2Yaw, kCos2Yaw, kOutputs };

struct SensorTensors {
  torch::Tensor image;   ///< H × W × 3 scene-linear, or undefined: LiDAR alone
  torch::Tensor points;  ///< N × 4
  Projection projection{};
};

/// Convolution (no bias), group norm, optional ReLU.
struct ConvNormImpl : torch::nn::Module {
  ConvNormImpl(int in, int out, int kernel, int stride, bool relu = true);
  torch::Tensor forward(const torch::Tensor& x);
  torch::nn::Conv2d conv{nullptr};
  torch::nn::GroupNorm norm{nullptr};
  bool relu_;
};
TORCH_MODULE(ConvNorm);

/// Two convolutions and a skip (He et al., CVPR 2016).
struct ResidualImpl : torch::nn::Module {
  explicit ResidualImpl(int channels);
  torch::Tensor forward(const torch::Tensor& x);
  ConvNorm first{nullptr}, second{nullptr};
};
TORCH_MODULE(Residual);

/// Half-size picture to 32 features at an eighth of the full size.
struct ImageBranchImpl : torch::nn::Module {
  ImageBranchImpl();
  torch::Tensor forward(const torch::Tensor& image);
  ConvNorm stem{nullptr}, down4{nullptr}, down8{nullptr}, lateral4{nullptr}, lateral8{nullptr},
      smooth{nullptr};
  Residual block2{nullptr}, block4{nullptr}, block8{nullptr};
};
TORCH_MODULE(ImageBranch);

/// Image features at the projections of the nearest points, with the offset from cell to point, through an
/// MLP.
struct ContinuousFusionImpl : torch::nn::Module {
  ContinuousFusionImpl(int out, std::int64_t rows, std::int64_t columns, double cell);
  /// 1 × out × rows × columns, zero where no point is near; undefined when no cell has one.
  torch::Tensor forward(const torch::Tensor& features, const SensorTensors& input);
  torch::nn::Linear hidden{nullptr}, hidden2{nullptr}, last{nullptr};
  int out_;
  std::int64_t rows_, columns_;
  double cell_;
};
TORCH_MODULE(ContinuousFusion);

struct NetworkImpl : torch::nn::Module {
  explicit NetworkImpl(bool with_image);
  /// kOutputs × 128 × 128.
  torch::Tensor forward(const SensorTensors& input);

  ImageBranch image{nullptr};
  ContinuousFusion fuse_fine{nullptr}, fuse_coarse{nullptr};
  ConvNorm stem{nullptr}, down2{nullptr}, down4{nullptr};
  Residual block1{nullptr}, block2a{nullptr}, block2b{nullptr}, block4a{nullptr}, block4b{nullptr};
  ConvNorm lateral1{nullptr}, lateral2{nullptr}, lateral4{nullptr}, reduce{nullptr}, smooth{nullptr};
  torch::nn::Conv2d head{nullptr};
};
TORCH_MODULE(Network);

}  // namespace mirage::fusion
