/* The plugin interface of depth completion: plain C, plain arrays, no exceptions across it.
 *
 * A back-end is a shared library that exports
 *     const MirageDepthApi* mirage_depth_api(void);
 * The host checks abi_version before it touches anything else. Every function that can fail returns 0 on
 * success and otherwise writes one line to `error` (error_size bytes, NUL-terminated).
 * An instance is used by one thread at a time. */
#ifndef MIRAGE_SCENE_DEPTH_DEPTH_ABI_H_
#define MIRAGE_SCENE_DEPTH_DEPTH_ABI_H_

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define MIRAGE_DEPTH_ABI 1u

/* What a completion reads: the picture and the sparse depth of the same pixels. */
typedef struct MirageDepthInput {
  const float* image;    /* height x width x 3, scene-linear RGB, row 0 on top; finite */
  const float* sparse;   /* height x width, planar depth in m; 0 where no return; finite */
  int32_t width, height; /* pixels */
} MirageDepthInput;

/* One training sample. truth: height x width, planar depth in m; 0: nothing there (sky); negative: not known,
 * no loss either way. */
typedef struct MirageDepthSample {
  MirageDepthInput input;
  const float* truth;
} MirageDepthSample;

/* The table of a depth plugin's functions. */
typedef struct MirageDepthApi {
  uint32_t abi_version; /* MIRAGE_DEPTH_ABI */
  const char* name;     /* "guided" */

  /* `options_json`: {"seed": N, "threads": N}; `weights`: a file, or NULL for freshly initialised weights.
   * NULL on failure. */
  void* (*create)(const char* options_json, const char* weights, char* error, size_t error_size);
  /* Ends an instance that create gave. */
  void (*destroy)(void* completion);

  /* Fills dense (height x width): planar depth in m, 0 where there is nothing. */
  int (*complete)(void* completion, const MirageDepthInput* input, float* dense, char* error,
                  size_t error_size);

  /* One optimiser step on the mean loss of the samples. Writes the loss terms: total, depth, presence. */
  int (*train_step)(void* completion, const MirageDepthSample* samples, int64_t count, float learning_rate,
                    float loss[3], char* error, size_t error_size);
  /* Saves weights (with_optimiser != 0: and the optimiser's state, for resuming) to `file`. */
  int (*save)(void* completion, const char* file, int32_t with_optimiser, char* error, size_t error_size);
} MirageDepthApi;

typedef const MirageDepthApi* (*MirageDepthEntry)(void);

#ifdef __cplusplus
}
#endif

#endif
