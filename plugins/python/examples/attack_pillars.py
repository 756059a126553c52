"""Trains a small network like PointPillars, in plain PyTorch, on a data set for a minute, then attacks it.

    python3 attack_pillars.py DATA OUT
"""

import argparse

import mirage
import torch
import torch.nn.functional as F
from torch import nn

CELL, ROWS, COLUMNS = 0.8, 64, 64  # m; the grid covers 0 … 51.2 m ahead and 25.6 m to each side


def centres():
    cells = torch.arange(ROWS * COLUMNS)
    row = torch.div(cells, COLUMNS, rounding_mode="floor")
    return torch.stack([(cells % COLUMNS + 0.5) * CELL, (row + 0.5 - ROWS / 2) * CELL], 1)


class Pillars(nn.Module):
    """Spreads points, each with the picture's colour at its pixel, over pillars; gives one box per pillar."""

    region = (0.0, COLUMNS * CELL, -ROWS * CELL / 2, ROWS * CELL / 2)

    def __init__(self):
        super().__init__()
        self.point = nn.Sequential(nn.Linear(7, 32), nn.ReLU(), nn.Linear(32, 32))
        self.grid = nn.Sequential(*(layer for k in range(4) for layer in (nn.Conv2d(32, 32, 3, padding=1), nn.ReLU())))
        self.head = nn.Conv2d(32, 7, 1)  # logit, dx, dy, log length, log width, cos yaw, sin yaw
        nn.init.constant_(self.head.bias[:1], -3.0)

    def forward(self, image, points, pixel_from_velo):
        uvw = F.pad(points[:, :3], (0, 1), value=1.0) @ pixel_from_velo.t()
        size = torch.tensor([image.shape[1], image.shape[0]], dtype=torch.float32)
        place = (2 * uvw[:, :2] / uvw[:, 2:].clamp(min=0.1) + 1) / size - 1
        colour = F.grid_sample(image.permute(2, 0, 1)[None], place[None, None], align_corners=False)[0, :, 0].t()
        features = self.point(torch.cat([points / 20, colour], 1))
        # A point is shared among the four pillars around it. One pillar per point, as in PointPillars, works too: a point's
        # features carry the gradient. With sharing, the gradient also shows the effect of crossing a pillar's border.
        x, y = points[:, 0] / CELL - 0.5, points[:, 1] / CELL + ROWS / 2 - 0.5
        grid = features.new_zeros(ROWS * COLUMNS, 32)
        for dc, dr in ((0, 0), (0, 1), (1, 0), (1, 1)):
            c, r = x.detach().floor() + dc, y.detach().floor() + dr
            inside = (c >= 0) & (c < COLUMNS) & (r >= 0) & (r < ROWS)
            share = ((1 - (x - c).abs()) * (1 - (y - r).abs()))[:, None] * features
            grid = grid.index_add(0, (r * COLUMNS + c).long()[inside], share[inside])
        maps = self.head(self.grid(torch.tanh(grid).t().reshape(1, 32, ROWS, COLUMNS)))[0].flatten(1)
        centre = centres()
        return torch.stack([centre[:, 0] + maps[1], centre[:, 1] + maps[2], 3.9 * maps[3].clamp(-1, 1).exp(),
                            1.6 * maps[4].clamp(-1, 1).exp(), torch.atan2(maps[6], maps[5] + 1)], 1), maps[0]


def train(network, frames, steps):
    """Trains each car's own pillar to have a high logit, and its box to equal the label's."""
    optimiser = torch.optim.Adam(network.parameters(), lr=2e-3)
    for step in range(steps):
        frame = frames[step % len(frames)]
        boxes, logits = network(*(torch.tensor(a) for a in (frame.image, frame.points_in_view, frame.pixel_from_velo)))
        truth = torch.tensor([label.box_bev for label in frame.labels if label.type == "Car"]).reshape(-1, 5)
        apart = torch.cdist(truth[:, :2], centres())
        wanted = torch.zeros_like(logits)
        wanted[apart.argmin(1)] = 1
        loss = F.binary_cross_entropy_with_logits(logits, wanted, pos_weight=torch.tensor(50.0))
        if len(truth):
            loss = loss + F.smooth_l1_loss(boxes[apart.argmin(1)], truth)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("data")
    options.add_argument("out")
    options.add_argument("--training", type=int, default=400)
    options.add_argument("--iterations", type=int, default=100)
    options = options.parse_args()
    torch.manual_seed(0)
    network = Pillars()
    train(network, [mirage.read_frame(options.data, id) for id in mirage.list_frames(options.data)], options.training)
    network.eval()
    mirage.attack(detector=network, data=options.data, out=options.out, iterations=options.iterations)
    told = mirage.evaluate(options.out, detector=network, hosts="all")
    print(f"{told['vehicles']} vehicles found; ASR {100 * told['asr']:.0f} %, "
          f"of a random mesh {100 * told['random']['asr']:.0f} %")
