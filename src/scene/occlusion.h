// A measured sweep as rays: which laser fired where, and what came back.
//
// A sweep file has no ray index. The unit's geometry (LidarModel) gives it back: at horizontal distance ρ
// laser b sees z = height_b + ρ tan(elevation_b), and azimuth = firing + offset_b + lateral_b / ρ with the
// firing on the encoder's grid. A firing is taken as real when several lasers have a return at it; a laser
// with none at a real firing looked at the sky, or its return was lost: an object put in its way is seen all
// the same.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "sensors/lidar_model.h"

namespace mirage {

/// A laser in the plane of horizontal distance ρ and height z (m): z = height + slope · ρ.
struct BeamLine {
  double height = 0, slope = 0;
  /// Its height at a distance.
  double at(double rho) const { return height + slope * rho; }
};
/// The line that passes nearest to a point there, of one line or more, from the top down.
std::size_t nearest_line(std::span<const BeamLine> lines, double rho, double z);

/// The laser (index) that passes nearest to each return; −1 where the return is not finite, or the unit has
/// no lasers.
std::vector<int> beams_of(std::span<const LidarPoint> points, const LidarModel& lidar);

/// How the unit's origin moves within a sweep that was corrected for the car's motion: every return is where
/// it was seen from, brought to one moment (nuScenes does so; KITTI does not).
struct SweepMotion {
  Vec3d start = Vec3d::Zero(), turn = Vec3d::Zero();  ///< m, unit's frame: at phase 0, and in a whole turn
  double cut = 0;                                     ///< rad: where the sweep begins, if it is a whole turn
  bool whole = false;                                 ///< else phases are counted from straight ahead

  /// The part of the turn that the unit looks to an azimuth (rad, unit's frame) at.
  double phase(double azimuth) const;
  /// The origin at a phase.
  Vec3d at(double phase) const { return start + phase * turn; }
  /// A point (m, unit's frame at rest) as the unit sees it when it looks there. `phase`: near which part of
  /// the turn that is (where the sweep begins and ends the unit sees some points twice), and then which.
  Vec3d seen(const Vec3d& p, double& phase) const;
  bool none() const { return start.isZero(0) && turn.isZero(0); }
};

/// No motion, for returns (unit's frame) in the sweep's order: a whole turn begins at the first. `phases`:
/// when each was seen; of a sweep that is written firing by firing its order tells.
SweepMotion no_motion(std::span<const Vec3d> points, std::vector<double>& phases);

/// A ray of the sweep.
struct SweepRay {
  LidarRay ray;  ///< `velo`; exactly through the return where there is one
  int beam = 0;
  int firing = -1;  ///< index of the firing, −1 for a return that shares (beam, firing) with a better one
  double azimuth = 0;  ///< rad, of the firing, in the unit's frame
  int point = -1;      ///< index of the return in the sweep, −1 where none came back
  double range = 0;    ///< m from the ray's origin to the return; 0 where none
};

/// The part of the unit's raster that a ray stands for: halfway to the next lasers and firings (into a gap
/// between firings, a pitch).
struct RasterCell {
  SweepRay ray;
  /// How a point moves over the raster: cells to the left and up, a metre (`velo`). Along the ray it does
  /// not.
  Vec3d left_per_metre, up_per_metre;
};

/// An index over a sweep; it keeps no reference to it. Where fewer than 95 % of the returns lie on the
/// model's rays (99 % of a unit without an encoder's grid), the sweep is asked for its own firings (of a unit
/// without an encoder's grid: every turn begins at another azimuth) and for the unit's motion within it; what
/// explains more is taken.
class SweepIndex {
 public:
  SweepIndex() = default;
  SweepIndex(const Sweep& sweep, const LidarModel& lidar);

  /// Every ray of the sweep, with or without a return, that passes through a ball. A return of the sweep
  /// belongs to exactly one ray. Order: by beam and firing; returns that share both with a better one come
  /// last.
  std::vector<SweepRay> rays_through(const Vec3d& centre_velo, double radius) const;

  /// The cell that a point (`velo`) lies in, seen from its laser; none above the first and below the last
  /// laser by more than half a pitch, where nothing was fired, for a point that is not finite, and of a unit
  /// with one laser.
  std::optional<RasterCell> cell_at(const Vec3d& p_velo) const;

  /// Firings found, over the whole turn.
  int firing_count() const { return static_cast<int>(firings_.size()); }
  /// Points that are not finite: they are no returns, and no ray goes through them.
  int skipped() const { return skipped_; }
  /// Share of the returns that are the only one of their (beam, firing) and within 0.1° of that ray.
  double assigned_share() const { return assigned_share_; }

 private:
  struct Return {
    Vec3d p_velo;
    int beam;
    double firing;  ///< rad, exact, not rounded to the grid
    double phase;   ///< of the turn, when it was seen
  };
  /// Firings are the model's, or the sweep's own.
  void build(const Sweep& sweep, std::span<const double> phases, const SweepMotion& motion, bool own_firings);
  void find_firings();
  void find_own_firings();
  /// A point (`velo`) as the unit sees it when it looks there.
  Vec3d seen_by_unit(const Vec3d& p_velo) const;
  void assign();
  SweepRay ray_of(int point, int firing) const;
  /// A cell's, through its return where it has one.
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
  std::vector<int> cells_;                          ///< beams × firings: point, −1 where none
  std::vector<int> extra_;                          ///< returns without a cell of their own
  double assigned_share_ = 0;
  int skipped_ = 0;
};

}  // namespace mirage
