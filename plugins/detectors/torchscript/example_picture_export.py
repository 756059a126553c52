"""A detector of boxes in the picture, exported for Mirage: wraps a network for photographs that you have as TorchScript.

    python3 example_picture_export.py NETWORK.pt MODEL.pt
    mirage detect --data DIR --detector torchscript --weights MODEL.pt --out OUT

NETWORK takes float32 [1, 3, H, W], blue-green-red, 0 to 255, H and W multiples of 32, and returns boxes [N, 4] (pixels:
left, top, right, bottom) and logits [N] before suppression. Change what differs in yours.
src/guide/attack.md says what a model must take and return.
"""

import sys
from typing import Tuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class PictureDetector(nn.Module):
    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, image: Tensor) -> Tuple[Tensor, Tensor]:
        height, width = image.size(0), image.size(1)
        # The network was trained on 8-bit sRGB. Both branches of the curve must have a finite gradient everywhere.
        linear = image.clamp(0.0, 1.0)
        curve = 1.055 * linear.clamp(min=0.0031308).pow(1 / 2.4) - 0.055
        srgb = torch.where(linear <= 0.0031308, 12.92 * linear, curve)
        picture = 255 * srgb.flip(2).permute(2, 0, 1).unsqueeze(0)  # blue first
        padded = F.pad(picture, [0, (32 - width % 32) % 32, 0, (32 - height % 32) % 32])  # on the right and below
        boxes, logits = self.network(padded)
        left, top = boxes[:, 0].clamp(0, width - 1), boxes[:, 1].clamp(0, height - 1)
        right, bottom = boxes[:, 2].clamp(0, width - 1), boxes[:, 3].clamp(0, height - 1)
        return torch.stack([left, top, right, bottom], 1), logits


if __name__ == "__main__":
    torch.jit.script(PictureDetector(torch.jit.load(sys.argv[1]).eval()).eval()).save(sys.argv[2])
