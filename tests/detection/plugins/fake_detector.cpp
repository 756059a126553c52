// A detector plugin with one error. The loader's tests open it.
#include "detection/detector_abi3.h"
#include "support/fake_plugin.h"

namespace {

using namespace mirage::test;

MirageProposal proposal = {{10, 1, 4, 2, 0}, {20, 30, 50, 45}, 3};

void region(void*, float out[4]) {
  const float values[] = {0, 50, -25, 25};
  for (int i = 0; i < 4; ++i) out[i] = values[i];
}
int forward(void*, const MirageSensorInput*, float, int32_t, const MirageProposal** proposals, int64_t* count,
            char* error, size_t error_size) {
  if (const int status = begin_run(error, error_size)) return status;
  if (kFake == Fake::not_finite) proposal.logit = __builtin_nanf("");
  *proposals = &proposal;
  *count = 1;
  return 0;
}
int backward(void*, const float* d_logits, int64_t, float* d_image, float* d_points, char*, size_t) {
  if (d_image) d_image[0] = d_logits[0];
  if (d_points) d_points[0] = 2 * d_logits[0];
  return 0;
}

/// "Losses" that show which of the picture's truth arrived.
int train_step(void*, const MirageSample* samples, int64_t count, float, float loss[3], char*, size_t) {
  const MirageSample& last = samples[count - 1];
  loss[0] = static_cast<float>(10 * last.picture_box_count + last.picture_ignore_count);
  loss[1] = last.picture_box_count > 0 ? last.picture_boxes[last.picture_box_count - 1].bottom : 0;
  loss[2] = static_cast<float>(last.picture_key % 1000) + (last.vehicle_mask ? last.vehicle_mask[1] : -1);
  return 0;
}
uint32_t capabilities(void*) {
  return MIRAGE_READS_IMAGE | MIRAGE_FINDS_BEV | MIRAGE_FINDS_PICTURE;
}

const MirageDetectorApi3 api = {abi(MIRAGE_DETECTOR_ABI_3),
                                "fake",
                                create,
                                destroy,
                                region,
                                forward,
                                backward,
                                train_step,
                                save,
                                capabilities,
                                nullptr,
                                nullptr,
                                nullptr,
                                nullptr,
                                nullptr,
                                nullptr};

}  // namespace

extern "C" const MirageDetectorApi3* MIRAGE_FAKE_ENTRY(mirage_detector_api)() {
  return &api;
}
