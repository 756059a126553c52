// A depth completion plugin that is wrong in one way, chosen by FAKE at compile time. The loader's tests open
// it.
#include <cstdio>
#include <stdexcept>

#include "scene/depth/depth_abi.h"

#define FAKE_WORKS 0
#define FAKE_WRONG_ABI 1
#define FAKE_REFUSES 2
#define FAKE_THROWS_IN_CREATE 3
#define FAKE_THROWS_IN_COMPLETE 4
#define FAKE_FAILS_IN_COMPLETE 5
#define FAKE_NOT_FINITE 6
#define FAKE_NO_ENTRY 7

namespace {

int instance = 0;

void* create(const char*, const char*, char* error, size_t error_size) {
  if (FAKE == FAKE_THROWS_IN_CREATE) throw std::runtime_error("thrown on purpose");
  if (FAKE == FAKE_REFUSES) {
    std::snprintf(error, error_size, "these weights are for another network");
    return nullptr;
  }
  return &instance;
}
void destroy(void*) {}
/// Gives back the sparse depth.
int complete(void*, const MirageDepthInput* input, float* dense, char* error, size_t error_size) {
  if (FAKE == FAKE_THROWS_IN_COMPLETE) throw std::runtime_error("thrown on purpose");
  if (FAKE == FAKE_FAILS_IN_COMPLETE) {
    std::snprintf(error, error_size, "out of luck");
    return 1;
  }
  for (int i = 0; i < input->width * input->height; ++i) dense[i] = input->sparse[i];
  if (FAKE == FAKE_NOT_FINITE) dense[1] = __builtin_nanf("");
  return 0;
}
int train_step(void*, const MirageDepthSample*, int64_t, float, float loss[3], char*, size_t) {
  loss[0] = loss[1] = loss[2] = 1;
  return 0;
}
int save(void*, const char*, int32_t, char*, size_t) {
  return 0;
}

const MirageDepthApi api = {
    FAKE == FAKE_WRONG_ABI ? 999u : MIRAGE_DEPTH_ABI, "fake", create, destroy, complete, train_step, save};

}  // namespace

#if FAKE == FAKE_NO_ENTRY
extern "C" const MirageDepthApi* some_other_function() {
  return &api;
}
#else
extern "C" const MirageDepthApi* mirage_depth_api() {
  return &api;
}
#endif
