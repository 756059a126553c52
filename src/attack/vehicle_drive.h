// The pose of a vehicle that carries an object, over its whole drive. Roofs fitted frame by frame
// (scene/carrier.h) would jitter. Here roof and box follow the vehicle's track in the world, smoothed over
// all its frames (tracking/tracker.h).
#pragma once

#include <array>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "base/json_fields.h"
#include "base/sizes.h"
#include "frames/frame_store.h"
#include "frames/hosts.h"
#include "scene/carrier.h"
#include "tracking/tracker.h"

namespace mirage {

/// The yaw of the pose's x axis, seen from above.
double heading_of(const Transform& pose);
/// The pose at `position` (m), turned by `yaw` about z.
Transform upright_pose(const Vec3d& position, double yaw);

/// One frame of a vehicle's track, before smoothing.
struct RoofTrackFrame {
  Moment moment;
  Carrier carrier;
};

/// Smoothness of a vehicle's track, and distance of the fitted roofs from it.
struct RoofTrackFit {
  int fitted = 0;                           ///< frames whose roof was fitted
  double residual_m = 0, residual_deg = 0;  ///< RMS of the fitted roofs around the smoothed ones
  double fit_jitter_m = 0, jitter_m = 0;    ///< roofs as found, smoothed (tracking/tracker.h)
  /// RMS of the smoothed roofs around their mean pose in the labelled boxes. If the labels are exact, this is
  /// how far the object moves on its roof.
  double in_box_m = 0, in_box_deg = 0;
};
/// The fields of RoofTrackFit by their keys in result.json.
inline constexpr std::pair<const char*, double RoofTrackFit::*> kRoofTrackNumbers[] = {
    {"residual_m", &RoofTrackFit::residual_m},     {"residual_deg", &RoofTrackFit::residual_deg},
    {"fit_jitter_m", &RoofTrackFit::fit_jitter_m}, {"jitter_m", &RoofTrackFit::jitter_m},
    {"in_box_m", &RoofTrackFit::in_box_m},         {"in_box_deg", &RoofTrackFit::in_box_deg}};

/// The vehicle's smoothed roofs along its track.
struct RoofTrack {
  std::vector<Carrier> carriers;  ///< one a frame; the labelled box and a fitted shape move with the roof
  std::vector<Vec3d> velocities;  ///< roof velocity in the world, m/s
  RoofTrackFit fit;
};

/// Frames by rising time. The roof's pose in the labelled box is the median over the fitted roofs, or over
/// all if no roof is fitted. It replaces the roof of a frame without a fit, with a larger σ.
RoofTrack roof_track(const std::vector<RoofTrackFrame>& frames);
/// The same from the store's roofs, for the vehicle's label in each frame.
RoofTrack roof_track(FrameStore& store, std::span<const std::pair<Moment, HostId>> frames);

// One vehicle of a drive in three versions: as recorded (clean), with the object (attacked), and with a
// random object of its size (random). Observations frame by frame, and outcomes in seconds and metres.
//
//   gap        the longest time without a detection or track. A frame lasts until the next one; the last
//              frame, and one before an unlabelled stretch, last for the usual step. An unlabelled stretch
//              ends a gap
//   track      it lies on the vehicle after as many detections there as a birth takes. Only detections since
//              the vehicle's first frame count
//   confirmed  the first frame in which a confirmed track lies on the vehicle: time since the vehicle's first
//              frame, and distance
//   reserve    d − v² / (2 a) at that moment; d: distance to the nearest corner of the box, v: closing speed,
//              a: deceleration (m/s²). Below zero: metres short of a stop
//   phantom    a confirmed track on no road user, and (except in the clean version) on no clean detection,
//              where an object would be labelled: in the picture and in no DontCare region

/// The three versions above.
enum class DriveVersion { clean, attacked, random };
/// Names of the versions in files, in the order of DriveVersion.
inline constexpr std::array<const char*, 3> kDriveVersions = {"clean", "attacked", "random"};
constexpr auto words_of(DriveVersion) {
  return kDriveVersions;
}
/// One value for each version.
template <class T>
struct ByVersion : std::array<T, kDriveVersions.size()> {
  using std::array<T, kDriveVersions.size()>::operator[];
  /// The version's value.
  T& operator[](DriveVersion version) { return (*this)[as_size(version)]; }
  /// The same, to read.
  const T& operator[](DriveVersion version) const { return (*this)[as_size(version)]; }
};
/// The JSON object {clean, attacked, random} with the values of(version).
template <class Of>
nlohmann::json by_version(const Of& of) {
  nlohmann::json json;
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v)
    json[kDriveVersions[v]] = of(static_cast<DriveVersion>(v));
  return json;
}

/// The vehicle's confirmed track in one frame: found (with a detection), coasting (without one), or lost (no
/// track lies on the vehicle).
enum class TrackStatus : char { found = 'f', coasting = 'c', lost = 'l' };

/// Observations in one version of one frame.
struct DriveObservation {
  bool found = false;  ///< a detection over the score overlaps the vehicle's box (MissCriterion vanished)
  TrackStatus track = TrackStatus::lost;
  int phantoms = 0;              ///< phantom tracks in this frame
  bool phantom_in_lane = false;  ///< one of them ahead in the car's own lane
};

/// The vehicle in one frame.
struct DriveFrame {
  int index = 0;       ///< Moment::index
  double time = 0;     ///< s
  double range = 0;    ///< m, from the `velo` origin to the box's centre, seen from above
  double nearest = 0;  ///< m, to its nearest corner
  double closing = 0;  ///< m/s, closing speed; negative: it moves away
  ByVersion<DriveObservation> observations;
};

/// Values of --death at which every drive is judged, besides its own: the trade-off between gaps and
/// phantoms.
inline constexpr std::array<int, 5> kDeaths = {1, 2, 3, 5, 10};

/// The vehicle's outcome at one of kDeaths.
struct DeathOutcome {
  ByVersion<double> track_gap_s{};
  ByVersion<int> phantom_frames{};
};

/// A vehicle over its drive.
struct VehicleDrive {
  std::string sequence, type;
  int track = -1;
  RoofTrackFit roof;
  ByVersion<int> phantom_tracks{};  ///< number of distinct tracks
  std::vector<DriveFrame> frames;   ///< by rising time
  std::array<DeathOutcome, kDeaths.size()> deaths{};
};

/// SEQUENCE_TRACK, the base name of the vehicle's file.
std::string vehicle_name(const std::string& sequence, int track);
/// Vehicles of a drive: (sequence, track identity).
using DriveVehicles = std::set<std::pair<std::string, int>>;

/// Decelerations of the reserve, m/s².
inline constexpr std::array<int, 3> kBrakes = {4, 6, 8};

/// Outcome of one version.
struct DriveOutcome {
  int found = 0;                      ///< frames
  double gap_s = 0, track_gap_s = 0;  ///< longest gap of detections, of confirmed tracks
  double phantom_s = 0, phantom_lane_s = 0;
  int phantom_frames = 0;
  /// The first confirmation of a track on the vehicle.
  struct Confirmation {
    double seconds = 0, metres = 0, closing = 0;
    std::optional<double> time_to_collision;  ///< s at that speed; nullopt if not closing
    std::array<double, kBrakes.size()> reserve{};
  };
  std::optional<Confirmation> confirmed;  ///< nullopt: never
};
/// Computes the outcome from the vehicle's frames.
DriveOutcome outcome_of(const VehicleDrive& vehicle, DriveVersion version);

/// As in result.json, with all fields that read_vehicle_drive needs. "strip", for plots, holds each frame's
/// duration (stands_s), and 1 for a frame after which the vehicle is away (0 otherwise), as gaps count them.
nlohmann::json to_json(const VehicleDrive& vehicle);
/// Inverse of to_json. InputError naming file and field if the JSON is invalid.
VehicleDrive read_vehicle_drive(const JsonFields& json);

// Summary of a drive over all its vehicles: medians, shares and the object's effect.

/// Result of judging a drive.
struct DriveResult {
  std::vector<VehicleDrive> vehicles;  ///< by sequence, then by identity
  TrackScores clean;                   ///< tracks of cars and vans as recorded, at a BEV IoU of 0.5
  int frames = 0;
  SkippedHosts left_out;  ///< vehicles without room for the object in some frame
};

/// {vehicles: as to_json(VehicleDrive), gap_s, track_gap_s, confirmed_m: medians over vehicles {clean,
/// attacked, random, attacked_less_clean, attacked_less_random: {value, low, high}} (median_interval; a
/// vehicle that is never confirmed counts as confirmed at 0 m), later_m: {vehicles, than_clean, than_random}:
/// how many metres nearer the attacked version is confirmed, over approaching vehicles, near: {metres,
/// vehicles: first seen beyond, clean, …: of these, not confirmed before}, never_confirmed: {clean, …},
/// deaths: [{death, track_gap_s: medians, phantom_share: of the frames}] for kDeaths, roof: medians of
/// kRoofTrackNumbers, survival: [{seconds, clean, attacked, random: share of vehicles with a gap of at least
/// that}], tracker: TrackScores as recorded, frames, left_out}
nlohmann::json to_json(const DriveResult& result);

/// The vehicles sorted by how much the object lengthens the longest detection gap, largest first.
std::vector<const VehicleDrive*> by_added_gap(const std::vector<VehicleDrive>& vehicles);
/// The at most `count` vehicles whose longest gap the object lengthens most; only vehicles whose gap it
/// lengthens at all.
DriveVehicles longest_hidden(const DriveResult& result, int count);
/// The same vehicles under another renderer: {vehicles: [as above], gap_s, track_gap_s: medians as above,
/// raster_gap_s: those of `plain`, kept: {value, low, high}: the gap added by the object, as a share of that
/// in `plain`}. Vehicles were selected by their gaps in `plain`, which biases "kept" low.
nlohmann::json by_renderer(const DriveResult& result, const DriveResult& plain);

}  // namespace mirage
