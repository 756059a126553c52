"""A replacement for PyTorch3D's soft rasteriser, on a CPU: the same σ, γ and blur radius, drawn by Mirage's rasteriser.

    renderer = MeshRenderer(MeshRasterizer(cameras, raster_settings), SoftPhongShader(…, blend_params=blend_params))
    images = renderer(meshes)
becomes
    images = mirage.pytorch3d.SoftRenderer(cameras, raster_settings, blend_params)(meshes)

for what PyTorch3D draws without lights. PyTorch3D is neither needed nor imported: only the attributes of meshes, cameras and
settings count. Mirage computes PyTorch3D's softmax_rgb_blend over sigmoid(−dists / σ), with three differences. Every face
counts, not only the nearest faces_per_pixel. Outside a face, barycentrics are clipped on screen before they are corrected for
perspective, not after. The gradient is exact for what is drawn. InputError is raised for depths that are linear on screen
(orthographic cameras, perspective_correct=False), and for faces that reach behind the camera and would have to be cut.
"""

from __future__ import annotations

import math
from typing import Any, Sequence

import torch

from . import _core

BLUR_FLOOR = 1e-30  # least coverage at the blur radius: smaller ones have no effect in float64


def _array(tensor: torch.Tensor) -> Any:
    return tensor.detach().cpu().numpy()


def _drawn(verts: torch.Tensor, faces: torch.Tensor, z_clip_value: float,
           cull_backfaces: bool) -> tuple[torch.Tensor | None, float, float]:
    """Which faces PyTorch3D draws, F booleans (None: all of them), and the least and largest depth (m) of these. InputError for
    faces that would have to be cut."""
    verts = verts.detach()
    z = verts[:, 2][faces]
    if not len(faces):
        return None, math.inf, -math.inf
    least, most = (float(depth) for depth in z.aminmax())
    if least > max(z_clip_value, 0) and math.isfinite(most) and not cull_backfaces:
        return None, least, most
    before = (z >= z_clip_value) & (z > 0)
    kept = before.all(1) & z.isfinite().all(1)
    cut = int((before.any(1) & (~before & z.isfinite()).any(1)).sum())
    if cut:
        raise _core.InputError(f"faces: {cut} of {len(faces)} reach behind z = {max(z_clip_value, 0):g} m, and only whole faces are "
                               "drawn; cut them there, leave them out, or move the camera")
    if cull_backfaces:
        x, y = verts[:, :2][faces].unbind(2)
        # With x to the left, faces that turn clockwise are seen from the front.
        kept &= (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) <= (y[:, 1] - y[:, 0]) * (x[:, 2] - x[:, 0])
    z = z[kept]
    return kept, *((float(z.min()), float(z.max())) if len(z) else (math.inf, -math.inf))


def _depth_numbers(least: float, most: float, gamma: float, znear: float, zfar: float) -> dict[str, float]:
    """near, far, gamma and epsilon of the rasteriser for faces between these depths (m). Unlike PyTorch3D, it colours nothing
    outside its depth range. So the range grows to hold all depths, and γ and the background's logit scale with it, which leaves
    every weight as it is."""
    if not zfar > znear:
        raise _core.InputError(f"soft_rasterize: znear, zfar: {znear:g} and {zfar:g} are not a depth range; give znear < zfar, in m")
    if least > most:  # there are no faces
        least = most = 1.0
    near = znear if 0 < znear < least else 0.9 * least  # a margin: rounded depths stay within
    far = zfar if zfar > most else 1.1 * most
    share = (zfar - znear) / (far - near)
    return {"near": near, "far": far, "gamma": gamma * share, "epsilon": 1e-10 * share + (far - zfar) / (far - near)}


class _Soft(torch.autograd.Function):
    """Draws N meshes to N×H×W×4, or `one` to H×W×4. tensors: the meshes' vertices (V×3: NDC and depth), then their colours."""

    @staticmethod
    def forward(ctx, one, faces, by_vertex, scale, height, width, background, numbers, *tensors):
        count = len(faces)
        double = any(tensor.dtype == torch.float64 for tensor in tensors)
        arrays = [_array(tensor) for tensor in tensors]
        ctx.drawn = _core.rasterize_screens(arrays[:count], [_array(f) for f in faces], arrays[count:], by_vertex, scale,
                                            height, width, background, numbers, {"blend": "logit"}, 1, double)
        ctx.like = [(tensor.shape, tensor.dtype, tensor.device) for tensor in tensors]
        rgba = torch.from_numpy(ctx.drawn.rgba).to(tensors[0].device)
        return rgba[0] if one else rgba  # indexed here: outside, autograd would allocate a gradient of all pictures

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
                   background_color: Sequence[float] = (1.0, 1.0, 1.0), znear: float = 1.0, zfar: float = 100.0,
                   cull_backfaces: bool = False, z_clip_value: float = 0.0) -> torch.Tensor:
    """Draws one mesh, differentiably, to H×W×4: colour (RGB) and alpha, as softmax_rgb_blend(colors, rasterize_meshes(…),
    BlendParams(sigma, gamma)). Lists of meshes, or of one mesh in several views, give N×H×W×4 in one call.

    verts_ndc: V×3, x and y in PyTorch3D's NDC (x to the left, y up, the shorter side of the picture from −1 to 1), z the depth
    in the view (m, positive in front). faces: F×3. colors: F×R×R×3 (TexturesAtlas) or V×3 (TexturesVertex).
    image_size: an int or (H, W). blur_radius: as in RasterizationSettings, the squared NDC distance outside a face beyond which
    it is skipped (None: log(1/1e-4 − 1)·sigma, as in PyTorch3D's tutorials; 0: hard outlines). znear, zfar: as in
    softmax_rgb_blend, the depth range (m) of which γ is a share; nearer and farther faces are drawn too. cull_backfaces: leave
    out faces that turn clockwise on screen. z_clip_value: leave out faces nearer than that (m). A float64 tensor makes all float64.
    Raises InputError for a face that reaches across z_clip_value or z = 0, lists of unequal length, or znear ≥ zfar.
    """
    height, width = (image_size, image_size) if isinstance(image_size, int) else (int(side) for side in image_size)
    if blur_radius is None:
        blur_radius = math.log(1 / 1e-4 - 1) * sigma
    scale = min(height, width) / max(height, width)  # Mirage's NDC is of the longer side
    cut_off = min(max(1 / (math.exp(min(blur_radius / sigma, 600.0)) + 1), BLUR_FLOOR), 0.5 - 1e-9)
    one = isinstance(verts_ndc, torch.Tensor)
    verts, faces, colors = ([item] if one else list(item) for item in (verts_ndc, faces, colors))
    if not verts or len({len(verts), len(faces), len(colors)}) > 1:
        raise _core.InputError(f"soft_rasterize: {len(verts)} verts, {len(faces)} faces, {len(colors)} colors; give equally many of each")
    told = [_drawn(v, f, z_clip_value, cull_backfaces) for v, f in zip(verts, faces)]
    for k, (kept, _, _) in enumerate(told):
        if kept is not None:
            faces[k], colors[k] = faces[k][kept], colors[k] if colors[k].dim() == 2 else colors[k][kept]
    least, most = min(low for _, low, _ in told), max(high for _, _, high in told)
    numbers = {"sigma": sigma * scale**2, "dist_eps": cut_off, **_depth_numbers(least, most, gamma, znear, zfar)}
    return _Soft.apply(one, faces, colors[0].dim() == 2, (-scale, scale, 1.0), height, width,
                       [float(channel) for channel in background_color], numbers, *verts, *colors)


def _number_of(owner: Any, name: str, otherwise: Any) -> Any:
    """An attribute as one number, from a number or from a tensor with one for each camera. InputError if these differ."""
    value = getattr(owner, name, None)
    if not isinstance(value, torch.Tensor):
        return otherwise if value is None else value
    if value.min() != value.max():
        raise _core.InputError(f"cameras: {name}: is {value.tolist()}; give cameras with one {name}, or draw them one by one")
    return float(value.flatten()[0])


class SoftRenderer(torch.nn.Module):
    """A renderer that takes PyTorch3D's Cameras, RasterizationSettings and BlendParams; called with Meshes, it gives N×H×W×4.

    znear, zfar: as for soft_rasterize (None: the cameras', or 1 and 100 m if they have none, as in PyTorch3D's shaders). There
    must be one camera for each mesh, or one for all; InputError otherwise, and as for soft_rasterize.
    """

    def __init__(self, cameras: Any, raster_settings: Any, blend_params: Any, *, znear: float | None = None,
                 zfar: float | None = None):
        super().__init__()
        self.cameras, self.raster_settings, self.blend_params = cameras, raster_settings, blend_params
        self.znear, self.zfar = znear, zfar

    def forward(self, meshes: Any) -> torch.Tensor:
        blend, raster, textures = self.blend_params, self.raster_settings, meshes.textures
        perspective = getattr(raster, "perspective_correct", None)
        if not (getattr(self.cameras, "is_perspective", lambda: True)() if perspective is None else perspective):
            raise _core.InputError("cameras, raster_settings: depths would be linear on screen, but only perspective is drawn; "
                                   "give perspective cameras and perspective_correct=None, or use PyTorch3D's renderer")
        znear, zfar = (_number_of(self.cameras, name, otherwise) if own is None else own
                       for name, own, otherwise in (("znear", self.znear, 1.0), ("zfar", self.zfar, 100.0)))
        z_clip = getattr(raster, "z_clip_value", None)
        if z_clip is None:
            z_clip = _number_of(self.cameras, "znear", 0.0) / 2
        colors = textures.atlas_list() if hasattr(textures, "atlas_list") else textures.verts_features_list()
        screen = []
        view = self.cameras.get_world_to_view_transform()
        for mesh, verts in enumerate(meshes.verts_list()):
            # N×V×3 from N cameras, one for each mesh; V×3 or 1×V×3 from one for all.
            ndc, in_view = (points.reshape(-1, len(verts), 3)
                            for points in (self.cameras.transform_points_ndc(verts), view.transform_points(verts)))
            if len(ndc) not in (1, len(colors)):
                raise _core.InputError(f"cameras: {len(ndc)} cameras for {len(colors)} meshes; give equally many, or one")
            camera = mesh if len(ndc) > 1 else 0
            screen.append(torch.cat([ndc[camera][:, :2], in_view[camera][:, 2:]], 1))
        return soft_rasterize(
            screen, meshes.faces_list(), colors, raster.image_size, sigma=blend.sigma, gamma=blend.gamma,
            blur_radius=raster.blur_radius, background_color=blend.background_color, znear=znear, zfar=zfar,
            cull_backfaces=getattr(raster, "cull_backfaces", False), z_clip_value=z_clip)
