// A detector plugin that is wrong in one way, chosen by FAKE at compile time. The loader's tests open it.
#include <cstdio>
#include <stdexcept>

#include "detection/detector_abi.h"

#define FAKE_WORKS 0
#define FAKE_WRONG_ABI 1
#define FAKE_REFUSES 2
#define FAKE_THROWS_IN_CREATE 3
#define FAKE_THROWS_IN_FORWARD 4
#define FAKE_FAILS_IN_FORWARD 5
#define FAKE_NOT_FINITE 6
#define FAKE_NO_ENTRY 7

namespace {

int instance = 0;
MirageProposal proposal = {{10, 1, 4, 2, 0}, 3};

void* create(const char*, const char*, char* error, size_t error_size) {
  if (FAKE == FAKE_THROWS_IN_CREATE) throw std::runtime_error("thrown on purpose");
  if (FAKE == FAKE_REFUSES) {
    std::snprintf(error, error_size, "these weights are for another network");
    return nullptr;
  }
  return &instance;
}
void destroy(void*) {}
void region(void*, float out[4]) {
  const float values[] = {0, 50, -25, 25};
  for (int i = 0; i < 4; ++i) out[i] = values[i];
}
int forward(void*, const MirageSensorInput*, float, int32_t, const MirageProposal** proposals, int64_t* count,
            char* error, size_t error_size) {
  if (FAKE == FAKE_THROWS_IN_FORWARD) throw std::runtime_error("thrown on purpose");
  if (FAKE == FAKE_FAILS_IN_FORWARD) {
    std::snprintf(error, error_size, "out of luck");
    return 1;
  }
  if (FAKE == FAKE_NOT_FINITE) proposal.logit = __builtin_nanf("");
  *proposals = &proposal;
  *count = 1;
  return 0;
}
int backward(void*, const float* d_logits, int64_t, float* d_image, float* d_points, char*, size_t) {
  if (d_image) d_image[0] = d_logits[0];
  if (d_points) d_points[0] = 2 * d_logits[0];
  return 0;
}
int train_step(void*, const MirageSample*, int64_t, float, float loss[3], char*, size_t) {
  loss[0] = loss[1] = loss[2] = 1;
  return 0;
}
int save(void*, const char*, int32_t, char*, size_t) {
  return 0;
}

const MirageDetectorApi api = {FAKE == FAKE_WRONG_ABI ? 999u : MIRAGE_DETECTOR_ABI,
                               "fake",
                               create,
                               destroy,
                               region,
                               forward,
                               backward,
                               train_step,
                               save};

}  // namespace

#if FAKE == FAKE_NO_ENTRY
extern "C" const MirageDetectorApi* some_other_function() {
  return &api;
}
#else
extern "C" const MirageDetectorApi* mirage_detector_api() {
  return &api;
}
#endif
