// Data types of an insertion: a prepared frame, settings, the simulated measurements, and gradients
// (insertion.h has the functions).
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "geometry/mesh.h"
#include "scene/frame.h"
#include "scene/occlusion.h"
#include "sensors/camera.h"
#include "sensors/lidar_effects.h"
#include "sensors/raster/limits.h"
#include "sensors/screen_mesh.h"
#include "sensors/visible_light.h"

namespace mirage {

/// Extent of the gradient of returns. fixed: the motion of existing returns. silhouette: also returns that
/// appear and vanish (adversary_lidar.h).
enum class LidarGradient { fixed, silhouette };
constexpr auto words_of(LidarGradient) {
  return std::to_array<const char*>({"fixed", "silhouette"});
}

class SensorPass;

/// A frame with everything that does not depend on the adversary.
struct PreparedFrame {
  Frame frame;
  ImageF depth;      ///< dense depth of the photograph, m (kFarDepth where unknown)
  LidarModel lidar;  ///< the unit that recorded the sweep
  SweepIndex index;  ///< the sweep by beam and azimuth
  std::vector<Lazy<ImageF>> other_depths = {};  ///< of each of the frame's other cameras, as `depth`
  /// For each of the frame's measurements, the sensor that made it.
  std::vector<std::shared_ptr<const SensorPass>> measured_by = {};

  /// Depth by a camera's index, as in Frame.
  const ImageF& depth_of(std::size_t camera) const {
    return camera == 0 ? depth : other_depths.at(camera - 1).get();
  }
};

/// Settings of the simulation with their defaults.
struct SimulationSettings {
  SoftRasterSettings<double> raster;  ///< near and far are set per object by simulate()
  /// Samples a pixel along each side, averaged: a 5×5 atlas has texels smaller than a pixel at most ranges,
  /// and an attack on point samples learns aliasing that no real camera shows.
  int supersampling = 2;
  /// Draw with the plain loop in double instead of the fast rasteriser: hundreds of times slower; derivatives
  /// are checked with it.
  bool reference = false;
  /// Draw exact areas (sensors/exact_coverage.h, in double) in place of the soft rasteriser: `raster`,
  /// `supersampling` and `reference` are then ignored.
  bool exact_coverage = false;
  double lidar_reflectivity = 0.5;  ///< reflectance of the adversary at normal incidence
  /// An occluder in the photograph must be nearer than the object by this (m), and than the vehicle that it
  /// stands on: the completed depth smears the rear over the roof, and a roof never hides its own load.
  double occlusion_margin = 0.3;
  /// Incidence below which a LiDAR return keeps its place but its gradient is scaled down: |n·d| / |n|.
  double grazing_cosine = 0.05;
  LidarGradient lidar_gradient = LidarGradient::silhouette;  ///< of an attack
  LidarEffects lidar_effects;                                ///< all off
  CameraEffects camera_effects;                              ///< all off
  LightModel light = LightModel::plain;
  VisibleLightSettings visible_light;  ///< of LightModel::visible
};

/// The fields as a run records them.
template <class Visitor, FieldsOf<SimulationSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "sigma", .help = kSigmaHelp, .range = {kMinSigma, kMaxSigma}}, s.raster.sigma);
  visit({.name = "gamma", .help = kGammaHelp, .range = {kMinSigma, kMaxGamma}}, s.raster.gamma);
  visit({.name = "epsilon", .range = {-1e6, 1e6}, .option = ""}, s.raster.epsilon);
  visit({.name = "dist_eps", .range = {1e-12, 0.49}, .option = ""}, s.raster.dist_eps);
  visit({.name = "supersampling", .help = "camera samples along a pixel's side", .range = {1, 32}},
        s.supersampling);
  visit({.name = "coverage", .option = "", .lacking = "euclidean"}, s.raster.coverage);
  visit({.name = "color", .option = "", .lacking = "softmax"}, s.raster.color);
  visit({.name = "silhouette", .option = "", .lacking = "product"}, s.raster.silhouette);
  visit({.name = "background", .option = "", .lacking = "silhouette"}, s.raster.background);
  visit({.name = "sides", .option = "", .lacking = "both"}, s.raster.sides);
  visit({.name = "perspective_texture", .option = "", .lacking = "true"}, s.raster.perspective_texture);
  visit({.name = "frozen_barycentrics", .option = "", .lacking = "false"}, s.raster.frozen_barycentrics);
  visit({.name = "edge_on_altitude", .range = {0, 1}, .option = "", .lacking = "1e-6"},
        s.raster.edge_on_altitude);
  visit({.name = "lidar_reflectivity", .range = {0, 1e3}, .option = ""}, s.lidar_reflectivity);
  visit({.name = "occlusion_margin", .range = {-1e3, 1e3}, .option = ""}, s.occlusion_margin);
  visit({.name = "grazing_cosine", .range = {1e-9, 1}, .option = ""}, s.grazing_cosine);
  visit({.name = "lidar_gradient",
         .help = "fixed: gradients of existing returns alone; silhouette: also of returns that appear and "
                 "vanish at the object's outline"},
        s.lidar_gradient);
  visit({.name = "double", .option = "", .lacking = "false"}, s.reference);
  visit({.name = "exact_coverage", .option = "", .lacking = "false"}, s.exact_coverage);
  visit({.name = "light",
         .help = "light on the object: plain (no shadows, no reflections), visible (ray-traced sun, sky and "
                 "bounces from roof, road and object) or fine (visible with more rays)",
         .lacking = "plain"},
        s.light);
  visit.group({.name = "visible_light", .lacking = ""}, s.visible_light);
  visit.group({.name = "lidar_effects", .lacking = ""}, s.lidar_effects);
  visit.list({.name = "camera_effects",
              .help = "lens and sensor on the object's pixels: ideal, unit (both), or some of blur,noise",
              .lacking = ""},
             s.camera_effects);
}

/// One camera's view with the placed adversary.
struct CameraSight {
  ImageF image;              ///< the photograph with the object in it
  PixelRect rect;            ///< pixels that may have changed
  Image<double> rgba;        ///< rect-sized: composited colour and silhouette S
  double visible_share = 0;  ///< visible / total silhouette; parts outside the image count as hidden
  int adversary_pixels = 0;  ///< pixels with S > 0.5
};

/// All sensors' measurements with the placed adversary; the base is the first camera's view.
struct Simulated : CameraSight {
  /// Views of the frame's other cameras. An image without the object is empty: it is as recorded, and was not
  /// read.
  std::vector<CameraSight> others;
  std::vector<Measurement> measurements;  ///< of each of the frame's, with the object in it
  Sweep sweep;                            ///< the sweep with the object in it; new returns come last
  int adversary_points = 0;               ///< returns on the object
  int removed_points = 0;                 ///< measured returns that the object hides
  int lost_points = 0;                    ///< would-be returns on the object that drop out (LidarEffects)
  int occluded_points = 0;                ///< would-be returns on the object hidden by the scene
  struct Tape;                            ///< what the VJP needs
  std::shared_ptr<const Tape> tape;

  /// The view of a camera by its index.
  const CameraSight& sight(std::size_t camera) const { return camera == 0 ? *this : others.at(camera - 1); }
  /// The largest visible_share of all cameras.
  double best_share() const;
};

/// d loss / d vertices (adversary frame, 1/m) and d loss / d texels, one for each of the adversary's.
struct AdversaryGradient {
  std::vector<Vec3d> vertices, texels;
};

/// A view of gradients in the caller's memory, in float or in double.
class GradientView {
 public:
  /// No gradient.
  GradientView() = default;
  /// `size` floats from `from`; null: no gradient.
  GradientView(const float* from, std::size_t size = 0) : floats_(from), size_(size) {}
  /// The same in double.
  GradientView(const double* from, std::size_t size = 0) : doubles_(from), size_(size) {}
  /// A list of numbers, or of points (x, y, z, reflectance).
  template <class List>
  requires requires(const List& list) { list.data(), list.size(); }
  GradientView(const List& list) : GradientView(first_of(list.data()), list.size()) {}

  /// Number of entries (numbers or points) of the viewed list.
  std::size_t size() const { return size_; }
  /// Whether there is a gradient.
  explicit operator bool() const { return floats_ || doubles_; }
  /// The number at index i, without a bounds check.
  double operator[](std::size_t i) const { return floats_ ? static_cast<double>(floats_[i]) : doubles_[i]; }

 private:
  template <class S>
  static const S* first_of(const S* numbers) {
    return numbers;
  }
  template <class S>
  static const S* first_of(const std::array<S, 4>* points) {
    return points ? points->data() : nullptr;
  }
  const float* floats_ = nullptr;
  const double* doubles_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace mirage
