"""Prints a table: mirage.pytorch3d beside PyTorch3D's published formula in plain PyTorch (soft_formula.py), forward and backward.

    python3 pytorch3d_table.py [--sizes 64 128 256] [--repeats 3]

PyTorch3D itself is not measured: its wheels do not run beside Debian's PyTorch. The mesh is an icosphere with 320 faces and 5×5
texels per face, which fills two thirds of the picture. Times are CPU times. Differences are the mean and the largest in colour,
the largest in alpha, and the cosine between the two gradients with respect to the vertices.
"""

import argparse
import statistics
import time

import mirage
import soft_formula
import torch


def scene():
    mesh = mirage.icosphere()
    verts = torch.tensor(mesh.vertices, dtype=torch.float32)
    verts = torch.stack([verts[:, 0], verts[:, 1], verts[:, 2] + 4.0], 1)
    colors = torch.rand(320, 5, 5, 3, generator=torch.Generator().manual_seed(1))
    return verts, torch.tensor(mesh.faces, dtype=torch.int64), colors


def measure(draw, size, settings, repeats):
    """Median CPU time (s), the picture, and the gradient of its weighted sum with respect to the vertices."""
    verts, faces, colors = scene()
    verts.requires_grad_(True)
    colors.requires_grad_(True)
    weights = torch.rand(size, size, 4, generator=torch.Generator().manual_seed(2))
    times = []
    for _ in range(repeats):
        verts.grad = None
        start = time.process_time()
        image = draw(verts, faces, colors, size, **settings)
        (weights * image).sum().backward()
        times.append(time.process_time() - start)
    return statistics.median(times), image.detach(), verts.grad.flatten()


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--sizes", type=int, nargs="+", default=[64, 128, 256])
    options.add_argument("--repeats", type=int, default=3)
    options = options.parse_args()
    print("| picture | σ | γ | formula in PyTorch, ms | mirage.pytorch3d, ms | × | colour: mean, worst | alpha: worst | cosine |")
    print("|---|---|---|---|---|---|---|---|---|")
    for size in options.sizes:
        for sigma, gamma in ((1e-4, 1e-4), (1e-5, 1e-3)):
            settings = dict(sigma=sigma, gamma=gamma, znear=1.0, zfar=10.0)
            slow, theirs, gradient = measure(soft_formula.soft_rasterize, size, settings, options.repeats)
            fast, ours, exact = measure(mirage.pytorch3d.soft_rasterize, size, settings, 5 * options.repeats)
            apart = (ours - theirs).abs()
            cosine = torch.nn.functional.cosine_similarity(gradient, exact, dim=0)
            print(f"| {size}×{size} | {sigma:g} | {gamma:g} | {1e3 * slow:.0f} | {1e3 * fast:.1f} | {slow / fast:.0f} | "
                  f"{apart[..., :3].mean():.1e}, {apart[..., :3].max():.1e} | {apart[..., 3].max():.1e} | {cosine:.4f} |",
                  flush=True)
