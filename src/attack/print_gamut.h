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
#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "base/types.h"
#include "geometry/convex_polytope.h"

namespace mirage {

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

}  // namespace mirage
