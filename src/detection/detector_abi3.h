/* Version 3 of the plugin interface of detectors (detector_abi.h is version 4): one picture, one sweep, boxes
 * from above or in the picture. Its plugins keep working, through detection/plugin_detector.cpp.
 *
 * A detector is a shared library that exports
 *     const MirageDetectorApi3* mirage_detector_api(void);
 * The host checks abi_version before it touches anything else. Every function that can fail returns 0 on
 * success and otherwise writes one line to `error` (error_size bytes, NUL-terminated): 2 says that the
 * weights file, which the user gave, is to blame, any other number that something failed. An instance is used
 * by one thread at a time. */
#ifndef MIRAGE_DETECTION_DETECTOR_ABI3_H_
#define MIRAGE_DETECTION_DETECTOR_ABI3_H_

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define MIRAGE_DETECTOR_ABI_3 3u

/* The sensors' data. The host keeps the memory alive until the next call of forward or destroy. */
typedef struct MirageSensorInput {
  const float* image;    /* height x width x 3, scene-linear RGB in [0, 1], row 0 on top */
  int32_t width, height; /* pixels */
  const float* points;   /* point_count x 4: x, y, z (m, velo), reflectance in [0, 1] */
  int64_t point_count;
  double pixel_from_velo[12]; /* row-major 3x4: (u w, v w, w) = M (x, y, z, 1) */
} MirageSensorInput;

/* A box of the bird's-eye view in velo: metres and radians, yaw counter-clockwise from +x. */
typedef struct MirageBox {
  float x, y, length, width, yaw;
} MirageBox;

/* A box in the picture: pixels, KITTI's convention (the centre of the upper left pixel is (0, 0)). */
typedef struct MiragePictureBox {
  float left, top, right, bottom;
} MiragePictureBox;

/* One proposal, before non-maximum suppression. score = sigmoid(logit). A detector fills the boxes that it
 * finds (see capabilities) and leaves the other zero. */
typedef struct MirageProposal {
  MirageBox box;
  MiragePictureBox picture;
  float logit;
} MirageProposal;

/* One training sample: an input and the ground truth. `ignore` boxes give no loss either way. */
typedef struct MirageSample {
  MirageSensorInput input;
  const MirageBox* boxes;
  int64_t box_count;
  const MirageBox* ignore;
  int64_t ignore_count;
  /* The same in the picture, which augmentation leaves alone: vehicles that must be found there, and regions
   * that give no loss (other vehicles, DontCare). */
  const MiragePictureBox* picture_boxes;
  int64_t picture_box_count;
  const MiragePictureBox* picture_ignore;
  int64_t picture_ignore_count;
  /* height x width: 1 where the pixel shows a vehicle, 0 where not; NULL where the data set does not tell. */
  const uint8_t* vehicle_mask;
  /* The same number for the same picture of a data set, so that outputs of frozen parts of a network may be
   * cached between epochs; 0: keep nothing. */
  uint64_t picture_key;
} MirageSample;

/* A detector's inputs and outputs: flags of `capabilities`. */
#define MIRAGE_READS_IMAGE 1u
#define MIRAGE_READS_POINTS 2u
#define MIRAGE_FINDS_BEV 4u /* MirageProposal.box */
#define MIRAGE_FINDS_PICTURE                                                                                \
  8u                             /* MirageProposal.picture; boxes of a detector with both flags go together \
                                  */
#define MIRAGE_KNOWS_CHANGES 16u /* the table goes on to why_whole and forward_changed */
/* The table goes on to watch and presence, over why_whole and forward_changed, which may be NULL without the
 * flag above. */
#define MIRAGE_KNOWS_PRESENCE 32u

/* A clean input with an object in it. The points may differ anywhere; outside the rectangle
 * (left, top) to (right, bottom), exclusive, pixels, the pictures are the same. */
typedef struct MirageChange {
  const MirageSensorInput* clean; /* the clean input; the same projection */
  uint64_t key;                   /* the same for the same clean input */
  int32_t left, top, right, bottom;
} MirageChange;

/* Euclidean norms of the image features over their channels; memory of the detector until its next call. */
typedef struct MirageImageFeatures {
  const float*
      map; /* rows x columns in the image plane, row 0 on top, from the picture's upper left corner */
  int32_t columns, rows;
  float stride;     /* pixels that one value covers along a side */
  const float* bev; /* bev_rows x bev_columns: the features in the bird's-eye view; columns along x
                     * from x_min, rows along y from y_min of the region; 0 without a feature */
  int32_t bev_columns, bev_rows;
  float cell; /* m */
} MirageImageFeatures;

/* The table of a detector plugin's functions. */
typedef struct MirageDetectorApi3 {
  uint32_t abi_version; /* MIRAGE_DETECTOR_ABI_3 */
  const char* name;     /* "fusion" */

  /* `options_json`: {"modality": the detector's name as the user gave it, "seed": N, "threads": N,
   * "start": bool, "precision": "float", "bfloat16" or "double", of convolutions, "locality": metres (0:
   * exact; otherwise forward_changed may skip places further from the change), "camera": a weights
   * file that the image branch of a new training starts from, "lidar": the same for the LiDAR branch,
   * "clean_memory_mb": N, memory of forward_changed for clean inputs (0: nothing, and passes are whole),
   * "parts": [names of optional parts of a fresh or starting network: "denoising", "depth-gate"]};
   * `weights`: a file, or NULL for freshly initialised weights. start: the weights begin a new training
   * (fresh optimiser; a fusion detector may begin with a lidar detector's).
   * NULL on failure. */
  void* (*create)(const char* options_json, const char* weights, char* error, size_t error_size);
  /* Ends an instance that create or share gave. */
  void (*destroy)(void* detector);

  /* Region of the bird's-eye view that is searched: x_min, x_max, y_min, y_max (m, velo). */
  void (*region)(void* detector, float out[4]);

  /* Runs the network. Points *proposals at memory of the detector, valid until the next call: every proposal
   * whose score exceeds score_threshold, in a fixed order. keep_graph != 0 prepares backward. */
  int (*forward)(void* detector, const MirageSensorInput* input, float score_threshold, int32_t keep_graph,
                 const MirageProposal** proposals, int64_t* count, char* error, size_t error_size);

  /* Vector-Jacobian product of the last forward(keep_graph): d_logits has one value a proposal. Fills
   * d_image (height x width x 3) and d_points (point_count x 4); either may be NULL. */
  int (*backward)(void* detector, const float* d_logits, int64_t count, float* d_image, float* d_points,
                  char* error, size_t error_size);

  /* One optimiser step on the mean loss of the samples. Writes the loss terms: total, score, box. */
  int (*train_step)(void* detector, const MirageSample* samples, int64_t count, float learning_rate,
                    float loss[3], char* error, size_t error_size);
  /* Saves weights (with_optimiser != 0: and the optimiser's state, for resuming) to `file`. */
  int (*save)(void* detector, const char* file, int32_t with_optimiser, char* error, size_t error_size);

  /* MIRAGE_READS_… | MIRAGE_FINDS_… | MIRAGE_KNOWS_… of this instance. */
  uint32_t (*capabilities)(void* detector);

  /* May be NULL. Another instance on the same weights, for another thread; NULL on failure. Only one of them
   * is trained, and while it is, no other runs. */
  void* (*share)(void* detector, char* error, size_t error_size);
  /* May be NULL. How strongly the image features answer to an input; a detector without any fails. */
  int (*image_features)(void* detector, const MirageSensorInput* input, MirageImageFeatures* features,
                        char* error, size_t error_size);

  /* Only with MIRAGE_KNOWS_CHANGES. Why a pass over a change is no shorter than a whole one; "" if it is. The
   * string lives as long as the plugin. */
  const char* (*why_whole)(void* detector);
  /* As forward, with the same answers up to rounding, of an input that is mostly a clean one. backward then
   * fills d_image inside the rectangle and d_points of points that are not in the clean sweep; the rest of
   * both may be zero. */
  int (*forward_changed)(void* detector, const MirageSensorInput* input, const MirageChange* change,
                         float score_threshold, int32_t keep_graph, const MirageProposal** proposals,
                         int64_t* count, char* error, size_t error_size);

  /* Only with MIRAGE_KNOWS_PRESENCE. Places (count x 4: x, y, z in m, velo; the fourth is 0) of which the
   * next forward or forward_changed that keeps its graph is to know what a further return there would change.
   * Its answers do not change. */
  int (*watch)(void* detector, const float* places, int64_t count, char* error, size_t error_size);
  /* After backward: d loss / d number of returns at each of these places, as if the number were
   * continuous; count as in watch. */
  int (*presence)(void* detector, float* d_presence, int64_t count, char* error, size_t error_size);
} MirageDetectorApi3;

typedef const MirageDetectorApi3* (*MirageDetectorEntry3)(void);

#ifdef __cplusplus
}
#endif

#endif
