"""The detector of bench_detector.cpp: one box, and gradients to everything."""

import sys

import numpy as np
from mirage_serve import serve


class Toy:
    """Its gradients are computed once: a detector's own time does not count."""

    made = ()

    def __call__(self, image, points, pixel_from_velo):
        self.like = image.shape, points.shape
        return np.array([[10, 0, 4, 2, 0]], np.float32), np.array([1 + points[0, 0]], np.float32)

    def backward(self, d_logits):
        if tuple(array.shape for array in self.made) != self.like:
            self.made = tuple(np.full(shape, d_logits[0], np.float32) for shape in self.like)
        return self.made


serve(Toy(), pictures=sys.argv[1])
