// Fits the shape manifold to one vehicle: packed parameters q = (t, yaw, s, z) of shape_model.h that minimise
//
//   Σ_points ρ(d(p; q) / σ_p)                         the returns lie on the surface
// + Σ_rays   ρ(min(0, d(p_ray; q)) / σ_e)             no ray passed through the body; p_ray is where the ray
//                                                     comes deepest into the shape, chosen anew every round
// + (t_z − ground(t))² / σ_g²                         the wheels stand on the ground
// + (t, yaw, s − s_label)² / σ_label²                 the label is about right
// + λ ‖z − z(s)‖² in the metric of the prior           the shape is a likely one for its size
//
// by Levenberg–Marquardt (Ceres), ρ Cauchy's loss. Rays go through windows: returns in the cabin and rays
// that cross it are outliers, which ρ and a bound on the depth at which a ray counts leave without weight.
#pragma once

#include <string>

#include "scene/carrier.h"
#include "scene/shape/shape_model.h"
#include "scene/shape/vehicle_evidence.h"

namespace mirage {

/// Weights and bounds of the fit.
struct ShapeFitSettings {
  EvidenceSettings evidence;
  int min_points = 20;           ///< fewer returns on the vehicle: no fit
  double point_sigma = 0.06;     ///< m
  double empty_sigma = 0.10;     ///< m
  double deepest = 0.25;         ///< m; a ray deeper inside went through glass
  double ground_sigma = 0.03;    ///< m
  double label_position = 0.10;  ///< m, along and across
  double label_height = 0.10;    ///< m, of the bottom
  double label_yaw = 0.03;       ///< rad
  double label_size = 0.03;      ///< share of length, width, height
  double prior = 2.0;            ///< λ; above 1 because returns err together, not each on its own
  double roof_depth = 0.20;      ///< m; the rooftop is what lies this close under the top
};

/// A fitted vehicle.
struct ShapeFit {
  bool fitted = false;    ///< false: nothing below but `points` and `reason` is set
  std::string reason;     ///< why there is no fit
  int points = 0;         ///< returns on the vehicle
  ShapeParameters shape;  ///< in the labelled box's frame
  Transform velo_from_vehicle = Transform::Identity();
  Vec3d size = Vec3d::Zero();                        ///< length, width, height (m)
  Mesh mesh;                                         ///< `velo`, watertight, wound outward
  Transform velo_from_roof = Transform::Identity();  ///< the rooftop's centre, x along the heading
  std::vector<Vec3d> returns_velo;                   ///< the thinned returns that were fitted
  int iterations = 0;
};

/// Fits shape, pose and size to what was seen of a vehicle, from its label on, by robust non-linear least
/// squares (`velo`, m).
ShapeFit fit_shape(const ShapeModel& model, const VehicleEvidence& evidence, const Box3& label,
                   const ShapeFitSettings& settings = {});

/// The rooftop of a vehicle in its own frame: of its upper envelope, what lies within `depth` of the highest
/// point; (x, y) is that region's centroid, z the envelope's height there. Grid of 2.5 cm. InputError for a
/// mesh without faces.
Vec3d roof_point(const Mesh& vehicle, double depth = 0.20);

}  // namespace mirage
