// The true shapes of a generated frame's vehicles: what a fit to the frame's sweep should find.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "generator/look.h"
#include "geometry/box.h"
#include "geometry/mesh.h"

namespace mirage::generator {

/// A generated vehicle as it is, with nothing hidden.
struct TrueVehicle {
  std::string type;
  Box3 box;   ///< `velo`
  Mesh mesh;  ///< `velo`; every surface of it, seats and lamps included, but for what is on its roof
  std::string kind = {};  ///< a car's body style ("hatchback", …); else empty
};

/// The labelled things of frame `index` of a seed, laid out again (nothing is rendered). `height`: of the
/// rig's LiDAR over the ground, as in make_street.
std::vector<TrueVehicle> true_vehicles(std::uint64_t seed, std::uint64_t index, double height,
                                       Look look = Look::european);

/// What a data set's streets come from.
struct StreetSource {
  std::uint64_t seed = 0;
  Look look = Look::european;
};
/// A data set's source, if this generator's version made it (dataset.json), so that true_vehicles gives what
/// was rendered; nothing for recorded sets and for those of other versions. InputError for a broken
/// dataset.json.
std::optional<StreetSource> source_of(const std::filesystem::path& data);
/// The index of a frame that the generator named; none for another name, which somebody gave it since.
std::optional<std::uint64_t> index_of(const std::string& frame);

/// The one of `vehicles` that a label of the data set means: same type, centre nearest and within 0.1 m.
const TrueVehicle* find_vehicle(const std::vector<TrueVehicle>& vehicles, const std::string& type,
                                const Box3& box);

}  // namespace mirage::generator
