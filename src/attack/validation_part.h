// The part of an attack's training vehicles that tells when the attack is at its plateau.
#pragma once

#include <cstdint>
#include <vector>

#include "frames/hosts.h"

namespace mirage {

/// At most this share of the training frames is held out, and no more frames than show kMostHeldOut hosts.
inline constexpr double kHeldOutShare = 0.2;
inline constexpr std::size_t kMostHeldOut = 16;

/// Training hosts, apart: whole frames are drawn, so that no vehicle held out stands in a picture that is
/// learned on.
struct ValidationPart {
  std::vector<Host> learn, held_out;
};

/// Draws frames of `train` at random by seed: one at least, and one at least is left; no more than show
/// `most` hosts. FieldError naming `field` if the hosts stand in fewer than two frames.
ValidationPart split_validation(const std::vector<Host>& train, std::uint64_t seed,
                                std::size_t most = kMostHeldOut, const char* field = "until_plateau");

}  // namespace mirage
