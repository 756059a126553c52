// The camera's side of the speed–accuracy study: one host, drawn in many ways.
//
// The references that a drawing is measured against:
//   image     hard edges (the nearest face, no σ, no γ) by the plain loop in double, reference_samples²
//   samples
//             a pixel, over the pixels that the object touches and one beyond;
//   gradient  of Σ w·I over the pixels, with w a fixed smooth field (waves of 6 to 24 pixels), to the placed
//             vertices: central differences of the hard render (reference_samples² samples) along random
//             directions in which every vertex moves, and the exact VJP of the plain loop in double at
//             sharp settings (σ 1e-7, γ 1e-3); to the texels: the exact VJP of the hard render, which is
//             linear in them.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "simulation/camera_pass.h"
#include "validation/tradeoff/points.h"
#include "validation/tradeoff/subjects.h"

namespace mirage {

/// Agreement of two gradients.
struct Agreement {
  double cosine = 0, norm = 0;  ///< norm: |own| / |reference|
};
/// Zero for a gradient that vanishes.
Agreement agreement(const std::vector<double>& own, const std::vector<double>& reference);

class CameraStudy {
 public:
  /// `placed` in `velo`. Draws the references: seconds.
  CameraStudy(const PreparedFrame& prepared, const Placement& placement, TexturedMesh placed,
              const TradeoffSettings& settings);
  /// m, root mean square of a vertex's move along a direction.
  static constexpr double kStep = 4e-3;

  /// Over the object's pixels: image_levels (mean |Δ|, 8-bit sRGB), image_mae, image_max (scene-linear).
  /// Agreement of the gradient with finite differences (gradient_cosine, gradient_norm, gradient = 1 − the
  /// cosine), with the double reference's (double_*) and with the hard render's to the texels (texel_*).
  std::map<std::string, double> errors(const CameraVariant& variant) const;
  /// Forward and VJP, beside the baseline. Call it with one thread (set_thread_count).
  void time(const CameraVariant& variant, TradeoffPoint& point) const;

  /// Agreement of the finite differences with those of half the step: the limit that their own noise sets.
  double self_cosine() const { return self_cosine_; }
  /// Agreement of the double reference with the finite differences.
  Agreement sharp_agreement() const { return sharp_agreement_; }
  /// Object pixels of the reference.
  int pixels() const { return pixels_; }

 private:
  struct Gradient {
    std::vector<double> vertices, texels;
  };
  struct Drawing {
    ImageF image;  ///< the whole photograph with the object
    Gradient gradient;
  };
  /// `shrink`: as a CameraVariant has it.
  Drawing draw(const SimulationSettings& simulation, int shrink = 1) const;
  double loss(const SimulationSettings& simulation, const TexturedMesh& placed) const;
  std::vector<double> finite_differences(double step) const;
  std::vector<double> along_directions(const std::vector<double>& gradient) const;
  void make_upstream(const PixelRect& rect);
  void make_mask(const Simulated& reference);
  const PreparedFrame& shrunk(int factor) const;

  const PreparedFrame& prepared_;
  const Placement& placement_;
  TexturedMesh placed_;
  const TradeoffSettings& settings_;
  const SimulationSettings baseline_;
  ImageF upstream_;   ///< whole image
  PixelRect rect_;    ///< where pictures are compared
  ImageF reference_;  ///< rect_-sized
  ImageF mask_;       ///< rect_-sized, 1 channel
  std::vector<std::vector<Vec3d>> directions_;
  std::vector<double> differences_;  ///< along the directions
  Gradient sharp_, hard_;
  double self_cosine_ = 0;
  Agreement sharp_agreement_;
  int pixels_ = 0;
  PreparedFrame half_, quarter_;
};

// The LiDAR's side: the rays of one sweep that can meet one host's object, traced in several ways.
//
// Reference: every ray against every face by Möller–Trumbore in double, the nearest hit. A ray that is
// not traced takes the range of the nearest traced ray of its beam. The gradient is that of Σ w·range, with w
// a fixed smooth weight over the rays, to the placed vertices; where rays are left out the traced ones count
// for them.

/// Points of group "lidar". Axes: "arithmetic" (Embree's own float range; its face and the range in double,
/// as simulate() has it, which is the baseline; all in double), "rays" (every 1st, 2nd, 4th, 8th ray of a
/// beam), and "beam" (one thin ray against the cone of 19 that the unit's divergence asks for; against the
/// cone, and only where the unit's divergence is known). Errors: range_error_m and range_max_m, mean and
/// largest of the rays that hit in both; disagreements, rays that hit in one only, over the reference's hits;
/// and the gradient's as above, where there is one. Empty if fewer than 8 rays hit. One thread.
std::vector<TradeoffPoint> lidar_study(const PreparedFrame& prepared, const TexturedMesh& placed,
                                       const SimulationSettings& settings, int repeats);

}  // namespace mirage
