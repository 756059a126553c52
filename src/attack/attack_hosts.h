// Hosts in frames that nobody has labelled: what the detector finds there without the object.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "attack/attack_settings.h"
#include "attack/detector_pool.h"
#include "frames/hosts.h"

namespace mirage {

/// Lets the detector look at each unlabelled frame of settings.data, and takes what it finds with a score
/// over that of an evaluation (evaluation.h) for the frame's cars: bird's-eye boxes with bottom and height
/// from the sweep (detection/car_in_picture.h), as labels that are neither truncated nor occluded but by the
/// picture's frame. They go to OUT/labelled, a data set (scene/data/layouts.h, open_given_labels) whose
/// folder is returned: what reads it meets these labels. Frames with labels keep theirs. Labels that lie
/// there are kept if they are of this detector and of these frames, by content; else InputError. FieldError
/// where every frame has labels, and for a detector of the picture alone, whose boxes stand nowhere;
/// Interrupted between frames.
std::filesystem::path label_by_detections(const AttackSettings& settings, const DetectorPool& detectors);

// The part of an attack's training vehicles that tells when the attack is at its plateau.

/// At most this share of the training frames is held out, and no more frames than show kMaxHeldOut hosts.
inline constexpr double kHeldOutShare = 0.2;
/// Hosts that are held out at most, unless a single frame shows more.
inline constexpr std::size_t kMaxHeldOut = 16;

/// Training hosts, apart: whole frames are drawn, so that no vehicle held out stands in a picture that is
/// learned on.
struct ValidationPart {
  std::vector<Host> learn, held_out;
};

/// Draws frames of `train` at random by seed: one at least, and one at least is left; no more than show
/// `most` hosts. FieldError naming `field` if the hosts stand in fewer than two frames.
ValidationPart split_validation(const std::vector<Host>& train, std::uint64_t seed,
                                std::size_t most = kMaxHeldOut, const char* field = "until_plateau");

// In which order an attack meets its hosts: at random, and such that a detector that keeps what it made of a
// frame (detection/detector.h, clean_memory_mb) meets all hosts of a frame while it still has it.

/// Frames that are open at a time, of all lanes together: what the largest shipped detector keeps in 2 GiB
/// (110 MB a frame). A constant, because the order decides what is learned and memory must not.
inline constexpr std::size_t kOpenFrames = 16;

/// Place k of every batch belongs to a lane, k mod lanes(); a lane has frames of its own. Where every place
/// is a lane, so has each of several processes (a process has certain places, attack/attack_step.h): no two
/// of them make the same frame's clean activations. A lane is an endless sequence of passes over its hosts.
/// In a pass its frames are opened in random order, some at a time; the next host is drawn among all that are
/// left of the open ones, and a frame of which none is left makes room for the next. A batch meets no host
/// twice where there are enough. Known by (hosts, batch, seed) alone.
class HostOrder {
 public:
  /// As many lanes as the batch has places, fewer where frames could not be dealt so that the hosts of no
  /// lane outnumber those of another by more than a quarter: hosts are to be met equally often. `batch` ≥ 1;
  /// `hosts` not empty.
  HostOrder(std::span<const Host> hosts, int batch, std::uint64_t seed);

  /// Indices into the hosts for iteration `iteration`, `batch` of them.
  std::vector<std::size_t> batch(long iteration) const;
  /// Number of lanes, at least 1.
  std::size_t lanes() const { return lanes_.size(); }

 private:
  /// Frames, each a list of hosts.
  using Lane = std::vector<std::vector<std::size_t>>;
  /// Of a batch, the lane's.
  std::size_t places(std::size_t lane) const;
  /// The hosts of a lane in the order of pass `pass`, as drawn.
  std::vector<std::size_t> drawn_order(std::size_t lane, long pass) const;
  /// The same; those of its first batch were not met in it by the end of the pass before, if the lane has
  /// three times as many hosts as that takes.
  std::vector<std::size_t> order(std::size_t lane, long pass) const;

  int batch_;
  std::uint64_t seed_;
  std::vector<Lane> lanes_;
};

}  // namespace mirage
