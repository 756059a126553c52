"""Frames, and a mesh on a roof in them."""

from __future__ import annotations

import os
from typing import Any

from . import _core
from ._settings import insertion_settings


def read_frame(folder: str | os.PathLike, id: str, *, rig: str | os.PathLike = "") -> _core.Frame:
    """Reads a frame of a data set (KITTI's object, tracking or raw layout, or nuScenes).

    The frame has .image (H×W×3 float32, scene-linear RGB in [0, 1]), .points (N×4 float32: x, y, z in m and
    reflectance), .pixel_from_velo (3×4 float32), .labels, .depth (H×W float32, m) and .hosts().

    rig: which recorded it, as --rig of the command line takes it ("": what the data set says).

    InputError naming file, field and fix for anything that is missing or wrong.
    """
    return _core.Frame._read(os.fspath(folder), str(id), os.fspath(rig))


def view(self: _core.Frame) -> tuple[Any, Any, Any]:
    """What a detector gets of it: image (H×W×3), the points in view (N×4), pixel_from_velo (3×4), float32."""
    return self.image, self.points_in_view, self.pixel_from_velo


_core.Frame.view = view


def hosts(self: _core.Frame, min_view: float = 0.7, **settings: Any) -> list[_core.Host]:
    """Vehicles (classes="Car" by default) within 70 m ahead and 40 m to the sides that show at least `min_view` of a mesh on
    their roof.

    Settings are those of `mirage.insert`.
    """
    return self._hosts(min_view, insertion_settings(settings, "frame.hosts"))


_core.Frame.hosts = hosts


def host_index(frame: _core.Frame, host: _core.Host | int) -> int:
    """Of its label. InputError for a vehicle of another frame."""
    if not isinstance(host, _core.Host):
        return int(host)
    if host.frame is not frame:
        raise _core.InputError(f"host: {host!r} is of another frame; give one of this frame's hosts(), or the index of a label")
    return host.index


def insert(frame: _core.Frame, host: _core.Host | int, mesh: _core.Mesh, *, double: bool = False,
           **settings: Any) -> _core.Insertion:
    """Puts a mesh on a vehicle's roof, as camera and LiDAR see it, with occlusion between it and the scene.

    host: one of this frame's hosts(), or the index of a label. mesh: its lowest vertex is set on the roof.
    double: draw with the plain loop in float64, which is some forty times as slow and what derivatives are checked
    with; faces are then dropped only where they cover less than 1e-13.
    settings: place, classes, depth, rooftop, quality, sigma, gamma, supersampling, light, lidar_effects,
    camera_effects and sun, as of `mirage simulate`. place="2,-1.5,0,90" puts it elsewhere (m and degrees in the
    vehicle's frame; with "world:" before them in `velo`'s).

    The result has .image (H×W×3), .points (M×4), .mask (H×W), .depth (H×W, m) and
    .vjp(d_image, d_points) -> (d_vertices (V×3), d_texels (F×C×C×3)).
    """
    return _core.insert(frame, host_index(frame, host), mesh, insertion_settings(settings, "mirage.insert"), double)
