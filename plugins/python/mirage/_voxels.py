"""Points in voxels, as spconv and mmcv make them. Gradients reach the points' values, but not the choice of voxel."""

from __future__ import annotations

import math
from typing import Any, Sequence

import torch

from ._core import InputError


def voxels_of(points: torch.Tensor, bounds: Sequence[float], size: Sequence[float], most_points: int, most_voxels: int,
              ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(voxels V×P×C, coordinates V×3 (z, y, x), numbers of points V) of points N×C within `bounds` (least x, y, z, then greatest,
    m), with voxels of `size` (x, y, z, m). Voxels stand in the order of their first points; the first `most_voxels` stay. Each
    keeps its first `most_points` points (P), and zeros fill the rest."""
    with torch.no_grad():
        low, step = points.new_tensor(bounds[:3]), points.new_tensor(size)
        cells = ((points.new_tensor(bounds[3:]) - low) / step).round().long()
        at = torch.floor((points[:, :3] - low) / step).long()
        kept = ((at >= 0) & (at < cells)).all(1).nonzero()[:, 0]
        at = at[kept]
        found, inverse = torch.unique((at[:, 2] * cells[1] + at[:, 1]) * cells[0] + at[:, 0], return_inverse=True)
        order = torch.argsort(inverse, stable=True)  # by voxel, and in a voxel by point
        counts = torch.bincount(inverse, minlength=len(found))
        begins = counts.cumsum(0) - counts
        slot = torch.arange(len(at), device=points.device) - begins[inverse[order]]
        first = order[begins]
        rank = torch.empty_like(first)
        rank[first.argsort()] = torch.arange(len(found), device=points.device)
        voxel, counts = rank[inverse[order]], counts[first.argsort()]
        stays = (slot < most_points) & (voxel < most_voxels)
        voxel, slot, order = voxel[stays], slot[stays], order[stays]
        number = min(len(found), most_voxels)
        coordinates = at[first.sort().values[:number]].flip(1)
    voxels = points.new_zeros(number, most_points, points.shape[1]).index_put((voxel, slot), points[kept[order]])
    return voxels, coordinates, counts[:number].clamp(max=most_points)


def turned(points: torch.Tensor, angle: float) -> torch.Tensor:
    """The points in axes that are turned by the angle (rad, counter-clockwise) about z."""
    if angle == 0:
        return points
    c, s = math.cos(angle), math.sin(angle)
    x, y = c * points[:, 0] + s * points[:, 1], c * points[:, 1] - s * points[:, 0]
    return torch.cat([torch.stack([x, y], 1), points[:, 2:]], 1)


def turned_back(boxes: torch.Tensor, angle: float) -> torch.Tensor:
    """Boxes (7 or 9 columns) from the turned axes, in the original ones."""
    if angle == 0:
        return boxes
    parts = [turned(boxes[:, :3], -angle), boxes[:, 3:6], boxes[:, 6:7] + angle]
    if boxes.shape[1] == 9:
        parts.append(turned(boxes[:, 7:9], -angle))
    return torch.cat(parts, 1)


def region_of(bounds: Sequence[float], angle: float) -> tuple[float, float, float, float]:
    """x_min, x_max, y_min, y_max (m) in the original axes, of bounds in axes turned by `angle`. InputError if it is not a quarter turn."""
    quarters = round(angle / (math.pi / 2))
    if abs(angle - quarters * math.pi / 2) > 1e-3:
        raise InputError(f"angle: {angle:g} rad is not a quarter turn; give 0, π/2, −π/2 or π")
    x, y = (bounds[0], bounds[3]), (bounds[1], bounds[4])
    for _ in range(quarters % 4):
        x, y = (-y[1], -y[0]), x
    return (*x, *y)


class Wrapped:
    """A framework's network as mirage.attack takes it: points N×4 in `velo` in, boxes in `velo` out."""

    heights = True

    def __init__(self, model: Any, bounds: Sequence[float], classes: Sequence[str], angle: float, intensity: float):
        self.model, self.angle, self.intensity = model.eval(), angle, intensity
        self.bounds = [float(edge) for edge in bounds]
        self.classes = list(classes)
        self.region = region_of(self.bounds, angle)
        self.device = next(model.parameters()).device

    def __call__(self, points: torch.Tensor):
        points = torch.cat([points[:, :3], self.intensity * points[:, 3:4]], 1)
        return self.detect(turned(points, self.angle))

    def detect(self, points: torch.Tensor):
        raise NotImplementedError
