// What makes an adversary an object that can be built and printed: no face passes through another, walls of
// some thickness, a flat base for the roof, colours that ink on paper has.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>

#include "attack/adversary.h"
#include "geometry/mesh.h"

namespace mirage {

/// The rules that a buildable adversary keeps.
struct BuildableSettings {
  bool on = false;
  double min_thickness = 0.01;  ///< m, of the walls as geometry/solid.h measures them
  /// Height of the flat base below the adversary's origin, as a share of the box's half height.
  double base = 0.5;
  /// Reflectance of a print's black and white: texels stay between (scene-linear, each channel). A box around
  /// an offset print's gamut on matt paper; the true gamut is smaller for saturated colours.
  double black = 0.03, white = 0.85;
};

template <class Visitor, FieldsOf<BuildableSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "buildable",
         .help = "keep the mesh printable: no self-intersection, thick walls, flat base, colours "
                 "of a printer"},
        s.on);
  visit({.name = "min_thickness", .help = "with --buildable: thinnest wall, m", .range = {0, kLargestSize}},
        s.min_thickness);
  visit({.name = "base", .range = {0, kLargestSize}, .option = ""}, s.base);
  visit({.name = "black", .range = kShare, .option = ""}, s.black);
  visit({.name = "white", .range = kShare, .option = ""}, s.white);
}

/// FieldError for a value that no mesh can meet.
void check_buildable(const BuildableSettings& settings, const AdversaryLimits& limits);

/// The start, made buildable: what lies below the base is moved up onto it, texels into the print's range.
void make_buildable(TexturedMesh& adversary, const BuildableSettings& settings,
                    const AdversaryLimits& limits);

/// After an optimiser's step from `before`, which is buildable: base vertices (those that `before` has on the
/// base) return to it, the others stay above it, and the vertices of faces that pass through another or whose
/// wall is too thin go back towards `before`, first half the way and then all of it, until none is left.
void keep_buildable(TexturedMesh& adversary, const TexturedMesh& before, const BuildableSettings& settings,
                    const AdversaryLimits& limits);

/// The random mesh that a learned one is compared with (random_adversary), under the same rules.
TexturedMesh random_baseline(std::uint64_t seed, const AdversaryLimits& limits,
                             const BuildableSettings& settings);

/// What holds of a mesh, measured.
struct BuildableReport {
  std::size_t intersecting_pairs = 0;  ///< of faces
  double min_thickness = 0;            ///< m, of its walls
  long base_vertices = 0;              ///< on the lowest height
  double base_area = 0;                ///< m², of faces that lie on it
  bool watertight = false;
  double printable = 0;  ///< share of texels within the print's range
  /// A solid that stands: watertight, no faces that intersect, walls of at least `least` (m), a flat base,
  /// and colours that a printer has.
  bool holds(double least) const {
    return watertight && intersecting_pairs == 0 && min_thickness >= least - 1e-9 && base_area > 0 &&
           printable > 1 - 1e-9;
  }
};
BuildableReport buildable_report(const TexturedMesh& adversary, const BuildableSettings& settings);

/// {intersecting_pairs, min_thickness_m, base_vertices, base_area_m2, watertight, texels_in_print_range}
nlohmann::json to_json(const BuildableReport& report);

}  // namespace mirage
