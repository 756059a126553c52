"""PyTorch3D's soft rasterisation by the formulas in its documentation, in plain PyTorch over all pixels and faces. Slow and plain:
pytorch3d_table.py compares mirage.pytorch3d with it.

    p(i, j) = sigmoid(−d(i, j) / σ), d the squared NDC distance to the face, negative inside; faces with d ≥ blur radius are
              skipped
    w(i, j) = p exp((z̄(i, j) − max z̄) / γ), z̄ = (zfar − z) / (zfar − znear); the background's weight is exp(−max z̄ / γ)
    colour  = (Σ w c + background) / Σ, alpha = 1 − Π (1 − p)
"""

import math

import torch


def _pixel_centres(height, width, dtype):
    """Pixel centres P×1×2 in NDC: x to the left, y up, the shorter side from −1 to 1."""
    shorter = min(height, width)
    x = (width - 1 - 2 * torch.arange(width, dtype=dtype)) / shorter
    y = (height - 1 - 2 * torch.arange(height, dtype=dtype)) / shorter
    return torch.stack(torch.meshgrid(y, x, indexing="ij")[::-1], -1).reshape(-1, 1, 2)


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _squared_distance_to_edge(p, a, b):
    along = b - a
    t = (((p - a) * along).sum(-1) / along.pow(2).sum(-1).clamp(min=1e-12)).clamp(0, 1)
    return (p - a - t[..., None] * along).pow(2).sum(-1)


def soft_rasterize(verts_ndc, faces, colors, image_size, *, sigma=1e-4, gamma=1e-4, blur_radius=None,
                   background_color=(1.0, 1.0, 1.0), znear=1.0, zfar=100.0):
    """Draws one mesh to H×W×4, with the arguments of mirage.pytorch3d.soft_rasterize."""
    height, width = (image_size, image_size) if isinstance(image_size, int) else image_size
    blur_radius = math.log(1 / 1e-4 - 1) * sigma if blur_radius is None else blur_radius
    corners = verts_ndc[faces]  # F×3×3
    p = _pixel_centres(height, width, verts_ndc.dtype)  # P×1×2
    xy, z = corners[None, :, :, :2], corners[None, :, :, 2]
    v0, v1, v2 = xy.unbind(2)
    area = _cross(v1 - v0, v2 - v0)
    has_area = area.abs() > 1e-8
    flat = torch.stack([_cross(v2 - v1, p - v1), _cross(v0 - v2, p - v2), _cross(v1 - v0, p - v0)], -1) / torch.where(
        has_area, area, torch.ones_like(area))[..., None]
    inside = (flat > 0).all(-1)
    distance = torch.stack([_squared_distance_to_edge(p, a, b) for a, b in ((v0, v1), (v1, v2), (v2, v0))]).amin(0)
    # Perspective first, then clipped, as PyTorch3D does.
    deep = flat * torch.stack([z[..., 1] * z[..., 2], z[..., 0] * z[..., 2], z[..., 0] * z[..., 1]], -1)
    whole = deep.sum(-1, keepdim=True)
    barycentrics = (deep / torch.where(has_area[..., None], whole, torch.ones_like(whole))).clamp(0, 1)
    barycentrics = barycentrics / barycentrics.sum(-1, keepdim=True).clamp(min=1e-5)
    depth = (barycentrics * z).sum(-1)
    counts = (inside | (distance < blur_radius)) & has_area & (depth > 0)
    signed = torch.where(inside, -distance, distance)
    probability = torch.sigmoid(-signed / sigma) * counts
    if colors.dim() == 2:
        sampled = torch.einsum("pfk,fkc->pfc", barycentrics, colors[faces])
    else:
        cells = colors.shape[1]
        place = (barycentrics[..., :2] * cells).detach()
        cell = place.long().clamp(max=cells - 1)
        lower = (place - cell).sum(-1) <= 1
        column, row = (torch.where(lower, cell[..., k], cells - 1 - cell[..., k]) for k in (0, 1))
        sampled = colors[torch.arange(len(faces))[None], row, column]
    z_inverse = (zfar - depth) / (zfar - znear) * counts
    nearest = z_inverse.amax(-1, keepdim=True).clamp(min=1e-10)
    weight = probability * torch.exp((z_inverse - nearest) / gamma)
    behind = torch.exp((1e-10 - nearest) / gamma).clamp(min=1e-10)
    background = verts_ndc.new_tensor(background_color)
    color = ((weight[..., None] * sampled).sum(1) + behind * background) / (weight.sum(-1, keepdim=True) + behind)
    alpha = 1 - (1 - probability).prod(-1, keepdim=True)
    return torch.cat([color, alpha], -1).reshape(height, width, 4)
