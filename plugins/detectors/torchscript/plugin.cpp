// The C interface of detectors (detection/detector_abi3.h). No exception leaves a function of this file.
#include <ATen/Parallel.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/csrc/jit/runtime/graph_executor.h>
#include <torch/script.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <sstream>
#include <string>
#include <vector>

#include "../../c_interface.h"
#include "../../torch_threads.h"
#include "../probe_scene.h"
#include "base/memory.h"
#include "detection/detector_abi3.h"

namespace mirage::torchscript {

/// Throws BadFile for everything that the model does wrong; the C interface turns it into one line.
class TorchScriptDetector {
 public:
  /// Loads the model, checks its signature and runs it once, with gradients, on a made-up scene.
  TorchScriptDetector(const std::string& file, int threads);

  const std::array<float, 4>& region() const { return region_; }
  /// MIRAGE_READS_… | MIRAGE_FINDS_…, by the model's signature.
  std::uint32_t capabilities() const;
  const std::vector<MirageProposal>& forward(const MirageSensorInput& input, float score_threshold,
                                             bool keep_graph);
  void backward(std::span<const float> d_logits, float* d_image, float* d_points);

 private:
  struct Outputs {
    torch::Tensor boxes, logits;  ///< M×5 (in the picture M×4) and M, float32
  };
  Outputs run(const torch::Tensor& projection);
  void check_signature();
  void read_region();
  void probe();

  torch::jit::Module module_;
  int threads_;
  bool picture_ = false;  ///< forward takes the image alone and finds boxes in it
  std::array<float, 4> region_ = {0, 70, -40, 40};
  std::vector<MirageProposal> proposals_;
  std::vector<std::int64_t> places_;  ///< the proposals' places in the model's logits
  torch::Tensor image_, points_, logits_;
};

namespace {

using torch::Tensor;

constexpr const char* kSignature =
    "forward(image [H,W,3], points [N,4], pixel_from_velo [3,4]), or forward(image [H,W,3]) to find boxes in "
    "the picture";
constexpr const char* kReturns = "(boxes [M,5], logits [M])";
constexpr const char* kReturnsInPicture = "(boxes [M,4], logits [M])";
constexpr const char* kWrite = "write it with torch.jit.script(model).save(FILE)";
constexpr const char* kGuide = "see src/guide/attack.md";

/// The line that says why: the last one of a TorchScript trace, otherwise the first. As _copy.py's.
std::string reason(const std::exception& problem) {
  const auto* by_torch = dynamic_cast<const c10::Error*>(&problem);
  const std::string what = by_torch ? by_torch->what_without_backtrace() : problem.what();
  std::string line, last;
  std::istringstream lines(what);
  const bool trace = what.find("Traceback of TorchScript") != std::string::npos;
  while (std::getline(lines, line))
    if (line.find_first_not_of(" \t\r~^<-HERE") != std::string::npos) {
      last = line;
      if (!trace) break;
    }
  if (last.empty()) return "without a word";
  // Exceptions of LibTorch's own containers say nothing about the model.
  return last.find(' ') == std::string::npos ? "LibTorch itself failed: " + last : last;
}

/// Runs user code: whatever it throws becomes BadFile, naming the method.
template <class Work>
auto guarded_call(const std::string& method, const Work& work) {
  try {
    return work();
  } catch (const std::exception& problem) {
    bad(method, "failed (" + reason(problem) + ")", "run the model in PyTorch first");
  }
}

std::string shape_of(const Tensor& tensor) {
  std::ostringstream text;
  text << tensor.sizes();
  return text.str();
}

Tensor floating(const Tensor& tensor, const char* name) {
  if (!tensor.is_floating_point())
    bad(std::string("forward's ") + name,
        "holds " + std::string(c10::toString(tensor.scalar_type())) + " values", "return float32");
  return tensor.to(torch::kCPU, torch::kFloat32);
}

Tensor from_memory(const float* values, std::vector<std::int64_t> shape) {
  Tensor tensor = torch::empty(shape);
  copy_bytes(tensor.data_ptr<float>(), values, sizeof(float) * as_size(tensor.numel()));
  return tensor;
}

constexpr const char* kNoTraining =
    "a TorchScript detector is trained in PyTorch; train it there, export it and name it with --weights";

using Functions = CFunctions<TorchScriptDetector>;

void* create(const char* options_json, const char* weights, char* error, size_t error_size) {
  return Functions::made(error, error_size, [&] {
    if (!weights) throw BadFile(kNoTraining);
    const auto json = nlohmann::json::parse(options_json ? options_json : "{}");
    if (json.value("start", false)) throw BadFile(kNoTraining);
    return std::make_unique<TorchScriptDetector>(weights, json.value("threads", 1));
  });
}

void region(void* detector, float out[4]) {
  std::ranges::copy(Functions::of(detector).region(), out);
}

int train_step(void*, const MirageSample*, int64_t, float, float*, char* error, size_t error_size) {
  return guarded(error, error_size, [] { throw BadFile(kNoTraining); });
}

int save(void*, const char*, int32_t, char* error, size_t error_size) {
  return guarded(error, error_size, [] { throw BadFile(kNoTraining); });
}

const MirageDetectorApi3 kApi = {MIRAGE_DETECTOR_ABI_3,
                                 "torchscript",
                                 create,
                                 Functions::destroy,
                                 region,
                                 Functions::forward,
                                 Functions::backward,
                                 train_step,
                                 save,
                                 Functions::capabilities,
                                 nullptr,
                                 nullptr,
                                 nullptr,
                                 nullptr,
                                 nullptr,
                                 nullptr};

}  // namespace

TorchScriptDetector::TorchScriptDetector(const std::string& file, int threads) : threads_(threads) {
  // Plain interpretation: no specialisation to the first inputs' shapes, the same result at every call, and
  // PyTorch's own gradients. The profiling executor without its optimiser (setGraphExecutorOptimize(false))
  // is none: it leaves out passes that a traced graph needs, and an integer tensor plus a float is then
  // float64.
  torch::jit::getExecutorMode() = true;
  torch::jit::getProfilingMode() = false;
  try {
    module_ = torch::jit::load(file, torch::kCPU);
  } catch (const std::exception& problem) {
    bad("file", "not a TorchScript model (" + reason(problem) + ")", kWrite);
  }
  module_.eval();
  for (Tensor parameter : module_.parameters()) parameter.requires_grad_(false);
  check_signature();
  read_region();
  probe();
}

std::uint32_t TorchScriptDetector::capabilities() const {
  return picture_ ? MIRAGE_READS_IMAGE | MIRAGE_FINDS_PICTURE
                  : MIRAGE_READS_IMAGE | MIRAGE_READS_POINTS | MIRAGE_FINDS_BEV;
}

void TorchScriptDetector::check_signature() {
  const auto method = module_.find_method("forward");
  if (!method) bad("forward", "the model has no such method", std::string("export ") + kSignature);
  const auto& arguments = method->function().getSchema().arguments();  // the first is self
  std::size_t needed = 0;
  for (const auto& argument : arguments) needed += !argument.default_value();
  const auto is_tensor = [&](std::size_t i) {
    return arguments[i].type()->kind() == c10::TypeKind::TensorType;
  };
  // Arguments after the image may be a model's own options with defaults.
  picture_ = arguments.size() >= 2 && needed <= 2 && !(arguments.size() >= 4 && is_tensor(2) && is_tensor(3));
  if (!picture_ && (arguments.size() < 4 || needed > 4))
    bad("forward", "takes " + std::to_string(arguments.size() - 1) + " arguments",
        std::string("export ") + kSignature + "; " + kGuide);
  for (std::size_t i = 1; i < (picture_ ? 2u : 4u); ++i)
    if (!is_tensor(i))
      bad("forward", "its argument '" + arguments[i].name() + "' is of type " + arguments[i].type()->str(),
          picture_ ? "take a Tensor: image" : "take three Tensors: image, points, pixel_from_velo");
}

void TorchScriptDetector::read_region() {
  c10::IValue value;
  if (module_.find_method("region"))
    value = guarded_call("region", [&] { return module_.run_method("region"); });
  else if (module_.hasattr("region"))
    value = module_.attr("region");
  else
    return;
  std::vector<double> numbers;
  if (value.isDoubleList()) {
    numbers = value.toDoubleVector();
  } else if (value.isTensor()) {
    const Tensor tensor = value.toTensor().to(torch::kFloat64).reshape({-1}).contiguous();
    numbers.assign(tensor.data_ptr<double>(), tensor.data_ptr<double>() + tensor.numel());
  } else if (value.isTuple()) {
    for (const auto& element : value.toTuple()->elements())
      if (element.isDouble() || element.isInt()) numbers.push_back(element.toScalar().toDouble());
  }
  if (numbers.size() != 4 || !(numbers[0] < numbers[1]) || !(numbers[2] < numbers[3]))
    bad("region", "is not [x_min, x_max, y_min, y_max]",
        "give four floats in metres, such as [0.0, 70.0, -40.0, 40.0], or leave it out");
  std::transform(numbers.begin(), numbers.end(), region_.begin(),
                 [](double number) { return static_cast<float>(number); });
}

TorchScriptDetector::Outputs TorchScriptDetector::run(const Tensor& projection) {
  set_torch_threads(threads_);
  std::vector<c10::IValue> inputs{image_};
  if (!picture_) inputs.insert(inputs.end(), {points_, projection});
  const c10::IValue value = guarded_call("forward", [&] { return module_.forward(inputs); });
  if (!value.isTuple() || value.toTuple()->elements().size() != 2 ||
      !value.toTuple()->elements()[0].isTensor() || !value.toTuple()->elements()[1].isTensor())
    bad("forward", "returns " + value.type()->str() + " where two Tensors belong",
        std::string("return ") + (picture_ ? kReturnsInPicture : kReturns));
  Outputs outputs{floating(value.toTuple()->elements()[0].toTensor(), "boxes"),
                  floating(value.toTuple()->elements()[1].toTensor(), "logits")};
  if (outputs.boxes.dim() != 2 || outputs.boxes.size(1) != (picture_ ? 4 : 5))
    bad("forward's boxes", "have shape " + shape_of(outputs.boxes),
        picture_ ? "return [M,4]: left, top, right, bottom (pixels)"
                 : "return [M,5]: x, y, length, width (m), yaw (rad)");
  if (outputs.logits.dim() != 1 || outputs.logits.size(0) != outputs.boxes.size(0))
    bad("forward's logits",
        "have shape " + shape_of(outputs.logits) + " for " + std::to_string(outputs.boxes.size(0)) + " boxes",
        "return [M], one a box");
  for (const auto& [name, tensor] :
       {std::pair("boxes", outputs.boxes), std::pair("logits", outputs.logits)}) {
    const Tensor finite = torch::isfinite(tensor.detach());
    if (finite.all().item<bool>()) continue;
    const Tensor rows = finite.reshape({tensor.size(0), -1}).all(1).logical_not().nonzero();
    bad(std::string("forward's ") + name,
        "are not finite (row " + std::to_string(rows[0].item<int64_t>()) + ")",
        "look for logarithms, roots and divisions of 0, and for points behind the camera");
  }
  return outputs;
}

const std::vector<MirageProposal>& TorchScriptDetector::forward(const MirageSensorInput& input,
                                                                float score_threshold, bool keep_graph) {
  logits_ = Tensor();
  proposals_.clear();
  places_.clear();
  image_ = input.image ? from_memory(input.image, {input.height, input.width, 3}) : torch::zeros({0, 0, 3});
  points_ = from_memory(input.points, {input.points ? input.point_count : 0, 4});
  Tensor projection = torch::empty({3, 4});
  for (int k = 0; k < 12; ++k) projection.data_ptr<float>()[k] = static_cast<float>(input.pixel_from_velo[k]);
  if (picture_ && image_.numel() == 0) {  // nothing to look at
    if (keep_graph) logits_ = torch::zeros({0});
    return proposals_;
  }
  torch::AutoGradMode mode(keep_graph);
  if (keep_graph) {
    image_.requires_grad_(true);
    points_.requires_grad_(true);
  }
  const Outputs outputs = run(projection);
  if (keep_graph) {
    if (outputs.logits.numel() > 0 && !outputs.logits.requires_grad())
      bad("forward's logits",
          std::string("don't depend on image ") + (picture_ ? "" : "or points ") + "in a differentiable way",
          "remove detach(), no_grad(), hard thresholds and .item() between them");
    logits_ = outputs.logits;
  }
  const Tensor boxes = outputs.boxes.detach().contiguous(), logits = outputs.logits.detach().contiguous();
  const float *box = boxes.data_ptr<float>(), *logit = logits.data_ptr<float>();
  for (std::int64_t k = 0; k < logits.numel(); ++k, box += boxes.size(1)) {
    if (!(1 / (1 + std::exp(-logit[k])) > score_threshold)) continue;
    if (picture_)
      proposals_.push_back({{}, {box[0], box[1], box[2], box[3]}, logit[k]});
    else
      proposals_.push_back({{box[0], box[1], box[2], box[3], box[4]}, {}, logit[k]});
    places_.push_back(k);
  }
  return proposals_;
}

void TorchScriptDetector::backward(std::span<const float> d_logits, float* d_image, float* d_points) {
  if (!logits_.defined())
    throw std::runtime_error(
        "backward needs a forward that kept its graph; call forward with keep_graph first");
  if (d_logits.size() != places_.size())
    throw std::runtime_error("backward got " + std::to_string(d_logits.size()) + " logit gradients for " +
                             std::to_string(places_.size()) + " proposals; give one for each");
  std::vector<Tensor> gradients(2);
  if (logits_.requires_grad()) {
    set_torch_threads(threads_);
    Tensor seed = torch::zeros({logits_.size(0)});
    for (std::size_t i = 0; i < places_.size(); ++i) seed.data_ptr<float>()[places_[i]] = d_logits[i];
    gradients = guarded_call("backward", [&] {
      return torch::autograd::grad({logits_}, {image_, points_}, {seed}, false, false, true);
    });
  }
  const auto copy = [](const Tensor& gradient, const Tensor& like, const char* name, float* out) {
    if (!out || like.numel() == 0) return;
    if (!gradient.defined()) {  // the model doesn't look at it
      std::fill_n(out, like.numel(), 0.f);
      return;
    }
    if (!torch::isfinite(gradient).all().item<bool>())
      bad(std::string("the gradient to ") + name, "is not finite",
          "look for roots and norms of 0, and for divisions, in the model");
    copy_bytes(out, gradient.contiguous().data_ptr<float>(), sizeof(float) * as_size(like.numel()));
  };
  copy(gradients[0], image_, "image", d_image);
  copy(gradients[1], points_, "points", d_points);
}

void TorchScriptDetector::probe() {
  const ProbeScene scene;
  MirageSensorInput input{};
  input.image = scene.image.data();
  input.width = scene.width, input.height = scene.height;
  input.points = scene.points.data();
  input.point_count = static_cast<std::int64_t>(scene.points.size() / 4);
  std::copy(scene.pixel_from_ego.begin(), scene.pixel_from_ego.end(), input.pixel_from_velo);
  const std::size_t proposal_count = forward(input, 0, true).size();
  std::vector<float> d_image(scene.image.size()), d_points(scene.points.size());
  backward(std::vector<float>(proposal_count, 1), d_image.data(), d_points.data());
  logits_ = image_ = points_ = Tensor();
}

}  // namespace mirage::torchscript

extern "C" __attribute__((visibility("default"))) const MirageDetectorApi3* mirage_detector_api(void) {
  return &mirage::torchscript::kApi;
}
