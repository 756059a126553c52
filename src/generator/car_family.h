// The car family that the shape manifold is learnt from: seven body styles, each with ranges of its
// proportions, lofted to closed meshes with wheels.
#pragma once

#include <array>
#include <string_view>
#include <vector>

#include "base/random.h"
#include "generator/car_body.h"
#include "geometry/mesh.h"
#include "scene/shape/shape_model.h"

namespace mirage {

/// Bodies of passenger cars.
enum class BodyStyle { hatchback, saloon, estate, suv, van, pickup, coupe };
/// All of them.
inline constexpr std::array<BodyStyle, 7> kBodyStyles = {
    BodyStyle::hatchback, BodyStyle::saloon, BodyStyle::estate, BodyStyle::suv,
    BodyStyle::van,       BodyStyle::pickup, BodyStyle::coupe};
/// "hatchback", …
std::string_view name_of(BodyStyle style);

/// Draws a body of the style: every measure uniform in the style's range (car_family.cpp has the table, with
/// wheelbase and overhangs as shares of the length). A pick-up's bed is covered: lofts have no hollows.
generator::BodyShape draw_body(BodyStyle style, RandomStream& random);

/// The body with its four wheels, in the vehicle's frame (x forward, y left, z up, origin on the ground under
/// the middle of its bounding box, m). Five closed, outward-wound parts that overlap: inside where the
/// winding number is above 1/2.
Mesh car_mesh(const generator::BodyShape& body);

/// `each` vehicles of every style, to learn a shape model from (scene/shape/shape_model.h).
std::vector<ShapeSample> family_samples(int each, std::uint64_t seed);

}  // namespace mirage
