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


class _Soft(torch.autograd.Function):
    """RGBA of one mesh: corners (F×3×3: screen x, y and depth), colours (F×C×C×3, or F×3×3 of the corners)."""

    @staticmethod
    def forward(ctx, corners, colors, of_vertices, height, width, background, numbers):
        double = torch.float64 in (corners.dtype, colors.dtype)
        ctx.drawn = _core.rasterize_screen(corners.detach().cpu().numpy(), colors.detach().cpu().numpy(), of_vertices,
                                           height, width, background, numbers, {"blend": "logit"}, 1, double)
        ctx.like = [(tensor.shape, tensor.dtype, tensor.device) for tensor in (corners, colors)]
        image, mask = torch.from_numpy(ctx.drawn.image), torch.from_numpy(ctx.drawn.mask)
        return torch.cat([image, mask.unsqueeze(-1)], -1).to(corners.device)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, d_rgba):
        d_rgba = d_rgba.detach().cpu().numpy()
        gradients = ctx.drawn._vjp(d_rgba[..., :3], d_rgba[..., 3])
        d_corners, d_colors = (torch.from_numpy(gradient).reshape(shape).to(device, dtype)
                               for gradient, (shape, dtype, device) in zip(gradients, ctx.like))
        return d_corners, d_colors, None, None, None, None, None


def soft_rasterize(verts_ndc: torch.Tensor, faces: torch.Tensor, colors: torch.Tensor, image_size: int | Sequence[int],
                   *, sigma: float = 1e-4, gamma: float = 1e-4, blur_radius: float | None = None,
                   background_color: Sequence[float] = (1.0, 1.0, 1.0), znear: float = 1.0,
                   zfar: float = 100.0) -> torch.Tensor:
    """One mesh, H×W×4: colour and alpha, as softmax_rgb_blend(colors, rasterize_meshes(…), BlendParams(sigma, gamma)).

    verts_ndc: V×3 in PyTorch3D's NDC (x to the left, y up, the shorter side of the picture from −1 to 1) with the depth
    in the view in z (m, positive in front). faces: F×3. colors: F×R×R×3 (TexturesAtlas) or V×3 (TexturesVertex).
    image_size: an int or (H, W). blur_radius: as of RasterizationSettings, squared NDC distance outside a face from which
    on it is skipped (None: log(1/1e-4 − 1)·sigma, as in its tutorials; 0: hard outlines). float64 in, float64 through.
    """
    height, width = (image_size, image_size) if isinstance(image_size, int) else (int(side) for side in image_size)
    if blur_radius is None:
        blur_radius = math.log(1 / 1e-4 - 1) * sigma
    scale = min(height, width) / max(height, width)  # Mirage's NDC is of the longer side
    turned = verts_ndc * verts_ndc.new_tensor([-scale, scale, 1.0])
    of_vertices = colors.dim() == 2
    cut_off = min(max(1 / (math.exp(min(blur_radius / sigma, 600.0)) + 1), BLUR_FLOOR), 0.5 - 1e-9)
    numbers = {"sigma": sigma * scale**2, "gamma": gamma, "epsilon": 1e-10, "dist_eps": cut_off, "near": znear,
               "far": zfar}
    return _Soft.apply(turned[faces], colors[faces] if of_vertices else colors, of_vertices, height, width,
                       [float(channel) for channel in background_color], numbers)


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
        images = []
        for verts, faces, color in zip(meshes.verts_list(), meshes.faces_list(), colors):
            ndc = self.cameras.transform_points_ndc(verts).reshape(-1, 3)
            depth = self.cameras.get_world_to_view_transform().transform_points(verts).reshape(-1, 3)[:, 2:]
            images.append(soft_rasterize(
                torch.cat([ndc[:, :2], depth], 1), faces, color, raster.image_size, sigma=blend.sigma,
                gamma=blend.gamma, blur_radius=raster.blur_radius, background_color=blend.background_color,
                znear=self.znear, zfar=self.zfar))
        return torch.stack(images)
