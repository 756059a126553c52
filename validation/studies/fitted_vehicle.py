"""A vehicle of a recorded drive as a mesh, from the frames of its track, and that mesh in another frame, in both sensors
(real_to_sim.py). The surface is an implicit one through the registered, mirrored returns (Kolluri, SODA 2005) over a saloon's outline;
what came back of the rays that met it, and its colours, are those of the same frames."""

import functools
import math
import pathlib
import tomllib

import mirage
import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, cKDTree

HERE = pathlib.Path(__file__).resolve().parents[2]
STEP = 0.1  # m, of the grid
REACH = 0.12  # m, of a return's weight
FAR = 90.0  # m: the range of a removed car's returns along their rays; recorded ones end at 80
LEAST_HEIGHT = 0.25  # m over the label's bottom; lower returns may be the road's
DEEP = 0.25  # m behind the surface: seen through a window
BEAMS = np.array(tomllib.loads((HERE / "scenes/rigs/kitti64.toml").read_text())["lidar"]["beams"])


def rays_of(points):
    """Origins, unit directions and lasers of the rays that returns (`velo`) came by."""
    rho = np.hypot(points[:, 0], points[:, 1])
    tangent = np.tan(np.radians(BEAMS[:, 0]))
    off = np.abs(points[:, 2:3] - BEAMS[:, 1] - rho[:, None] * tangent)
    laser = off.argmin(1)
    beam = BEAMS[laser]
    azimuth = np.arctan2(points[:, 1], points[:, 0]) - np.arcsin(beam[:, 2] / np.maximum(rho, 1))
    origin = np.stack([-np.sin(azimuth) * beam[:, 2], np.cos(azimuth) * beam[:, 2], beam[:, 1]], 1)
    away = points[:, :3] - origin
    return origin, away / np.linalg.norm(away, axis=1, keepdims=True), laser


def turn(yaw):
    return np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])


def to_box(points, pose):
    return (points - pose[:3]) @ turn(pose[3])


def from_box(points, pose):
    return points @ turn(pose[3]).T + pose[:3]


class Sight:
    """A vehicle in a frame: its label, and its returns in the label's frame (on the ground under its centre, x ahead)."""

    def __init__(self, frame_id, frame, label):
        x, y, length, width, yaw = label.box_bev
        self.id, self.type, self.pose = frame_id, label.type, np.array([x, y, label.bottom, yaw])
        self.size = np.array([length, width, label.height])
        self.whole = label.truncated < 0.05
        self.occluded, self.picture = label.occluded, label.box_2d
        of = self.on(frame.points)
        self.points, self.reflectance = to_box(frame.points[of, :3], self.pose), frame.points[of, 3]
        self.seen_from = to_box(np.zeros((1, 3)), self.pose)[0]
        self.shift = np.zeros(3)  # x, y, yaw of the registered car in the label's frame

    @property
    def registered(self):
        """The car's pose in `velo`: the label's, corrected by its returns."""
        x, y, yaw = self.shift
        return np.append(from_box(np.array([[x, y, 0]]), self.pose)[0], self.pose[3] + yaw)

    def on(self, points, margin=0.2):
        """Whether each point (`velo`) lies on the car."""
        p = to_box(points[:, :3], self.pose)
        return (np.abs(p[:, :2]) < self.size[:2] / 2 + margin).all(1) & (p[:, 2] > LEAST_HEIGHT) & (p[:, 2] < self.size[2] + margin)

    def aligned(self, points):
        x, y, yaw = self.shift
        return (points - [x, y, 0]) @ turn(yaw)


# The mesh.

def outer(p, margin=0.25):
    """Whether each point belongs to the shell: near the convex hull of their slice across x, y or z. The others were seen through
    windows, or are isolated: glare before a plate or a lamp."""
    lonely = cKDTree(p).query(p, 6)[0][:, 5]
    near, dense = np.zeros(len(p), bool), lonely < 4 * np.median(lonely)
    q = p[dense]
    near[dense] = near_hulls(q, 0, margin) | near_hulls(q, 1, margin) | near_hulls(q, 2, margin)
    return near


def near_hulls(p, axis, margin, thick=0.15):
    """Whether each point is within `margin` of the convex hull of its slice across an axis."""
    near, others = np.zeros(len(p), bool), [k for k in range(3) if k != axis]
    slices = np.round(p[:, axis] / thick)
    for at in np.unique(slices):
        inside = slices == at
        flat = p[np.abs(p[:, axis] / thick - at) < 1][:, others]
        if len(flat) < 8 or np.ptp(flat, axis=0).min() < 0.05:
            near |= inside
            continue
        hull = ConvexHull(flat).equations
        near[inside] = (p[inside][:, others] @ hull[:, :2].T + hull[:, 2]).max(1) > -margin
    return near


def normals_of(p, towards):
    """Normals of the planes through each point's neighbours, and the flatness of these, 0 ... 1."""
    _, around = cKDTree(p).query(p, min(20, len(p)))
    near = p[around] - p[around].mean(1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    n = axes[:, :, 0]
    return n * np.where((n * towards).sum(1) < 0, -1.0, 1.0)[:, None], np.exp(-spread[:, 0] / np.maximum(spread[:, 1], 1e-9) / 0.1)


def outline(grid, size, kind):
    """Approximate signed distance of a saloon or van of that size."""
    x, y, z = grid[..., 0] / size[0], np.abs(grid[..., 1]), grid[..., 2] / size[2]
    tops = [0.95, 1, 1, 1, 0.65, 0.5] if kind == "Van" else [0.6, 0.85, 1, 1, 0.65, 0.5]
    top = np.interp(x, [-0.5, -0.42, -0.25, 0.1, 0.3, 0.5], tops)
    side = y - size[1] / 2 * (1 - 0.35 * np.clip(z - 0.55, 0, 1))
    return np.max([side, (np.abs(x) - 0.5) * size[0], (z - top) * size[2], 0.05 - grid[..., 2]], 0)


class Field:
    """Signed distance from returns with normals: the weighted mean of the distances to their planes (Kolluri)."""

    def __init__(self, points, normals, weights, size, kind):
        half = size[:2] / 2 + 0.35
        self.low = np.array([-half[0], -half[1], -0.1])
        axes = [np.arange(low, high, STEP) for low, high in zip(self.low, (*half, size[2] + 0.35))]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        nodes = grid.reshape(-1, 3)
        away, near = cKDTree(points).query(nodes, min(32, len(points)), distance_upper_bound=4 * REACH)
        there = near < len(points)
        near[~there] = 0
        w = np.where(there, weights[near] * np.exp(-np.where(there, away, 0) ** 2 / REACH**2), 0)
        planes = np.clip(((nodes[:, None] - points[near]) * normals[near]).sum(2), -0.2, 0.2)
        prior, sure = np.clip(outline(grid, size, kind).reshape(-1), -0.2, 0.2), 0.01
        values = ((w * planes).sum(1) + sure * prior) / (w.sum(1) + sure)
        hull = ConvexHull(np.concatenate([points, nodes[prior < 0]])).equations  # beyond it planes are extrapolated
        values = np.maximum(values, (nodes @ hull[:, :3].T + hull[:, 3]).max(1) - 0.02).reshape(grid.shape[:3])
        parts, _ = ndimage.label(values < 0)
        self.values = np.where((values < 0) & (parts != np.bincount(parts[parts > 0]).argmax()), 0.02, values)
        inner = np.zeros(self.values.shape, bool)
        inner[1:-1, 1:-1, 1:-1] = True
        self.values = np.where(inner, self.values, np.maximum(self.values, 0.05))

    def at(self, p):
        return ndimage.map_coordinates(self.values, ((p - self.low) / STEP).T, order=1, mode="nearest")

    def slope(self, p):
        return np.stack([(self.at(p + d) - self.at(p - d)) / 0.1 for d in 0.05 * np.eye(3)], 1)

    def mesh(self):
        """Vertices and faces of the zero surface: a vertex in each cell that it crosses (naive surface nets)."""
        f = self.values
        corners = [np.s_[i:f.shape[0] - 1 + i, j:f.shape[1] - 1 + j, k:f.shape[2] - 1 + k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        at = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
        total, count = np.zeros((*(np.array(f.shape) - 1), 3)), np.zeros(np.array(f.shape) - 1)
        for a in range(8):
            for b in range(a + 1, 8):
                if np.abs(at[a] - at[b]).sum() == 1:
                    fa, fb = f[corners[a]], f[corners[b]]
                    cross = (fa < 0) != (fb < 0)
                    t = np.where(cross, fa / np.where(cross, fa - fb, 1), 0)
                    total += np.where(cross[..., None], at[a] + t[..., None] * (at[b] - at[a]), 0)
                    count += cross
        active = count > 0
        number = np.full(active.shape, -1)
        number[active] = np.arange(active.sum())
        vertices = (np.argwhere(active) + total[active] / count[active][:, None]) * STEP + self.low
        faces = []
        for axis in range(3):
            g, n = np.moveaxis(f, axis, 0), np.moveaxis(number, axis, 0)
            enters = ((g[:-1] < 0) != (g[1:] < 0))[:, 1:-1, 1:-1]
            quad = np.stack([n[:, :-1, :-1], n[:, 1:, :-1], n[:, 1:, 1:], n[:, :-1, 1:]], -1)[enters]
            outward = (g[:-1] < 0)[:, 1:-1, 1:-1][enters]
            if axis == 1:  # the axis order exchanged the handedness of the other two
                outward = ~outward
            quad[~outward] = quad[~outward][:, ::-1]
            faces += [quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]
        return vertices, np.concatenate(faces)


def cloud(sights):
    """All returns of the registered sights: points, towards the unit, and which are inside the car."""
    p = np.concatenate([s.aligned(s.points) for s in sights])
    towards = np.concatenate([s.aligned(s.seen_from[None])[0] - s.aligned(s.points) for s in sights])
    both = np.concatenate([p, p * [1, -1, 1]])
    return p, towards, outer(both)[:len(p)]


def register(sights, field):
    """Moves each sight's car to the surface: x, y and yaw by robust least squares, held by the label."""
    for s in sights:
        for _ in range(4):
            p = s.aligned(s.points)
            r, n = field.at(p), field.slope(p)
            keep = np.abs(r) < 0.25
            if keep.sum() < 6:
                break
            r, n, p = r[keep], n[keep], p[keep]
            jacobian = np.stack([-n[:, 0], -n[:, 1], n[:, 0] * p[:, 1] - n[:, 1] * p[:, 0]], 1)
            w = (1 / np.maximum(1, np.abs(r) / 0.03))[:, None]
            hold = np.diag((0.05 / np.array([0.1, 0.1, 0.02])) ** 2)
            step = np.linalg.solve(jacobian.T @ (w * jacobian) + hold, -jacobian.T @ (w[:, 0] * r) - hold @ s.shift)
            s.shift = s.shift + np.append(turn(s.shift[2])[:2, :2] @ step[:2], step[2])


def surface(sights, rounds=3):
    """Field and shell of a vehicle; sights become registered."""
    size, kind = np.median([s.size for s in sights], 0), sights[0].type
    field = None
    for turns in range(rounds):
        p, towards, shell = cloud(sights)
        p, (n, flat) = p[shell], normals_of(p[shell], towards[shell])
        weights = np.concatenate([flat, 0.05 * flat])
        field = Field(np.concatenate([p, p * [1, -1, 1]]), np.concatenate([n, n * [1, -1, 1]]), weights, size, kind)
        if turns < rounds - 1:
            register(sights, field)
    return field


# Simulation of both sensors.

def without(frame, sight):
    """The sweep with the car's returns moved far out along their rays: each ray keeps its direction."""
    points = frame.points.copy()
    gone = sight.on(points)
    origin, direction, _ = rays_of(points[gone])
    points[gone, :3] = origin + FAR * direction
    return points


def beside(frame, sight, mesh, pose, **settings):
    """The frame without the car but with a mesh in its place: the Insertion, its returns, and the rest of the sweep."""
    x, y, z, yaw = sight.pose
    length, width, height = sight.size
    built = mirage.Frame(image=frame.image, points=without(frame, sight), intrinsics=frame.intrinsics,
                         camera_from_velo=frame.camera_from_velo,
                         labels=[("Car", (x, y, z + height / 2, length, width, height, yaw))], rig="kitti64")
    result = insert(built, 0, mesh, pose, **settings)
    new = result.points[len(result.points) - result.adversary_points:]
    left = result.points[:len(result.points) - len(new)]
    return result, new, left[np.linalg.norm(left[:, :3], axis=1) < FAR - 5]


def insert(frame, host, mesh, pose, **settings):
    """The mesh, in a vehicle's frame, where `pose` has that frame in `velo`."""
    low = pose[2] + mesh.vertices[np.unique(mesh.faces), 2].min()
    place = ",".join(f"{v:.5f}" for v in (pose[0], pose[1], low, math.degrees(pose[3])))
    return mirage.insert(frame, host, mesh, place="world:" + place, **settings)


def against_recording(frame, sight, mesh, pose, returns):
    """For each simulated return: face, laser, cosine and range; and of the recorded one on its ray range (inf: none), reflectance, and
    whether it is the car's."""
    origin, direction, laser = rays_of(returns)
    placed = mirage.Mesh(from_box(mesh.vertices, pose), mesh.faces)
    hits = mirage.cast_rays(placed, origin, direction)
    corner = placed.vertices[mesh.faces[np.maximum(hits.face, 0)]]
    n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    cosine = np.abs((n * direction).sum(1)) / np.maximum(np.linalg.norm(n, axis=1), 1e-12)
    of = rays_of(frame.points)
    away, near = cKDTree(of[1]).query(direction, distance_upper_bound=2e-4)
    there = near < len(frame.points)
    near[~there] = 0
    measured = np.where(there, np.linalg.norm(frame.points[near, :3] - of[0][near], axis=1), np.inf)
    return {"face": hits.face, "laser": laser, "cosine": cosine, "range": np.linalg.norm(returns[:, :3] - origin, axis=1),
            "recorded": measured, "reflectance": np.where(there, frame.points[near, 3], 0),
            "of_car": there & sight.on(frame.points)[near]}


@functools.lru_cache(maxsize=64)
def read(data, frame_id):
    """Cached: the fits of a track read the same frames."""
    return mirage.read_frame(data, frame_id)


def spread(values, weights, places, at, reach=0.15, twin=0.1):
    """Weighted means around `at` of values that were seen at places, their mirror images counting little; and their weight."""
    both = np.concatenate([places, places * [1, -1, 1]])
    away, near = cKDTree(both).query(at, 64 if len(both) > 64 else len(both), distance_upper_bound=3 * reach)
    there = near < len(both)
    near[~there] = 0
    w = np.where(there, np.concatenate([weights, twin * weights])[near] * np.exp(-np.where(there, away / reach, 0) ** 2), 0)
    return (w * np.concatenate([values, values])[near]).sum(1) / np.maximum(w.sum(1), 1e-12), w.sum(1)


def centres(vertices, faces):
    return vertices[faces].mean(1)


class Material:
    """What became of the rays that met the surface in the other frames: each one's place, incidence and laser, and whether it came back
    (with which reflectance; how far behind the surface, through a window), passed the car, or was lost."""

    def __init__(self, data, sights, vertices, faces):
        whole, self.middle = mirage.Mesh(vertices, faces, np.ones((len(faces), 1, 1, 3))), centres(vertices, faces)
        seen = []
        for s in sights:
            frame = read(data, s.id)
            _, new, _ = beside(frame, s, whole, s.registered, lidar_effects="ideal", supersampling=1)
            if len(new):
                seen.append(against_recording(frame, s, whole, s.registered, new))
        seen = {key: np.concatenate([one[key] for one in seen]) for key in seen[0]}
        seen = {key: value[seen["face"] >= 0] for key, value in seen.items()}
        self.back, self.behind = seen["of_car"], np.where(seen["of_car"], seen["recorded"] - seen["range"], 0)
        self.passed = ~self.back & (seen["recorded"] < np.inf) & (seen["recorded"] > seen["range"])
        self.reflectance, self.cosine, self.place = seen["reflectance"], seen["cosine"], self.middle[seen["face"]]
        # Lasers differ in their sensitivity to dark paint.
        self.sensitivity = np.ones(len(BEAMS))
        key = self.key(self.place, self.cosine, seen["laser"])
        alike = cKDTree(key).query(key, 16)[1]
        found, expected = (np.bincount(seen["laser"], w, len(BEAMS)) for w in (self.back, self.back[alike].mean(1)))
        self.sensitivity = (found + 5) / (expected + 5)
        key = self.key(self.place, self.cosine, seen["laser"])
        self.tree = cKDTree(np.concatenate([key, key * [1, -1, 1, 1, 1] + [0, 0, 0, 2 * STEP, 0]]))

    def key(self, place, cosine, laser):
        """Rays are compared in metres: a cosine of 1 counts for half of one, a sensitivity of 1 for a fifth."""
        return np.concatenate([place, 0.5 * cosine[:, None], 0.2 * self.sensitivity[laser][:, None]], 1)

    def albedo(self, at):
        """Reflectance at normal incidence by Lambert's law around `at`."""
        good = (self.back & (np.abs(self.behind) < DEEP) & (self.cosine > 0.1)).astype(float)
        top, _ = spread(self.reflectance * self.cosine, good, self.place, at)
        bottom, known = spread(self.cosine**2, good, self.place, at)
        return np.clip(np.where(known > 1e-6, top / np.maximum(bottom, 1e-6), np.median(self.reflectance[good > 0])), 0.005, 1)

    def drawn(self, random, place, cosine, laser):
        """Each ray has the outcome of a similar ray of the fit: (came back, how far behind, passed, reflectance)."""
        alike = self.tree.query(self.key(place, cosine, laser), 8)[1]
        one = alike[np.arange(len(place)), random.integers(0, 8, len(place))] % len(self.back)
        return self.back[one], self.behind[one], self.passed[one], self.reflectance[one]


def texel_places(vertices, faces, c):
    """Centre of each texel, faces x c*c x 3, in TexelAtlas's order."""
    out = np.zeros((len(faces), c * c, 3))
    for iy in range(c):
        for ix in range(c - iy):
            halves = [(iy * c + ix, 1 / 3)] + ([((c - 1 - iy) * c + c - 1 - ix, 2 / 3)] if ix + iy <= c - 2 else [])
            for index, part in halves:
                b0, b1 = (ix + part) / c, (iy + part) / c
                out[:, index] = vertices[faces] .transpose(0, 2, 1) @ np.array([b0, b1, 1 - b0 - b1])
    return out


def project(frame, p_velo):
    """Pixels (u, v) and planar depths."""
    p = np.concatenate([p_velo, np.ones((len(p_velo), 1))], 1) @ frame.camera_from_velo.T
    fx, fy, cx, cy = frame.intrinsics
    z = np.maximum(p[:, 2], 0.1)
    return np.stack([fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy], 1), p[:, 2]


def painted(data, sights, vertices, faces, c=4, views=5):
    """The painted mesh: texels are medians of the photographs' colours. Also each sight's brightness beside the texels."""
    places = texel_places(vertices, faces, c).reshape(-1, 3)
    face = np.repeat(np.arange(len(faces)), c * c)
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    colours, weights = np.full((len(sights), len(places), 3), np.nan, np.float32), np.zeros((len(sights), len(places)), np.float32)
    mesh = mirage.Mesh(vertices, faces)
    for k, s in enumerate(sights):
        frame = read(data, s.id)
        turned = frame.camera_from_velo[:, :3]
        eye = to_box(-(turned.T @ frame.camera_from_velo[:, 3])[None], s.registered)[0]
        away = places - eye
        distance = np.linalg.norm(away, axis=1)
        cosine = -(away * normal[face]).sum(1) / distance
        (uv, depth), image = project(frame, from_box(places, s.registered)), frame.image
        high, wide = image.shape[:2]
        ok = (cosine > 0.1) & (uv > 1).all(1) & (uv[:, 0] < wide - 2) & (uv[:, 1] < high - 2) & (depth > 1)
        hits = mirage.cast_rays(mesh, eye[None], away[ok])
        ok[ok] = hits.t > 1 - 0.08 / distance[ok]
        at = np.round(uv[ok]).astype(int)
        ok[ok] = frame.depth[at[:, 1], at[:, 0]] > depth[ok] - 0.6
        for channel in range(3):
            colours[k, ok, channel] = ndimage.map_coordinates(image[..., channel], uv[ok][:, ::-1].T, order=1)
        weights[k, ok] = cosine[ok] / distance[ok]
    best = np.argsort(-weights, 0)[:views]
    picked = np.take_along_axis(colours, best[..., None], 0)
    known = weights.max(0) > 0
    texels = np.zeros((len(places), 3))
    texels[known] = np.nanmedian(picked[:, known], 0)
    twin = np.concatenate([places[known], places[known] * [1, -1, 1]])
    nearest = cKDTree(twin).query(places[~known])[1] % known.sum()
    texels[~known] = texels[known][nearest]
    bright = [np.nanmedian(colours[k].mean(1)[weights[k] > 0] / np.maximum(texels.mean(1)[weights[k] > 0], 1e-3))
              if (weights[k] > 0).sum() > 50 else np.nan for k in range(len(sights))]
    return mirage.Mesh(vertices, faces, np.clip(texels, 0, 1).reshape(len(faces), c, c, 3)), np.array(bright), known.mean()


class Fit:
    """A vehicle from the sights that a judged one may be compared with: the nearest in time, but for its neighbours."""

    def __init__(self, data, track, judged, apart, most=24):
        number = [int(s.id[-6:]) for s in track]
        at = number[judged]
        self.sights = [s for s, n in zip(track, number) if abs(n - at) > apart and s.whole and len(s.points) >= 10]
        self.sights = sorted(sorted(self.sights, key=lambda s: abs(int(s.id[-6:]) - at))[:most], key=lambda s: s.id)
        for s in self.sights:
            s.shift = np.zeros(3)
        self.field = surface(self.sights)
        self.vertices, self.faces = self.field.mesh()
        self.material = Material(data, self.sights, self.vertices, self.faces)
        self.reflector = mirage.Mesh(self.vertices, self.faces, grey(self.material.albedo(centres(self.vertices, self.faces))))
        self.paint, bright, self.known = painted(data, self.sights, self.vertices, self.faces)
        numbers = np.array([int(s.id[-6:]) for s in self.sights])
        near = np.argsort(np.abs(numbers - at))[:4]
        self.exposure = float(np.nanmedian(bright[near])) if np.isfinite(bright[near]).any() else 1.0
        # The label's offset, as the labels before and after are offset from their returns.
        shifts = np.array([s.shift for s in self.sights])
        self.shift = np.array([np.interp(at, numbers, shifts[:, k]) for k in range(3)])


def grey(values):
    return np.repeat(np.asarray(values)[:, None, None, None], 3, 3)


def returned(frame, sight, fit, pose, seed):
    """Returns on the fitted car, and the sweep beside them. A ray that its surface stops fares as the other frames' rays there."""
    _, new, left = beside(frame, sight, fit.reflector, pose, lidar_effects="noise,divergence,albedo", supersampling=1)
    if not len(new):
        return new, left
    ray = against_recording(frame, sight, fit.reflector, pose, new)
    place = fit.material.middle[ray["face"]]
    back, behind, passed, reflectance = fit.material.drawn(np.random.default_rng(seed), place, ray["cosine"], ray["laser"])
    origin, direction, _ = rays_of(new)
    points = new[:, :3] + np.where(np.abs(behind) > DEEP, behind, 0)[:, None] * direction
    others = frame.points[~sight.on(frame.points)]
    away, near = cKDTree(rays_of(others)[1]).query(direction[passed], distance_upper_bound=2e-4)
    return (np.concatenate([points[back], reflectance[back][:, None]], 1).astype(np.float32),
            np.concatenate([left, others[np.unique(near[away < 2e-4])]]))
