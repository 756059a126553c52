// The C interface of depth completion (scene/depth/depth_abi.h). No exception leaves a function of this file.
#include <algorithm>
#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <stdexcept>
#include <string>

#include "../../c_interface.h"
#include "../../torch_threads.h"
#include "network.h"
#include "weights_file.h"

namespace mirage::guided {

/// Errors leave as std::exception; the C interface turns them into one line.
class GuidedCompletion {
 public:
  /// `threads`: samples of a training step at once; completing one picture uses one. `weights`: a file
  /// written by save(), or nullptr for fresh weights drawn from the seed.
  GuidedCompletion(std::uint64_t seed, int threads, const char* weights);

  void complete(const MirageDepthInput& input, float* dense);
  /// Total, depth and presence loss.
  std::array<float, 3> train_step(std::span<const MirageDepthSample> samples, float learning_rate);
  /// Without the optimiser, weights are kept in half precision.
  void save(const std::string& file, bool with_optimiser);

 private:
  void load(const std::string& file);

  int threads_;
  Network network_{nullptr};
  torch::optim::AdamW optimiser_;
};

namespace {

using torch::Tensor;

constexpr const char* kFormat = "mirage guided depth completion 2";
constexpr double kWeightDecay = 1e-3, kMaxGradient = 2.0;
constexpr float kMaxDistance = 200;  // m; the network's depth is bounded by its formula, this guards the file

constexpr double kSpanMargin = 0.02;

void check_shape(const MirageDepthInput& input) {
  if (!input.image || !input.sparse || input.width < 1 || input.height < 1)
    throw std::runtime_error("no picture or no sparse depth; give both, of the same size");
}

Network make_network(std::uint64_t seed) {
  torch::manual_seed(seed);
  return Network();
}

using Functions = CFunctions<GuidedCompletion>;

void* create(const char* options_json, const char* weights, char* error, size_t error_size) {
  return Functions::made(error, error_size, [&] {
    const auto json = nlohmann::json::parse(options_json ? options_json : "{}");
    return std::make_unique<GuidedCompletion>(json.value("seed", std::uint64_t{0}), json.value("threads", 1),
                                              weights);
  });
}

int complete(void* completion, const MirageDepthInput* input, float* dense, char* error, size_t error_size) {
  return guarded(error, error_size, [&] { Functions::of(completion).complete(*input, dense); });
}

const MirageDepthApi kApi = {MIRAGE_DEPTH_ABI,      "guided",       create, Functions::destroy, complete,
                             Functions::train_step, Functions::save};

}  // namespace

GuidedCompletion::GuidedCompletion(std::uint64_t seed, int threads, const char* weights)
    : threads_(threads),
      network_(make_network(seed)),
      optimiser_(network_->parameters(),
                 torch::optim::AdamWOptions(1e-3).betas({0.9, 0.99}).weight_decay(kWeightDecay)) {
  if (weights) load(weights);
}

void GuidedCompletion::complete(const MirageDepthInput& input, float* dense) {
  check_shape(input);
  set_torch_threads(1);
  torch::InferenceMode mode;
  const Features features = make_features(input);
  const Prediction prediction = network_->forward(features);
  // Between two close returns, depth lies within the span of these and IP-Basic: there the network only
  // chooses. This keeps pictures unlike the training's from overriding measured depth.
  const Tensor& inverse = features.candidates;
  const Tensor nearest = (1 - kSpanMargin) / inverse.amax(0).clamp_min(1e-6);
  const Tensor farthest = (1 + kSpanMargin) / torch::where(inverse > 0, inverse, 1e6).amin(0).clamp_min(1e-6);
  const Tensor within = torch::minimum(torch::maximum(prediction.depth, nearest), farthest);
  const Tensor depth = torch::where(features.enclosed, within, prediction.depth).contiguous();
  const Tensor present = torch::logical_or(prediction.presence > 0, features.enclosed).contiguous();
  const float* z = depth.data_ptr<float>();
  const bool* here = present.data_ptr<bool>();
  for (std::int64_t i = 0; i < depth.numel(); ++i) dense[i] = here[i] ? std::min(z[i], kMaxDistance) : 0;
}

std::array<float, 3> GuidedCompletion::train_step(std::span<const MirageDepthSample> samples,
                                                  float learning_rate) {
  if (samples.empty()) throw std::runtime_error("train_step got no samples; give at least one");
  for (const MirageDepthSample& sample : samples) check_shape(sample.input);
  const std::vector<Tensor> parameters = network_->parameters();
  std::vector<SampleResult> results(samples.size());
  for_each_sample(samples.size(), threads_, [&](std::size_t i) {
    const MirageDepthInput& input = samples[i].input;
    const Tensor truth = torch::empty({input.height, input.width});
    std::copy_n(samples[i].truth, truth.numel(), truth.data_ptr<float>());
    const Features features = make_features(input);
    const LossTerms terms = completion_loss(network_->forward(features), features, truth);
    results[i].loss = {terms.total.item<float>(), static_cast<float>(terms.depth),
                       static_cast<float>(terms.presence)};
    results[i].gradients = torch::autograd::grad({terms.total}, parameters);
  });
  return take_step(optimiser_, parameters, results, static_cast<float>(samples.size()), kMaxGradient,
                   learning_rate);
}

void GuidedCompletion::save(const std::string& file, bool with_optimiser) {
  WeightsWriter writer;
  writer.state("format", kFormat);
  for (const auto& parameter : network_->named_parameters())
    writer.add(parameter.key(), parameter.value().to(with_optimiser ? torch::kFloat : torch::kHalf));
  if (with_optimiser) add_state(writer, optimiser_);
  writer.write(file);
}

void GuidedCompletion::load(const std::string& file) {
  const WeightsFile weights(file);
  if (weights.fact("format") != kFormat)
    throw std::runtime_error("weights of another program or version; train anew with mirage train depth");
  const torch::NoGradGuard guard;
  for (auto& parameter : network_->named_parameters())
    parameter.value().copy_(weights.tensor(parameter.key(), parameter.value().sizes()));
  read_state(weights, optimiser_);
}

}  // namespace mirage::guided

extern "C" __attribute__((visibility("default"))) const MirageDepthApi* mirage_depth_api(void) {
  return &mirage::guided::kApi;
}
