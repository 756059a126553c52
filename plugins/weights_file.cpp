#include "weights_file.h"

#include <fmt/ranges.h>
#include <openssl/evp.h>

#include <array>
#include <sstream>
#include <stdexcept>
#include <type_traits>

#include "base/files.h"
#include "base/memory.h"

namespace mirage {
namespace {

using torch::Tensor;

constexpr std::size_t kHeadBytes = 9;  // of a header's length and its first letter

torch::Dtype dtype_of(Element element) {
  switch (element) {
    case Element::float32:
      return torch::kFloat;
    case Element::float16:
      return torch::kHalf;
    case Element::float64:
      return torch::kDouble;
    case Element::int64:
      return torch::kLong;
  }
  throw std::logic_error("an element type without its LibTorch type");
}

Element element_of(const Tensor& tensor) {
  for (const Element element : {Element::float32, Element::float16, Element::float64, Element::int64})
    if (tensor.scalar_type() == dtype_of(element)) return element;
  throw std::logic_error("a tensor of a type that weights files do not hold");
}

std::string sha256(std::string_view bytes) {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned size = 0;
  if (EVP_Digest(bytes.data(), bytes.size(), digest.data(), &size, EVP_sha256(), nullptr) != 1)
    throw std::runtime_error("OpenSSL computes no SHA-256");
  return fmt::format("{:02x}", fmt::join(digest.data(), digest.data() + size, ""));
}

/// The file's bytes, or only its first ones if these are not a weights file's.
std::string read_weights(const std::filesystem::path& file) {
  std::string head = read_head(file, kHeadBytes);
  return head.size() == kHeadBytes && head.back() == '{' ? read_file(file) : head;
}

std::string name_of(std::size_t parameter, const char* what) {
  return "optimiser." + std::to_string(parameter) + "." + what;
}

/// A parameter in an optimiser's map of states: by text until LibTorch 2.0, by address from then on.
template <class Key>
Key key_of(const Tensor& parameter) {
  if constexpr (std::is_same_v<Key, std::string>) {
    std::ostringstream text;  // as LibTorch writes it
    text << parameter.unsafeGetTensorImpl();
    return text.str();
  } else {
    return parameter.unsafeGetTensorImpl();
  }
}

}  // namespace

WeightsFile::WeightsFile(const std::filesystem::path& file) {
  bytes_.reserve(1 + kMaxParts);  // the tensors point into them
  bytes_.push_back(read_weights(file));
  files_.push_back(parse_tensor_file(bytes_.front()));
  for (const NamedPart& part : std::vector(files_.front().parts)) {
    const std::filesystem::path beside = file.parent_path() / part.file;
    if (!std::filesystem::is_regular_file(beside))
      throw std::runtime_error("needs " + part.file + " beside it, and there is none; copy both together");
    bytes_.push_back(read_weights(beside));
    if (sha256(bytes_.back()) != part.sha256)
      throw std::runtime_error("needs " + part.file + " of SHA-256 " + part.sha256 +
                               " beside it, and that file is another; restore both");
    files_.push_back(parse_tensor_file(bytes_.back()));
  }
}

std::string WeightsFile::fact(std::string_view key) const {
  const Facts& facts = files_.front().facts;
  const auto found = facts.find(key);
  return found == facts.end() ? "" : found->second;
}

std::vector<std::string> WeightsFile::names() const {
  std::vector<std::string> names;
  for (const auto& [name, tensor] : files_.front().tensors) names.push_back(name);
  return names;
}

const StoredTensor* WeightsFile::find(std::string_view tensor) const {
  for (const TensorFile& file : files_)
    if (const auto found = file.tensors.find(tensor); found != file.tensors.end()) return &found->second;
  return nullptr;
}

Tensor WeightsFile::tensor(std::string_view name, torch::IntArrayRef sizes) const {
  const StoredTensor* stored = find(name);
  if (!stored || sizes != torch::IntArrayRef(stored->shape))
    throw std::runtime_error("weights of another network; train anew with mirage train");
  const Tensor value = torch::empty(sizes, dtype_of(stored->element));
  copy_bytes(value.data_ptr(), stored->data.data(), stored->data.size());
  return value;
}

void WeightsWriter::add(std::string name, const Tensor& tensor) {
  tensors_[std::move(name)] = tensor.detach().to(torch::kCPU).contiguous();
}

void WeightsWriter::write(const std::filesystem::path& file) const {
  StoredTensors stored;
  for (const auto& [name, tensor] : tensors_)
    stored[name] = {element_of(tensor),
                    tensor.sizes().vec(),
                    {static_cast<const char*>(tensor.data_ptr()), tensor.nbytes()}};
  write_file(file, tensor_file_bytes(facts_, stored));
}

void add_state(WeightsWriter& writer, torch::optim::AdamW& optimiser) {
  auto& states = optimiser.state();
  using Key = typename std::decay_t<decltype(states)>::key_type;
  const auto& parameters = optimiser.param_groups().front().params();
  for (std::size_t k = 0; k < parameters.size(); ++k) {
    const auto found = states.find(key_of<Key>(parameters[k]));
    if (found == states.end()) continue;  // had no gradient yet
    auto& state = static_cast<torch::optim::AdamWParamState&>(*found->second);
    writer.add(name_of(k, "step"), torch::tensor(state.step(), torch::kLong));
    writer.add(name_of(k, "exp_avg"), state.exp_avg());
    writer.add(name_of(k, "exp_avg_sq"), state.exp_avg_sq());
  }
}

void read_state(const WeightsFile& file, torch::optim::AdamW& optimiser) {
  auto& states = optimiser.state();
  using Key = typename std::decay_t<decltype(states)>::key_type;
  const auto& parameters = optimiser.param_groups().front().params();
  states.clear();
  for (std::size_t k = 0; k < parameters.size(); ++k) {
    if (!file.holds(name_of(k, "step"))) continue;
    const auto moment = [&](const char* what) {
      Tensor like = torch::zeros_like(parameters[k], torch::MemoryFormat::Preserve);
      return like.copy_(file.tensor(name_of(k, what), parameters[k].sizes()));
    };
    auto state = std::make_unique<torch::optim::AdamWParamState>();
    state->step(file.tensor(name_of(k, "step"), {}).item<std::int64_t>());
    state->exp_avg(moment("exp_avg"));
    state->exp_avg_sq(moment("exp_avg_sq"));
    states[key_of<Key>(parameters[k])] = std::move(state);
  }
}

}  // namespace mirage
