// What makes an adversary an object that can be built and printed: no face passes through another, walls of
// some thickness, a flat base for the roof, colours that ink on paper has.
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

// Colours that a printer has, measured. A halftone's dots mix the areas of paper and of the inks' overprints
// (the Neugebauer primaries; H. E. J. Neugebauer, "Die theoretischen Grundlagen des Mehrfarbenbuchdruckes",
// 1937; the weights of the areas, M. E. Demichel, 1924, sum to 1): in linear light what it prints is a convex
// combination of them. So the gamut is the convex hull of measured patches; dot gain moves a colour within
// it.
//
// Patches come from an ICC profile of a CMYK printer, whose 16 overprints it tells (absolute colorimetric:
// paper is no perfect white), or from a chart of measured patches as CGATS.17 text (IT8.7/3, IT8.7/4,
// ArgyllCMS's .ti3) with XYZ or Lab for D50 and 2°. They become texels' colours: Bradford to D65, Rec. 709
// primaries, scene-linear. Of the hull, the part within [0, 1] in each channel counts, which is what textures
// hold.

/// Of scenes/prints: offset print on coated paper.
inline constexpr const char* kDefaultGamut = "fogra39";

/// The colours that texels may have, as --gamut names them.
class PrintGamut {
 public:
  /// kDefaultGamut, whose file is read when it is first asked for.
  PrintGamut() = default;
  /// `points`: corners of the hull, scene-linear. None for a hull without volume within [0, 1].
  static std::optional<PrintGamut> of(std::string name, const std::vector<Vec3d>& points);
  /// Each channel by itself from black to white. FieldError, of that `text`, if these are no reflectances.
  static PrintGamut box(double black, double white, const std::string& text = "");

  /// A shipped word, a file's absolute path, or "box:BLACK,WHITE".
  const std::string& name() const { return name_; }
  /// Whether the gamut has one range of reflectance for all channels.
  bool is_box() const { return name_.starts_with("box:"); }
  /// Corners.
  const std::vector<Vec3d>& colours() const { return solid().corners(); }
  /// To within 1e-9.
  bool holds(const Vec3d& texel) const;
  /// The texel itself, or the nearest of the gamut (in linear RGB).
  Vec3d nearest(const Vec3d& texel) const;

 private:
  const ConvexPolytope& solid() const;

  std::string name_ = kDefaultGamut;
  std::shared_ptr<const ConvexPolytope> solid_;  ///< null: of the shipped default
};

/// A shipped gamut's word, the file of an ICC profile or chart, or box:BLACK,WHITE (reflectances, for all
/// channels). FieldError for another text; InputError naming file and field as read_gamut.
void set_from_text(const std::string& text, PrintGamut& gamut);
/// The gamut's name, which set_from_text takes.
inline std::string text_of(const PrintGamut& gamut) {
  return gamut.name();
}

/// Of a file. InputError naming file and field: no ICC profile and no chart, not of a CMYK printer, no
/// columns of colours, fewer than 4 patches, a value that no print has, or patches in one plane.
PrintGamut read_gamut(const std::filesystem::path& file, const std::string& name);

/// [[r, g, b], …], its corners.
nlohmann::json to_json(const PrintGamut& gamut);
/// Of what to_json wrote, which stands in a `file` as its `key`. InputError.
PrintGamut read_gamut(const nlohmann::json& written, const std::filesystem::path& file,
                      const std::string& key, const std::string& name);

/// The rules that a buildable adversary keeps.
struct BuildableSettings {
  bool on = true;
  double min_thickness = 0.01;  ///< m, of the walls as geometry/solid.h measures them
  /// Share of a start's height that is cut off for its flat base, unless it has one.
  double base = 1.0 / 6;
  PrintGamut gamut = {};  ///< texels stay in it

  /// Files of earlier programs end with reflectances of black and white, for each channel by itself.
  static constexpr std::size_t kFormerNumbers = 2;
  /// Takes {black, white} as PrintGamut::box does. FieldError if these are no reflectances.
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

/// The start, made buildable: its lowest part is cut off for a flat base, which stands on the box's floor,
/// and texels come into the print's gamut. FieldError for a start that is no such solid.
void make_buildable(TexturedMesh& adversary, const BuildableSettings& settings,
                    const AdversaryLimits& limits);

/// The optimiser's step of vertices (m) that keeps a solid one. The gradient and Adam's step are averaged
/// over what is near in space (a Gaussian), and steps towards a side of the box fade out before it. So the
/// step is a smooth map of space whose derivative stays close to the identity: it is invertible, and faces
/// smaller than the Gaussian cannot pass through each other (Christensen, Rabbitt, Miller, IEEE Trans. Image
/// Processing 1996). keep_buildable has the last word.
void step_buildable(Adam& adam, std::vector<Vec3d>& vertices, const std::vector<Vec3d>& gradient,
                    const AdversaryLimits& limits);

/// After a step from `before`, which is buildable: vertices that `before` has at its lowest height stay
/// there, the others above; walls that are nearly too thin are moved apart; and vertices of faces that pass
/// through another, or whose wall is too thin all the same, go back towards `before`, first half the way and
/// then all of it, until none is left.
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
  double printable = 0;  ///< share of texels within the print's gamut
  /// A solid that stands: watertight, no faces that intersect, walls of at least `least` (m), a flat base,
  /// and colours that a printer has.
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
/// Measures the mesh as it is, and counts its texels within settings.gamut.
BuildableReport buildable_report(const TexturedMesh& adversary, const BuildableSettings& settings);

}  // namespace mirage
