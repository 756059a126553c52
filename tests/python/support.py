"""Shared by the module's tests: a data set of a few tiny frames, and a detector of a few lines."""

import importlib.util
import os
import shutil
import tempfile

import numpy as np
from PIL import Image

PROGRAM = os.path.join(os.environ.get("MIRAGE_BUILD", "build/release"), "mirage")
EXAMPLES = os.path.join(os.environ.get("MIRAGE_SOURCE", "."), "plugins", "python", "examples")
WIDTH, HEIGHT, FOCAL = 248, 75, 144.0  # a fifth of KITTI's picture


def example(name):
    """A module of the package's examples."""
    found = importlib.util.spec_from_file_location(name, os.path.join(EXAMPLES, name + ".py"))
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def car_returns(x, y, length, width, height, bottom, random):
    """Points on a box's rear, sides and roof, as a LiDAR at the origin sees them."""
    count = 150
    u, v = random.uniform(-0.5, 0.5, (2, count))
    rear = np.stack([np.full(count, x - length / 2), y + u * width, bottom + (v + 0.5) * height], 1)
    roof = np.stack([x + u * length * 0.5, y + v * width, np.full(count, bottom + height)], 1)
    side = np.sign(-y) if y else 1.0
    near = np.stack([x + u * length, np.full(count, y + side * width / 2), bottom + (v + 0.5) * height], 1)
    return np.concatenate([rear, roof, near])


def write_data(folder, frames=4):
    """Flat ground and one car a frame, in KITTI's layout."""
    random = np.random.default_rng(1)
    for name in ("image_2", "velodyne", "calib", "label_2"):
        os.makedirs(os.path.join(folder, "training", name))
    for i in range(frames):
        x, y, length, width, height, bottom = 10.0 + i, 0.5 * i - 0.5, 3.9, 1.6, 1.5, -1.73
        ground = np.stack(np.meshgrid(np.arange(6, 40, 0.8), np.arange(-6, 6, 0.5)), -1).reshape(-1, 2)
        points = np.concatenate([np.c_[ground, np.full(len(ground), bottom)],
                                 car_returns(x, y, length, width, height, bottom, random)])
        points = np.c_[points, np.full(len(points), 0.3)].astype("<f4")
        place = os.path.join(folder, "training", "{}", f"{i:06d}.{{}}")
        points.tofile(place.format("velodyne", "bin"))
        picture = (60 + 40 * random.random((HEIGHT, WIDTH, 3))).astype(np.uint8)
        Image.fromarray(picture).save(place.format("image_2", "png"))
        p2 = f"{FOCAL} 0 122 0 0 {FOCAL} 35 0 0 0 1 0"
        eye = "1 0 0 0 1 0 0 0 1"
        rows = [f"P{k}: {p2}" for k in range(4)] + [f"R0_rect: {eye}", "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27",
                                                   "Tr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0"]
        with open(place.format("calib", "txt"), "w") as file:
            file.write("\n".join(rows) + "\n")
        # The label's place is in the camera's frame: x right, y down, z forward.
        label = (f"Car 0.00 0 0.00 90.00 20.00 150.00 60.00 {height} {width} {length} "
                 f"{-y:.3f} {-bottom - 0.08:.3f} {x - 0.27:.3f} {-np.pi / 2:.4f}")
        with open(place.format("label_2", "txt"), "w") as file:
            file.write(label + "\n")
    # The ground is a grid and lies on no unit's rays: a unit that is named is not taken for an assumed one.
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    shutil.copy(os.path.join(root, "scenes", "rigs", "kitti64.toml"), os.path.join(folder, "rig.toml"))


class Folder:
    """A temporary folder with data, for a module's tests."""

    def __init__(self, frames=4):
        self.path = tempfile.mkdtemp(prefix="mirage-python-")
        self.data = os.path.join(self.path, "data")
        write_data(self.data, frames)

    def remove(self):
        shutil.rmtree(self.path)


def anchors():
    """The positions of the tests' detector, M×2."""
    import torch

    x, y = torch.meshgrid(torch.arange(8.0, 16.0, 0.5), torch.arange(-3.0, 4.0, 0.5), indexing="ij")
    return torch.stack([x.flatten(), y.flatten()], 1)


def evidence(points):
    """How many points are near each anchor: a sum over the points."""
    import torch

    apart = (anchors()[:, None, :] - points[None, :, :2]).pow(2).sum(-1)
    return (torch.exp(-apart / 0.8) * torch.sigmoid(4 * (points[:, 2] + 1.2))).sum(1)


def detector(image, points, pixel_from_velo):
    """A detector of the tests: anchors on a grid, scored by the points around them and by the picture there."""
    return scored_anchors(image, evidence(points), pixel_from_velo)


def scored_anchors(image, count, pixel_from_velo):
    """(boxes, logits)"""
    import torch

    centres = anchors()
    roof = torch.cat([centres, torch.zeros(len(centres), 1), torch.ones(len(centres), 1)], 1) @ pixel_from_velo.t()
    pixel = roof[:, :2] / roof[:, 2:]
    place = 2 * pixel / torch.tensor([image.shape[1] - 1.0, image.shape[0] - 1.0]) - 1
    seen = torch.nn.functional.grid_sample(image.permute(2, 0, 1)[None], place[None, None], align_corners=True)
    logits = 0.15 * (count - 30) - 4 * (seen[0, :, 0].mean(0) - 0.15)
    size = torch.tensor([3.9, 1.6, 0.0]).expand(len(centres), 3)
    return torch.cat([centres, size], 1), logits


class LocalDetector:
    """The tests' detector, which sums over the points of a clean sweep once."""

    local = True

    def __init__(self, local=True):
        self.local, self.kept, self.rows = local, {}, 0

    def evidence(self, points):
        self.rows += len(points)
        return evidence(points)

    def __call__(self, frame):
        import torch

        points, count = frame.points["lidar"], 0
        if frame.clean is not None:
            before = frame.clean.points["lidar"]
            if frame.clean.key not in self.kept:
                self.kept[frame.clean.key] = self.evidence(before)
            ours, known = ([row.tobytes() for row in rows.detach().numpy()] for rows in (points, before))
            alike = set(ours) & set(known)
            added, gone = (torch.tensor([row not in alike for row in rows]) for rows in (ours, known))
            count, points = self.kept[frame.clean.key] - self.evidence(before[gone]), points[added]
        return scored_anchors(frame.images["camera"], count + self.evidence(points), frame.pixel_from_velo["camera"])
