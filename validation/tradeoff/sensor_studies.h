// The camera's side of the speed–accuracy study: one host, drawn in many ways.
//
// Against what a drawing is measured:
//   image     hard edges (the nearest face, no σ, no γ) by the plain loop in double, reference_samples²
//   samples
//             a pixel, over the pixels that the object touches and one beyond;
//   gradient  of Σ w·I over the pixels, with w a fixed smooth field (waves of 6 to 24 pixels), to the placed
//             vertices: central differences of the hard render (reference_samples² samples) along random
//             directions in which every vertex moves, and the exact VJP of the plain loop in double at
//             sharp settings (σ 1e-7, γ 1e-3); to the texels: the exact VJP of the hard render, which is
//             linear in them.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "simulation/camera_pass.h"

namespace mirage {

/// One way to draw.
struct CameraVariant {
  std::string axis, label;
  SimulationSettings simulation;
  /// The picture is drawn at 1/shrink of its width and height, and what it changes is enlarged (bilinear).
  int shrink = 1;
};

struct CameraFigures {
  double image_levels = 0;                        ///< mean |Δ| of the object's pixels, 8-bit sRGB levels
  double image_mae = 0, image_max = 0;            ///< scene-linear
  double gradient_cosine = 0, gradient_norm = 0;  ///< against finite differences; norm: own / reference
  double double_cosine = 0, double_norm = 0;      ///< against the double reference
  double texel_cosine = 0, texel_norm = 0;        ///< against the hard render's
  double ms = 0, baseline_ms = 0, ratio = 1;      ///< CPU time, forward + VJP; medians over repeats
};

struct CameraStudySettings {
  std::uint64_t seed = 0;
  int repeats = 5;             ///< of a timing
  int reference_samples = 16;  ///< along a pixel's side
  int sharp_samples = 8;       ///< the same, of the double reference of the gradient
  int directions = 24;
  double step = 4e-3;  ///< m, root mean square of a vertex's move along a direction
  SimulationSettings baseline;
};

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
              const CameraStudySettings& settings);

  /// Draws and times; the baseline is timed beside it, in alternation. Thread-bound CPU time: call it with
  /// one thread (set_thread_count).
  CameraFigures measure(const CameraVariant& variant, bool timed = true) const;

  /// Agreement of the finite differences with those of half the step: what their own noise leaves.
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
  Drawing draw(const CameraVariant& variant, const TexturedMesh& placed, bool with_gradient) const;
  double loss(const CameraVariant& variant, const TexturedMesh& placed) const;
  std::vector<double> finite_differences(double step) const;
  std::vector<double> along_directions(const std::vector<double>& gradient) const;
  void make_upstream(const PixelRect& rect);
  void make_mask(const Simulated& reference);
  const PreparedFrame& shrunk(int factor) const;

  const PreparedFrame& prepared_;
  const Placement& placement_;
  TexturedMesh placed_;
  CameraStudySettings settings_;
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

/// Hard edges; `samples` along a pixel's side; by the plain loop in double or the fast rasteriser.
SimulationSettings hard_render(SimulationSettings settings, int samples, bool in_double);

}  // namespace mirage
