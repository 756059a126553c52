// Fits the shape manifold to one vehicle: packed parameters q = (t, yaw, s, z) of shape_model.h that minimise
//
//   Σ_points ρ(d(p; q) / σ_p)                         the returns lie on the surface
// + Σ_rays   ρ(min(0, d(p_ray; q)) / σ_e)             no ray passed through the body; p_ray is where the ray
//                                                     comes deepest into the shape, chosen anew every round
// + (t_z − ground(t))² / σ_g²                         the wheels stand on the ground
// + (t, yaw, s − s_label)² / σ_label²                 the label is approximately right
// + λ ‖z − z(s)‖² in the metric of the prior           the shape is likely for its size
//
// by Levenberg–Marquardt (Ceres), ρ Cauchy's loss. Rays go through windows: returns in the cabin and rays
// across it are outliers. ρ and a bound on a ray's depth inside take their weight away.
#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "geometry/box.h"
#include "scene/carrier.h"
#include "scene/occlusion.h"
#include "scene/shape/shape_model.h"

namespace mirage {

// The evidence of a sweep on one vehicle: returns on it, space that rays found empty, the ground under it.
// All in the frame of the labelled box: origin at the centre of its bottom, x along its heading, z up.

/// A piece of a ray (m, `velo`).
struct Segment {
  Vec3d from, to;
};

/// z = height + slope · (x, y).
struct GroundPlane {
  double height = 0;  ///< m
  Vec2d slope = Vec2d::Zero();
  /// The ground's z (m) at (x, y).
  double at(double x, double y) const { return height + slope.x() * x + slope.y() * y; }
};

/// The evidence of a sweep on one vehicle, in `velo`.
struct VehicleEvidence {
  std::vector<Vec3d> surface;         ///< returns on the vehicle, thinned
  std::vector<Segment> empty;         ///< parts of rays before their return, near the vehicle, thinned
  std::optional<GroundPlane> ground;  ///< nullopt if too little is visible
  int points = 0;                     ///< returns on the vehicle before thinning
};

/// A ray without a return is no evidence: dark paint and glass swallow light as the sky does. Nor is a ray
/// that passes below a return on the vehicle in about the same direction: it may have gone through a window.
/// Rays of empty space start at their own laser (SweepIndex): an HDL-64E's lasers lie 20 cm apart.
VehicleEvidence gather_evidence(const SweepIndex& sweep, const Box3& box);

/// Default number of returns on a vehicle below which it is not fitted.
inline constexpr int kMinFitReturns = 20;

/// A fitted vehicle.
struct ShapeFit {
  bool fitted = false;    ///< false: only `points` and `reason` are set
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

/// Fits shape, pose and size to the evidence on a vehicle by robust non-linear least squares, starting from
/// its label (`velo`, m).
ShapeFit fit_shape(const ShapeModel& model, const VehicleEvidence& evidence, const Box3& label,
                   int min_points = kMinFitReturns);

/// The rooftop point (m) of a vehicle in its own frame. The rooftop is the part of the upper envelope within
/// 20 cm of the highest point; (x, y) is its centroid, z the envelope's height there. Grid of 2.5 cm.
/// InputError for a mesh without faces.
Vec3d roof_point(const Mesh& vehicle);

// Roof poses from fitted shapes.

/// Fits the shape manifold to cars and vans; the adversary stands on the fitted roof. A vehicle that can't be
/// fitted (too few returns, another type) gets BoxRoofFinder's pose, from_box and the reason.
class ShapeRoofFinder : public RoofFinder {
 public:
  /// `lidar`: the unit that recorded the frames' sweeps.
  ShapeRoofFinder(ShapeModel model, LidarModel lidar, int min_points = kMinFitReturns);
  Carrier find(const Frame& frame, const Label& label) const override;
  /// The complete fit, from an index over the frame's sweep.
  ShapeFit fit(const SweepIndex& index, const Label& label) const;

 private:
  ShapeModel model_;
  LidarModel lidar_;
  int min_points_;
  // Indices of the most recent sweeps, one a thread: a frame's vehicles are requested together.
  struct Indexed {
    Sweep sweep;
    std::shared_ptr<const SweepIndex> index;
  };
  std::shared_ptr<const SweepIndex> index_of(const Sweep& sweep) const;
  mutable std::mutex mutex_;
  mutable std::vector<Indexed> indexed_;  ///< the most recently used last
};

/// The roof finder, as --rooftop names it: "shape" (the shipped manifold), "box", or a user's manifold
/// (*.shape, `mirage fit --build-model`).
inline constexpr const char* kDefaultRoof = "shape";
/// `lidar`: the unit that recorded the frames' sweeps. InputError for another word.
std::unique_ptr<RoofFinder> make_roof_finder(const std::string& rooftop, const LidarModel& lidar);
/// content_hash of the manifold that `rooftop` names; empty for "box". InputError for another word.
std::string rooftop_model_hash(const std::string& rooftop);

}  // namespace mirage
