// Normalisation that is affine at inference: batch norm whose statistics are frozen.
//
// In the first part of a training each sample is normalised by its own statistics (batch norm of one sample),
// which are followed by a running mean; in the last part, and at inference, by that mean, which makes the
// layer a gain and a bias that fold into the convolution before it (Ioffe & Szegedy, ICML 2015, section 3.1;
// freezing them before the end as He et al. do when fine-tuning removes the difference between the two).
#pragma once

#include <torch/torch.h>

#include <vector>

#include "joins.h"
#include "second_stage.h"
#include "sensor_tensors.h"

namespace mirage::fusion {

struct ChannelNormImpl : torch::nn::Module {
  explicit ChannelNormImpl(int channels);
  /// Gain and bias of the frozen layer: y = gain · x + shift.
  torch::Tensor gain() const;
  torch::Tensor shift() const;
  torch::Tensor weight, bias;    ///< parameters
  torch::Tensor mean, variance;  ///< buffers
};
TORCH_MODULE(ChannelNorm);

/// While one lives, norms on this thread use the sample's statistics, which it collects. One a thread at
/// most.
class SampleStatistics {
 public:
  SampleStatistics();
  SampleStatistics(const SampleStatistics&) = delete;
  SampleStatistics& operator=(const SampleStatistics&) = delete;
  ~SampleStatistics();
  /// Of this thread; nullptr if norms are frozen.
  static SampleStatistics* current();

  struct Seen {
    ChannelNormImpl* norm;
    torch::Tensor mean, variance;
  };
  std::vector<Seen> seen;
};

/// Moves the running means towards a sample's statistics, the `samples`-th of the training: the plain mean of
/// the first fifty, a mean that forgets from then on.
void follow(const std::vector<SampleStatistics::Seen>& seen, std::int64_t samples);

// The network: LiDAR voxels and image features, joined by continuous fusion, to one proposal a cell.
// After Liang et al., "Deep Continuous Fusion" (ECCV 2018) and "Multi-Task Multi-Sensor Fusion" (CVPR 2019),
// made small enough to train on two cores. Nothing between input and logit stops a gradient: the feature of a
// cell also moves with the pixel that its point projects to.
//
// Six detectors are made of five parts (Parts): the LiDAR's backbone over the bird's-eye view, the camera
// network (camera.h), one of three ways to join them: evidence painted on returns (joins.h), continuous
// fusion of features, proposals joined with boxes (joins.h), and a second look at the best proposals
// (second_stage.h).

/// Convolution (no bias), batch norm with frozen statistics (network.h: local, and folded into the
/// convolution), optional ReLU. Output i of stride 2 is centred on the two cells that it replaces (kernels of
/// 2 and of 4 with padding 1), so that grids of all strides share their edges.
struct ConvNormImpl : torch::nn::Module {
  ConvNormImpl(int in, int out, int kernel, int stride, bool relu = true);
  torch::Tensor forward(const torch::Tensor& x);
  torch::nn::Conv2d conv{nullptr};
  ChannelNorm channel_norm{nullptr};
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

/// The parts that a network may have.
struct Parts {
  bool image = true;        ///< continuous fusion of the camera network's features
  bool denoising = false;   ///< non-local means on the image features that fusion reads
  bool depth_gate = false;  ///< fusion weighs image features by agreement in depth (joins.h)
  bool camera = true;       ///< the camera network
  bool lidar = true;        ///< the backbone; without it the camera network finds boxes in the picture
  bool painted = false;     ///< the camera network's mask painted on the returns
  bool late = false;        ///< proposals joined with the camera network's boxes
  bool second = false;      ///< proposals looked at again in their regions; needs `image`
};

/// Feature denoising by a non-local mean (Xie et al., CVPR 2019) in its dot-product form: each place takes
/// the mean of all places, weighed by the inner product of features, through a 1 × 1 convolution, and is
/// added to it. Linear in the number of places. Effective from the start: with an initial gain of zero, a
/// training of hundreds of steps left it there (0.4 % of the features), and nothing was denoised.
struct NonLocalMeanImpl : torch::nn::Module {
  explicit NonLocalMeanImpl(int channels);
  torch::Tensor forward(const torch::Tensor& x);
  torch::nn::Conv2d project{nullptr};
  torch::nn::GroupNorm norm{nullptr};
};
TORCH_MODULE(NonLocalMean);

/// The image feature read at a cell's point, with the offset from cell to point, through an MLP of three
/// layers.
struct ContinuousFusionImpl : torch::nn::Module {
  ContinuousFusionImpl(int features, int out);
  /// read: n × features, offset: n × 3 (m), for the n `cells` of the grid. 1 × out × rows × columns, zero
  /// elsewhere.
  torch::Tensor forward(const torch::Tensor& read, const torch::Tensor& offset, const torch::Tensor& cells,
                        const Grid& grid);
  torch::Tensor rows(const torch::Tensor& read, const torch::Tensor& offset);  ///< the MLP: n × out
  torch::nn::Linear hidden{nullptr}, hidden2{nullptr}, last{nullptr};
  int out_;
};
TORCH_MODULE(ContinuousFusion);

/// Image features where fusion reads them: one row for each cell that has a point, of all scales in turn.
struct ReadFeatures {
  torch::Tensor map;     ///< 1 × features × H/8 × W/8
  torch::Tensor points;  ///< n × 3, the cells' points
  torch::Tensor read;    ///< n × features, gated where the network has a gate
  std::array<NearestPoints, kGrids.size()> nearest;
};

struct NetworkImpl : torch::nn::Module {
  explicit NetworkImpl(const Parts& parts);
  /// kOutputs × 140 × 160, on the CPU. Needs the backbone. Without a picture every join leaves the backbone's
  /// proposals as they are, and so does the second stage.
  torch::Tensor forward(const SensorTensors& input);
  /// The same before proposals are joined or looked at again; its picture and mask are those of a network
  /// with a second stage.
  FirstStage first_stage(const SensorTensors& input);
  /// The camera network's output for input.image; undefined without a picture or that network. With boxes if
  /// asked for, or if the network joins them.
  CameraOutput see(const SensorTensors& input, bool with_boxes = false);
  /// The map that continuous fusion reads: 1 × (kCameraFeatures + 1) × H/8 × W/8.
  torch::Tensor read_map(const CameraOutput& seen);
  /// Undefined tensors where no point of the sweep is in the picture.
  ReadFeatures read_image(const SensorTensors& input);
  /// The picture's term at each scale of the backbone; undefined where it adds nothing.
  std::array<torch::Tensor, kGrids.size()> fused(const SensorTensors& input);

  CameraNet camera{nullptr};
  NonLocalMean denoise{nullptr};  ///< of the camera network's features
  LateJoin join{nullptr};
  SecondStage second{nullptr};
  std::array<ContinuousFusion, kGrids.size()> fuse{nullptr, nullptr, nullptr, nullptr};
  // The number is the stride in proposal cells: 0.5, 1, 2 and 4 m.
  ConvNorm stem{nullptr}, down2{nullptr}, down4{nullptr}, down8{nullptr};
  Residual group1{nullptr}, group2a{nullptr}, group2b{nullptr}, group4a{nullptr}, group4b{nullptr},
      group8{nullptr};
  ConvNorm lateral1{nullptr}, lateral2{nullptr}, lateral4{nullptr}, lateral8{nullptr}, reduce{nullptr},
      smooth{nullptr};
  torch::nn::Conv2d head{nullptr};
  Parts parts;
};
TORCH_MODULE(Network);

/// The picture and the points in the type of the network's weights (float, or double in tests of the float
/// passes).
SensorTensors in_type_of(NetworkImpl& network, SensorTensors input);

}  // namespace mirage::fusion
