/* The plugin interface of sensors that are neither cameras nor LiDARs: plain C, plain arrays, no exceptions
 * across it. plugins/sensors/radar is an example.
 *
 * A sensor is a shared library that exports
 *     const MirageSensorApi* mirage_sensor_api(void);
 * The host checks abi_version before it touches anything else. A function that returns int returns 0 on
 * success and otherwise writes one line to `error` (error_size bytes, NUL-terminated). An instance may be
 * used by several threads at once.
 *
 * The ego frame is that of boxes and returns: metres, x forward, y left, z up. */
#ifndef MIRAGE_SIMULATION_SENSOR_ABI_H_
#define MIRAGE_SIMULATION_SENSOR_ABI_H_

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define MIRAGE_SENSOR_ABI 1u

/* What the sensor is, and the array that it measures. */
typedef struct MirageSensorWord {
  const char* name;           /* by which detectors ask for it: "radar" */
  int64_t shape[3];           /* of the array, row-major; each at least 1 */
  double sensor_from_ego[12]; /* row-major 3x4: p_sensor = M (x, y, z, 1) */
} MirageSensorWord;

/* A labelled road user. */
typedef struct MirageBody {
  double x, y, z, length, width, height, yaw; /* the box's centre and size (m, ego); yaw from +x */
  double velocity[3];                         /* m/s over ground, axes of the ego frame; NaN: not known */
} MirageBody;

/* A frame without the object. */
typedef struct MirageSensorScene {
  const char* data;    /* the data set's folder; "": there is none */
  const char* frame;   /* its id */
  const float* points; /* point_count x 4: x, y, z (m, ego), reflectance in [0, 1]; the first LiDAR's sweep */
  int64_t point_count;
  const MirageBody* bodies;
  int64_t body_count;
} MirageSensorScene;

/* The object where it stands. */
typedef struct MirageSensorObject {
  const double* vertices; /* vertex_count x 3 (m, ego) */
  int64_t vertex_count;
  const int32_t* faces; /* face_count x 3; counter-clockwise from outside */
  int64_t face_count;
  const double* albedo; /* face_count x texels_a_face x 3, scene-linear */
  int64_t texels_a_face;
  double velocity[3]; /* of its carrier: m/s over ground, axes of the ego frame; 0 where not known */
} MirageSensorObject;

/* The table of a sensor plugin's functions. None may be NULL. */
typedef struct MirageSensorApi {
  uint32_t abi_version; /* MIRAGE_SENSOR_ABI */

  /* `options_json`: {}. NULL on failure. */
  void* (*create)(const char* options_json, char* error, size_t error_size);
  /* Frees the sensor; never called with NULL. */
  void (*destroy)(void* sensor);
  /* Lives as long as the sensor. */
  const MirageSensorWord* (*word)(void* sensor);

  /* Fills `data` (shape[0] x shape[1] x shape[2]) with what the sensor measures of the scene. `recorded`:
   * NULL, or what this function filled for the same scene without the object, so that only the object's share
   * is computed. `object`: NULL without one; with one, *tape may point to what vjp needs, until release. */
  int (*measure)(void* sensor, const MirageSensorScene* scene, const MirageSensorObject* object,
                 const double* recorded, double* data, void** tape, char* error, size_t error_size);
  /* Vector-Jacobian product of that measure: adds d loss / d vertices and d loss / d albedo, in their shapes,
   * given d loss / d data. */
  int (*vjp)(void* sensor, const void* tape, const double* d_data, double* d_vertices, double* d_albedo,
             char* error, size_t error_size);
  /* Frees a tape that measure has set; never called with NULL. */
  void (*release)(void* tape);
} MirageSensorApi;

typedef const MirageSensorApi* (*MirageSensorEntry)(void);

#ifdef __cplusplus
}
#endif

#endif
