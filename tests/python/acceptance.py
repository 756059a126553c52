"""A script by somebody who knows only the page: read a frame, gradcheck, 20 steps of Adam on texels and
vertices against its own torch function, then `mirage evaluate` from the command line on the run.

    python3 acceptance.py DATA FRAME OUT MIRAGE
"""

import subprocess
import sys

import mirage
import torch

folder, name, out, program = sys.argv[1:5]

# A frame.
frame = mirage.read_frame(folder, name)
height, width, channels = frame.image.shape
assert channels == 3 and str(frame.image.dtype) == "float32"
assert frame.points.shape[1] == 4 and frame.pixel_from_velo.shape == (3, 4)
assert len(frame.labels) > 0
host = frame.hosts()[0]

# A mesh, written and read.
mesh = mirage.icosphere()
mesh.write(out + "/a.glb")
mesh = mirage.read_mesh(out + "/a.glb")

# An insertion and its vector-Jacobian product.
result = mirage.insert(frame, host, mesh, sigma=1e-6, gamma=1e-2)
assert result.image.shape == frame.image.shape and result.points.shape[1] == 4
assert result.mask.shape == result.depth.shape == (height, width)
d_vertices, d_texels = result.vjp(torch.ones(height, width, 3), torch.ones(len(result.points), 4))
assert d_vertices.shape == mesh.vertices.shape and d_texels.shape == mesh.texels.shape

# The gradient, checked by PyTorch.
vertices = torch.tensor(mesh.vertices, dtype=torch.float64, requires_grad=True)
texels = torch.tensor(mesh.texels, dtype=torch.float64, requires_grad=True)
assert torch.autograd.gradcheck(lambda v, t: mirage.torch.insert(frame, host, v, t), (vertices, texels), fast_mode=True)


# A detector of the script's own.
def detector(image, points, pixel_from_velo):
    x, y = torch.meshgrid(torch.arange(5.0, 40.0, 1.0), torch.arange(-8.0, 9.0, 1.0), indexing="ij")
    centres = torch.stack([x.reshape(-1), y.reshape(-1)], dim=1)
    near = torch.exp(-torch.cdist(centres, points[:, :2]))
    above = torch.sigmoid(5 * (points[:, 2] + 1.3))
    homogeneous = torch.cat([centres, torch.zeros(len(centres), 1), torch.ones(len(centres), 1)], dim=1)
    uvw = homogeneous @ pixel_from_velo.t()
    grid = torch.stack([2 * uvw[:, 0] / uvw[:, 2] / image.shape[1] - 1, 2 * uvw[:, 1] / uvw[:, 2] / image.shape[0] - 1], 1)
    colour = torch.nn.functional.grid_sample(image.permute(2, 0, 1)[None], grid[None, None], align_corners=False)
    logits = 0.05 * (near @ above) - 4 * colour[0, :, 0].mean(dim=0)
    boxes = torch.cat([centres, torch.tensor([[3.9, 1.6, 0.0]]).repeat(len(centres), 1)], dim=1)
    return boxes, logits


# Twenty steps of Adam by hand.
vertices = torch.tensor(mesh.vertices, dtype=torch.float32, requires_grad=True)
texels = torch.tensor(mesh.texels, dtype=torch.float32, requires_grad=True)
optimiser = torch.optim.Adam([{"params": [vertices], "lr": 1e-2}, {"params": [texels], "lr": 4e-2}])
matrix = torch.tensor(frame.pixel_from_velo, dtype=torch.float32)
losses = []
for step in range(20):
    image, points = mirage.torch.insert(frame, host, vertices, texels)
    boxes, logits = detector(image, points, matrix)
    apart = (boxes[:, :2] - torch.tensor(host.label.box_bev[:2])).norm(dim=1)
    loss = torch.nn.functional.softplus(logits[apart < 2]).sum()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    with torch.no_grad():
        texels.clamp_(0, 1)
    losses.append(float(loss))
assert sum(losses[-5:]) / 5 < losses[0], losses  # one step may rise: which ray hits has no derivative

# Twenty steps of Mirage's own, on the whole data set, and the command line on the run.
run = out + "/run"
mirage.attack(detector=detector, data=folder, out=run, iterations=20)
subprocess.run([program, "evaluate", "--run", run, "--out", out + "/evaluate"], check=True)
print("accepted: loss", losses[0], "to", losses[-1])
