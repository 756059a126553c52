// Input of the soft rasteriser: mesh, target window and options (soft_rasterizer.h has the equations).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "base/image.h"
#include "base/types.h"
#include "geometry/mesh.h"

namespace mirage {

/// Blending of the photograph behind the object.
enum class Background {
  paper_logit,  ///< the paper's: background logit ε. Dilates the object to where D exp(z̄/γ) ≈ exp(ε/γ), that
                ///< is by √T, because γ is small
  authors_logit,  ///< the authors' code: logit 2ε (golden values only)
  silhouette,     ///< I = S · (colour among faces) + (1 − S) · background: edges stay in place
};
constexpr auto words_of(Background) {
  return std::to_array<const char*>({"paper_logit", "authors_logit", "silhouette"});
}

/// Coverage D.
enum class Coverage {
  euclidean,    ///< sigmoid(δ d² / σ)
  barycentric,  ///< sigmoid(δ b² / σ), b the smallest barycentric; skipped where −δ b² ≥ T
  hard,         ///< 1 inside, skipped outside; no gradient
};
constexpr auto words_of(Coverage) {
  return std::to_array<const char*>({"euclidean", "barycentric", "hard"});
}

/// Colour among faces.
enum class ColorBlend {
  softmax,  ///< weights w above
  hard,     ///< the nearest face that contains the sample; gradient to its texture, and to the face through
            ///< its barycentrics (Texture::vertex)
};
constexpr auto words_of(ColorBlend) {
  return std::to_array<const char*>({"softmax", "hard"});
}

/// Combination of the coverages D of a pixel's faces to its silhouette S.
enum class SilhouetteBlend {
  product,  ///< 1 − Π(1 − D)
  sum,      ///< Σ D / number of faces, as in the authors' code
  hard,     ///< 1 where any D > 1/2; no gradient
};
constexpr auto words_of(SilhouetteBlend) {
  return std::to_array<const char*>({"product", "sum", "hard"});
}

/// Faces that give colour, by their winding on screen (y up). The authors' one-sided mode is `clockwise`.
enum class Sides { both, counter_clockwise, clockwise };
constexpr auto words_of(Sides) {
  return std::to_array<const char*>({"both", "counter_clockwise", "clockwise"});
}

/// The source of a face's colour.
enum class Texture {
  atlas,   ///< C² texels a face, nearest (TexelAtlas)
  vertex,  ///< three colours a face, interpolated
};

/// Options of the soft rasteriser (Liu et al., ICCV 2019), with Mirage's defaults.
template <class S>
struct SoftRasterSettings {
  S sigma = S(5e-7);            ///< edge softness in NDC²; 1 px of a 1242 px image is 2.6e-6
  S gamma = S(1e-2);            ///< softness of depth ordering, in units of (far − near)
  S epsilon = S(1e-3);          ///< ε of the background logit
  S dist_eps = S(1e-4);         ///< coverage below which a face is skipped
  S near = S(1), far = S(100);  ///< depth range, m; set it per object (src/README.md)
  Coverage coverage = Coverage::euclidean;
  ColorBlend color = ColorBlend::softmax;
  SilhouetteBlend silhouette = SilhouetteBlend::product;
  Background background = Background::silhouette;
  Sides sides = Sides::both;
  bool perspective_texture = true;   ///< texture by perspective-correct barycentrics (false: screen-space)
  bool frozen_barycentrics = false;  ///< the authors' gradient: barycentrics held constant in z
  /// Faces whose smallest altitude on screen is below this (NDC) have their barycentric slope scaled by
  /// altitude / edge_on_altitude in the VJP, so that it is bounded by 1 / edge_on_altitude.
  S edge_on_altitude = S(1e-6);
};

/// A face whose altitude on screen (NDC) is smaller covers nothing: it has no barycentrics.
inline constexpr double kNoArea = 1e-12;

/// A mesh to draw. Screen frame: x right, y up in NDC of the longer image side (pixel (u, v) has its centre
/// at ((2u + 1 − W)/L, (H − 1 − 2v)/L), L = max(W, H)); z is depth in metres, > 0. A face with a coordinate
/// that is not finite or a depth ≤ 0 is skipped. The grid locates the texels of each face that has its own.
template <class S>
struct ScreenMesh : TexelGrid {
  std::vector<std::array<Vec3<S>, 3>> faces;
  std::vector<Vec3<S>> texels;  ///< colours with the light already multiplied in; see `texture`
  Texture texture = Texture::atlas;
  /// Parts of clipped faces (projection.h), atlas only. Both empty: every face is whole and has its own
  /// texels. Otherwise one entry a face: the face whose texels it uses, and its corners' barycentrics there.
  std::vector<int> texel_face;
  std::vector<std::array<Vec3<S>, 3>> corner_barycentrics;
};

/// The target of a drawing: a window of an image.
template <class S>
struct RasterTarget {
  int width = 0, height = 0;  ///< of the whole image
  PixelRect rect;             ///< the window
  /// Samples a pixel along each side, on a regular grid, averaged. 1: the pixel's centre.
  int supersampling = 1;
  Image<S> background;   ///< window-sized RGB
  Image<S> depth_limit;  ///< window-sized, or empty: fragments with z > limit are dropped (both I and S)
};

/// d loss / d the three corners of each face, as in ScreenMesh, and d loss / d texels.
template <class S>
struct ScreenGradient {
  std::vector<std::array<Vec3<S>, 3>> faces;
  std::vector<Vec3<S>> texels;
  /// d loss / d ScreenMesh::corner_barycentrics; empty if texel borders don't count (this rasteriser).
  std::vector<std::array<Vec3<S>, 3>> corner_barycentrics;
};

/// NDC of the centre of pixel (u, v).
template <class S>
Vec2<S> ndc_from_pixel(S u, S v, int width, int height) {
  const S longer = S(width > height ? width : height);
  return {(2 * u + 1 - S(width)) / longer, (S(height) - 1 - 2 * v) / longer};
}

/// Logit of the background, comparable to the faces' z̄; meaningless for Background::silhouette.
template <class S>
S background_logit(const SoftRasterSettings<S>& settings) {
  return (settings.background == Background::authors_logit ? 2 : 1) * settings.epsilon;
}

/// T: squared distance (NDC², or barycentric²) outside a face beyond which the face is skipped.
template <class S>
S cut_off(const SoftRasterSettings<S>& settings) {
  return settings.sigma * std::log(1 / settings.dist_eps - 1);
}

}  // namespace mirage
