// Where a vehicle that carries an object stands while it drives: the object rides on it. One roof for each
// frame, as found in that frame alone (scene/carrier.h), would jump with the fits; here roof and box follow
// the vehicle's track, smoothed over all its frames (tracking/tracker.h), in the world.
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

/// A vehicle in one frame of its track, as found there.
struct RoofTrackFrame {
  Moment moment;
  Carrier carrier;
};

/// How smooth a vehicle's track is, and how far the roofs are from it.
struct RoofTrackFit {
  int fitted = 0;                           ///< frames whose roof was fitted
  double residual_m = 0, residual_deg = 0;  ///< RMS of the fitted roofs around the smoothed ones
  double fit_jitter_m = 0, jitter_m = 0;    ///< of the roofs as found, and smoothed (tracking/tracker.h)
  /// RMS of the smoothed roofs around their mean place in the boxes as labelled: where labels are true, how
  /// far the object moves on its roof.
  double in_box_m = 0, in_box_deg = 0;
};
/// Its numbers by their keys in result.json.
inline constexpr std::pair<const char*, double RoofTrackFit::*> kRoofTrackNumbers[] = {
    {"residual_m", &RoofTrackFit::residual_m},     {"residual_deg", &RoofTrackFit::residual_deg},
    {"fit_jitter_m", &RoofTrackFit::fit_jitter_m}, {"jitter_m", &RoofTrackFit::jitter_m},
    {"in_box_m", &RoofTrackFit::in_box_m},         {"in_box_deg", &RoofTrackFit::in_box_deg}};

/// The vehicle over its track.
struct RoofTrack {
  std::vector<Carrier> carriers;  ///< one a frame; the labelled box and a fitted shape move with the roof
  std::vector<Vec3d> velocities;  ///< of the roof in the world, m/s
  RoofTrackFit fit;
};

/// Frames by rising time. The roof's place in the labelled box is the median of the fitted ones, or of all if
/// none is fitted. Where a frame's roof is not fitted that place stands in for it, with a larger σ.
RoofTrack roof_track(const std::vector<RoofTrackFrame>& frames);
/// With the roofs of the store, given the vehicle's label in each frame.
RoofTrack roof_track(FrameStore& store, std::span<const std::pair<Moment, HostId>> frames);

// One vehicle of a drive in three versions: as recorded (clean), with the object (attacked), and with a
// random object of its size (random). What was seen of it frame by frame, and what follows in seconds and
// metres.
//
//   gap        the longest time on end without: a frame stands for the time until the next one, the last one
//              and one before a stretch without a label for the usual step, and such a stretch ends a gap
//   track      one lies on the vehicle once it has the detections of a birth there, since the vehicle is
//              followed: what was seen of it before, without the object, does not count
//   confirmed  the first frame in which a confirmed track lies on the vehicle: the time since its first
//              frame, and its distance there
//   reserve    with d the distance to the nearest corner of its box at that moment and v the speed at which
//              it comes nearer: d − v² / (2 a) for brakes of a m/s²; below zero: metres short of a stop
//   phantom    a confirmed track on no road user and, but for the clean version, on no clean detection,
//              where a thing would have a label: in the picture and in no DontCare region

/// See above.
enum class DriveVersion { clean, attacked, random };
/// The versions' names in files, in the order of DriveVersion.
inline constexpr std::array<const char*, 3> kDriveVersions = {"clean", "attacked", "random"};
constexpr auto words_of(DriveVersion) {
  return kDriveVersions;
}
/// One of each.
template <class T>
struct ByVersion : std::array<T, kDriveVersions.size()> {
  using std::array<T, kDriveVersions.size()>::operator[];
  /// The version's value.
  T& operator[](DriveVersion version) { return (*this)[as_size(version)]; }
  /// The same, to read.
  const T& operator[](DriveVersion version) const { return (*this)[as_size(version)]; }
};
/// {clean, attacked, random} of of(version).
template <class Of>
nlohmann::json by_version(const Of& of) {
  nlohmann::json json;
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v)
    json[kDriveVersions[v]] = of(static_cast<DriveVersion>(v));
  return json;
}

/// What the tracker says of the vehicle in one frame: a confirmed track lies on it and has a detection; one
/// lies on it and coasts; none does.
enum class TrackStatus : char { found = 'f', coasting = 'c', lost = 'l' };

/// One version of one frame.
struct DriveObservation {
  bool found = false;  ///< a detection over the score overlaps the vehicle's box (MissCriterion vanished)
  TrackStatus track = TrackStatus::lost;
  int phantoms = 0;              ///< phantom tracks there
  bool phantom_in_lane = false;  ///< one of them ahead in the car's own lane
};

/// The vehicle in one frame.
struct DriveFrame {
  int index = 0;       ///< Moment's
  double time = 0;     ///< s
  double range = 0;    ///< m, from the `velo` origin to the box's centre, seen from above
  double nearest = 0;  ///< m, to its nearest corner
  double closing = 0;  ///< m/s at which it comes nearer; negative: it goes away
  ByVersion<DriveObservation> observations;
};

/// Settings of --death that a drive is judged at besides its own: what it saves in gaps, and costs in
/// phantoms.
inline constexpr std::array<int, 5> kDeaths = {1, 2, 3, 5, 10};

/// The vehicle's figures at one of them.
struct DeathOutcome {
  ByVersion<double> track_gap_s{};
  ByVersion<int> phantom_frames{};
};

/// A vehicle through its drive.
struct VehicleDrive {
  std::string sequence, type;
  int track = -1;
  RoofTrackFit roof;
  ByVersion<int> phantom_tracks{};  ///< different ones
  std::vector<DriveFrame> frames;   ///< by rising time
  std::array<DeathOutcome, kDeaths.size()> deaths{};
};

/// SEQUENCE_TRACK, as its file is called.
std::string vehicle_name(const std::string& sequence, int track);
/// Vehicles of a drive, by sequence and identity.
using DriveVehicles = std::set<std::pair<std::string, int>>;

/// Decelerations of the reserve, m/s².
inline constexpr std::array<int, 3> kBrakes = {4, 6, 8};

/// What follows for one version.
struct DriveOutcome {
  int found = 0;                      ///< frames
  double gap_s = 0, track_gap_s = 0;  ///< longest: of detections, of confirmed tracks
  double phantom_s = 0, phantom_lane_s = 0;
  int phantom_frames = 0;
  /// At the first confirmation.
  struct Confirmation {
    double seconds = 0, metres = 0, closing = 0;
    std::optional<double> time_to_collision;  ///< s at that speed; none if it does not come nearer
    std::array<double, kBrakes.size()> reserve{};
  };
  std::optional<Confirmation> confirmed;  ///< none: it never was
};
/// Computes these figures from the vehicle's frames.
DriveOutcome outcome_of(const VehicleDrive& vehicle, DriveVersion version);

/// As in result.json, with all that read_vehicle_drive needs. strip, for those who draw it, says how long
/// each frame stands (stands_s), and after which the vehicle is away (1, else 0), as gaps are counted.
nlohmann::json to_json(const VehicleDrive& vehicle);
/// Its inverse. InputError naming file and field for anything else.
VehicleDrive read_vehicle_drive(const JsonFields& json);

// What a drive says over all its vehicles: medians, shares and how much the object adds.

/// A drive, judged.
struct DriveResult {
  std::vector<VehicleDrive> vehicles;  ///< by sequence, then by identity
  TrackScores clean;  ///< of tracks of cars and vans as recorded, at an IoU of 0.5 from above
  int frames = 0;
  SkippedHosts left_out;  ///< vehicles beside which the object has no room in some frame
};

/// {vehicles: as to_json(VehicleDrive), gap_s, track_gap_s, confirmed_m: medians over vehicles {clean,
/// attacked, random, attacked_less_clean, attacked_less_random: {value, low, high}} (median_interval; a
/// vehicle that is never confirmed counts as confirmed at 0 m), later_m: {vehicles, than_clean, than_random}:
/// by how many metres less far the attacked one is confirmed, over those that come nearer, near: {metres,
/// vehicles: first seen beyond, clean, …: of these, not confirmed before}, never_confirmed: {clean, …},
/// deaths: [{death, track_gap_s: medians, phantom_share: of the frames}] for kDeaths, roof: medians of
/// kRoofTrackNumbers, survival: [{seconds, clean, attacked, random: share of vehicles with a gap of so long
/// or more}], tracker: TrackScores as recorded, frames, left_out}
nlohmann::json to_json(const DriveResult& result);

/// By what the object adds to the longest gap of detection, the most first.
std::vector<const VehicleDrive*> by_added_gap(const std::vector<VehicleDrive>& vehicles);
/// At most `count` vehicles, those of the longest gap that the object adds to the recorded one. Only where it
/// adds any.
DriveVehicles longest_hidden(const DriveResult& result, int count);
/// The same vehicles by another renderer: {vehicles: [as above], gap_s, track_gap_s: medians as above,
/// raster_gap_s: the same of `plain`, kept: {value, low, high}: what the object adds to the gaps, as a share
/// of what it adds in `plain`}. They were chosen for their gaps in `plain`, so kept is rather too low.
nlohmann::json by_renderer(const DriveResult& result, const DriveResult& plain);

}  // namespace mirage
