/* The glue of a detector in C, with a toy in the network's place: one car around the returns that stand over the road in front,
 * surer the brighter they are.
 *
 *     cc -O2 plugins/process/example.c -o my_detector
 *     mirage detect --detector "exec:./my_detector" --data path/to/kitti */
#include "mirage_process.h"

typedef struct Toy {
  const MirageFrame* frame; /* the last one; its memory stays as it is until the next */
  long count;               /* of the returns that count */
} Toy;

static int counts(const float* p) {
  return p[0] > 5 && p[0] < 30 && p[1] > -4 && p[1] < 4 && p[2] > -1.4f && p[2] < 0.3f;
}

static long detect(void* mine, const MirageFrame* frame, float* boxes, float* logits, long most, char* error) {
  Toy* toy = (Toy*)mine;
  double x = 0, y = 0, bright = 0;
  toy->frame = frame;
  toy->count = 0;
  if (most < 1) return snprintf(error, 256, "no room"), -1;
  for (long i = 0; i < frame->point_count; ++i) {
    const float* p = frame->points + 4 * i;
    if (!counts(p)) continue;
    ++toy->count;
    x += p[0], y += p[1], bright += p[3];
  }
  if (toy->count < 5) return 0;
  const float box[7] = {(float)(x / toy->count), (float)(y / toy->count), -0.98f, 3.9f, 1.6f, 1.5f, 0};
  memcpy(boxes, box, sizeof box);
  logits[0] = (float)(10 * bright / toy->count);
  return 1;
}

static int gradient(void* mine, const float* d_logits, long count, float* d_image, float* d_points, char* error) {
  const Toy* toy = (const Toy*)mine;
  (void)d_image, (void)error;
  for (long i = 0; count == 1 && i < toy->frame->point_count; ++i)
    if (counts(toy->frame->points + 4 * i)) d_points[4 * i + 3] = 10 * d_logits[0] / (float)toy->count;
  return 0;
}

int main(void) {
  Toy toy = {0, 0};
  const MirageProgram program = {&toy, 0, detect, gradient};
  return mirage_serve(&program);
}
