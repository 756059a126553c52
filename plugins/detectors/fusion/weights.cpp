#include "weights.h"

#include <map>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "base/files.h"
#include "data_archive.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr const char* kFormat = "mirage fusion detector 2";

}  // namespace

torch::Device best_device() {
  return torch::cuda::is_available() ? torch::kCUDA : torch::kCPU;
}

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

torch::serialize::InputArchive open_weights(const std::string& file) {
  torch::serialize::InputArchive archive = open_data_archive(file, best_device());
  c10::IValue value;
  if (!archive.try_read("format", value) || !value.isString() || value.toStringRef() != kFormat)
    throw std::runtime_error("weights of another program or version; train anew with mirage train");
  return archive;
}

bool is_weights_file(const std::string& file) {
  try {
    open_weights(file);
    return true;
  } catch (const std::exception&) {
    return false;
  }
}

Parts parts_of(torch::serialize::InputArchive& archive) {
  // Files name what they have.
  const auto flag = [&](const char* key) {
    c10::IValue value;
    return archive.try_read(key, value) && value.toBool();
  };
  Parts parts{flag("with_image"), flag("denoising"), flag("depth_gate"), flag("camera")};
  parts.lidar = !flag("without_lidar");
  parts.painted = flag("painted");
  parts.late = flag("late");
  parts.second = flag("second");
  if (parts.lidar && !flag("channel_norm"))
    throw std::runtime_error(
        "weights of a network of before, with group norms; train anew with mirage train");
  return parts;
}

void copy_network(const std::string& file, NetworkImpl& network) {
  torch::serialize::InputArchive archive = open_weights(file), stored;
  archive.read("network", stored);
  Network read(parts_of(archive));
  read->to(best_device());
  std::map<std::string, std::vector<std::int64_t>> shapes;
  for (const auto& item : read->named_parameters()) shapes[item.key()] = item.value().sizes().vec();
  read->load(stored);
  const torch::NoGradGuard guard;
  auto parameters = network.named_parameters(), buffers = network.named_buffers();
  for (const auto& item : read->named_parameters()) {
    const Tensor& value = item.value();
    if (value.sizes().vec() != shapes[item.key()])
      throw std::runtime_error("weights of another network; train anew with mirage train");
    if (!torch::isfinite(value).all().item<bool>())
      throw std::runtime_error(
          "weights that are not finite; restore the file, or train anew with mirage train");
    Tensor& ours = parameters[item.key()];
    if (value.dim() == 4 && ours.size(1) > value.size(1))
      ours.narrow(1, 0, value.size(1)).copy_(value);
    else
      ours.copy_(value);
  }
  for (const auto& item : read->named_buffers()) buffers[item.key()].copy_(item.value());
}

torch::serialize::OutputArchive begin_weights(const Parts& parts) {
  torch::serialize::OutputArchive archive;
  archive.write("format", c10::IValue(std::string(kFormat)));
  archive.write("with_image", c10::IValue(parts.image));
  archive.write("denoising", c10::IValue(parts.denoising));
  archive.write("depth_gate", c10::IValue(parts.depth_gate));
  archive.write("camera", c10::IValue(parts.camera));
  archive.write("without_lidar", c10::IValue(!parts.lidar));
  archive.write("painted", c10::IValue(parts.painted));
  archive.write("late", c10::IValue(parts.late));
  archive.write("second", c10::IValue(parts.second));
  archive.write("channel_norm", c10::IValue(true));
  return archive;
}

void write_weights(torch::serialize::OutputArchive& archive, const std::string& file) {
  // Through memory: LibTorch's file writer aborts the process when its destructor meets a full disk.
  std::ostringstream bytes;
  archive.save_to(bytes);
  write_file(file, bytes.str());
}

}  // namespace mirage::fusion
