"""Mirage simulates what a mesh on a car's roof changes in a camera's picture and a LiDAR's sweep, with derivatives, on a CPU.

    import mirage
    frame = mirage.read_frame("kitti", "000008")
    host = frame.hosts()[0]
    mesh = mirage.icosphere()
    result = mirage.insert(frame, host, mesh)             # result.image, .points, .mask, .depth
    d_vertices, d_texels = result.vjp(d_image, d_points)

`mirage.torch.insert` does the same as a torch.autograd.Function. For a network of yours, `mirage.check` tells whether Mirage
calls it as it expects, and `mirage.attack` learns a mesh that hides vehicles from it. `mirage.evaluate` and `mirage.validate`
judge that mesh. `mirage.serve` turns a network into a detector for the command line.

Units are metres, radians and scene-linear radiance. `velo` is the LiDAR's frame: x forward, y left, z up. Settings are the
command line's options (`mirage simulate --help`, `mirage attack --help`) with _ for -. Arrays come out as NumPy's; NumPy arrays,
lists and anything with __dlpack__ go in. Wrong input raises InputError (a ValueError), failed work Failure (a RuntimeError).
"""

from __future__ import annotations

import glob
import importlib.util
import os
import sys
import sysconfig
from typing import TYPE_CHECKING


def _complaint() -> str:
    """Why this interpreter cannot load the module; "" if it can."""
    built = [os.path.basename(file) for file in sorted(glob.glob(os.path.join(os.path.dirname(__file__), "_core.*.so")))]
    if "_core" + sysconfig.get_config_var("EXT_SUFFIX") not in built:
        tags = ", ".join(name.split(".")[1] for name in built) or "none"
        return (f"mirage: is built for {tags}, and this is Python {sys.version_info[0]}.{sys.version_info[1]} "
                f"({sys.executable}); build it for this one too: make python PYTHON={sys.executable}")
    if importlib.util.find_spec("numpy") is None:
        return f"mirage: needs NumPy, which {sys.executable} does not have; python -m pip install numpy"
    return ""


if _complaint():
    raise ImportError(_complaint())

from ._core import Failure, Frame, Hits, Host, InputError, Insertion, Label, Mesh, icosphere, list_frames, read_mesh
from ._core import version as __version__
from ._insertion import insert, read_frame
from ._pieces import cast_rays, rasterize
from ._runs import attack, audit, check, compare, detect, evaluate, export, generate, validate, view
from .mirage_serve import serve

if TYPE_CHECKING:
    from . import mmdet3d, openpcdet, pytorch3d, torch  # noqa: F401

__all__ = ["Failure", "Frame", "Hits", "Host", "InputError", "Insertion", "Label", "Mesh", "attack", "audit", "cast_rays", "check",
           "compare", "detect", "evaluate", "export", "generate", "icosphere", "insert", "list_frames", "mmdet3d", "openpcdet",
           "pytorch3d", "rasterize", "read_frame", "read_mesh", "serve", "torch", "validate", "view"]


def __getattr__(name: str):
    """Imports the submodules that need PyTorch when they are first used."""
    if name in ("torch", "pytorch3d", "openpcdet", "mmdet3d"):
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
