// The table of functions of --detector clusters.
#include <memory>
#include <string>

#include "../../c_interface.h"
#include "clusters_detector.h"

namespace {

using mirage::guarded;
using namespace mirage::clusters;

/// It has no state but its last answer.
struct ClustersDetector {
  std::vector<MirageDetection> found;
};

ClustersDetector& instance(void* detector) {
  return *static_cast<ClustersDetector*>(detector);
}

void* create(const char* /*options_json*/, const char* weights, char* error, size_t error_size) {
  std::unique_ptr<ClustersDetector> detector;
  guarded(error, error_size, [&] {
    if (weights) mirage::bad("weights", "clusters has none", "leave --weights out");
    detector = std::make_unique<ClustersDetector>();
  });
  return detector.release();
}

void destroy(void* detector) {
  delete &instance(detector);
}

const MirageCapabilities* capabilities(void*) {
  static const MirageCapabilities all = [] {
    MirageCapabilities can{};
    can.flags = MIRAGE_FINDS_BEV | MIRAGE_FINDS_HEIGHTS;
    can.kinds = MIRAGE_LIDAR;
    can.types = kTypes, can.type_count = std::size(kTypes);
    std::copy(std::begin(kRegion), std::end(kRegion), can.region);
    return can;
  }();
  return &all;
}

int forward(void* detector, const MiragePass* pass, const MirageDetection** detections, int64_t* count,
            char* error, size_t error_size) {
  return guarded(error, error_size, [&] {
    auto& found = instance(detector).found;
    found = detect(*pass->frame, pass->score_threshold);
    *detections = found.data();
    *count = static_cast<int64_t>(found.size());
  });
}

void* share(void*, char* error, size_t error_size) {
  std::unique_ptr<ClustersDetector> other;
  guarded(error, error_size, [&] { other = std::make_unique<ClustersDetector>(); });
  return other.release();
}

const MirageDetectorApi kApi = {MIRAGE_DETECTOR_ABI,
                                "clusters",
                                create,
                                destroy,
                                capabilities,
                                forward,
                                nullptr,
                                nullptr,
                                share,
                                nullptr,
                                nullptr,
                                nullptr};

}  // namespace

extern "C" __attribute__((visibility("default"))) const MirageDetectorApi* mirage_detector_api(void) {
  return &kApi;
}
