"""Published networks as detectors, in PyTorch alone: Point-GNN (LiDAR), one for photographs, and CLOCs, a late fusion of both.

    lidar = PointGnn("point_gnn_t0.npz")
    fusion = Clocs("clocs.npz", lidar, Picture("vehicle_adas_0002.pt"))
    mirage.attack(detector=fusion, data="path/to/kitti", out="out/run")

or as a program, which needs only torch and mirage_serve.py:

    mirage attack --detector "exec:python3 published.py point-gnn point_gnn_t0.npz" --data path/to/kitti --out out/run
    … "exec:python3 published.py picture vehicle_adas_0002.pt"
    … "exec:python3 published.py clocs point_gnn_t0.npz vehicle_adas_0002.pt clocs.npz"

The weights come from the authors (MIT; trained on KITTI). Point-GNN, Shi and Rajkumar, CVPR 2020: github.com/WeijingShi/Point-GNN,
checkpoints/car_auto_T0_train, converted to arrays under the variables' names:

    reader = tensorflow.train.load_checkpoint("checkpoints/car_auto_T0_train")
    numpy.savez("point_gnn_t0.npz", **{name: reader.get_tensor(name) for name in reader.get_variable_to_shape_map()})

CLOCs, Pang, Morris and Radha, IROS 2020: github.com/lunhengsheng/CLOCs_based_pp, second/output/0831_ppcas_baseline:

    state = torch.load("fusion_layer-37120.tckpt", map_location="cpu")
    numpy.savez("clocs.npz", **{name: tensor.numpy() for name, tensor in state.items()})

The network for photographs is a TorchScript file. It takes float32 [1, 3, H, W], blue first, 0 to 255, H and W multiples of 32,
and returns boxes [N, 4] (left, top, right, bottom; pixels) and logits [N] before suppression.
"""

import hashlib
import sys
import warnings

import numpy as np
import torch
import torch.nn.functional as F
from torch.utils.checkpoint import checkpoint

warnings.filterwarnings("ignore", "scatter_reduce")  # "in beta"
BLOCK = 1 << 15  # edges to process at once


def version_of(file):
    """A hash of the file's content. Mirage stores answers on disk under it, so that a long evaluation can resume."""
    with open(file, "rb") as content:
        return hashlib.sha256(content.read()).hexdigest()[:16]


def layers_of(arrays, scope):
    """The linear layers of a scope, as a list of (weights, biases)."""
    found = []
    while True:
        name = f"{scope}/fully_connected" + (f"_{len(found)}" if found else "")
        if f"{name}/weights" not in arrays:
            return found
        found.append(tuple(torch.from_numpy(arrays[f"{name}/{part}"]) for part in ("weights", "biases")))


def apply(layers, x):
    """Applies linear layers to rows, with a ReLU between two layers."""
    for k, (weights, biases) in enumerate(layers):
        x = torch.addmm(biases, x.relu() if k else x, weights)
    return x


def camera_of(matrix):
    """Rotation and translation (m) from `velo` into the camera's frame, by RQ decomposition of the 3×4 projection."""
    q, r = np.linalg.qr(np.flipud(matrix[:, :3]).T)
    intrinsics, rotation = np.fliplr(np.flipud(r.T)), np.flipud(q.T)
    sign = np.sign(np.diag(intrinsics))
    return rotation * sign[:, None], np.linalg.solve(intrinsics * sign, matrix[:, 3])


def pairs_within(radius, points, centres):
    """Indices (points, centres) of all pairs at most `radius` apart (m), sorted by centre. A grid of cells of that size finds them;
    it is sorted so that the three cells of a column are adjacent."""
    low = points.min(0) - 2 * radius
    cell, at = (np.floor((part - low) / radius).astype(np.int64) for part in (points, centres))
    extent = np.maximum(cell.max(0), at.max(0)) + 3
    key = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    key = key[order]
    x, y = (at[:, axis, None] + step.ravel() for axis, step in enumerate(np.mgrid[-1:2, -1:2]))
    middle = ((x * extent[1] + y) * extent[2] + at[:, 2, None]).ravel()
    first = np.searchsorted(key, middle - 1)
    count = np.searchsorted(key, middle + 1, side="right") - first
    column = np.repeat(np.arange(len(middle)), count)
    point = order[first[column] + np.arange(len(column)) - (np.cumsum(count) - count)[column]]
    near = np.square(points[point] - centres[column // 9]).sum(1) <= radius * radius
    return point[near], column[near] // 9


def keypoints_of(xyz, voxel):
    """For each occupied voxel (side in m), the index of the point closest to its mean, at most half a voxel's diagonal away."""
    cell = np.floor((xyz - (xyz.min(0) - voxel / 2)) / voxel).astype(np.int64)
    extent = cell.max(0) + 1
    _, voxel_of, count = np.unique((cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2], return_inverse=True,
                                   return_counts=True)
    mean = np.stack([np.bincount(voxel_of, column) / count for column in xyz.T], 1).astype(np.float32)
    point, centre = pairs_within(0.8661 * voxel, xyz, mean)
    order = np.lexsort((np.square(xyz[point] - mean[centre]).sum(1), centre))
    return point[order[np.unique(centre[order], return_index=True)[1]]]


def marks_of(*columns):
    """A 64-bit hash of each row of 32-bit values."""
    mark = np.zeros(len(columns[0]), np.uint64)
    for column in columns:
        for value in np.ascontiguousarray(column).view(np.uint32).T:
            mark = (mark ^ value) * np.uint64(0x9E3779B97F4A7C15)
            mark ^= mark >> np.uint64(29)
    return mark


class PointGnn:
    """Point-GNN without a graph layer (T0): each keypoint gives two boxes, from the points within 1 m.

    Its answers are cached by neighbourhood, so that an object on a roof costs only what it changes. A cached neighbourhood has no
    gradient, because nothing in it has moved.
    """

    region = (0.0, 70.0, -40.0, 40.0)
    classes = ["Car"]
    reads = ("points",)
    heights = True
    VOXEL, RADIUS = 0.4, 1.0  # m
    SIZE = torch.tensor([3.88, 1.5, 1.63])  # m, median length, height, width
    BASELINE = torch.tensor([0.0598, -0.0003, 0.0027])  # m, from KITTI's rectified camera 0, the boxes' frame, to the colour camera
    LEAST_SCORE = 0.01

    def __init__(self, file, keep=1 << 19):
        with np.load(file, allow_pickle=False) as arrays:
            arrays = {name: arrays[name] for name in arrays.files}
        self.edges, self.features, self.classify = (layers_of(arrays, scope) for scope in (
            "layer1/extract_vertex_features", "layer1/combined_features", "output/predictor/cls"))
        self.locate = [layers_of(arrays, f"output/predictor/loc/cls_{k}") for k in (1, 2)]
        if any(name.startswith("layer2/") for name in arrays) or not all((self.edges, self.features, self.classify, *self.locate)):
            raise ValueError(f"{file}: holds no Point-GNN without graph layers; convert checkpoints/car_auto_T0_train")
        self.version = version_of(file)
        self.keep, self.known = keep, {}  # at most `keep` answers, by neighbourhood

    def answers(self, reflectance, xyz, place, point, centre):
        """Answers for K keypoints, K×18: 4 logits, then the codes of 2 boxes, 7 each."""
        head = torch.cat([reflectance, xyz], 1)
        tail = torch.cat([torch.zeros_like(place[:, :1]), place], 1)

        def greatest(point, rows, tail):
            value = apply(self.edges, head[point] - tail[rows]).relu()
            return value.new_zeros(len(tail), value.shape[1]).scatter_reduce(0, rows[:, None].expand_as(value), value, "amax")

        start, most, begin = np.searchsorted(centre.numpy(), np.arange(len(place) + 1)), [], 0
        for end in range(1, len(place) + 1):
            if end == len(place) or start[end] - start[begin] >= BLOCK:
                block = slice(start[begin], start[end])
                most.append(checkpoint(greatest, point[block], centre[block] - begin, tail[begin:end], use_reentrant=False))
                begin = end
        features = apply(self.features, torch.cat(most)).relu()
        return torch.cat([apply(layers, features) for layers in (self.classify, *self.locate)], 1)

    def boxes(self, points, pixel_from_velo):
        """Boxes M×7 in `velo` (centre, length, width, height in m; yaw in rad) and logits M, before suppression."""
        rotation, translation = (torch.from_numpy(part).float() for part in camera_of(pixel_from_velo.double().numpy()))
        xyz = points[:, :3] @ rotation.t() + translation
        ahead = xyz[:, 2].detach() > 0.1
        xyz, reflectance = xyz[ahead], points[ahead, 3:4]
        if not len(xyz):
            return points.new_zeros(0, 7), points.sum() + points.new_zeros(0)
        still = xyz.detach().numpy()
        chosen = keypoints_of(still, self.VOXEL)
        point, centre = pairs_within(self.RADIUS, still, still[chosen])
        marks = marks_of(still, reflectance.detach().numpy())
        begins = np.searchsorted(centre, np.arange(len(chosen)))
        hoods = (np.add.reduceat(marks[point], begins) * np.uint64(3) + marks[chosen]).tolist()
        fresh = np.array([hood not in self.known for hood in hoods])
        place = xyz[torch.from_numpy(chosen)]
        rows = torch.from_numpy(np.stack([self.known.get(hood, np.zeros(18, np.float32)) for hood in hoods]))
        if fresh.any():
            kept = fresh[centre]
            number = torch.from_numpy(np.cumsum(fresh) - 1)
            here = torch.from_numpy(fresh)
            found = self.answers(reflectance, xyz, place[here], torch.from_numpy(point[kept]),
                                 number[torch.from_numpy(centre[kept])])
            rows = rows.index_put((here.nonzero()[:, 0],), found)
            if len(self.known) > self.keep:
                self.known.clear()
            self.known.update(zip((hood for hood, new in zip(hoods, fresh) if new), found.detach().numpy()))
        logits = rows[:, :4]
        logits = torch.stack([logits[:, k] - torch.cat([logits[:, :k], logits[:, k + 1:]], 1).logsumexp(1) for k in (1, 2)], 1)
        likely = logits.detach().sigmoid() >= self.LEAST_SCORE
        code = rows[:, 4:].reshape(-1, 2, 7)
        size = code[:, :, 3:6].exp() * self.SIZE  # length, height, width
        middle = place[:, None] + code[:, :, :3] * self.SIZE + self.BASELINE - size * torch.tensor([0, 0.5, 0])
        middle = (middle - translation) @ rotation
        yaw = code[:, :, 6] * (np.pi / 4) + torch.tensor([0, np.pi / 2])
        along = torch.stack([yaw.cos(), 0 * yaw, -yaw.sin()], 2) @ rotation
        boxes = torch.cat([middle, size[:, :, [0, 2, 1]], torch.atan2(along[:, :, 1], along[:, :, 0])[:, :, None]], 2)
        return boxes[likely], logits[likely]

    def __call__(self, image, points, pixel_from_velo):
        return self.boxes(points, pixel_from_velo)


def overlaps(a, b):
    """IoU of all pairs of rectangles M×4 and N×4 (left, top, right, bottom): M×N."""
    inside = (torch.minimum(a[:, None, 2:], b[None, :, 2:]) - torch.maximum(a[:, None, :2], b[None, :, :2])).clamp(min=0).prod(2)
    area = [(part[:, 2] - part[:, 0]) * (part[:, 3] - part[:, 1]) for part in (a, b)]
    return inside / (area[0][:, None] + area[1][None] - inside).clamp(min=1e-6)


class Picture:
    """A network for 8-bit photographs, with boxes M×4 in the picture (pixels)."""

    def __init__(self, file):
        self.network, self.version = torch.jit.load(file).eval(), version_of(file)

    def __call__(self, image):
        height, width = image.shape[:2]
        linear = image.clamp(0, 1)
        srgb = torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp(min=0.0031308) ** (1 / 2.4) - 0.055)
        batch = 255 * srgb.flip(2).permute(2, 0, 1)[None]
        boxes, logits = self.network(F.pad(batch, [0, -width % 32, 0, -height % 32]))
        most = boxes.new_tensor([width - 1, height - 1, width - 1, height - 1])
        return torch.minimum(boxes.clamp(min=0), most), logits


class Clocs:
    """CLOCs' fusion layer. It pairs each box of the LiDAR network with the boxes of the picture network, and gives it the greatest
    logit of its pairs. It was trained on other networks' scores (PointPillars, Cascade R-CNN)."""

    region = PointGnn.region
    classes = ["Car"]
    heights = True
    DISTANCE = 82.0  # m; the unit of the layer's distances

    def __init__(self, file, lidar, picture, least_score=0.01):
        self.lidar, self.picture, self.least_score = lidar, picture, least_score
        self.version = "-".join((version_of(file), lidar.version, picture.version))
        with np.load(file, allow_pickle=False) as arrays:
            self.layers = [(torch.from_numpy(arrays[f"fuse_2d_3d.{k}.weight"][:, :, 0, 0]).t(),
                            torch.from_numpy(arrays[f"fuse_2d_3d.{k}.bias"])) for k in (0, 2, 4, 6)]

    def rectangles(self, boxes, matrix, height, width):
        """The rectangles M×4 (pixels) around the boxes' projected corners, clipped to the picture."""
        half = boxes.new_tensor([-0.5, 0.5])
        corner = torch.cartesian_prod(half, half, half) * boxes[:, None, 3:6]
        c, s = boxes[:, 6:].cos(), boxes[:, 6:].sin()
        along, across, up = corner.unbind(2)
        turned = torch.stack([c * along - s * across, s * along + c * across, up], 2)
        pixel = (boxes[:, None, :3] + turned) @ matrix[:, :3].t() + matrix[:, 3]
        pixel = pixel[:, :, :2] / pixel[:, :, 2:].clamp(min=0.1)
        u, v = pixel[:, :, 0].clamp(0, width), pixel[:, :, 1].clamp(0, height)
        return torch.stack([u.amin(1), v.amin(1), u.amax(1), v.amax(1)], 1)

    def seen(self, image):
        """The picture network's boxes (pixels) and scores, without overlapping boxes."""
        boxes, logits = self.picture(image)
        scores = logits.sigmoid()
        order = scores.detach().argsort(descending=True)
        order = order[scores.detach()[order] > self.least_score]
        alike = (overlaps(boxes[order], boxes[order]) > 0.5).detach().numpy()
        stays = np.ones(len(order), bool)
        for k in range(len(order)):
            if stays[k]:
                stays[k + 1:] &= ~alike[k, k + 1:]
        order = order[torch.from_numpy(stays)][:200]
        return boxes[order], scores[order]

    def __call__(self, image, points, pixel_from_velo):
        boxes, logits = self.lidar.boxes(points, pixel_from_velo)
        scores = logits.sigmoid()
        distance = boxes[:, :2].square().sum(1).clamp(min=1e-6).sqrt() / self.DISTANCE
        nothing = torch.full_like(distance, -1)
        fused = apply(self.layers, torch.stack([nothing, scores, nothing, distance], 1))[:, 0]
        if not len(boxes) or not image.numel():
            return boxes, fused
        found, found_scores = self.seen(image)
        iou = overlaps(self.rectangles(boxes, pixel_from_velo, *image.shape[:2]), found)
        i, j = (iou.detach() > 0).nonzero().t()
        pairs = apply(self.layers, torch.stack([iou[i, j], scores[i], found_scores[j], distance[i]], 1))[:, 0]
        return boxes, fused.scatter_reduce(0, i, pairs, "amax")


def detector_of(name, *files):
    """The detector that the command line names."""
    if name == "clocs":
        return Clocs(files[2], PointGnn(files[0]), Picture(files[1]))
    return {"point-gnn": PointGnn, "picture": Picture}[name](*files)


if __name__ == "__main__":
    from mirage_serve import serve

    network = detector_of(*sys.argv[1:])
    serve(network)
