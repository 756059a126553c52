// The picture that an area-sampling camera takes of a mesh, and its derivative, both exact.
//
// A pixel's colour is the mean over its square of what is seen there: with V_t ⊂ R² the part of the picture
// in which texel t of a face is the nearest surface (coverage/visible.h), c_t its colour and B the
// photograph's pixel,
//     A_i = Σ_t |V_t ∩ pixel i|,    I_i = Σ_t |V_t ∩ pixel i| c_t + (1 − A_i) B_i               (areas in
//     px²)
// Every V_t is a polygon: faces, what hides them, lines where faces cross and borders of texels
// (perspective-correct barycentrics, TexelAtlas) are straight on screen. So there is nothing to sample, no σ
// and no γ. By Green's theorem an area is a sum over the polygon's edges, each of which meets few pixels.
//
// The VJP is the derivative of these areas (Reynolds' transport theorem): over every visible edge e, with
// outward normal n and v the speed at which the edge moves,
//     d loss = Σ_i g_i · Σ_e ∫_{e ∩ pixel i} (c_inside − c_outside) (v · n) ds,        g = d loss / d (I, A)
// v is linear along an edge: silhouettes and mesh edges move with their two vertices, borders of texels with
// the points of the face that they are painted on, a line where faces F and G cross with both
// (v · n = −∂(1/z_G − 1/z_F) / |∇(1/z_G − 1/z_F)|). What is hidden has no influence and gets no gradient.
// Edges that lie exactly on each other (kinks of the loss) take one side's. Ideas: Li, Aittala, Durand and
// Lehtinen (SIGGRAPH Asia 2018), Laine et al. (nvdiffrast, 2020), Pidhorskyi et al. (EdgeGrad, ECCV 2024).
#pragma once

#include <memory>

#include "sensors/soft_rasterizer.h"

namespace mirage {

/// What a forward pass leaves for its VJP. Its memory is kept from call to call.
class ExactTape {
 public:
  ExactTape();
  ~ExactTape();
  /// Takes the other's memory.
  ExactTape(ExactTape&&) noexcept;
  /// Takes the other's memory.
  ExactTape& operator=(ExactTape&&) noexcept;

  Image<double> rgba;  ///< window-sized: I and A
  double area = 0;     ///< px² of the whole object, up to one image's size beyond the image; no depth limit

  struct State;
  std::unique_ptr<State> state;
};

/// Draws both sides of all faces (Texture::atlas only), with perspective-correct texture; `supersampling` is
/// not looked at. A surface behind the depth limit of a pixel is not there, cut along z = limit where the
/// pixel's part of it crosses that; nothing behind it shows either. Faces without an area (kNoArea), not
/// finite or with a depth ≤ 0 are skipped. InputError, naming it, for a colour that is not finite and for
/// Texture::vertex.
template <class S>
void draw_exact(const ScreenMesh<double>& mesh, const RasterTarget<S>& target, ExactTape& tape);

/// VJP of the last draw_exact into this tape, of the same mesh and target; d_rgba is window-sized RGBA.
/// Fills ScreenGradient::corner_barycentrics where the mesh has parts of clipped faces.
template <class S>
ScreenGradient<double> draw_exact_vjp(const ScreenMesh<double>& mesh, const RasterTarget<S>& target,
                                      const Image<double>& d_rgba, const ExactTape& tape);

}  // namespace mirage
