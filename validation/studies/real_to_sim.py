#!/usr/bin/env python3
"""How far is a simulated car from the recorded one, in the detector's terms? A car of a recorded drive is fitted from the other frames
of its track, put where its label and those frames say in one that the fit has not seen, and detected there beside the recording:

    python3 validation/studies/real_to_sim.py --data DRIVES --out OUT [--detectors lidar,fusion,late] [--weights real,free] [--frames 3]

DRIVES is KITTI's tracking layout. Of each Car and Van as many frames are judged; the fit takes those of its track that are more than
--apart frames away. The mesh: an implicit surface through the registered, mirrored returns (Kolluri, SODA 2005) over a saloon's outline.
Reflectance and the share that returns at all come from the returns of the same frames, texels from their photographs.
Both are drawn by mirage.insert. Beside this arm, `fitted`, stand the same mesh with a unit's effects by word in place of measured losses
(`unit`, `as-recorded`), a cuboid of the label's size, no returns of the car at all (`removed`), and the next recorded frame.
Writes OUT/real-to-sim.json and a picture of each judged vehicle (recorded, fitted, cuboid); a stopped run goes on. Other frames or
another program want another OUT. Needs PYTHONPATH=build/release/python.
"""

import argparse
import json
import math
import os
import pathlib
import re

import fitted_vehicle
import kept
import mirage
import numpy as np
from fitted_vehicle import Fit, Sight, against_recording, beside, insert, rays_of, read, returned, to_box, turn, without
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation


def srgb(linear):
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)
    return np.round(255 * np.clip(curve, 0, 1)).astype(np.uint8)


class Writer:
    """Frames in KITTI's object layout: those with a fitted car beside the recorded ones, under the same numbers."""

    def __init__(self, data, folder):
        self.data, self.folder = data / "training", folder

    def put(self, arm, name, frame_id, points, picture=None):
        """`picture`: scene-linear RGB and where it is not the recorded one."""
        sequence, number = frame_id.split("_")
        file = {kind: self.folder / arm / "training" / kind / f"{name}.{end}"
                for kind, end in (("image_2", "png"), ("velodyne", "bin"), ("calib", "txt"), ("label_2", "txt"), ("lighting", "json"))}
        for one in file.values():
            one.parent.mkdir(parents=True, exist_ok=True)
        recorded = self.data / "image_02" / sequence / f"{number}.png"
        file["image_2"].unlink(missing_ok=True)
        if picture is None:
            file["image_2"].symlink_to(recorded.resolve())
        else:
            drawn, where = picture
            Image.fromarray(np.where(where[..., None], srgb(drawn), np.array(Image.open(recorded)))).save(file["image_2"])
        points.astype("<f4").tofile(file["velodyne"])
        calibration = (self.data / "calib" / f"{sequence}.txt").read_text()
        for old, new in (("R_rect", "R0_rect:"), ("Tr_velo_cam", "Tr_velo_to_cam:"), ("Tr_imu_velo", "Tr_imu_to_velo:")):
            calibration = calibration.replace(old + " ", new + " ")
        file["calib"].write_text(calibration)
        rows = [row.split() for row in (self.data / "label_02" / f"{sequence}.txt").read_text().splitlines()]
        truncated = {"1": "0.3", "2": "0.8"}  # the tracking benchmark has steps, the object benchmark shares
        file["label_2"].write_text("".join(" ".join([row[2], truncated.get(row[3], row[3]), *row[4:]]) + "\n"
                                           for row in rows if int(row[0]) == int(number)))
        # A texel is drawn as it was photographed.
        file["lighting"].write_text(json.dumps({"to_sun_velo": [0, 0, 1], "sun": [0] * 3, "ambient": [1] * 3, "hemisphere": [0] * 3}))


def photographed(writer, name, frame, sight, mesh, pose):
    """The picture with the mesh in place of the car, and its silhouette."""
    writer.put("stage", name, sight.id, without(frame, sight))
    stage = mirage.read_frame(writer.folder / "stage", name)
    host = min(range(len(stage.labels)), key=lambda k: math.hypot(*np.subtract(stage.labels[k].box_bev[:2], sight.pose[:2]))
               if stage.labels[k].type in ("Car", "Van") else math.inf)
    result = insert(stage, host, mesh, pose)
    return result.image, result.mask


def cuboid(size, albedo, colour):
    corner = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)]) * size
    faces = np.array([(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
                      (1, 5, 7), (1, 7, 3)])
    return mirage.Mesh(corner, faces, np.tile(np.broadcast_to(albedo, 3), (12, 1, 1, 1))), mirage.Mesh(
        corner, faces, np.tile(colour, (12, 1, 1, 1)))


def overlap(a, b):
    """IoU of two boxes from above: x, y, length, width, yaw."""
    def corners(box):
        x, y, length, width, yaw = box
        c = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * [length / 2, width / 2]
        return c @ turn(yaw)[:2, :2].T + [x, y]

    def area(p):
        return abs(sum(p[i - 1][0] * p[i][1] - p[i][0] * p[i - 1][1] for i in range(len(p)))) / 2 if len(p) > 2 else 0

    shape, other = list(corners(a)), corners(b)
    for p, q in zip(other, np.roll(other, -1, 0)):
        side = [(q[0] - p[0]) * (v[1] - p[1]) - (q[1] - p[1]) * (v[0] - p[0]) for v in shape]
        cut = []
        for i in range(len(shape)):
            if (side[i - 1] < 0) != (side[i] < 0):
                cut.append(shape[i - 1] + (shape[i] - shape[i - 1]) * side[i - 1] / (side[i - 1] - side[i]))
            if side[i] >= 0:
                cut.append(shape[i])
        shape = cut
    both = area(shape)
    return both / (a[2] * a[3] + b[2] * b[3] - both)


def over_vehicles(values, vehicles, statistic, seed=0, times=2000):
    """The statistic over vehicles, each with the mean of its frames, and its 95 % bootstrap interval."""
    known = [(v, x) for v, x in zip(vehicles, values) if x is not None and np.isfinite(x)]
    each = np.array([np.mean([x for w, x in known if w == v]) for v in dict.fromkeys(v for v, _ in known)])
    if not len(each):
        return None
    random = np.random.default_rng(seed)
    low, high = np.percentile([statistic(each[random.integers(0, len(each), len(each))]) for _ in range(times)], [2.5, 97.5])
    return {"value": float(statistic(each)), "low": float(low), "high": float(high), "vehicles": len(each)}


def total(rows, key, arm, seed=0, times=2000):
    """All of an arm's returns over all recorded ones, with its 95 % bootstrap interval over vehicles."""
    names = list(dict.fromkeys(row["vehicle"] for row in rows))
    sums = np.array([[sum(row[key][which] for row in rows if row["vehicle"] == name) for which in (arm, "recorded")] for name in names])
    random = np.random.default_rng(seed)
    again = [np.divide(*sums[random.integers(0, len(names), len(names))].sum(0)) for _ in range(times)]
    low, high = np.percentile(again, [2.5, 97.5])
    return {"value": float(np.divide(*sums.sum(0))), "low": float(low), "high": float(high), "vehicles": len(names)}


def roughness(points):
    """Second differences of range along each laser's neighbouring returns, m, as the noise of one of them."""
    origin, direction, laser = rays_of(points)
    r, azimuth = np.linalg.norm(points[:, :3] - origin, axis=1), np.degrees(np.arctan2(direction[:, 1], direction[:, 0]))
    order = np.lexsort((azimuth, laser))
    r, azimuth, laser = r[order], azimuth[order], laser[order]
    beside_ = (laser[2:] == laser[:-2]) & (azimuth[2:] - azimuth[:-2] < 0.5) & (np.abs(r[2:] - r[:-2]) < 0.1)
    return np.abs(r[:-2] - 2 * r[1:-1] + r[2:])[beside_] / math.sqrt(6)


ARMS = ("recorded", "next", "fitted", "unit", "as-recorded", "cuboid", "removed")
DARK_POWER = 0.3  # of src/sensors/lidar_effects.cpp
EFFECTS = {"unit": "noise,drop-out,divergence,albedo", "as-recorded": "noise,dark-loss,divergence,albedo"}


def compare(options, writer, name, track, judged):
    """One vehicle in one frame: writes the arms' frames and a picture, and returns what was measured."""
    sight = track[judged]
    fit = Fit(options.data, track, judged, options.apart)
    frame = read(options.data, sight.id)
    sight.shift = fit.shift
    pose = sight.registered
    clear = frame.points[~sight.on(frame.points)]
    new, left = returned(frame, sight, fit, pose, judged)
    fit.paint.texels = np.clip(fit.paint.texels * fit.exposure, 0, 1)
    drawn, mask = photographed(writer, name, frame, sight, fit.paint, pose)
    boxes = cuboid(sight.size, np.median(fit.reflector.texels), np.median(fit.paint.texels.reshape(-1, 3), 0))
    boxed, box_mask = photographed(writer, name, frame, sight, boxes[1], sight.pose)
    arms = {"recorded": (frame.points, None), "removed": (clear, None), "fitted": (np.concatenate([left, new]), (drawn, mask > 0))}
    counts, bodies = {}, {}

    def count(arm, returns):
        of = to_box(returns[sight.on(returns), :3], sight.pose)
        counts[arm], bodies[arm] = len(of), int((of[:, 2] < 0.6 * sight.size[2]).sum())

    count("recorded", frame.points)
    count("fitted", new)
    count("redrawn", returned(frame, sight, fit, pose, judged + 1000)[0])
    for arm, words in EFFECTS.items():
        _, of_words, beside_ = beside(frame, sight, fit.reflector, pose, lidar_effects=words, supersampling=1)
        count(arm, of_words)
        arms[arm] = (np.concatenate([beside_, of_words]), (drawn, mask > 0))
    _, of_box, beside_ = beside(frame, sight, boxes[0], sight.pose, lidar_effects=EFFECTS["unit"], supersampling=1)
    count("cuboid", of_box)
    arms["cuboid"] = (np.concatenate([beside_, of_box]), (boxed, box_mask > 0))
    following = next((s for s in track if int(s.id[-6:]) == int(sight.id[-6:]) + 1), None)
    if following:
        writer.put("next", name, following.id, read(options.data, following.id).points)
    for arm, (points, picture) in arms.items():
        writer.put(arm, name, sight.id, points, picture)
    ranges = {}
    for arm, returns in (("fitted", new), ("cuboid", of_box)):
        ray, recorded = rays_of(returns), rays_of(frame.points)
        away, near = cKDTree(recorded[1]).query(ray[1], distance_upper_bound=2e-4)
        there = away < 2e-4
        there[there] = sight.on(frame.points[near[there]])
        error = np.linalg.norm(returns[there, :3] - ray[0][there], axis=1) - np.linalg.norm(
            frame.points[near[there], :3] - recorded[0][near[there]], axis=1)
        ranges[arm] = float(np.median(np.abs(error))) if there.any() else None
    _, whole, _ = beside(frame, sight, fit.reflector, pose, lidar_effects="ideal", supersampling=1)
    ray = against_recording(frame, sight, fit.reflector, pose, whole)
    height = fit.material.middle[ray["face"], 2] / sight.size[2]
    body = (ray["face"] >= 0) & (height > 0.2) & (height < 0.6) & (ray["cosine"] > 0.05) & (ray["range"] < 35)
    albedo = fit.reflector.texels[ray["face"], 0, 0, 0]
    coded = [srgb(picture).astype(float) for picture in (frame.image, drawn, boxed)]
    inside = mask > 0.9
    left_, top, right, bottom = (int(v) for v in sight.picture)
    view = np.s_[max(0, top - 25):bottom + 25, max(0, left_ - 40):right + 40]
    Image.fromarray(np.concatenate([i[view] for i in coded]).astype(np.uint8)).save(options.out / "pictures" / f"{name}.png")
    of_car = frame.points[sight.on(frame.points)]
    low = to_box(of_car[:, :3], sight.pose)[:, 2] < 0.6 * sight.size[2]
    box = lambda s: [*s.pose[:2], *s.size[:2], s.pose[3]]  # noqa: E731
    return {"vehicle": options.vehicle, "frame": sight.id, "range": float(np.hypot(*sight.pose[:2])), "box": box(sight),
            "next": following and box(following), "fitted_from": len(fit.sights), "returns": counts, "below_windows": bodies,
            "range_error": ranges, "reflectance": {"recorded": float(sight.reflectance.mean()), "fitted": float(new[:, 3].mean())},
            "pixels": int(inside.sum()), "pixel_error": {arm: float(np.abs(coded[0][m] - coded[k][m]).mean()) if m.any() else None
                                                         for arm, k, m in (("fitted", 1, inside), ("cuboid", 2, box_mask > 0.9))},
            "brightness": float(np.median(frame.image[inside].mean(1)) / max(1e-4, np.median(drawn[inside].mean(1)))),
            "roughness": {"recorded": roughness(of_car[low]).tolist(), "fitted": roughness(new[sight.on(new)]).tolist()},
            "rays": {"albedo": albedo[body].tolist(), "cosine": ray["cosine"][body].tolist(), "range": ray["range"][body].tolist(),
                     "back": ray["of_car"][body].tolist()}}


def detected(options, arm, detector):
    """The folder of the detector's answers on an arm."""
    return options.out / "detections" / f"{arm} {detector}"


def detections(options, arm, detector):
    """{name: [(score, box)]} of an arm's frames; `detector` with its weights: "lidar real"."""
    out = detected(options, arm, detector)
    name, weights = detector.split()
    if not (out / "result.json").exists():
        mirage.detect(name, data=options.out / "arms" / arm, out=out, weights=None if weights == "free" else weights)
    found = json.loads((out / "detections.json").read_text())["frames"]
    return {f["frame"]: [(d["score"], [d[k] for k in ("x", "y", "length", "width", "yaw")]) for d in f["detections"]] for f in found}


def judged(boxes, truth):
    """Logit of the likeliest box on the car (IoU >= 0.1; that of the lowest score that is told where there is none), and whether it is
    found: at a score of 0.3 with IoU over 0.7, and with IoU over 0.1."""
    on = [(score, overlap(box, truth)) for score, box in boxes]
    best = min(max([score for score, iou in on if iou >= 0.1], default=0.02), 1 - 1e-9)
    return {"logit": math.log(best / (1 - best)), "found": any(s >= 0.3 and i > 0.7 for s, i in on),
            "seen": any(s >= 0.3 and i > 0.1 for s, i in on)}


def chosen(track, count, apart):
    """Frames to judge, evenly over those in which the car is whole and has 20 returns."""
    usable = [k for k, s in enumerate(track) if s.whole and len(s.points) >= 20 and s.occluded < 3 and
              sum(abs(int(o.id[-6:]) - int(s.id[-6:])) > apart and o.whole and len(o.points) >= 10 for o in track) >= 5]
    return sorted({usable[int((i + 0.5) * len(usable) / count)] for i in range(count)}) if usable else []


def stands(data, track):
    """Whether its place in the world stays the same, by the ego vehicle's poses."""
    sequence = data / "training"
    name = track[0].id[:4]
    rows = np.loadtxt(sequence / "oxts" / f"{name}.txt")[:, :6]
    scale, earth = math.cos(math.radians(rows[0, 0])), 6378137.0
    calibration = [row.split() for row in (sequence / "calib" / f"{name}.txt").read_text().splitlines() if row]
    calibration = {row[0].rstrip(":"): row[1:] for row in calibration}
    imu = np.array(next(calibration[k] for k in ("Tr_imu_velo", "Tr_imu_to_velo")), float).reshape(3, 4)
    places = []
    for s in track:
        latitude, longitude, up, roll, pitch, yaw = rows[int(s.id[-6:])]
        p = imu[:, :3].T @ (s.pose[:3] - imu[:, 3])
        p = turn(yaw) @ Rotation.from_euler("xy", [roll, pitch]).as_matrix() @ p
        north = math.log(math.tan(math.pi / 4 + math.radians(latitude) / 2))
        places.append(p[:2] + scale * earth * np.array([math.radians(longitude), north]))
    return bool(np.linalg.norm(np.array(places) - np.median(places, 0), axis=1).max() < 0.5)


def dark_law(rays, power=DARK_POWER):
    """The floor of 1 - exp(-(albedo / floor)^power), the law of dark-loss, that returns and losses are likeliest by; and how likely
    they are, nats a ray, by it, by `unit` and by the best constant."""
    albedo, cosine, range_, back = (np.concatenate([r[key] for r in rays]) for key in ("albedo", "cosine", "range", "back"))

    def nats(share):
        share = np.clip(share, 1e-3, 1 - 1e-3)
        return float(np.where(back, np.log(share), np.log(1 - share)).mean())
    floors = np.geomspace(0.001, 1, 200)
    likely = [nats(1 - np.exp(-((albedo / floor) ** power))) for floor in floors]
    unit = 0.985 * (1 - np.exp(-albedo * cosine**0.7 / range_**2 / 3e-5))
    return floors[int(np.argmax(likely))], {"dark": max(likely), "unit": nats(unit), "constant": nats(np.full(len(back), back.mean()))}


def figures(rows):
    """Summary of the rows, over vehicles."""
    vehicles = [row["vehicle"] for row in rows]
    def of(value, statistic=np.median):
        return over_vehicles([value(row) for row in rows], vehicles, statistic)
    out = {"vehicles": len(set(vehicles)), "parked": len({r["vehicle"] for r in rows if r["parked"]}), "frames": len(rows)}
    near = [r for r in rows if r["range"] < 35]
    out["returns"] = {arm: {"ratio": of(lambda r: r["returns"][arm] / r["returns"]["recorded"]),
                            "off": of(lambda r: abs(r["returns"][arm] / r["returns"]["recorded"] - 1)),
                            "within_10": of(lambda r: r["returns"][arm] / r["returns"]["recorded"],
                                            lambda x: np.mean(np.abs(x - 1) <= 0.1)),
                            "sum_within_35_m": total(near, "returns", arm)}
                      for arm in ("fitted", *EFFECTS, "cuboid")}
    out["redrawn"] = of(lambda r: abs(r["returns"]["redrawn"] / r["returns"]["fitted"] - 1))  # the effect of chance alone
    out["below_windows_within_35_m"] = {
        arm: {"off": over_vehicles([abs(r["below_windows"][arm] / r["below_windows"]["recorded"] - 1) for r in near],
                                   [r["vehicle"] for r in near], np.median),
              "sum": total(near, "below_windows", arm)}
        for arm in ("fitted", *EFFECTS)}
    out["range_error_m"] = {arm: of(lambda r: r["range_error"][arm]) for arm in ("fitted", "cuboid")}
    out["pixel_error"] = {arm: of(lambda r: r["pixel_error"][arm]) for arm in ("fitted", "cuboid")}
    out["reflectance"] = of(lambda r: abs(r["reflectance"]["fitted"] - r["reflectance"]["recorded"]))
    out["exposure"] = of(lambda r: abs(math.log(r["brightness"])))
    out["sigma_m"] = {what: of(lambda r: 1.4826 * np.median(r["roughness"][what]) if len(r["roughness"][what]) > 30 else None)
                      for what in ("recorded", "fitted")}
    rays = {v: [row["rays"] for row in rows if row["vehicle"] == v] for v in dict.fromkeys(vehicles)}
    floor, likely = dark_law([r for one in rays.values() for r in one])
    random, names = np.random.default_rng(0), list(rays)
    again = [dark_law([r for k in random.integers(0, len(names), len(names)) for r in rays[names[k]]])[0] for _ in range(200)]
    out["dark_floor"] = {"value": floor, "low": np.percentile(again, 2.5), "high": np.percentile(again, 97.5), "nats": likely}
    ray = {key: np.concatenate([r[key] for one in rays.values() for r in one]) for key in ("albedo", "cosine", "range", "back")}
    out["lost"] = [{"albedo": [a, b], by: [c, d], "rays": int(m.sum()), "share": float(1 - ray["back"][m].mean())}
                   for by, bins in (("cosine", ((0.05, 0.4), (0.4, 0.8), (0.8, 1.01))), ("range", ((5, 10), (10, 15), (15, 20), (20, 35))))
                   for a, b in ((0, 0.05), (0.05, 0.15), (0.15, 0.3), (0.3, 0.5), (0.5, 1.01)) for c, d in bins
                   if (m := (ray["albedo"] >= a) & (ray["albedo"] < b) & (ray[by] >= c) & (ray[by] < d)).sum() >= 50]
    out["detectors"] = {}
    for detector in rows[0]["answers"]:
        said = lambda r, arm: r["answers"][detector].get(arm)  # noqa: E731, B023
        one = out["detectors"][detector] = {"found": of(lambda r: said(r, "recorded")["found"], np.mean), "delta_logit": {}, "flips": {}}
        for arm in ARMS[1:]:
            delta = lambda r: (said(r, arm)["logit"] - said(r, "recorded")["logit"]  # noqa: E731
                               if said(r, arm) and said(r, "recorded")["seen"] else None)
            one["delta_logit"][arm] = {"size": of(lambda r: None if (d := delta(r)) is None else abs(d)), "shift": of(delta)}
            one["flips"][arm] = {rule: flips([said(r, arm) and said(r, arm)[rule] != said(r, "recorded")[rule] for r in rows], vehicles)
                                 for rule in ("found", "seen")}
    # How often a verdict turns though nothing was attacked, over all detectors.
    out["error_bar"] = {arm: {rule: flips([np.mean([r["answers"][d][arm][rule] != r["answers"][d]["recorded"][rule]
                                                    for d in out["detectors"]]) if arm in next(iter(r["answers"].values())) else None
                                           for r in rows], vehicles) for rule in ("found", "seen")} for arm in ("fitted", "next")}
    return out


def flips(flipped, vehicles):
    """The share of frames, the mean over vehicles, with Wilson's interval of as many trials as there are vehicles."""
    each = [np.mean([x for x, w in zip(flipped, vehicles) if w == v and x is not None]) for v in dict.fromkeys(vehicles)]
    each = [x for x in each if np.isfinite(x)]
    share, n, z = float(np.mean(each)), len(each), 1.96
    middle, half = share + z * z / (2 * n), z * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return {"value": share, "low": max(0.0, (middle - half) / (1 + z * z / n)), "high": (middle + half) / (1 + z * z / n), "vehicles": n}


def rounded(value):
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [rounded(one) for one in value]
    return round(float(value), 3) if isinstance(value, (float, np.floating)) else value


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("data", "out"):
        parser.add_argument("--" + name, required=True, type=pathlib.Path)
    parser.add_argument("--detectors", default="lidar,fusion,late")
    parser.add_argument("--weights", default="real,free")
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--apart", type=int, default=2)
    options = parser.parse_args()
    kept.require_same(options.out, data=str(options.data.resolve()), files=kept.listing(options.data), frames=options.frames,
                      apart=options.apart, program=kept.program(mirage._core.__file__),
                      study=kept.content(__file__, fitted_vehicle.__file__))
    for folder in ("rows", "pictures"):
        (options.out / folder).mkdir(parents=True, exist_ok=True)
    tracks = {}
    for frame_id in mirage.list_frames(options.data):
        frame = mirage.read_frame(options.data, frame_id)
        for label in frame.labels:
            if label.type in ("Car", "Van"):
                tracks.setdefault(f"{frame_id[:4]}_{label.track % 100000}", []).append(Sight(frame_id, frame, label))
    writer, rows = Writer(options.data, options.out / "arms"), []
    for vehicle, track in sorted(tracks.items()):
        for k in chosen(track, options.frames, options.apart):
            name = f"{len(rows):06d}"
            file = options.out / "rows" / f"{name}.json"
            if not file.exists():
                options.vehicle = vehicle
                row = compare(options, writer, name, track, k)
                temporary = file.with_suffix(".tmp")
                temporary.write_text(json.dumps(row))
                os.replace(temporary, file)
            rows.append(json.loads(file.read_text()))
            print(vehicle, rows[-1]["frame"], rows[-1]["returns"], rows[-1]["range_error"], rows[-1]["pixel_error"], flush=True)
        read.cache_clear()
    answers = {f"{detector} {weights}": {arm: detections(options, arm, f"{detector} {weights}") for arm in ARMS}
               for detector in options.detectors.split(",") for weights in options.weights.split(",")}
    for k, row in enumerate(rows):
        row["parked"] = stands(options.data, tracks[row["vehicle"]])
        row["answers"] = {detector: {arm: judged(of[f"{k:06d}"], row["next" if arm == "next" else "box"]) for arm, of in by_arm.items()
                                     if row["next"] or arm != "next"} for detector, by_arm in answers.items()}
    last = json.loads((detected(options, ARMS[-1], next(reversed(answers))) / "result.json").read_text())
    result = {"command": "python3 validation/studies/real_to_sim.py --data DRIVES", "mirage": mirage.__version__,
              **kept.origin(last), "figures": figures(rows), "rows": [
                  {**{key: row[key] for key in ("vehicle", "frame", "parked", "range", "returns")}, "logits": {
                      name: [of["recorded"]["logit"], of["fitted"]["logit"]] for name, of in row["answers"].items()}} for row in rows]}
    temporary = options.out / "real-to-sim.tmp"
    text = re.sub(r"\n {3,}|(?<=[\]}])\n +(?=[\]}])", " ", json.dumps(rounded(result), indent=1))  # a row a line
    temporary.write_text(text + "\n")
    os.replace(temporary, options.out / "real-to-sim.json")
    print(json.dumps(rounded(result["figures"]), indent=1))


if __name__ == "__main__":
    main()
