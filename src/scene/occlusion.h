// A measured sweep as rays: each laser's firings and their returns.
//
// A sweep file has no ray index. The unit's geometry (LidarModel) recovers it: at horizontal distance ρ laser
// b sees z = height_b + ρ tan(elevation_b), and azimuth = firing + offset_b + lateral_b / ρ with the firing
// on the encoder's grid. A firing counts as real if several lasers have a return at it. A laser without a
// return at a real firing met the sky, or its return was lost: it can still see an inserted object.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "sensors/lidar_model.h"

namespace mirage {

/// A laser in the plane of horizontal distance ρ and height z (m): z = height + slope · ρ.
struct BeamLine {
  double height = 0, slope = 0;
  /// Height (m) at a distance.
  double at(double rho) const { return height + slope * rho; }
};
/// Index of the line that passes nearest to the point (rho, z); at least one line, ordered from the top down.
std::size_t nearest_line(std::span<const BeamLine> lines, double rho, double z);

/// For each return the index of the nearest laser; −1 if the return is not finite or the unit has no lasers.
std::vector<int> beams_of(std::span<const LidarPoint> points, const LidarModel& lidar);

/// Motion of the unit's origin within a sweep that was corrected for the car's motion: every return is
/// transformed from its own moment to a common one (in nuScenes; not in KITTI).
struct SweepMotion {
  Vec3d start = Vec3d::Zero(), turn = Vec3d::Zero();  ///< m, unit's frame: at phase 0, and in a whole turn
  double cut = 0;                                     ///< rad: azimuth at which a whole turn begins
  bool whole = false;                                 ///< otherwise phases count from straight ahead

  /// Phase, in turns, at which the unit looks to an azimuth (rad, unit's frame).
  double phase(double azimuth) const;
  /// The origin at a phase.
  Vec3d at(double phase) const { return start + phase * turn; }
  /// A point (m, unit's frame at rest) as the unit sees it when it looks there. `phase`: a guess in, the
  /// phase out (where the sweep begins and ends, the unit sees some points twice).
  Vec3d seen(const Vec3d& p, double& phase) const;
  bool none() const { return start.isZero(0) && turn.isZero(0); }
};

/// No motion, for returns (unit's frame) in the sweep's order: a whole turn begins at the first. `phases`: of
/// each return; from the order if the sweep is written firing by firing, otherwise from the azimuth.
SweepMotion no_motion(std::span<const Vec3d> points, std::vector<double>& phases);

/// A ray of the sweep.
struct SweepRay {
  LidarRay ray;  ///< `velo`; exactly through the return, if any
  int beam = 0;
  int firing = -1;  ///< index of the firing, −1 for a return that shares (beam, firing) with a better one
  double azimuth = 0;  ///< rad, of the firing, in the unit's frame
  int point = -1;      ///< index of the return in the sweep, −1 without one
  double range = 0;    ///< m from the ray's origin to the return; 0 without one
};

/// The part of the unit's raster that a ray represents: halfway to the next lasers and firings (one pitch
/// into a gap between firings).
struct RasterCell {
  SweepRay ray;
  /// Motion of a point over the raster: cells to the left and up per metre (`velo`); 0 along the ray.
  Vec3d left_per_metre, up_per_metre;
};

/// An index over a sweep; it keeps no reference to it. If fewer than 95 % of the returns (99 % for a unit
/// without an encoder's grid) lie on the model's rays, it also tries the unit's motion within the sweep and,
/// without a grid, the sweep's own firings (every turn then begins at another azimuth). It takes whichever
/// explains more returns.
class SweepIndex {
 public:
  SweepIndex() = default;
  SweepIndex(const Sweep& sweep, const LidarModel& lidar);

  /// Every ray of the sweep, with or without a return, that passes through a ball. Each return belongs to
  /// exactly one ray. Sorted by beam and firing; returns that share both with a better one come last.
  std::vector<SweepRay> rays_through(const Vec3d& centre_velo, double radius) const;

  /// The cell of a point (`velo`), seen from its laser. Nullopt more than half a pitch above the first or
  /// below the last laser, where nothing was fired, for a point that is not finite, and for a unit of one
  /// laser.
  std::optional<RasterCell> cell_at(const Vec3d& p_velo) const;

  /// Number of firings found in the whole turn.
  int firing_count() const { return static_cast<int>(firings_.size()); }
  /// Number of points that are not finite: they are not returns, and no ray goes through them.
  int skipped() const { return skipped_; }
  /// Share of the returns that are the only one of their (beam, firing) and within 0.1° of that ray.
  double assigned_share() const { return assigned_share_; }

 private:
  struct Return {
    Vec3d p_velo;
    int beam;
    double firing;  ///< rad, exact, not rounded to the grid
    double phase;   ///< of the turn, at the return
  };
  /// `own_firings`: the sweep's own firings, not the model's.
  void build(const Sweep& sweep, std::span<const double> phases, const SweepMotion& motion, bool own_firings);
  void find_firings();
  void find_own_firings();
  /// A point (`velo`) in the unit's frame at the moment when it looks there.
  Vec3d seen_by_unit(const Vec3d& p_velo) const;
  void assign();
  SweepRay ray_of(int point, int firing) const;
  /// The ray of a cell, through its return if it has one.
  SweepRay ray_at(std::size_t beam, std::size_t firing) const;
  LidarRay ray_of_cell(std::size_t beam, std::size_t firing) const;

  struct Turn {
    double cosine, sine;
  };

  LidarModel lidar_;
  SweepMotion motion_;
  std::vector<Return> returns_;                     ///< beam −1: not finite, skipped
  std::vector<double> firings_;                     ///< rad, rising, in [−π, π)
  std::vector<Turn> elevations_, offsets_, turns_;  ///< of the beams, their azimuth offsets, the firings
  std::vector<BeamLine> lines_;                     ///< of the beams
  std::vector<int> cells_;                          ///< beams × firings: point, −1: none
  std::vector<int> extra_;                          ///< returns without a cell of their own
  double assigned_share_ = 0;
  int skipped_ = 0;
};

}  // namespace mirage
