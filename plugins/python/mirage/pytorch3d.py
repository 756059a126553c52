"""In the place of PyTorch3D's soft rasteriser, on a CPU: the same σ, γ and blur radius, by Mirage's own rasteriser.

    renderer = MeshRenderer(MeshRasterizer(cameras, raster_settings), SoftPhongShader(…, blend_params=blend_params))
    images = renderer(meshes)
becomes
    images = mirage.pytorch3d.SoftRenderer(cameras, raster_settings, blend_params)(meshes)

for what PyTorch3D draws without lights. PyTorch3D itself is neither needed nor imported: meshes, cameras and settings are
told by what they have. What is computed is its softmax_rgb_blend over sigmoid(−dists / σ), with these differences:
every face counts, not the nearest faces_per_pixel; outside a face barycentrics are clipped on screen before they are
corrected for perspective, not after; and the gradient is the exact one of what is drawn.
"""

from __future__ import annotations

import math
from typing import Any, Sequence

import torch

from . import _core

BLUR_FLOOR = 1e-30  # of the coverage at the blur radius: beyond it float64 has no use for a face anyway


def _array(tensor: torch.Tensor) -> Any:
    return tensor.detach().cpu().numpy()


class _Soft(torch.autograd.Function):
    """N×H×W×4 of N meshes, or H×W×4 of `one`: their vertices (V×3: NDC and depth), then their colours."""

    @staticmethod
    def forward(ctx, one, faces, by_vertex, scale, height, width, background, numbers, *tensors):
        count = len(faces)
        double = any(tensor.dtype == torch.float64 for tensor in tensors)
        arrays = [_array(tensor) for tensor in tensors]
        ctx.drawn = _core.rasterize_screens(arrays[:count], [_array(f) for f in faces], arrays[count:], by_vertex, scale,
                                            height, width, background, numbers, {"blend": "logit"}, 1, double)
        ctx.like = [(tensor.shape, tensor.dtype, tensor.device) for tensor in tensors]
        rgba = torch.from_numpy(ctx.drawn.rgba).to(tensors[0].device)
        return rgba[0] if one else rgba  # here, where it needs no gradient as large as all pictures

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, d_rgba):
        pairs = ctx.drawn.vjp(_array(d_rgba if d_rgba.dim() == 4 else d_rgba[None]))
        gradients = [vertices for vertices, _ in pairs] + [colors for _, colors in pairs]
        return (None,) * 8 + tuple(torch.from_numpy(gradient).to(device, dtype).reshape(shape)
                                   for gradient, (shape, dtype, device) in zip(gradients, ctx.like))


def soft_rasterize(verts_ndc: torch.Tensor | Sequence[torch.Tensor], faces: torch.Tensor | Sequence[torch.Tensor],
                   colors: torch.Tensor | Sequence[torch.Tensor], image_size: int | Sequence[int], *,
                   sigma: float = 1e-4, gamma: float = 1e-4, blur_radius: float | None = None,
                   background_color: Sequence[float] = (1.0, 1.0, 1.0), znear: float = 1.0,
                   zfar: float = 100.0) -> torch.Tensor:
    """One mesh, H×W×4: colour and alpha, as softmax_rgb_blend(colors, rasterize_meshes(…), BlendParams(sigma, gamma)).
    Of lists (meshes, or one mesh in several views) N×H×W×4 in one call.

    verts_ndc: V×3 in PyTorch3D's NDC (x to the left, y up, the shorter side of the picture from −1 to 1) with the depth
    in the view in z (m, positive in front). faces: F×3. colors: F×R×R×3 (TexturesAtlas) or V×3 (TexturesVertex).
    image_size: an int or (H, W). blur_radius: as of RasterizationSettings, squared NDC distance outside a face from which
    on it is skipped (None: log(1/1e-4 − 1)·sigma, as in its tutorials; 0: hard outlines). float64 in, float64 through.
    """
    height, width = (image_size, image_size) if isinstance(image_size, int) else (int(side) for side in image_size)
    if blur_radius is None:
        blur_radius = math.log(1 / 1e-4 - 1) * sigma
    scale = min(height, width) / max(height, width)  # Mirage's NDC is of the longer side
    cut_off = min(max(1 / (math.exp(min(blur_radius / sigma, 600.0)) + 1), BLUR_FLOOR), 0.5 - 1e-9)
    numbers = {"sigma": sigma * scale**2, "gamma": gamma, "epsilon": 1e-10, "dist_eps": cut_off, "near": znear,
               "far": zfar}
    one = isinstance(verts_ndc, torch.Tensor)
    verts, faces, colors = ([item] if one else list(item) for item in (verts_ndc, faces, colors))
    if not verts or len({len(verts), len(faces), len(colors)}) > 1:
        raise _core.InputError(f"soft_rasterize: {len(verts)} verts, {len(faces)} faces, {len(colors)} colors; give as many")
    return _Soft.apply(one, faces, colors[0].dim() == 2, (-scale, scale, 1.0), height, width,
                       [float(channel) for channel in background_color], numbers, *verts, *colors)


class SoftRenderer(torch.nn.Module):
    """A renderer for PyTorch3D's own Meshes, Cameras, RasterizationSettings and BlendParams: N×H×W×4."""

    def __init__(self, cameras: Any, raster_settings: Any, blend_params: Any, *, znear: float = 1.0,
                 zfar: float = 100.0):
        super().__init__()
        self.cameras, self.raster_settings, self.blend_params = cameras, raster_settings, blend_params
        self.znear, self.zfar = znear, zfar

    def forward(self, meshes: Any) -> torch.Tensor:
        blend, raster, textures = self.blend_params, self.raster_settings, meshes.textures
        colors = textures.atlas_list() if hasattr(textures, "atlas_list") else textures.verts_features_list()
        screen = []
        view = self.cameras.get_world_to_view_transform()
        for mesh, verts in enumerate(meshes.verts_list()):
            # N×V×3 by N cameras, one a mesh; V×3 or 1×V×3 by one for all.
            ndc, in_view = (points.reshape(-1, len(verts), 3)
                            for points in (self.cameras.transform_points_ndc(verts), view.transform_points(verts)))
            if len(ndc) not in (1, len(colors)):
                raise _core.InputError(f"cameras: {len(ndc)} cameras for {len(colors)} meshes; give as many, or one")
            camera = mesh if len(ndc) > 1 else 0
            screen.append(torch.cat([ndc[camera][:, :2], in_view[camera][:, 2:]], 1))
        return soft_rasterize(
            screen, meshes.faces_list(), colors, raster.image_size, sigma=blend.sigma, gamma=blend.gamma,
            blur_radius=raster.blur_radius, background_color=blend.background_color, znear=self.znear, zfar=self.zfar)
