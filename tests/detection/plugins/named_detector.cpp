// A working detector plugin of version 4: it reads two cameras and a LiDAR by name, finds two classes in 3-D
// and keeps state. Its answers repeat its inputs.
#include <cmath>
#include <cstring>

#include "detection/detector_abi.h"
#include "support/fake_plugin.h"

namespace {

using namespace mirage::test;

const char* const kSensors[] = {"camera", "lidar", "back"};
const char* const kTypes[] = {"human.pedestrian.adult", "vehicle.car"};
const MirageCapabilities kCapabilities = {MIRAGE_FINDS_BEV | MIRAGE_FINDS_HEIGHTS | MIRAGE_FINDS_PICTURE |
                                              MIRAGE_HAS_GRADIENTS | MIRAGE_REMEMBERS |
                                              MIRAGE_KNOWS_PRESENCE | MIRAGE_HAS_LOCAL_PASSES,
                                          MIRAGE_CAMERA | MIRAGE_LIDAR,
                                          kSensors,
                                          3,
                                          kTypes,
                                          2,
                                          {-50, 50, -50, 50},
                                          nullptr};

MirageDetection found[2];
int frames = 0;  // since the last reset

const MirageCapabilities* capabilities(void*) {
  return &kCapabilities;
}
const MirageSensor* sensor(const MirageFrame& frame, const char* name) {
  for (int64_t i = 0; i < frame.sensor_count; ++i)
    if (std::strcmp(frame.sensors[i].name, name) == 0) return &frame.sensors[i];
  return nullptr;
}

/// A pedestrian, and a car behind the sensor; the car's box shows which inputs arrived.
int forward(void*, const MiragePass* pass, const MirageDetection** detections, int64_t* count, char* error,
            size_t error_size) {
  if (const int status = begin_run(error, error_size)) return status;
  const MirageFrame& frame = *pass->frame;
  const MirageSensor *back = sensor(frame, "back"), *lidar = sensor(frame, "lidar");
  ++frames;
  MirageDetection& walker = found[0];
  walker = {};
  walker.x = 5, walker.length = walker.width = 1, walker.height = 1.8f, walker.logit = 4,
  walker.identity = -1;
  walker.velocity[0] = NAN;
  MirageDetection& car = found[1];
  car = {};
  car.x = -10 - static_cast<float>(frame.sensor_count), car.y = static_cast<float>(frames), car.z = -1;
  car.length = 4, car.width = 2, car.height = 1.5f;
  car.left = 1, car.right = 90, car.top = 1, car.bottom = 5, car.camera = 2;
  car.logit = back->data[0] + lidar->data[0] + (pass->clean ? 100.f : 0.f);
  car.type = 1, car.identity = 7;
  car.velocity[0] = static_cast<float>(back->sensor_from_ego[3]), car.velocity[1] = 0, car.velocity[2] = 0;
  *detections = found;
  *count = 2;
  return 0;
}
int backward(void*, const float* d_logits, int64_t, const MirageGradient* gradients, int64_t count,
             float* d_presence, char*, size_t) {
  for (int64_t i = 0; i < count; ++i)
    if (std::strcmp(gradients[i].name, "camera") != 0) gradients[i].data[0] = d_logits[1];
  if (d_presence) d_presence[0] = 3 * d_logits[1];
  return 0;
}
int reset(void*, const char*, char*, size_t) {
  frames = 0;
  return 0;
}
/// "Losses" that show which of the truth arrived.
int train_step(void*, const MirageTrainingFrame* samples, int64_t count, float, float loss[3], char*,
               size_t) {
  const MirageTrainingFrame& last = samples[count - 1];
  loss[0] = static_cast<float>(last.label_count);
  loss[1] = last.label_count > 0 ? last.labels[0].length : -1;
  loss[2] = last.label_count > 1 ? static_cast<float>(10 * last.labels[1].counts) + last.labels[1].right : -1;
  return 0;
}

const MirageDetectorApi api = {
    MIRAGE_DETECTOR_ABI, "named", create, destroy, capabilities, forward, backward, reset, nullptr,
    train_step,          save,    nullptr};

}  // namespace

extern "C" const MirageDetectorApi* mirage_detector_api() {
  return &api;
}
