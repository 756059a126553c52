"""An insertion as a PyTorch operation. It works with any version of PyTorch, because it does not link against it."""

from __future__ import annotations

import functools
from typing import Any

import torch

from . import _core
from ._insertion import host_index
from ._settings import insertion_settings


def srgb(linear: torch.Tensor) -> torch.Tensor:
    """Converts scene-linear values in [0, 1], as in Mirage's pictures, to sRGB in [0, 1], as in files: what a network trained on
    8-bit pictures / 255 expects. Any shape; values outside [0, 1] are clamped. Differentiable."""
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
    """Puts a mesh on a vehicle's roof. Returns image (H×W×3, scene-linear RGB in [0, 1]) and points (M×4: x, y, z in `velo`, m,
    and reflectance), differentiable in vertices and texels. The returns on the object come last; M may change from call to call.

    frame, host, settings: as for mirage.insert. vertices: V×3, m; texels: F×C×C×3, scene-linear albedo in [0, 1]; faces: F×3
    indices (None: those of the icosphere with as many vertices, as from mirage.icosphere and mirage.attack).

    With float64 vertices or texels, everything is drawn in float64 by the plain loop, and image and points are float64, for
    torch.autograd.gradcheck. A jump has no derivative: a texel's border, or a ray that changes face. To leave only the rays,
    check with equal texels or one texel per face. Raises InputError and, for a gradient that is not finite, Failure.
    """
    double = torch.float64 in (vertices.dtype, texels.dtype)
    if faces is None:
        faces = _faces_of_icosphere(vertices.shape[0])
    elif isinstance(faces, torch.Tensor):
        faces = _array(faces)
    return Insertion.apply(vertices, texels, faces, frame, host_index(frame, host),
                           insertion_settings(settings, "mirage.torch.insert"), double)
