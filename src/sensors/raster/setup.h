// Set-up of the fast soft rasteriser (raster_batch.h): faces in sample coordinates, and their tiles.
//
// Sample coordinates: x right, y down, sample (i, j) of the s-times finer grid at (i, j). Set-up runs in
// double; a tile's kernel reads values relative to the tile, which float represents accurately.
#pragma once

#include <cstdint>
#include <vector>

#include "sensors/screen_mesh.h"

namespace mirage::raster {

inline constexpr int kTile = 32;  ///< samples along a tile's side, at most

/// Edge k runs from vertex k to vertex k + 1. With p a sample:
///     s_k = n_k · (p − v_k)   signed distance to the line, positive inside
///     r_k = e_k · (p − v_k)   position along it, [0, length_k] on the edge
/// Barycentric b_k = s_{k+1} · inv_altitude_k.
struct FaceSetup {
  int face = 0;  ///< index in the screen mesh
  double x[3], y[3];
  double nx[3], ny[3], ex[3], ey[3];
  float length[3], inv_length[3], inv_altitude[3];
  float delta[3];                       ///< middle / z_k − 1: a small number, accurate in float
  float front = 0;                      ///< largest depth key (middle − z) / (far − near) of a vertex
  double low_x, high_x, low_y, high_y;  ///< bounding box grown by √T
  double slope_bound = 1;               ///< scale of the barycentric slope of an edge-on face
  bool colored = true;                  ///< its visible side gives colour
};

/// A mesh ready to be drawn into one window.
struct Setup {
  double samples_per_ndc = 1;        ///< s L / 2
  double nearest = 1, farthest = 1;  ///< depths (m) of the corners between near and far
  double middle = 1;                 ///< depth (m) with depth key 0
  double depth_range = 1;            ///< far − near
  double reach = 0;                  ///< √T in samples
  std::vector<FaceSetup> faces;      ///< usable ones, the nearest first

  int tile_pixels = 1;                ///< side of a tile in pixels
  int columns = 0, rows = 0;          ///< tiles of the window
  std::vector<int> first;             ///< first entry of each tile in `binned`; columns · rows + 1 values
  std::vector<std::uint32_t> binned;  ///< indices into faces, the nearest first
  std::vector<int> cursor;            ///< scratch
  std::vector<std::uint32_t> order;
  std::vector<FaceSetup> unsorted;
};

/// Throws InputError, naming the field, for meaningless settings (σ ≤ 0, NaN, far ≤ near, …).
void check_settings(const SoftRasterSettings<double>& settings);

/// Fills `setup`, reusing its memory.
void set_up(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
            const RasterTarget<float>& target, Setup& setup);

/// Sums over a face's samples in a tile: d loss / d the values that its gradient follows from.
struct FaceGradientSums {
  float x[3], y[3];  ///< vertex k in sample coordinates
  float delta[3];    ///< delta_k
};

/// Adds a face's sums to the gradient of its vertices in NDC and depth.
void add_face_gradient(const Setup& setup, const FaceSetup& face, const FaceGradientSums& sums,
                       std::array<Vec3<double>, 3>& d_face);

}  // namespace mirage::raster
