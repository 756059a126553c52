"""A small camera + LiDAR detector, exported for Mirage. Its weights are random: put your trained model in its place.

    python3 example_export.py MODEL.pt
    mirage detect --data DIR --detector torchscript --weights MODEL.pt --out OUT

MODEL.onnx writes the same network for --detector onnx.

src/guide/attack.md says what a model must take and return.
"""

import sys
from typing import Tuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.jit import Final


class ExampleDetector(nn.Module):
    """Points, with the picture's features where they fall, spread over a bird's-eye grid; a box per cell."""

    x_max: Final[float] = 70.0  # m; TorchScript sees constants of the class, not of the file
    y_max: Final[float] = 40.0
    cell: Final[float] = 1.0
    rows: Final[int] = 80
    columns: Final[int] = 70

    def __init__(self):
        super().__init__()
        self.picture = nn.Conv2d(3, 8, 5, stride=4, padding=2)
        self.point = nn.Linear(4 + 8, 16)
        self.grid = nn.Sequential(nn.Conv2d(16, 32, 3, padding=1), nn.ReLU(), nn.Conv2d(32, 32, 3, padding=1), nn.ReLU())
        self.head = nn.Conv2d(32, 7, 1)  # logit, dx, dy, log length, log width, cos yaw, sin yaw
        nn.init.normal_(self.head.weight, std=0.3)

    @torch.jit.export
    def region(self) -> Tuple[float, float, float, float]:
        """Searched region: x_min, x_max, y_min, y_max (m). Leave it out for 0, 70, -40, 40."""
        return (0.0, self.x_max, -self.y_max, self.y_max)

    def picture_features(self, image: Tensor, xyz: Tensor, pixel_from_velo: Tensor) -> Tensor:
        """N x 8: bilinear, so that gradients reach both the pixels and the points."""
        features = torch.tanh(self.picture(image.permute(2, 0, 1).unsqueeze(0)))
        ones = torch.ones(xyz.size(0), 1, dtype=xyz.dtype, device=xyz.device)
        uvw = torch.cat([xyz, ones], 1) @ pixel_from_velo.t()
        uv = uvw[:, :2] / uvw[:, 2:].clamp(min=0.1)  # never divide by 0: the gradient would not be finite
        size = torch.tensor([float(image.size(1)), float(image.size(0))], device=uv.device)
        place = (2 * uv + 1) / size - 1  # pixel 0's centre is at 0
        return F.grid_sample(features, place.view(1, 1, -1, 2), align_corners=False)[0, :, 0].t()

    def forward(self, image: Tensor, points: Tensor, pixel_from_velo: Tensor) -> Tuple[Tensor, Tensor]:
        seen = self.picture_features(image, points[:, :3], pixel_from_velo)
        features = torch.relu(self.point(torch.cat([points / 20, seen], 1)))
        # Each point is shared among the four nearest cells: differentiable in x and y, as a hard grid is not.
        x, y = points[:, 0] / self.cell - 0.5, (points[:, 1] + self.y_max) / self.cell - 0.5
        column, row = torch.floor(x).detach(), torch.floor(y).detach()
        grid = torch.zeros(self.rows * self.columns, 16, dtype=points.dtype, device=points.device)
        for dr in range(2):
            for dc in range(2):
                c, r = column + dc, row + dr
                weight = (1 - (x - c).abs()) * (1 - (y - r).abs())
                inside = (c >= 0) & (c < self.columns) & (r >= 0) & (r < self.rows)
                place = (r * self.columns + c).long()[inside]
                # Not index_add: its ONNX version forgets all but one of the points in a cell.
                grid = grid.scatter_add(0, place.unsqueeze(1).expand(-1, 16), features[inside] * weight[inside].unsqueeze(1))
        maps = self.head(self.grid(torch.log1p(grid).t().reshape(1, 16, self.rows, self.columns)))[0].flatten(1)
        cells = torch.arange(self.rows * self.columns, device=points.device)
        centre_x = ((cells % self.columns).float() + 0.5) * self.cell
        centre_y = (torch.div(cells, self.columns, rounding_mode="floor").float() + 0.5) * self.cell - self.y_max
        boxes = torch.stack([centre_x + maps[1], centre_y + maps[2], 4 * torch.exp(maps[3].clamp(-1, 1)),
                             1.8 * torch.exp(maps[4].clamp(-1, 1)), torch.atan2(maps[6], maps[5] + 2)], 1)
        return boxes, maps[0] - 2  # logits: before the sigmoid, and before suppression of overlapping boxes


def write_onnx(detector, file):
    """Dynamic axes for sizes that differ from frame to frame; the region is in the file's metadata."""
    import onnx

    example = (torch.rand(64, 96, 3), torch.rand(50, 4) + torch.tensor([10.0, 0.0, -1.0, 0.0]), torch.eye(3, 4))
    axes = {"image": {0: "H", 1: "W"}, "points": {0: "N"}, "boxes": {0: "M"}, "logits": {0: "M"}}
    torch.onnx.export(torch.jit.script(detector), example, file, opset_version=16, input_names=["image", "points", "pixel_from_velo"],
                      output_names=["boxes", "logits"], dynamic_axes=axes)
    model = onnx.load(file)
    onnx.helper.set_model_props(model, {"region": " ".join(map(str, detector.region()))})
    onnx.save(model, file)


if __name__ == "__main__":
    torch.manual_seed(0)
    model = ExampleDetector().eval()
    if sys.argv[1].endswith(".onnx"):
        write_onnx(model, sys.argv[1])
    else:
        torch.jit.script(model).save(sys.argv[1])
