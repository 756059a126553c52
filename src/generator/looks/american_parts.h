// Things in North American streets. Signs face −x (oncoming traffic).
#pragma once

#include "generator/parts.h"

namespace mirage::generator::american {

/// Saloons, SUVs, pick-ups and the rest of the car family by their shares there.
Actor make_car(RandomStream& random);
/// KITTI's type "Misc".
Actor make_school_bus(RandomStream& random);

/// Rows of block letters between two corners of a board that faces −x: `y0` (reader's left) to `y1`, middle
/// height `z`; added to `mesh` at `x`.
void add_letters(Mesh& mesh, double x, double y0, double y1, double z, double height, RandomStream& random);

/// Pole at the origin, arm of `reach` metres towards +y, heads over the lanes at the listed y; a street-name
/// board on the arm. `lit`: 0 red, 1 amber, 2 green.
Actor make_mast_arm(RandomStream& random, double reach, const std::vector<double>& heads, int lit);
/// One signal head, its middle at (0, 0, z), facing −x.
void add_signal_head(Actor& actor, double y, double z, int lit, bool yellow);
/// Wooden pole with cross-arm (along y), insulators, now and then a transformer.
Actor make_utility_pole(RandomStream& random, double height);
Actor make_street_lamp(RandomStream& random);
/// On a post: speed limit, warning, no parking, street names.
Actor make_sign(RandomStream& random);
Actor make_stop_sign(RandomStream& random);
Actor make_hydrant(RandomStream& random);
/// A shop's tall sign.
Actor make_pylon(RandomStream& random);
/// Mailboxes, bins, benches.
Actor make_kerb_item(RandomStream& random);

}  // namespace mirage::generator::american
