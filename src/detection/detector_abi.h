/* The plugin interface of detectors, version 4: plain C, plain spans, no exceptions across it.
 *
 * A detector is a shared library that exports
 *     const MirageDetectorApi* mirage_detector_api(void);
 * The host checks abi_version before it touches anything else. A function that returns int returns 0 on
 * success and otherwise writes one line to `error` (error_size bytes, NUL-terminated): 2 says that the
 * weights file, which the user gave, is to blame, any other number that something failed. An instance is used
 * by one thread at a time.
 *
 * The ego frame is the frame of boxes, returns and poses: metres, x forward, y left, z up. KITTI's is that of
 * its Velodyne. target_from_source are row-major 3x4: p_target = M (x, y, z, 1). */
#ifndef MIRAGE_DETECTION_DETECTOR_ABI_H_
#define MIRAGE_DETECTION_DETECTOR_ABI_H_

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define MIRAGE_DETECTOR_ABI 4u

/* Kinds of sensors. */
#define MIRAGE_CAMERA 1u
#define MIRAGE_LIDAR 2u
#define MIRAGE_OTHER 4u /* any other: its plugin defines its array (simulation/sensor_abi.h) */

/* One sensor's data. */
typedef struct MirageSensor {
  const char* name; /* "camera", "lidar", "CAM_BACK" */
  uint32_t kind;    /* MIRAGE_CAMERA, MIRAGE_LIDAR or MIRAGE_OTHER */
  /* A camera: rows x columns x 3, scene-linear RGB in [0, 1], row 0 on top. A LiDAR: returns x 4: x, y, z (m,
   * ego frame whatever its mount), reflectance in [0, 1]. */
  const float* data;
  int64_t shape[3]; /* rows, columns, 3; or returns, 4, 1; or as its plugin says. 0 first: it saw nothing */
  double sensor_from_ego[12]; /* a camera's axes: x right, y down, z forward */
  double intrinsics[9];       /* row-major 3x3 of a camera; (0, 0) is the centre of the upper left pixel */
  double time;                /* s, as MirageFrame.time */
} MirageSensor;

/* One moment. The host keeps the memory alive until the next call of forward or destroy. */
typedef struct MirageFrame {
  const char* id;
  const char*
      sequence; /* the drive that it is of; "": not known, and then time and pose are 0 and identity */
  double time;  /* s, from the start of the sequence */
  double world_from_ego[12];
  const MirageSensor* sensors;
  int64_t sensor_count;
} MirageFrame;

/* One answer, before non-maximum suppression. score = sigmoid(logit). Values that it does not find are 0. */
typedef struct MirageDetection {
  float x, y, z;                    /* the box's centre (m, ego) */
  float length, width, height, yaw; /* m; yaw counter-clockwise from +x. height 0: from above alone */
  float left, top, right, bottom;   /* pixels */
  int32_t camera;                   /* the camera of that box: index into MirageFrame.sensors */
  float logit;
  int32_t type;      /* index into MirageCapabilities.types */
  int32_t identity;  /* of a tracker: the same for the same object; -1: not known */
  float velocity[3]; /* m/s over ground, axes of the ego frame; NaN: not known */
} MirageDetection;

/* A detector's inputs, outputs and abilities. Flags of version 3 keep their values. */
#define MIRAGE_FINDS_BEV 4u       /* x, y, length, width, yaw */
#define MIRAGE_FINDS_HEIGHTS 64u  /* z and height, too */
#define MIRAGE_FINDS_PICTURE 8u   /* left, top, right, bottom; with MIRAGE_FINDS_BEV both are of one object */
#define MIRAGE_HAS_GRADIENTS 128u /* backward */
#define MIRAGE_HAS_LOCAL_PASSES 16u /* MiragePass.clean saves it work */
#define MIRAGE_KNOWS_PRESENCE 32u   /* MiragePass.watched */
#define MIRAGE_REMEMBERS 256u       /* answers depend on the frames before: reset */
/* A detector's description. */
typedef struct MirageCapabilities {
  uint32_t flags; /* MIRAGE_FINDS_… | MIRAGE_HAS_… | … */
  uint32_t kinds; /* of sensors that it reads: MIRAGE_CAMERA | MIRAGE_LIDAR */
  const char* const*
      sensors; /* sensors that it reads, by name, of any kind; sensor_count 0: all of these kinds */
  int64_t sensor_count;
  const char* const* types; /* classes that it finds, by KITTI's, nuScenes', Waymo's or Argoverse's names */
  int64_t type_count;       /* at least 1 */
  float region[4];          /* where it looks: x_min, x_max, y_min, y_max (m, ego) */
  const char* why_whole;    /* NULL, or why its local passes are no shorter than whole ones */
} MirageCapabilities;

/* A clean input with an object in it. The returns may differ anywhere; of the camera i of
 * `sensors` the pictures are the same outside the rectangle left, top, right, bottom (exclusive, pixels) at
 * changed + 4 i. */
typedef struct MirageClean {
  const MirageFrame* frame; /* the same sensors at the same places */
  uint64_t key;             /* the same for the same clean frame */
  const int32_t* changed;
} MirageClean;

/* The arguments of forward. */
typedef struct MiragePass {
  const MirageFrame* frame;
  float score_threshold; /* answers with a score over it, in a fixed order; the host drops others */
  int32_t keep_graph;    /* prepare backward */
  /* NULL, or the frame without the object: outputs for it may be cached. Answers are those of the whole
   * pass up to rounding; backward then fills gradients inside the rectangles and of returns that are not in
   * the clean sweep, and the rest may be 0. */
  const MirageClean* clean;
  /* Places (count x 4: x, y, z in m, ego; the fourth is 0) for which backward gives the effect of a further
   * return (d_presence). */
  const float* watched;
  int64_t watched_count;
} MiragePass;

/* Where backward writes d loss / d data of the sensor of that name, in its shape. */
typedef struct MirageGradient {
  const char* name;
  float* data;
} MirageGradient;

/* A box of the ground truth: in space (length over 0) or in the first camera's picture (right over left). */
typedef struct MirageLabel {
  float x, y, z, length, width, height, yaw; /* height 0: not known */
  float left, top, right, bottom;
  int32_t counts; /* 1: must be found; 0: gives no loss either way */
} MirageLabel;

/* One training sample. */
typedef struct MirageTrainingFrame {
  MirageFrame frame;
  const MirageLabel* labels;
  int64_t label_count;
  const uint8_t* vehicle_mask; /* rows x columns of the first camera: 1 a vehicle; NULL: unknown */
  uint64_t picture_key;        /* the same for the same picture of a data set; 0: keep nothing */
} MirageTrainingFrame;

/* Euclidean norms of the image features over their channels; memory of the detector until its next call. */
typedef struct MirageFeatureMaps {
  const float* map; /* rows x columns in the first camera's picture, from its upper left corner */
  int64_t rows, columns;
  float stride;     /* pixels that one value covers along a side */
  const float* bev; /* columns along x from x_min, rows along y from y_min of the region */
  int64_t bev_rows, bev_columns;
  float cell; /* m */
} MirageFeatureMaps;

/* The table of a detector plugin's functions. */
typedef struct MirageDetectorApi {
  uint32_t abi_version; /* MIRAGE_DETECTOR_ABI */
  const char* name;     /* "fusion" */

  /* `options_json`: {"modality": the detector's name as the user gave it, "seed": N, "threads": N, "start":
   * bool, "precision": "float", "bfloat16" or "double", "locality": metres (0: exact), "camera", "lidar":
   * weights files that a new training starts from, "clean_memory_mb": N, "parts": [names]}; `weights`: a
   * file, or NULL for freshly initialised weights and where there are none. NULL on failure. */
  void* (*create)(const char* options_json, const char* weights, char* error, size_t error_size);
  /* Ends an instance that create or share gave. */
  void (*destroy)(void* detector);
  /* Of this instance; the struct and its pointers live as long. */
  const MirageCapabilities* (*capabilities)(void* detector);

  /* Runs the network. Points *detections at memory of the detector, valid until the next call. */
  int (*forward)(void* detector, const MiragePass* pass, const MirageDetection** detections, int64_t* count,
                 char* error, size_t error_size);
  /* Vector-Jacobian product of the last forward(keep_graph): d_logits has one value a detection, 0 for
   * those that the host dropped. `d_presence`: d loss / d number of returns at each watched place; NULL
   * without any. NULL without MIRAGE_HAS_GRADIENTS. */
  int (*backward)(void* detector, const float* d_logits, int64_t count, const MirageGradient* gradients,
                  int64_t gradient_count, float* d_presence, char* error, size_t error_size);
  /* Forgets previous frames; `sequence` begins ("": a frame that stands alone). NULL without
   * MIRAGE_REMEMBERS. */
  int (*reset)(void* detector, const char* sequence, char* error, size_t error_size);

  /* The rest may be NULL: the detector cannot. */

  /* Another instance on the same weights, for another thread; NULL on failure. Only one of them is trained,
   * and while it is, no other runs. */
  void* (*share)(void* detector, char* error, size_t error_size);
  /* One optimiser step on the mean loss of the samples. Writes the loss terms: total, score, box. */
  int (*train_step)(void* detector, const MirageTrainingFrame* samples, int64_t count, float learning_rate,
                    float loss[3], char* error, size_t error_size);
  /* Saves weights (with_optimiser != 0: and the optimiser's state, for resuming) to `file`. */
  int (*save)(void* detector, const char* file, int32_t with_optimiser, char* error, size_t error_size);
  /* How strongly the image features answer to a frame. */
  int (*image_features)(void* detector, const MirageFrame* frame, MirageFeatureMaps* features, char* error,
                        size_t error_size);
} MirageDetectorApi;

typedef const MirageDetectorApi* (*MirageDetectorEntry)(void);

#ifdef __cplusplus
}
#endif

#endif
