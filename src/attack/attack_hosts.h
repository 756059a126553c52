// Hosts in unlabelled frames: the vehicles that the detector finds there without the object.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "attack/attack_settings.h"
#include "attack/detector_pool.h"
#include "frames/hosts.h"

namespace mirage {

/// Runs the detector on each unlabelled frame of settings.data. Its detections above the score threshold of
/// an evaluation (evaluation.h) become labelled cars. Boxes are bird's-eye, with bottom and height from the
/// sweep (detection/car_in_picture.h); never occluded, and truncated by the picture's edge alone. The labels
/// go to OUT/labelled, a data set (scene/data/layouts.h, open_given_labels); returns its folder. Labelled
/// frames keep their labels. Existing labels in OUT/labelled are kept if their detector and frames are the
/// same, by content; otherwise InputError. FieldError if every frame has labels, or if the detector finds
/// boxes in the picture alone. Interrupted between frames.
std::filesystem::path label_by_detections(const AttackSettings& settings, const DetectorPool& detectors);

// The validation part of the training vehicles, which tells when an attack has reached its plateau.

/// Largest share of the training frames that is held out.
inline constexpr double kHeldOutShare = 0.2;
/// Frames are held out only until they show this many hosts; the last frame may exceed it.
inline constexpr std::size_t kMaxHeldOut = 16;

/// Training hosts, split by whole frames: no training picture shows a validation vehicle.
struct ValidationPart {
  std::vector<Host> learn, held_out;
};

/// Draws validation frames of `train` at random by seed until they show `most` hosts. Draws at least one
/// frame, at most kHeldOutShare of the frames, and leaves at least one. FieldError naming `field` if the
/// hosts stand in fewer than two frames.
ValidationPart split_validation(const std::vector<Host>& train, std::uint64_t seed,
                                std::size_t most = kMaxHeldOut, const char* field = "until_plateau");

// The order in which an attack visits its hosts. It is random, but a detector that caches its clean
// activations of a frame (detection/detector.h, clean_memory_mb) sees all hosts of that frame while they are
// cached.

/// Number of frames open at a time, over all lanes: the largest shipped detector caches as many in 2 GiB (110
/// MB a frame). It is a constant because the order decides the result, and memory must not.
inline constexpr std::size_t kOpenFrames = 16;

/// Place k of every batch belongs to lane k mod lanes(); lanes share no frames. If every place is its own
/// lane, processes share no frames either (attack/attack_step.h assigns places to processes), so no two of
/// them compute the same clean activations. A lane is an endless sequence of passes over its hosts. A pass
/// opens its frames in random order, some at a time, and draws the next host among the remaining hosts of the
/// open frames. A frame without remaining hosts makes room for the next. No host occurs twice in a batch if
/// there are enough. The order depends on (hosts, batch, seed) alone.
class HostOrder {
 public:
  /// One lane for each place of the batch, but fewer if some lane would have over 25 % more hosts than
  /// another. Hosts are to be visited equally often. `batch` ≥ 1; `hosts` not empty.
  HostOrder(std::span<const Host> hosts, int batch, std::uint64_t seed);

  /// The `batch` host indices of iteration `iteration`.
  std::vector<std::size_t> batch(long iteration) const;
  /// Number of lanes, at least 1.
  std::size_t lanes() const { return lanes_.size(); }

 private:
  /// Frames, each a list of hosts.
  using Lane = std::vector<std::vector<std::size_t>>;
  /// The lane's number of places in a batch.
  std::size_t places(std::size_t lane) const;
  /// The hosts of a lane in the order drawn for pass `pass`.
  std::vector<std::size_t> drawn_order(std::size_t lane, long pass) const;
  /// The same, changed so that the batch which spans two passes repeats no host. Unchanged if the lane has
  /// too few hosts for that.
  std::vector<std::size_t> order(std::size_t lane, long pass) const;

  int batch_;
  std::uint64_t seed_;
  std::vector<Lane> lanes_;
};

}  // namespace mirage
