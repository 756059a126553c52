// Soft rasteriser (Liu, Li, Chen, Li: Soft Rasterizer, ICCV 2019): its definition, and its reference, a plain
// loop over all pixels and faces, forward and exact VJP. raster_batch.h is the fast one.
//
// For sample i and face j, with d² the squared Euclidean distance from the sample to the face's boundary
// in NDC of the image's longer side and δ = ±1 inside / outside:
//     D_ij = sigmoid(δ d² / σ)                                      coverage           (eq. 1)
//     z_ij = 1 / Σ_k b_k / z_k,  z̄_ij = (far − z_ij) / (far − near)  clipped screen-space barycentrics b
//     w_ij = D_ij exp(z̄_ij / γ) / (Σ_k D_ik exp(z̄_ik / γ) + exp(ε / γ))               (eq. 3)
//     I_i  = Σ_j w_ij C_ij + w_i,background C_background,i                              (eq. 2)
//     S_i  = 1 − Π_j (1 − D_ij)                                      silhouette         (eq. 4)
// Faces outside which d² ≥ T = σ log(1/dist_eps − 1), and samples outside the face's bounding box grown by
// √T, are skipped. The silhouette counts every face, on either side; colour counts only fragments of the
// chosen sides with near ≤ z ≤ far. The enums of screen_mesh.h are the options of Liu et al.'s public code.
#pragma once

#include "sensors/screen_mesh.h"

namespace mirage {

/// Window-sized RGBA: I and S.
template <class S>
Image<S> rasterize(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings,
                   const RasterTarget<S>& target);

/// Exact derivative of rasterize: Σ d_rgba · ∂rgba/∂(faces, texels). The choice of fragments (cut-off, depth
/// limit, near / far, texel index, nearest face) is piecewise constant and contributes nothing.
template <class S>
ScreenGradient<S> rasterize_vjp(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings,
                                const RasterTarget<S>& target, const Image<S>& d_rgba);

/// Pixels that the mesh can touch in an image of width × height: its faces' bounding boxes grown by √T,
/// clipped to `clip` (which may reach beyond the image).
template <class S>
PixelRect touched_pixels(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings, int width,
                         int height, const PixelRect& clip);

}  // namespace mirage
