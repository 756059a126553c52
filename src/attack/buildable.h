// Constraints that make an adversary buildable and printable: no intersecting faces, a minimum wall
// thickness, a flat base for the roof, and printable colours.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "attack/adversary.h"
#include "base/types.h"
#include "geometry/convex_polytope.h"
#include "geometry/mesh.h"

namespace mirage {

// The measured colours of a printer. A halftone's dots mix the areas of paper and of the inks' overprints
// (the Neugebauer primaries; H. E. J. Neugebauer, "Die theoretischen Grundlagen des Mehrfarbenbuchdruckes",
// 1937; the weights of the areas, M. E. Demichel, 1924, sum to 1): in linear light a printed colour is a
// convex combination of them. So the gamut is the convex hull of measured patches; dot gain moves a colour
// within it.
//
// Patches come from a CMYK printer's ICC profile or from a chart. The profile gives the 16 overprints
// (absolute colorimetric: paper is no perfect white). A chart is CGATS.17 text (IT8.7/3, IT8.7/4, ArgyllCMS's
// .ti3) with XYZ or Lab for D50 and 2°. Patches are converted to texel colours: Bradford to D65, Rec. 709
// primaries, scene-linear. The hull is clipped to [0, 1] in each channel, the range of textures.

/// A gamut of scenes/prints: offset print on coated paper.
inline constexpr const char* kDefaultGamut = "fogra39";

/// The colours that texels may have, as --gamut names them.
class PrintGamut {
 public:
  /// kDefaultGamut; its file is read on first use.
  PrintGamut() = default;
  /// `points`: corners of the hull, scene-linear. nullopt for a hull without volume within [0, 1].
  static std::optional<PrintGamut> of(std::string name, const std::vector<Vec3d>& points);
  /// Each channel independently from black to white. FieldError quoting `text` if these are no reflectances.
  static PrintGamut box(double black, double white, const std::string& text = "");

  /// A shipped word, a file's absolute path, or "box:BLACK,WHITE".
  const std::string& name() const { return name_; }
  /// Whether the gamut has one range of reflectance for all channels.
  bool is_box() const { return name_.starts_with("box:"); }
  /// The hull's corners, scene-linear RGB.
  const std::vector<Vec3d>& colours() const { return solid().corners(); }
  /// Whether the texel is in the gamut, to within 1e-9.
  bool holds(const Vec3d& texel) const;
  /// The nearest colour of the gamut (in linear RGB); the texel itself if inside.
  Vec3d nearest(const Vec3d& texel) const;

 private:
  const ConvexPolytope& solid() const;

  std::string name_ = kDefaultGamut;
  std::shared_ptr<const ConvexPolytope> solid_;  ///< null: the shipped default's
};

/// A shipped gamut's word, the file of an ICC profile or chart, or box:BLACK,WHITE (reflectances, for all
/// channels). FieldError for another text; InputError naming file and field as read_gamut.
void set_from_text(const std::string& text, PrintGamut& gamut);
/// The gamut's name, which set_from_text takes.
inline std::string text_of(const PrintGamut& gamut) {
  return gamut.name();
}

/// Reads an ICC profile or chart. InputError naming file and field: neither, not of a CMYK printer, no colour
/// columns, fewer than 4 patches, patches in one plane, or a value that no print has.
PrintGamut read_gamut(const std::filesystem::path& file, const std::string& name);

/// The corners as [[r, g, b], …].
nlohmann::json to_json(const PrintGamut& gamut);
/// Inverse of to_json, for the value of `key` in `file`. InputError if it is invalid.
PrintGamut read_gamut(const nlohmann::json& written, const std::filesystem::path& file,
                      const std::string& key, const std::string& name);

/// The rules that a buildable adversary keeps.
struct BuildableSettings {
  bool on = true;
  double min_thickness = 0.01;  ///< m, smallest wall thickness by geometry/solid.h
  /// Share of a start's height cut off for a flat base, unless it already has one.
  double base = 1.0 / 6;
  PrintGamut gamut = {};  ///< gamut of the texels

  /// Files of earlier versions end with the reflectances of black and white, the same for each channel.
  static constexpr std::size_t kFormerNumbers = 2;
  /// Reads {black, white} as PrintGamut::box. FieldError if these are no reflectances.
  void read_former(std::span<const double> black_and_white) {
    gamut = PrintGamut::box(black_and_white[0], black_and_white[1]);
  }
};

template <class Visitor, FieldsOf<BuildableSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit(
      {.name = "buildable",
       .help = "let the mesh's faces intersect, as in the paper. By default the mesh stays a printable solid "
               "with thick walls, a flat base and colours of --gamut",
       .option = "free"},
      s.on);
  visit({.name = "min_thickness", .help = "thinnest wall without --free, m", .range = {0, kMaxAdversarySize}},
        s.min_thickness);
  visit({.name = "cut", .range = kShare, .option = "", .lacking = "0"}, s.base);
}

/// FieldError for a value that no mesh can meet.
void check_buildable(const BuildableSettings& settings, const AdversaryLimits& limits);

/// Makes the start buildable: cuts off its lowest part for a flat base on the box's floor, and moves texels
/// into the print's gamut. FieldError if the result breaks the rules of a solid.
void make_buildable(TexturedMesh& adversary, const BuildableSettings& settings,
                    const AdversaryLimits& limits);

/// An Adam step of the vertices (m) that preserves a solid. The gradient and the step are smoothed over
/// nearby vertices (a Gaussian of distance), and steps towards a side of the box fade out before it. So the
/// step is a smooth map of space with a derivative close to the identity. Such a map is invertible, so faces
/// smaller than the Gaussian cannot pass through each other (Christensen, Rabbitt, Miller, IEEE Trans. Image
/// Processing 1996). keep_buildable enforces the rules afterwards.
void step_buildable(Adam& adam, std::vector<Vec3d>& vertices, const std::vector<Vec3d>& gradient,
                    const AdversaryLimits& limits);

/// Restores the rules after a step from `before`, which is buildable. Vertices at the lowest height of
/// `before` stay there, and all others stay above. Walls that are nearly too thin are moved apart. Vertices
/// of intersecting faces, and of walls still too thin, return towards `before`, first halfway, then fully,
/// until no face breaks a rule.
void keep_buildable(TexturedMesh& adversary, const TexturedMesh& before, const BuildableSettings& settings,
                    const AdversaryLimits& limits);

/// The random mesh that a learned one is compared with (random_adversary), under the same rules.
TexturedMesh random_baseline(std::uint64_t seed, const AdversaryLimits& limits,
                             const BuildableSettings& settings);

/// Measured properties of a mesh.
struct BuildableReport {
  std::size_t intersecting_pairs = 0;  ///< of faces
  double min_thickness = 0;            ///< m, thinnest wall
  long base_vertices = 0;              ///< vertices at the lowest height
  double base_area = 0;                ///< m², area of faces at that height
  bool watertight = false;
  double printable = 0;  ///< share of texels within the print's gamut
  /// Whether the mesh is buildable: watertight, no intersecting faces, walls of at least `least` (m), a flat
  /// base, and printable colours.
  bool holds(double least) const {
    return watertight && intersecting_pairs == 0 && min_thickness >= least - 1e-9 && base_area > 0 &&
           printable > 1 - 1e-9;
  }
};
template <class Visitor, FieldsOf<BuildableReport> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "intersecting_pairs", s.intersecting_pairs, "min_thickness_m", s.min_thickness,
              "base_vertices", s.base_vertices, "base_area_m2", s.base_area, "watertight", s.watertight,
              "texels_in_print_range", s.printable);
}
/// Measures the mesh, and counts its texels within settings.gamut.
BuildableReport buildable_report(const TexturedMesh& adversary, const BuildableSettings& settings);

}  // namespace mirage
