// The C interface of detectors (detection/detector_abi3.h). No exception leaves a function of this file.
#include <nlohmann/json.hpp>

#include "../../c_interface.h"
#include "fusion_detector.h"
#include "region.h"
#include "weights.h"

namespace {

using mirage::guarded;
using mirage::fusion::FusionDetector;
using Functions = mirage::CFunctions<FusionDetector>;

mirage::fusion::Precision precision_named(const std::string& word) {
  using mirage::fusion::Precision;
  for (const auto& [name, precision] : {std::pair("float", Precision::float_),
                                        {"bfloat16", Precision::bfloat16},
                                        {"double", Precision::double_}})
    if (word == name) return precision;
  throw std::runtime_error("precision: unknown value '" + word + "'; use float, bfloat16 or double");
}

constexpr std::string_view kKeepStart = "keep-start=";  // and a share

void* create(const char* options_json, const char* weights, char* error, size_t error_size) {
  return Functions::made(error, error_size, [&] {
    const auto json = nlohmann::json::parse(options_json ? options_json : "{}");
    mirage::fusion::Options options;
    options.parts = mirage::fusion::parts_named(json.value("modality", "fusion"));
    options.camera = json.value("camera", "");
    options.lidar = json.value("lidar", "");
    options.seed = json.value("seed", std::uint64_t{0});
    options.threads = json.value("threads", 1);
    options.start = json.value("start", false);
    options.precision = precision_named(json.value("precision", "float"));
    options.locality = json.value("locality", 0.0);
    options.clean_memory = json.value("clean_memory_mb", std::size_t{2048}) << 20;
    for (const std::string part : json.value("parts", nlohmann::json::array())) {
      if (part == "denoising")
        options.parts.denoising = true;
      else if (part == "depth-gate")
        options.parts.depth_gate = true;
      else if (part == "joint")
        options.joint = true;
      else if (part == "heads")
        options.heads = true;
      else if (part.starts_with(kKeepStart))
        options.keep_start = std::stod(part.substr(kKeepStart.size()));
      else
        throw std::runtime_error("parts: unknown value '" + part +
                                 "'; use denoising, depth-gate, joint, heads or keep-start=SHARE");
    }
    return std::make_unique<FusionDetector>(options, weights);
  });
}

void region(void*, float out[4]) {
  out[0] = static_cast<float>(mirage::fusion::kXMin);
  out[1] = static_cast<float>(mirage::fusion::kXMax);
  out[2] = static_cast<float>(mirage::fusion::kYMin);
  out[3] = static_cast<float>(mirage::fusion::kYMax);
}

int image_features(void* detector, const MirageSensorInput* input, MirageImageFeatures* features, char* error,
                   size_t error_size) {
  return guarded(error, error_size, [&] { *features = Functions::of(detector).image_features(*input); });
}

const char* why_whole(void* detector) {
  return Functions::of(detector).why_whole();
}

int forward_changed(void* detector, const MirageSensorInput* input, const MirageChange* change,
                    float score_threshold, int32_t keep_graph, const MirageProposal** proposals,
                    int64_t* count, char* error, size_t error_size) {
  return guarded(error, error_size, [&] {
    mirage::give(Functions::of(detector).forward_changed(*input, *change, score_threshold, keep_graph != 0),
                 proposals, count);
  });
}

int watch(void* detector, const float* places, int64_t count, char* error, size_t error_size) {
  return guarded(error, error_size, [&] { Functions::of(detector).watch(places, count); });
}

int presence(void* detector, float* d_presence, int64_t count, char* error, size_t error_size) {
  return guarded(error, error_size, [&] {
    const auto by_place = Functions::of(detector).presence();
    if (static_cast<int64_t>(by_place.size()) != count)
      throw std::runtime_error("presence: the last backward was of a forward that watched " +
                               std::to_string(by_place.size()) + " places, not " + std::to_string(count));
    std::copy(by_place.begin(), by_place.end(), d_presence);
  });
}

const MirageDetectorApi3 kApi = {MIRAGE_DETECTOR_ABI_3,
                                 "fusion",
                                 create,
                                 Functions::destroy,
                                 region,
                                 Functions::forward,
                                 Functions::backward,
                                 Functions::train_step,
                                 Functions::save,
                                 Functions::capabilities,
                                 Functions::share,
                                 image_features,
                                 why_whole,
                                 forward_changed,
                                 watch,
                                 presence};

}  // namespace

extern "C" __attribute__((visibility("default"))) const MirageDetectorApi3* mirage_detector_api(void) {
  return &kApi;
}
