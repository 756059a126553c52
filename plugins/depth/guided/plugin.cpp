// The C interface of depth completion (scene/depth/depth_abi.h). No exception leaves a function of this file.
#include <nlohmann/json.hpp>

#include "../../c_interface.h"
#include "guided_completion.h"

namespace {

using mirage::guarded;
using mirage::guided::GuidedCompletion;

GuidedCompletion& instance(void* completion) {
  return *static_cast<GuidedCompletion*>(completion);
}

void* create(const char* options_json, const char* weights, char* error, size_t error_size) {
  GuidedCompletion* completion = nullptr;
  guarded(error, error_size, [&] {
    const auto json = nlohmann::json::parse(options_json ? options_json : "{}");
    mirage::guided::Options options;
    options.seed = json.value("seed", std::uint64_t{0});
    options.threads = json.value("threads", 1);
    completion = new GuidedCompletion(options, weights);
  });
  return completion;
}

void destroy(void* completion) {
  delete static_cast<GuidedCompletion*>(completion);
}

int complete(void* completion, const MirageDepthInput* input, float* dense, char* error, size_t error_size) {
  return guarded(error, error_size, [&] { instance(completion).complete(*input, dense); });
}

int train_step(void* completion, const MirageDepthSample* samples, int64_t count, float learning_rate,
               float loss[3], char* error, size_t error_size) {
  return guarded(error, error_size, [&] {
    const auto terms =
        instance(completion).train_step({samples, static_cast<std::size_t>(count)}, learning_rate);
    std::copy(terms.begin(), terms.end(), loss);
  });
}

int save(void* completion, const char* file, int32_t with_optimiser, char* error, size_t error_size) {
  return guarded(error, error_size, [&] { instance(completion).save(file, with_optimiser != 0); });
}

const MirageDepthApi kApi = {MIRAGE_DEPTH_ABI, "guided", create, destroy, complete, train_step, save};

}  // namespace

extern "C" __attribute__((visibility("default"))) const MirageDepthApi* mirage_depth_api(void) {
  return &kApi;
}
