// A depth completion plugin with one error. The loader's tests open it.
#include "scene/depth/depth_abi.h"
#include "support/fake_plugin.h"

namespace {

using namespace mirage::test;

/// Returns the sparse depth.
int complete(void*, const MirageDepthInput* input, float* dense, char* error, size_t error_size) {
  if (const int status = begin_run(error, error_size)) return status;
  for (int i = 0; i < input->width * input->height; ++i) dense[i] = input->sparse[i];
  if (kFake == Fake::not_finite) dense[1] = __builtin_nanf("");
  return 0;
}

const MirageDepthApi api = {abi(MIRAGE_DEPTH_ABI),         "fake", create, destroy, complete,
                            train_step<MirageDepthSample>, save};

}  // namespace

extern "C" const MirageDepthApi* MIRAGE_FAKE_ENTRY(mirage_depth_api)() {
  return &api;
}
