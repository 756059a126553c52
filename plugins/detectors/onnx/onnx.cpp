// A network as an ONNX file, run by ONNX Runtime on the processor: it has no gradients. src/guide/attack.md
// says what it must take and return; detection/detector_abi.h is the interface.
#include <onnxruntime_cxx_api.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "../../c_interface.h"
#include "../probe_scene.h"
#include "base/sizes.h"
#include "detection/detector_abi.h"

namespace {

using mirage::as_size;
using mirage::bad;
using mirage::BadFile;
using mirage::guarded;

constexpr const char* kTakes =
    "name the inputs image [H,W,3], points [N,4] and pixel_from_velo [3,4], or some of them";
constexpr const char* kReturns = "name the outputs boxes [M,5] (or [M,4], in the picture) and logits [M]";
constexpr const char* kNoTraining =
    "an ONNX model is not trained here; train it where it came from and export it again";

/// ONNX Runtime's reasons run over several lines.
std::string one_line(std::string text) {
  for (char& letter : text)
    if (letter == '\n' || letter == '\t') letter = ' ';
  return text.substr(0, text.find_last_not_of(' ') + 1);
}

std::string text_of(const std::vector<std::int64_t>& shape) {
  return nlohmann::json(shape).dump();
}

/// One tensor of a model: an input or an output.
struct Place {
  std::string name;
  ONNXTensorElementDataType type = ONNX_TENSOR_ELEMENT_DATA_TYPE_UNDEFINED;
  std::vector<std::int64_t> shape;  ///< -1: any
};

Place place_of(const std::string& name, const Ort::TypeInfo& about) {
  if (about.GetONNXType() != ONNX_TYPE_TENSOR) bad(name, "is not a tensor", "export tensors alone");
  const auto tensor = about.GetTensorTypeAndShapeInfo();
  return {name, tensor.GetElementType(), tensor.GetShape()};
}

/// Debian's ONNX Runtime says on std::cerr, when it opens its first file, that operators are registered
/// twice: nothing that a user can mend.
class Quiet {
 public:
  Quiet() : before_(std::cerr.rdbuf(unseen_.rdbuf())) {}
  Quiet(const Quiet&) = delete;
  Quiet& operator=(const Quiet&) = delete;
  ~Quiet() { std::cerr.rdbuf(before_); }

 private:
  std::ostringstream unseen_;
  std::streambuf* before_;
};

/// A file with its session, which any number of threads may run.
class Model {
 public:
  Model(const char* file, int threads) : session_(open(file, threads)) {
    Ort::AllocatorWithDefaultOptions memory;
    for (std::size_t i = 0; i < session_.GetInputCount(); ++i)
      inputs_.push_back(
          place_of(session_.GetInputNameAllocated(i, memory).get(), session_.GetInputTypeInfo(i)));
    for (std::size_t i = 0; i < session_.GetOutputCount(); ++i)
      outputs_.push_back(
          place_of(session_.GetOutputNameAllocated(i, memory).get(), session_.GetOutputTypeInfo(i)));
    check_inputs();
    for (const char* name : {"boxes", "logits"})
      if (!find(outputs_, name)) bad("output", std::string("there is none named ") + name, kReturns);
    const auto region = session_.GetModelMetadata().LookupCustomMetadataMapAllocated("region", memory);
    if (region) read_region(region.get());
    probe();
  }

  /// The model's input of that name; null if it has none.
  const Place* input(const char* name) const { return find(inputs_, name); }
  const std::array<float, 4>& region() const { return region_; }
  bool in_picture() const { return in_picture_; }

  struct Answer {
    std::vector<float> boxes, logits;
    std::int64_t columns = 0;  ///< of boxes
  };
  /// BadFile for shapes that the model does not take, and for invalid answers.
  Answer run(const float* image, std::int64_t rows, std::int64_t columns, const float* points,
             std::int64_t count, const std::array<float, 12>& pixel_from_ego) const {
    const auto memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
    std::vector<Ort::Value> values;
    std::vector<const char*> names;
    // ONNX Runtime takes no null, and asks for memory that may be written to; it writes nothing there.
    static float nothing = 0;
    const auto add = [&](const Place& place, const float* data, const std::vector<std::int64_t>& shape) {
      std::size_t size = 1;
      for (const std::int64_t side : shape) size *= as_size(side);
      values.push_back(Ort::Value::CreateTensor<float>(memory, size > 0 ? const_cast<float*>(data) : &nothing,
                                                       size, shape.data(), shape.size()));
      names.push_back(place.name.c_str());
    };
    for (const Place& place : inputs_) {
      if (place.name == "image") add(place, image, {rows, columns, 3});
      if (place.name == "points") add(place, points, {count, 4});
      if (place.name == "pixel_from_velo") add(place, pixel_from_ego.data(), {3, 4});
    }
    constexpr std::array<const char*, 2> kOutputs = {"boxes", "logits"};
    std::vector<Ort::Value> found;
    try {
      Ort::Session& session = session_;
      found = session.Run(Ort::RunOptions(), names.data(), values.data(), values.size(), kOutputs.data(),
                          kOutputs.size());
    } catch (const Ort::Exception& problem) {
      bad("the model", "failed (" + one_line(problem.what()) + ")",
          "export it with dynamic_axes for H, W and N, and run it in ONNX Runtime first");
    }
    Answer answer;
    std::vector<std::int64_t> shape;
    answer.boxes = floats(found[0], "boxes", shape);
    if (shape.size() != 2 || (shape[1] != 4 && shape[1] != 5))
      bad("boxes", "have shape " + text_of(shape), kReturns);
    answer.columns = shape[1];
    const std::int64_t boxes = shape[0];
    answer.logits = floats(found[1], "logits", shape);
    if (shape.size() != 1 || shape[0] != boxes)
      bad("logits", "have shape " + text_of(shape) + " for " + std::to_string(boxes) + " boxes",
          "return [M], one a box");
    return answer;
  }

 private:
  static Ort::Session open(const char* file, int threads) {
    const Quiet quiet;
    static Ort::Env environment(ORT_LOGGING_LEVEL_FATAL, "mirage");
    Ort::SessionOptions options;
    options.SetIntraOpNumThreads(threads);
    options.SetDeterministicCompute(true);
    try {
      return Ort::Session(environment, file, options);
    } catch (const Ort::Exception& problem) {
      bad("file", "is not an ONNX model (" + one_line(problem.what()) + ")",
          "write it with torch.onnx.export");
    }
  }

  static const Place* find(const std::vector<Place>& places, const std::string& name) {
    const auto found = std::ranges::find(places, name, &Place::name);
    return found == places.end() ? nullptr : &*found;
  }

  void check_inputs() const {
    if (inputs_.empty()) bad("input", "there is none", kTakes);
    for (const Place& place : inputs_) {
      const bool picture = place.name == "image";
      if (!picture && place.name != "points" && place.name != "pixel_from_velo")
        bad("input " + place.name, "is not known", kTakes);
      if (place.type != ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT)
        bad("input " + place.name, "is not of float32", "take float32, and convert it inside the model");
      const std::int64_t last = picture ? 3 : 4;
      if (place.shape.size() != (picture ? 3u : 2u) ||
          (place.shape.back() != last && place.shape.back() != -1))
        bad("input " + place.name, "has shape " + text_of(place.shape), kTakes);
    }
    if (!input("image") && !input("points")) bad("input", "is neither image nor points", kTakes);
  }

  void read_region(const std::string& text) {
    std::istringstream numbers(text);
    std::array<float, 4> region{};
    for (float& number : region) numbers >> number;
    std::string rest;
    if (!numbers || numbers >> rest || !(region[0] < region[1]) || !(region[2] < region[3]))
      bad("metadata region", "\"" + text + "\" is not x_min x_max y_min y_max",
          "give four numbers in metres, such as \"0 70 -40 40\", or leave it out");
    region_ = region;
  }

  /// Runs the model once, so that its problems are reported before any work is done.
  void probe() {
    const Place* image = input("image");
    const auto side = [&](std::size_t axis, int usual) {
      return image && image->shape[axis] > 0 ? static_cast<int>(image->shape[axis]) : usual;
    };
    const mirage::ProbeScene scene(side(1, 1242), side(0, 375));
    std::array<float, 12> matrix{};
    std::transform(scene.pixel_from_ego.begin(), scene.pixel_from_ego.end(), matrix.begin(),
                   [](double value) { return static_cast<float>(value); });
    in_picture_ = run(scene.image.data(), scene.height, scene.width, scene.points.data(),
                      static_cast<std::int64_t>(scene.points.size() / 4), matrix)
                      .columns == 4;
  }

  static std::vector<float> floats(const Ort::Value& value, const char* name,
                                   std::vector<std::int64_t>& shape) {
    const auto about = value.GetTensorTypeAndShapeInfo();
    shape = about.GetShape();
    if (about.GetElementType() != ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT)
      bad(name, "are not of float32", "return float32");
    const float* first = value.GetTensorData<float>();
    std::vector<float> numbers(first, first + about.GetElementCount());
    const auto odd =
        std::find_if(numbers.begin(), numbers.end(), [](float number) { return !std::isfinite(number); });
    if (odd != numbers.end())
      bad(name, "are not finite (value " + std::to_string(odd - numbers.begin()) + ")",
          "look for logarithms, roots and divisions of 0, and for points behind the camera");
    return numbers;
  }

  mutable Ort::Session session_;  ///< Run is safe from several threads, and not const
  std::vector<Place> inputs_, outputs_;
  std::array<float, 4> region_ = {0, 70, -40, 40};
  bool in_picture_ = false;
};

class OnnxDetector {
 public:
  explicit OnnxDetector(std::shared_ptr<const Model> model) : model_(std::move(model)) {
    const auto reads = [&](const char* name, std::uint32_t kind) { return model_->input(name) ? kind : 0u; };
    capabilities_.flags = model_->in_picture() ? MIRAGE_FINDS_PICTURE : MIRAGE_FINDS_BEV;
    capabilities_.kinds = reads("image", MIRAGE_CAMERA) | reads("points", MIRAGE_LIDAR) |
                          reads("pixel_from_velo", MIRAGE_CAMERA);
    static const char* const kTypes[] = {"Car"};
    capabilities_.types = kTypes, capabilities_.type_count = 1;
    std::copy(model_->region().begin(), model_->region().end(), capabilities_.region);
  }

  const MirageCapabilities* capabilities() const { return &capabilities_; }
  std::unique_ptr<OnnxDetector> shared() const { return std::make_unique<OnnxDetector>(model_); }

  const std::vector<MirageDetection>& forward(const MiragePass& pass) {
    found_.clear();
    const MirageSensor *camera = nullptr, *lidar = nullptr;  // the first of each kind
    std::int32_t which = 0;
    for (std::int64_t i = pass.frame->sensor_count; i-- > 0;) {
      const MirageSensor& sensor = pass.frame->sensors[i];
      if (sensor.kind == MIRAGE_CAMERA) camera = &sensor, which = static_cast<std::int32_t>(i);
      if (sensor.kind == MIRAGE_LIDAR) lidar = &sensor;
    }
    if (model_->in_picture() && (!camera || camera->shape[0] == 0)) return found_;  // nothing to look at
    std::array<float, 12> matrix{};
    if (camera)
      for (std::size_t row = 0; row < 3; ++row)
        for (std::size_t column = 0; column < 4; ++column) {
          double sum = 0;
          for (std::size_t k = 0; k < 3; ++k)
            sum += camera->intrinsics[3 * row + k] * camera->sensor_from_ego[4 * k + column];
          matrix[4 * row + column] = static_cast<float>(sum);
        }
    const auto answer = model_->run(camera ? camera->data : nullptr, camera ? camera->shape[0] : 0,
                                    camera ? camera->shape[1] : 0, lidar ? lidar->data : nullptr,
                                    lidar ? lidar->shape[0] : 0, matrix);
    if ((answer.columns == 4) != model_->in_picture())
      bad("boxes", "have " + std::to_string(answer.columns) + " columns here, and had others at the start",
          kReturns);
    for (std::size_t k = 0; k < answer.logits.size(); ++k) {
      const float logit = answer.logits[k];
      if (!(1 / (1 + std::exp(-logit)) > pass.score_threshold)) continue;
      const float* box = answer.boxes.data() + k * as_size(answer.columns);
      MirageDetection made{};
      if (model_->in_picture())
        made.left = box[0], made.top = box[1], made.right = box[2], made.bottom = box[3], made.camera = which;
      else
        made.x = box[0], made.y = box[1], made.length = box[2], made.width = box[3], made.yaw = box[4];
      made.logit = logit;
      made.identity = -1;
      std::fill(std::begin(made.velocity), std::end(made.velocity), std::nanf(""));
      found_.push_back(made);
    }
    return found_;
  }

 private:
  std::shared_ptr<const Model> model_;
  MirageCapabilities capabilities_{};
  std::vector<MirageDetection> found_;
};

using Functions = mirage::CFunctions<OnnxDetector>;

void* create(const char* options_json, const char* weights, char* error, size_t error_size) {
  return Functions::made(error, error_size, [&] {
    const auto json = nlohmann::json::parse(options_json ? options_json : "{}");
    if (!weights || json.value("start", false)) throw BadFile(kNoTraining);
    return std::make_unique<OnnxDetector>(std::make_shared<const Model>(weights, json.value("threads", 1)));
  });
}

int train_step(void*, const MirageTrainingFrame*, int64_t, float, float*, char* error, size_t error_size) {
  return guarded(error, error_size, [] { throw BadFile(kNoTraining); });
}

const MirageDetectorApi kApi = {MIRAGE_DETECTOR_ABI,
                                "onnx",
                                create,
                                Functions::destroy,
                                Functions::capabilities,
                                Functions::forward,
                                nullptr,
                                nullptr,
                                Functions::share,
                                train_step,
                                nullptr,
                                nullptr};

}  // namespace

extern "C" __attribute__((visibility("default"))) const MirageDetectorApi* mirage_detector_api(void) {
  return &kApi;
}
