#include "weights.h"

#include <algorithm>
#include <iterator>
#include <sstream>
#include <stdexcept>

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr const char* kFormat = "mirage fusion detector 3";
constexpr const char *kDenoising = "denoising", *kDepthGate = "depth-gate";

/// The file's value of a network's tensor. std::runtime_error for another type, and for a variance below 0.
Tensor network_tensor(const WeightsFile& file, const std::string& name, torch::IntArrayRef sizes) {
  Tensor value = file.tensor(name, sizes);
  constexpr const char* kFix = "; restore the file, or train anew with mirage train";
  if (value.scalar_type() != torch::kFloat && value.scalar_type() != torch::kHalf)
    throw std::runtime_error("weights of another type: " + name + " is neither F32 nor F16" + kFix);
  if (name.ends_with("variance") && (value < 0).any().item<bool>())
    throw std::runtime_error("weights of no network: " + name + " is negative" + kFix);
  return value;
}

/// std::runtime_error for a tensor that neither the network nor a training's state has.
void require_known(const WeightsFile& file, const NetworkImpl& stored) {
  const auto parameters = stored.named_parameters(), buffers = stored.named_buffers();
  for (const std::string& name : file.names())
    if (!parameters.contains(name) && !buffers.contains(name) && !name.starts_with("training.") &&
        !name.starts_with("optimiser.") && !name.starts_with("start"))
      throw std::runtime_error("weights of another network: " + name +
                               " is unknown; restore the file, or train anew with mirage train");
}

}  // namespace

std::string name_of(const Parts& parts) {
  if (!parts.lidar) return "camera";
  if (parts.second) return "refined";
  return parts.painted ? "painted" : parts.late ? "late" : parts.image ? "fusion" : "lidar";
}

Parts parts_named(const std::string& name) {
  Parts parts;
  parts.second = name == "refined";
  parts.image = parts.second || name == "fusion";
  parts.camera = name != "lidar";
  parts.lidar = name != "camera";
  parts.painted = name == "painted";
  parts.late = name == "late";
  if (name_of(parts) != name)
    throw std::runtime_error("modality: unknown value '" + name +
                             "'; use lidar, camera, painted, fusion, late or refined");
  return parts;
}

WeightsFile open_weights(const std::string& file) {
  WeightsFile weights(file);
  if (weights.fact("format") != kFormat)
    throw std::runtime_error("weights of another program or version; train anew with mirage train");
  return weights;
}

bool is_weights_file(const std::string& file) {
  try {
    open_weights(file);
    return true;
  } catch (const std::exception&) {
    return false;
  }
}

bool has_word(const WeightsFile& file, std::string_view key, std::string_view word) {
  std::istringstream words(file.fact(key));
  return std::find(std::istream_iterator<std::string>(words), {}, word) !=
         std::istream_iterator<std::string>();
}

Parts parts_of(const WeightsFile& file) {
  Parts parts = parts_named(file.fact("detector"));
  parts.denoising = has_word(file, "with", kDenoising);
  parts.depth_gate = has_word(file, "with", kDepthGate);
  return parts;
}

void copy_network(const std::string& file, NetworkImpl& network) {
  const WeightsFile weights = open_weights(file);
  const torch::NoGradGuard guard;
  auto parameters = network.named_parameters(), buffers = network.named_buffers();
  Network stored(parts_of(weights));  // for its tensors' names and shapes
  require_known(weights, *stored);
  for (const auto& item : stored->named_parameters()) {
    const Tensor value = network_tensor(weights, item.key(), item.value().sizes());
    Tensor& ours = parameters[item.key()];
    if (value.dim() == 4 && ours.size(1) > value.size(1))
      ours.narrow(1, 0, value.size(1)).copy_(value);
    else
      ours.copy_(value);
  }
  for (const auto& item : stored->named_buffers())
    buffers[item.key()].copy_(network_tensor(weights, item.key(), item.value().sizes()));
}

WeightsWriter begin_weights(const NetworkImpl& network) {
  WeightsWriter writer;
  writer.state("format", kFormat);
  writer.state("detector", name_of(network.parts));
  std::string with;
  if (network.parts.denoising) with += kDenoising;
  if (network.parts.depth_gate) with.append(with.empty() ? "" : " ").append(kDepthGate);
  if (!with.empty()) writer.state("with", with);
  for (const auto& item : network.named_parameters()) writer.add(item.key(), item.value());
  for (const auto& item : network.named_buffers()) writer.add(item.key(), item.value());
  return writer;
}

}  // namespace mirage::fusion
