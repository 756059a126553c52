// The C interface of detectors (detection/detector_abi3.h). No exception leaves a function of this file.
#include <nlohmann/json.hpp>

#include "../../c_interface.h"
#include "torchscript_detector.h"

namespace {

using mirage::BadFile;
using mirage::guarded;
using mirage::torchscript::TorchScriptDetector;

constexpr const char* kNoTraining =
    "a TorchScript detector is trained in PyTorch; train it there, export it and name it with --weights";

TorchScriptDetector& instance(void* detector) {
  return *static_cast<TorchScriptDetector*>(detector);
}

void* create(const char* options_json, const char* weights, char* error, size_t error_size) {
  TorchScriptDetector* detector = nullptr;
  guarded(error, error_size, [&] {
    if (!weights) throw BadFile(kNoTraining);
    const auto json = nlohmann::json::parse(options_json ? options_json : "{}");
    if (json.value("start", false)) throw BadFile(kNoTraining);
    detector = new TorchScriptDetector(weights, json.value("threads", 1));
  });
  return detector;
}

void destroy(void* detector) {
  delete static_cast<TorchScriptDetector*>(detector);
}

void region(void* detector, float out[4]) {
  std::copy(instance(detector).region().begin(), instance(detector).region().end(), out);
}

int forward(void* detector, const MirageSensorInput* input, float score_threshold, int32_t keep_graph,
            const MirageProposal** proposals, int64_t* count, char* error, size_t error_size) {
  return guarded(error, error_size, [&] {
    const auto& outputs = instance(detector).forward(*input, score_threshold, keep_graph != 0);
    *proposals = outputs.data();
    *count = static_cast<int64_t>(outputs.size());
  });
}

int backward(void* detector, const float* d_logits, int64_t count, float* d_image, float* d_points,
             char* error, size_t error_size) {
  return guarded(error, error_size, [&] {
    instance(detector).backward({d_logits, static_cast<std::size_t>(count)}, d_image, d_points);
  });
}

int train_step(void*, const MirageSample*, int64_t, float, float*, char* error, size_t error_size) {
  return guarded(error, error_size, [] { throw BadFile(kNoTraining); });
}

int save(void*, const char*, int32_t, char* error, size_t error_size) {
  return guarded(error, error_size, [] { throw BadFile(kNoTraining); });
}

uint32_t capabilities(void* detector) {
  return instance(detector).capabilities();
}

const MirageDetectorApi3 kApi = {
    MIRAGE_DETECTOR_ABI_3, "torchscript", create,  destroy, region,  forward, backward, train_step, save,
    capabilities,          nullptr,       nullptr, nullptr, nullptr, nullptr, nullptr};

}  // namespace

extern "C" __attribute__((visibility("default"))) const MirageDetectorApi3* mirage_detector_api(void) {
  return &kApi;
}
