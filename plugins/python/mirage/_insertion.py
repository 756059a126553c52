"""Frames, and meshes on roofs in them."""

from __future__ import annotations

import os
from typing import Any

from . import _core
from ._settings import insertion_settings


def read_frame(folder: str | os.PathLike, id: str, *, rig: str | os.PathLike = "") -> _core.Frame:
    """Reads a frame of a data set (KITTI's object, tracking or raw layout, or nuScenes).

    id: as mirage.list_frames returns it. rig: the rig that recorded the frame, as for --rig ("": what the data set says).

    The frame has .image (H×W×3 float32, scene-linear RGB in [0, 1]), .points (N×4 float32: x, y, z in `velo`, m, and
    reflectance), .pixel_from_velo (3×4 float32), .labels, .depth (H×W float32, planar, m) and .hosts().

    Raises InputError, naming file, field and fix, if something is missing or wrong.
    """
    return _core.Frame._read(os.fspath(folder), str(id), os.fspath(rig))


def view(self: _core.Frame) -> tuple[Any, Any, Any]:
    """The inputs of a detector, float32: image (H×W×3), points_in_view (N×4: x, y, z in `velo`, m, reflectance), pixel_from_velo (3×4)."""
    return self.image, self.points_in_view, self.pixel_from_velo


_core.Frame.view = view


def hosts(self: _core.Frame, min_view: float = 0.7, **settings: Any) -> list[_core.Host]:
    """The vehicles (classes="Car" by default) up to 70 m ahead and 40 m to each side that can carry a mesh: the picture must show
    at least the share `min_view` (0 … 1) of a reference mesh on the roof.

    Settings are those of `mirage.insert`; InputError for an unknown or wrong one.
    """
    return self._hosts(min_view, insertion_settings(settings, "frame.hosts"))


_core.Frame.hosts = hosts


def host_index(frame: _core.Frame, host: _core.Host | int) -> int:
    """The index of the host's label in frame.labels. InputError for a vehicle of another frame."""
    if not isinstance(host, _core.Host):
        return int(host)
    if host.frame is not frame:
        raise _core.InputError(f"host: {host!r} is of another frame; give one of this frame's hosts(), or the index of a label")
    return host.index


def insert(frame: _core.Frame, host: _core.Host | int, mesh: _core.Mesh, *, double: bool = False,
           **settings: Any) -> _core.Insertion:
    """Puts a mesh on a vehicle's roof and simulates camera and LiDAR, with occlusion between the mesh and the scene.

    host: one of this frame's hosts(), or the index of a label. mesh: its lowest vertex is set on the roof.
    double: draw in float64 with the plain loop, to check derivatives. This is some forty times as slow. A face is then skipped
    only where its coverage is below 1e-13.
    settings: place, classes, depth, rooftop, quality, sigma, gamma, supersampling, light, lidar_effects, camera_effects and
    sun, as for `mirage simulate`. place="2,-1.5,0,90" puts the mesh elsewhere: m forward, left and up from the ground under the
    vehicle, degrees from its heading; with "world:" in front, x, y, z, yaw in `velo`.

    The result has .image (H×W×3, scene-linear RGB), .points (M×4, `velo`), .mask (H×W, 0 … 1), .depth (H×W, planar, m) and
    .vjp(d_image, d_points) -> (d_vertices (V×3), d_texels (F×C×C×3)). Raises InputError for a wrong host, mesh or setting.
    """
    return _core.insert(frame, host_index(frame, host), mesh, insertion_settings(settings, "mirage.insert"), double)
