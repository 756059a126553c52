"""An insertion as an operation of PyTorch: any version of it, as nothing here is linked to it."""

from __future__ import annotations

import functools
from typing import Any

import torch

from . import _core
from ._insertion import host_index
from ._settings import insertion_settings


def srgb(linear: torch.Tensor) -> torch.Tensor:
    """Scene-linear values in [0, 1], as Mirage's pictures have them, as sRGB in [0, 1], as files have them: what a network
    that was trained on 8-bit pictures / 255 expects. Differentiable."""
    linear = linear.clamp(0, 1)
    curve = 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curve)


@functools.lru_cache(maxsize=None)
def _faces_of_icosphere(vertices: int):
    for subdivisions in range(7):
        if 10 * 4**subdivisions + 2 == vertices:
            return _core.icosphere(subdivisions, resolution=1).faces
    raise _core.InputError(f"faces: no icosphere has {vertices} vertices; give faces=mesh.faces")


def _array(tensor: torch.Tensor):
    return tensor.detach().cpu().numpy()


class Insertion(torch.autograd.Function):
    """image, points = Insertion.apply(vertices, texels, faces, frame, host, settings, double)"""

    @staticmethod
    def forward(ctx, vertices, texels, faces, frame, host, settings, double):
        ctx.set_materialize_grads(False)
        mesh = _core.Mesh(_array(vertices), faces, _array(texels))
        ctx.result = _core.insert(frame, host, mesh, settings, double)
        ctx.like = [(tensor.shape, tensor.dtype, tensor.device) for tensor in (vertices, texels)]
        image, points = (torch.from_numpy(array).to(vertices.device)
                         for array in (ctx.result.image, ctx.result.points))
        return image, points

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, d_image, d_points):
        upstream = (None if d is None else _array(d) for d in (d_image, d_points))
        gradients = ctx.result.vjp(*upstream)
        d_vertices, d_texels = (torch.from_numpy(gradient).to(device, dtype).reshape(shape)
                                for gradient, (shape, dtype, device) in zip(gradients, ctx.like))
        return d_vertices, d_texels, None, None, None, None, None


def insert(frame: _core.Frame, host: _core.Host | int, vertices: torch.Tensor, texels: torch.Tensor, *,
           faces: Any = None, **settings: Any) -> tuple[torch.Tensor, torch.Tensor]:
    """Puts a mesh on a vehicle's roof: (image (H×W×3), points (M×4)), differentiable in vertices and texels.

    frame, host, settings: as of mirage.insert. vertices: V×3, m; texels: F×C×C×3 albedo in [0, 1]; faces: F×3 indices
    (None: those of the icosphere with so many vertices, as of mirage.icosphere and of an attack's mesh).

    If vertices or texels are float64, everything is drawn in float64 by the plain loop, and image and points are
    float64: for torch.autograd.gradcheck. What jumps has no derivative: a texel's border, a ray that meets another
    face. Check with equal texels or one a face, where only the rays are left.
    Of M points the last are the returns on the object: M may change from call to call.
    """
    double = torch.float64 in (vertices.dtype, texels.dtype)
    if faces is None:
        faces = _faces_of_icosphere(vertices.shape[0])
    elif isinstance(faces, torch.Tensor):
        faces = _array(faces)
    return Insertion.apply(vertices, texels, faces, frame, host_index(frame, host),
                           insertion_settings(settings, "mirage.torch.insert"), double)
