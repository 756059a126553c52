/* A detector in a process of its own, in C or C++: fill a MirageProgram, end main with
 * mirage_serve(&program).
 *
 *     mirage detect --detector "exec:./my_detector" --data path/to/kitti
 *
 * The protocol, for any other language. Mirage writes JSON objects to standard input, one a line,
 * {"id": N, "job": …}, and for each reads one line back from standard output, {"id": N, "ok": true, …} or
 * {"id": N, "ok": false, "error": "one line"}. Print nothing else there. Arrays lie in a memory that both
 * map: {"at": byte, "shape": [lengths], "type": "float32"}.
 *
 * job hello
 *   protocol   1
 *   memory     a path: open it for reading and writing, and map it
 *   threads, seed
 *   ← protocol 1
 *   ← reads    ["image", "points"], or one of them; and names of further sensors ("CAM_BACK")
 *   ← finds    "boxes", or "picture" for boxes in the picture
 *   ← pictures "linear", or "srgb8": as files have them
 *   ← gradient true if it answers the job gradient
 *   ← region   [x_min, x_max, y_min, y_max] (m) that it searches
 *   ← heights  true if z and height of its boxes count; remembers: true if frames before count
 *   ← classes  ["Car", …], in the order of the answers' numbers
 *   ← version  a text that changes with the network: its answers may be kept on disk under it
 *   ← local    true if clean of the job detect saves it work
 * job detect
 *   size       bytes to map; answer_at: the byte from which answers may stand
 *   threshold  of the score: boxes below it are dropped; gradient: true if the job gradient may follow
 *   frame      its id; continues: false if it does not follow the frame before
 *   moment     where the data set knows it: sequence, index, time (s), world_from_ego (3 × 4)
 *   cameras    {NAME: {image: H × W × 3 (float32 in [0, 1], or uint8 with "srgb8"), row 0 on top,
 *              pixel_from_velo (3 × 4: (u w, v w, w) = M (x, y, z, 1)), intrinsics (fx, fy, cx, cy),
 *              sensor_from_ego (3 × 4), time}}; the first is called camera
 *   lidars     {NAME: {points: N × 4 float32: x, y, z (m), reflectance, time}}; the first is called lidar
 *   sensors    {NAME: {data: float32, as its plugin gives it, sensor_from_ego, time}}: of other kinds. A
 *              tracker reads "detections": M × 8, x, y, z of the centre, length, width, height, yaw, score
 *   clean      with local: the frame without the object. cameras and lidars as above, each camera with
 *              changed (left, top, right, bottom; pixels, exclusive), outside which its pictures are equal;
 *              key: a text that stays while the clean frame does, under which to cache its results.
 *              Gradients of unchanged pixels and of the clean sweep's returns may then be 0
 *   ← boxes    M × 5: x, y, length, width, yaw; M × 7: x, y, z of the centre, length, width, height, yaw;
 *              M × 9: and vx, vy; for "picture" M × 4: left, top, right, bottom
 *   ← logits   M, of all boxes before suppression; classes: M, int32
 *   ← identities  M, int32, of a tracker: the same for the same object, 0 or more
 * job gradient
 *   size, answer_at
 *   d_logits   M, of the last detect
 *   ← cameras  {NAME: {d_image: H × W × 3}}; with "srgb8" by the level, 0 … 255
 *   ← lidars   {NAME: {d_points: N × 4}}; sensors: {NAME: {d_data}}; missing ones are 0
 *
 * Ignore keys that you do not know. Standard input ends when Mirage is done: end, too. A program
 * that dies or gives no answer is started again and asked once more. Metres, radians; x forward, y left,
 * z up, in the LiDAR's frame. */
#ifndef MIRAGE_PROCESS_H_
#define MIRAGE_PROCESS_H_

#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

/* One frame of one camera and one LiDAR. */
typedef struct MirageFrame {
  const float* image; /* height × width × 3, scene-linear; NULL without a picture */
  long width, height;
  const float* points; /* point_count × 4 */
  long point_count;
  double pixel_from_velo[12];
  int gradient; /* whether a gradient may be asked for */
} MirageFrame;

typedef struct MirageProgram {
  void* mine; /* handed to the functions */
  int finds_picture;
  /* Writes at most `most` rows of 7 (x, y, z, length, width, height, yaw), of 4 if finds_picture, and their
   * logits. The number of rows, or −1 with a reason in `error` (256 bytes). */
  long (*detect)(void* mine, const MirageFrame* frame, float* boxes, float* logits, long most, char* error);
  /* NULL without one. Fills d_image and d_points (as the frame's; zero before). 0, or −1 with a reason. */
  int (*gradient)(void* mine, const float* d_logits, long count, float* d_image, float* d_points,
                  char* error);
} MirageProgram;

enum { MIRAGE_MOST_BOXES = 100000 };

/* The text after "key": within the object that begins at `text`, or NULL. Quoted texts, such as a
 * frame's id, are skipped. */
static const char* mirage_after(const char* text, const char* key) {
  char quoted[64];
  const int length = snprintf(quoted, sizeof quoted, "\"%s\":", key);
  int depth = 0;
  for (; text && *text; ++text) {
    if (*text == '{') ++depth;
    if (*text == '}' && --depth == 0) return NULL;
    if (*text != '"') continue;
    if (strncmp(text, quoted, (size_t)length) == 0) return text + length;
    for (++text; *text && *text != '"'; ++text)
      if (*text == '\\' && text[1]) ++text;
    if (!*text) return NULL;
  }
  return NULL;
}

static long mirage_number(const char* text, const char* key) {
  const char* at = mirage_after(text, key);
  return at ? strtol(at, NULL, 10) : 0;
}

/* Reads up to `most` numbers of the list after the key; returns how many. */
static int mirage_numbers(const char* text, const char* key, double* numbers, int most) {
  const char* at = mirage_after(text, key);
  int count = 0;
  if (!at || *at != '[') return 0;
  while (*at != ']' && count < most) {
    char* end;
    numbers[count++] = strtod(at + 1, &end);
    at = end;
  }
  return count;
}

/* Answers Mirage until it closes the connection. The exit code for main. */
static int mirage_serve(const MirageProgram* program) {
  char *line = NULL, *memory = NULL;
  size_t room = 0, mapped = 0;
  int file = -1;
  long image_at = 0, points_at = 0;
  MirageFrame frame;
  memset(&frame, 0, sizeof frame);
  while (getline(&line, &room, stdin) > 0) {
    const char* job = mirage_after(line, "job");
    const long id = mirage_number(line, "id"), answer_at = mirage_number(line, "answer_at");
    const size_t size = (size_t)mirage_number(line, "size");
    char error[256] = "";
    if (job && strncmp(job, "\"hello\"", 7) == 0) {
      char path[256] = "";
      sscanf(mirage_after(line, "memory"), "\"%255[^\"]", path);
      file = open(path, O_RDWR);
      if (file < 0) return 1;
      printf("{\"id\":%ld,\"ok\":true,\"protocol\":1,\"finds\":\"%s\",\"gradient\":%s}\n", id,
             program->finds_picture ? "picture" : "boxes", program->gradient ? "true" : "false");
      fflush(stdout);
      continue;
    }
    if (size != mapped) {
      if (memory) munmap(memory, mapped);
      memory = (char*)mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
      if (memory == (char*)MAP_FAILED) return 1;
      mapped = size;
    }
    if (job && strncmp(job, "\"detect\"", 8) == 0) {
      double shape[3] = {0, 0, 0};
      const char* camera = mirage_after(line, "camera");
      const char *image = mirage_after(camera, "image"),
                 *points = mirage_after(mirage_after(line, "lidar"), "points");
      image_at = mirage_number(image, "at");
      points_at = mirage_number(points, "at");
      frame.height = image && mirage_numbers(image, "shape", shape, 3) ? (long)shape[0] : 0;
      frame.width = image ? (long)shape[1] : 0;
      frame.image = image ? (const float*)(memory + image_at) : NULL;
      frame.point_count = points && mirage_numbers(points, "shape", shape, 3) ? (long)shape[0] : 0;
      frame.points = (const float*)(memory + points_at);
      mirage_numbers(camera, "pixel_from_velo", frame.pixel_from_velo, 12);
      frame.gradient = mirage_after(line, "gradient") && *mirage_after(line, "gradient") == 't';
      const int columns = program->finds_picture ? 4 : 7;
      const long logits_at = answer_at + 4L * columns * MIRAGE_MOST_BOXES;
      const long count = program->detect(program->mine, &frame, (float*)(memory + answer_at),
                                         (float*)(memory + logits_at), MIRAGE_MOST_BOXES, error);
      if (count >= 0)
        printf(
            "{\"id\":%ld,\"ok\":true,\"boxes\":{\"at\":%ld,\"shape\":[%ld,%d]},\"logits\":{\"at\":%ld,"
            "\"shape\":[%ld]}}\n",
            id, answer_at, count, columns, logits_at, count);
      else
        printf("{\"id\":%ld,\"ok\":false,\"error\":\"%s\"}\n", id, error);
    } else {
      const char* d_logits = mirage_after(line, "d_logits");
      double count = 0;
      const size_t pixels = frame.image ? 3u * (size_t)(frame.width * frame.height) : 0,
                   values = 4u * (size_t)frame.point_count;
      float* d_image = (float*)(memory + answer_at);
      float* d_points = d_image + pixels;
      memset(d_image, 0, 4 * (pixels + values));
      mirage_numbers(d_logits, "shape", &count, 1);
      if (program->gradient &&
          program->gradient(program->mine, (const float*)(memory + mirage_number(d_logits, "at")),
                            (long)count, d_image, d_points, error) == 0) {
        printf("{\"id\":%ld,\"ok\":true", id);
        if (pixels)
          printf(",\"cameras\":{\"camera\":{\"d_image\":{\"at\":%ld,\"shape\":[%ld,%ld,3]}}}", answer_at,
                 frame.height, frame.width);
        printf(",\"lidars\":{\"lidar\":{\"d_points\":{\"at\":%ld,\"shape\":[%ld,4]}}}}\n",
               answer_at + 4L * (long)pixels, frame.point_count);
      } else {
        printf("{\"id\":%ld,\"ok\":false,\"error\":\"%s\"}\n", id, error[0] ? error : "no gradient");
      }
    }
    fflush(stdout);
  }
  free(line);
  return 0;
}

#endif
