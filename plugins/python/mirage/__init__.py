"""Mirage: what a mesh on a car's roof does to a camera's picture and a LiDAR's sweep, with derivatives, on a CPU.

    import mirage
    frame = mirage.read_frame("kitti", "000008")
    host = frame.hosts()[0]
    mesh = mirage.icosphere()
    result = mirage.insert(frame, host, mesh)             # result.image, .points, .mask, .depth
    d_vertices, d_texels = result.vjp(d_image, d_points)

`mirage.torch.insert` is the same as a torch.autograd.Function, `mirage.attack` learns a mesh against a network of yours
and `mirage.evaluate` judges it. Units are metres, radians and scene-linear radiance; `velo` is the LiDAR's frame (x
forward, y left, z up). Settings have the names of the command line's options (`mirage simulate --help`, `mirage attack
--help`) with _ for -. Arrays are NumPy's; where arrays go in, anything with __dlpack__ does too.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from ._core import Failure, Frame, Hits, Host, InputError, Insertion, Label, Mesh, icosphere, list_frames, read_mesh
from ._core import version as __version__
from ._insertion import insert, read_frame
from ._pieces import cast_rays, rasterize
from ._runs import attack, evaluate, generate

if TYPE_CHECKING:
    from . import pytorch3d, torch  # noqa: F401

__all__ = ["Failure", "Frame", "Hits", "Host", "InputError", "Insertion", "Label", "Mesh", "attack", "cast_rays",
           "evaluate", "generate", "icosphere", "insert", "list_frames", "rasterize", "read_frame",
           "read_mesh", "pytorch3d", "torch"]


def __getattr__(name: str):
    """mirage.torch and mirage.pytorch3d, which need PyTorch, come when they are asked for."""
    if name in ("torch", "pytorch3d"):
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
