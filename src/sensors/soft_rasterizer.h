// Soft rasteriser (Liu, Li, Chen, Li: Soft Rasterizer, ICCV 2019), forward and exact VJP.
//
// For pixel i and face j, with d² the squared Euclidean distance from the pixel centre to the face's boundary
// in NDC of the image's longer side and δ = ±1 inside / outside:
//     D_ij = sigmoid(δ d² / σ)                                      coverage           (eq. 1)
//     z_ij = 1 / Σ_k b_k / z_k,  z̄_ij = (far − z_ij) / (far − near)  clipped screen-space barycentrics b
//     w_ij = D_ij exp(z̄_ij / γ) / (Σ_k D_ik exp(z̄_ik / γ) + exp(ε / γ))               (eq. 3)
//     I_i  = Σ_j w_ij C_ij + w_i,background C_background,i                              (eq. 2)
//     S_i  = 1 − Π_j (1 − D_ij)                                      silhouette         (eq. 4)
// Faces outside which d² ≥ T = σ log(1/dist_eps − 1), and pixels outside the face's bounding box grown by √T,
// are skipped. The silhouette counts every face; colour only fragments with near ≤ z ≤ far.
#pragma once

#include <array>
#include <vector>

#include "base/image.h"
#include "base/types.h"

namespace mirage {

/// How the photograph behind the object enters.
enum class Background {
  paper_logit,  ///< the paper's: background logit ε. Dilates the object to where D exp(z̄/γ) ≈ exp(ε/γ), that
                ///< is by √T, because γ is small
  authors_logit,  ///< as the authors' code: logit 2ε (golden values only)
  silhouette,     ///< I = S · (colour among faces) + (1 − S) · background: edges stay where they are
};

template <class S>
struct SoftRasterSettings {
  S sigma = S(5e-7);                 ///< edge softness in NDC²; 1 px of a 1242 px image is 2.6e-6
  S gamma = S(1e-2);                 ///< softness of depth ordering, in units of (far − near)
  S epsilon = S(1e-3);               ///< ε of the background logit
  S dist_eps = S(1e-4);              ///< coverage below which a face is skipped
  S near = S(1), far = S(100);       ///< depth range, m; set it per object (DESIGN, section 4)
  bool double_sided = true;          ///< false keeps only faces that turn their front to the camera
  bool perspective_texture = true;   ///< texels by perspective-correct barycentrics (false: screen-space)
  bool frozen_barycentrics = false;  ///< the authors' gradient: barycentrics held constant in z
  /// Faces whose smallest altitude on screen is below this (NDC) have their barycentric slope scaled by
  /// altitude / edge_on_altitude in the VJP, so that it is bounded by 1 / edge_on_altitude.
  S edge_on_altitude = S(1e-6);
  Background background = Background::silhouette;
};

/// What is drawn. Screen frame: x right, y up in NDC of the longer image side (pixel (u, v) has its centre at
/// ((2u + 1 − W)/L, (H − 1 − 2v)/L), L = max(W, H)); z is depth in metres. Counter-clockwise = front.
template <class S>
struct ScreenMesh {
  std::vector<std::array<Vec3<S>, 3>> faces;
  std::vector<Vec3<S>> texels;  ///< faces × C²: colours with the light already multiplied in
  int resolution = 1;           ///< C
};

/// Where it is drawn: a window of an image.
template <class S>
struct RasterTarget {
  int width = 0, height = 0;  ///< of the whole image
  PixelRect rect;             ///< the window
  Image<S> background;        ///< window-sized RGB
  Image<S> depth_limit;       ///< window-sized, or empty: fragments with z > limit are dropped (both I and S)
};

/// Window-sized RGBA: I and S.
template <class S>
Image<S> rasterize(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings,
                   const RasterTarget<S>& target);

template <class S>
struct ScreenGradient {
  std::vector<std::array<Vec3<S>, 3>> faces;
  std::vector<Vec3<S>> texels;
};

/// Exact derivative of rasterize: Σ d_rgba · ∂rgba/∂(faces, texels). The choice of fragments (cut-off, depth
/// limit, near / far, texel index) is piecewise constant and contributes nothing.
template <class S>
ScreenGradient<S> rasterize_vjp(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings,
                                const RasterTarget<S>& target, const Image<S>& d_rgba);

/// NDC of the centre of pixel (u, v).
template <class S>
Vec2<S> ndc_from_pixel(S u, S v, int width, int height) {
  const S longer = S(width > height ? width : height);
  return {(2 * u + 1 - S(width)) / longer, (S(height) - 1 - 2 * v) / longer};
}

/// Pixels that the mesh can touch in an image of width × height: its faces' bounding boxes grown by √T,
/// clipped to `clip` (which may reach beyond the image).
template <class S>
PixelRect touched_pixels(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings, int width,
                         int height, const PixelRect& clip);

/// Index within a face of the texel at barycentrics (b0, b1) (see TexelAtlas).
template <class S>
int texel_index(S b0, S b1, int resolution);

}  // namespace mirage
