"""The simulator's soft rasteriser and ray caster, each by itself."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Sequence

from . import _core

if TYPE_CHECKING:
    import numpy


class Raster:
    """A picture drawn by the soft rasteriser, or N pictures if meshes or cameras were a list.

    image: (N×)H×W×3, the mesh over the background, scene-linear RGB. mask: (N×)H×W, the silhouette, 0 … 1. Both are float32, or
    float64 if drawn in double.
    """

    def __init__(self, drawn: _core.Raster, shapes: list, one_picture: bool, one_mesh: bool):
        self._drawn, self._shapes = drawn, shapes
        self._one_picture, self._one_mesh = one_picture, one_mesh

    @property
    def image(self) -> numpy.ndarray:
        """(N×)H×W×3, the mesh over the background, scene-linear RGB."""
        return self._drawn.image[0] if self._one_picture else self._drawn.image

    @property
    def mask(self) -> numpy.ndarray:
        """(N×)H×W, the silhouette, 0 … 1."""
        return self._drawn.mask[0] if self._one_picture else self._drawn.mask

    def vjp(self, d_image: Any = None, d_mask: Any = None) -> Any:
        """Vector-Jacobian product: from d loss / d image and d loss / d mask (in the shapes of image and mask; either may be None)
        to (d_vertices (V×3, per m), d_texels (F×C×C×3)), float64. One mesh gives one pair, summed over its pictures; a list of
        meshes gives a list of pairs. Failure for a gradient that is not finite."""
        if self._one_picture:
            d_image, d_mask = (None if d is None else _array(d)[None] for d in (d_image, d_mask))
        pairs = [(vertices, texels.reshape(shape))
                 for (vertices, texels), shape in zip(self._drawn.vjp(d_image, d_mask), self._shapes)]
        if not self._one_mesh:
            return pairs
        return pairs[0] if len(pairs) == 1 else (sum(v for v, _ in pairs), sum(t for _, t in pairs))


def _array(values: Any) -> Any:
    """Leaves arrays and tensors unchanged; turns lists into arrays, so that they can be indexed."""
    if hasattr(values, "shape"):
        return values
    import numpy

    return numpy.asarray(values)


def _is_one_camera(camera: Any) -> bool:
    """Whether it is four numbers or three rows of three, not a list of cameras."""
    first = camera[0]
    return not (isinstance(first, _core.Frame) or hasattr(first, "__len__")) or (
        len(camera) == 3 and len(first) == 3 and not hasattr(first[0], "__len__"))


def _intrinsics(camera: Any) -> tuple[float, float, float, float]:
    if isinstance(camera, _core.Frame):
        return camera.intrinsics
    rows = [list(row) for row in camera] if hasattr(camera[0], "__len__") else None
    values = [rows[0][0], rows[1][1], rows[0][2], rows[1][2]] if rows and len(rows) == 3 else list(camera)
    if len(values) != 4 or not all(math.isfinite(value) for value in values):
        raise _core.InputError("camera: is not a pinhole camera; give a frame, (fx, fy, cx, cy) or a 3×3 matrix, in pixels")
    return tuple(float(value) for value in values)


def rasterize(mesh: _core.Mesh | Sequence[_core.Mesh], camera: Any, height: int, width: int, *,
              background: Any = None, sigma: float = 5e-7,
              gamma: float = 1e-2, epsilon: float = 1e-3, dist_eps: float = 1e-4, near: float | None = None,
              far: float | None = None, supersampling: int = 1, blend: str = "silhouette", sides: str = "both",
              double: bool = False) -> Raster:
    """Draws a mesh with the soft rasteriser (Liu et al., ICCV 2019), unlit: the picture shows the texels' colours. Returns a Raster.

    mesh: vertices in the camera's frame (x right, y down, z forward, m). camera: (fx, fy, cx, cy) in pixels, a 3×3
    matrix or a frame; (0, 0) is the centre of the top left pixel. Either may be a list, drawn in one call: N meshes with as many
    cameras, one mesh with N cameras, or N meshes with one camera. background: RGB or H×W×3, for all pictures (None: black).
    sigma: softness of edges, NDC² of the picture's longer side. gamma: softness of depth, as a share of far − near.
    near, far: depth range, m (None: the meshes' own with a margin). supersampling: samples along a pixel's side.
    blend: "silhouette" (edges stay in place) or "logit" (the paper's background, with logit epsilon).
    dist_eps: coverage below which a face is skipped. sides: "both", "counter_clockwise" or "clockwise" on screen.
    double: draw in float64 with the plain loop. Raises InputError for a wrong mesh, camera or setting.
    """
    one_mesh = isinstance(mesh, _core.Mesh)
    meshes = [mesh] if one_mesh else list(mesh)
    one_camera = isinstance(camera, _core.Frame) or _is_one_camera(camera)
    cameras = [_intrinsics(one) for one in ([camera] if one_camera else camera)]
    count = max(len(meshes), len(cameras))
    if not meshes or {len(meshes), len(cameras)} - {1, count}:
        raise _core.InputError(f"rasterize: camera: {len(cameras)} cameras for {len(meshes)} meshes; give equally many, or one")
    if near is None or far is None:
        depths = [m.vertices[:, 2][m.faces] for m in meshes]  # a vertex that no face uses is not drawn
        depths = [d for d in depths if d.size]
        front = min((float(d.min()) for d in depths), default=1.0)
        back = max((float(d.max()) for d in depths), default=1.0)
        near = max(0.05, front - 0.5) if near is None else near
        far = max(near + 1.0, back + 0.5) if far is None else far
    numbers = {"sigma": sigma, "gamma": gamma, "epsilon": epsilon, "dist_eps": dist_eps, "near": near, "far": far}
    meshes, cameras = (items * count if len(items) == 1 else items for items in (meshes, cameras))
    drawn = _core.rasterize_meshes(meshes, cameras, height, width, background, numbers, {"blend": blend, "sides": sides},
                                   supersampling, double)
    return Raster(drawn, [m.texels.shape for m in meshes], one_mesh and one_camera, one_mesh)


def cast_rays(meshes: _core.Mesh | Sequence[_core.Mesh], origins: Any, directions: Any, *, t_min: float = 0.0,
              t_max: float = math.inf) -> _core.Hits:
    """Finds the nearest face that each ray hits between t_min and t_max, in units of the direction's length, from either side.

    meshes: one, or several in the same frame, m. origins: N×3, or 1×3 for all rays, m. directions: N×3, of any length.
    The result has .t, .mesh, .face (N), .barycentrics, .points (N×3, m) and .vjp(d_points (N×3)) -> [V×3 for each mesh].
    A ray that hits nothing has t = inf and mesh = −1. Raises InputError for arrays of other shapes.
    """
    return _core.cast_rays([meshes] if isinstance(meshes, _core.Mesh) else list(meshes), origins, directions, t_min,
                           t_max)
