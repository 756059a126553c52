"""A small validation made up for tests of the page: fixture.make(FOLDER) writes FOLDER/{validation,run}, evaluation.json
and tradeoff.json. Nothing in it was measured."""

import json
import math
import os
import struct

from PIL import Image

PICTURES = ("attacked", "clean", "cycles", "cycles_crop", "difference", "matched_cycles", "matched_difference",
            "matched_raster", "raster_crop")
COLORS = {"clean": (70, 110, 160), "attacked": (180, 90, 60), "cycles": (120, 80, 170)}  # of the photographs


def share(value, spread=0.1):
    return {"value": value, "low": max(-1, value - spread), "high": min(1, value + spread)}


def write_json(path, content):
    with open(path, "w", encoding="utf-8") as file:
        json.dump(content, file)


def glb(path):
    """A tetrahedron."""
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
    blob = b"".join(struct.pack("<3f", *p) for p in points) + struct.pack("<12H", *faces)
    tree = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0],
                           "max": [1, 1, 1]}, {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"}],
            "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
            "buffers": [{"byteLength": len(blob)}]}
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(blob)))
        file.write(struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob)


def host(folder, name, index):
    files = {}
    for kind in PICTURES:
        size = (640, 200) if kind in COLORS else (40, 30)
        files[kind] = f"pictures/{name}_{kind}.png"
        Image.new("RGB", size, COLORS.get(kind, (90 + 10 * index, 120, 90))).save(os.path.join(folder, files[kind]))
    box = [20.0 + index, 1.0, 4.2, 1.8, 0.1]
    found = [{"box": box, "score": 0.9}]
    judged = {"iou": 0.75, "score": 0.8, "hidden": False, "false_positive": False}
    vanished, misplaced = [{**judged, "iou": iou, "hidden": True} for iou in (0.05, 0.62)]
    raster, cycles = (vanished, misplaced) if index == 0 else (judged, judged)
    arms = [{"light": light, "returns": returns, **outcome} for light, outcome in (("raster", raster), ("cycles", cycles))
            for returns in ("ideal", "realistic")]
    seen = [{"box": [310, 70, 385, 152], "score": 0.8}]
    in_picture = {"picture_boxes": {"host": [300, 90, 380, 150], "object": [320, 60, 360, 90], "clean": seen, "raster": [],
                                    "truth": [[300, 90, 380, 150], [10, 80, 60, 120]], "cycles": seen}} if index == 1 else {}
    return {**in_picture, "name": name, "frame": name[:6], "label": 0, "range": 20.0 - index, "visible_share": 0.9, "detected": True,
            "adversary_points": 2, "host_rect": [300, 90, 380, 150], "crop_rect": [320, 60, 360, 90],
            "clean": {"iou": 0.8, "score": 0.95}, "raster": raster, "cycles": {**cycles, "score": 0.7}, "arms": arms,
            "full": {"mae": 0.02, "mean": 0.2, "relative": 0.1, "ssim": 0.9, "flip": 0.1, "seconds": 1.5},
            "matched": {"mask_iou": 1.0, "mae": 1e-5, "range_error_m": 1e-5, "max_error": 1e-3}, "pictures": files,
            "bev": {"reach": 16.0, "host": box, "truth": [box, [30.0, -4.0, 4.0, 1.7, 0.0]],
                    "points": [[20 + 10 * math.cos(k), 8 * math.sin(k)] for k in range(60)],
                    "adversary_points": [[20.0 + index, 1.0], [20.2 + index, 1.2]], "clean": found, "raster": [],
                    "cycles": found}}


def ladder():
    fidelity = {"mae": 0.01, "relative": 0.05, "psnr": 31.0, "ssim": 0.95, "flip": 0.06}
    rungs = [("hard edges", "raster", 0.01), ("visible light, exact areas", "raster", 0.02), ("+occlusion", "cycles", 0.4),
             ("bounces 4", "cycles", 1.2)]
    return [{"effect": effect, "group": group, "base": "matched", **fidelity, "crop": fidelity,
             "to_full": {**fidelity, "relative": 0.3 / (1 + k)}, "seconds": seconds, "vehicles": 128, "detected": 128,
             "hidden": 111, "false_positive": 0, "fn_asr": 0.5, "asr": 0.5, "mean_score": 0.6, "score_change": 0.03,
             "error_plain": math.hypot(0.3 / (1 + k), 0.05 * k), "floor": 0.05 * k, "error_drawn": 0.32 / (1 + k),
             "error_unbiased": 0.3 / (1 + k) if k < 3 else -0.02, "interval_over": "clusters",
             "interval": share(0.3 / (1 + k) if k < 3 else -0.02, 0.05)}
            for k, (effect, group, seconds) in enumerate(rungs)]


def verdict(names, vacuous=False):
    variants = [{"name": name, "vehicles": 20, "fn_asr": share(0.3), "fp_asr": share(0.1), "asr": share(0.35),
                 "mean_score": 0.61} for name in ("soft", "hard", "bounces 4", "cycles")]
    group = {"frames": 10, "vehicles": 20, "clusters": {"by": "frame", "count": 10}, "variants": variants, "told": "cannot be told", "score_correlation": 0.93, "agree": 0.95,
             "difference": {key: share(0.02) for key in ("fn_asr", "fp_asr", "asr")}, "score_mean_difference": 0.01}
    pairs = [{"name": name, "frame": name[:6], "split": "test", "detected": True, "clean": 0.95, "soft": 0.4 + 0.3 * k,
              "hard": 0.5, "cycles": 0.5 + 0.2 * k} for k, name in enumerate(names)]
    def against(asr):
        return {} if asr is None else {"difference": share(asr - 0.35, 0.05), "told": "less" if asr < 0.3 else "cannot be told"}

    arms = [{"light": light, "returns": returns, "vehicles": 20, "fn_asr": share(0.3), "fp_asr": share(0.1), "asr": share(asr),
             "mean_score": 0.6, **against(None if light == "learned" else asr), "flips": 0 if asr == 0.35 else 2, "mean_delta_logit": 0.8, "mean_delta_score": 0.1}
            for light, returns, asr in (("learned", "learned", 0.35), ("raster", "ideal", 0.35), ("raster", "realistic", 0.25), ("visible", "ideal", 0.33),
                                        ("visible", "realistic", 0.24), ("cycles", "ideal", 0.31), ("cycles", "realistic", 0.22))]
    controls = [{"channel": channel, "control": control, "vehicles": 20, "asr": share(0.1), "difference": share(-0.25, 0.05),
                 "flips": 0 if vacuous else 5, "mean_delta_logit": 0.02 if vacuous else 1.4, "mean_delta_score": 0.1}
                for channel, control in (("image", "noise"), ("image", "photograph"), ("lidar", "no returns"))]
    flip = {"name": names[0], "frame": names[0][:6], "split": "test", "range": 20.0, "from": "hidden", "to": "found",
            "soft_iou": 0.2, "soft_score": 0.25, "cycles_iou": 0.75, "cycles_score": 0.7,
            "pictures": {kind: f"pictures/{names[0]}_{kind}.png" for kind in PICTURES}}
    return {"confidence": 0.95, "held_back": group, "all": group, "pairs": pairs, "flips": [flip], "of": "held_back", "arms": arms, "nearest": 6,
            "controls": controls, "vacuous": {"image": vacuous, "lidar": False, "bound": 0.5}}


def tradeoff():
    points = []
    for group, errors in (("camera", ("image_levels", "gradient")), ("lidar", ("range_error_m",))):
        for k in range(5):
            points.append({"group": group, "axis": "sigma", "label": f"setting {k}", "settings": {}, "ms": 2.0**k,
                           "baseline_ms": 4, "ratio": 2.0**k / 4, "errors": {name: 1.0 / (1 + k) for name in errors},
                           "front": list(errors) if k % 2 else []})
    quality = {"rule": "made up", "settings": {"sigma": 1e-6, "gamma": 0.01, "supersampling": 2}, "ratio": 1.0, "ms": 4.0,
               "errors": {"image_levels": 2.5, "gradient_cosine": 0.9}, "on_front": []}
    return {"points": points, "recommended": [{"name": name, **quality} for name in ("draft", "default", "exact")]}


def reliance(uses_picture=True):
    drop = 0.2 if uses_picture else 0.0
    note = "" if uses_picture else "this detector does not use its picture, so this says nothing about images"
    return {"reads_picture": True, "uses_picture": uses_picture, "note": note, "ap70": 0.768, "ap70_swapped": 0.768 - drop,
            "ap70_black": 0.7, "drop": drop, "drop_low": drop - 0.03, "drop_high": drop + 0.03, "mean_delta_logit": 8 * drop,
            "mean_delta_score": drop, "frames": 40, "frames_left_out": 0, "vehicles": 120,
            "clusters": {"by": "vehicle", "count": 40}}


def budget():
    tested = {"frames": 6, "vehicles": 12, "within": share(0.9), "kept": True, "seconds": 3.0, "saved": 0.75,
              "oracle": {"within": share(1.0), "seconds": 2.0, "saved": 0.83}, "chosen": {"hemisphere": 7, "bounces 4": 5},
              "fixed": {"within": share(0.92), "seconds": 12.0, "chosen": {"bounces 4": 12}}}
    return {"budget": 0.05, "of": "radiance", "confidence": 0.9, "groups": {"by": "vehicle", "count": 5, "folds": 5},
            "test": tested, "scenes": [],
            "rule": "made up for this test"}


def make(folder, uses_picture=True, vacuous=False, **more):
    """`more`: replaces entries of result.json."""
    validation, run = os.path.join(folder, "validation"), os.path.join(folder, "run")
    for path in (run, os.path.join(validation, "hosts"), os.path.join(validation, "pictures")):
        os.makedirs(path)
    names = ["000001_0", "000002_1"]
    for index, name in enumerate(names):
        write_json(os.path.join(validation, "hosts", name + ".json"), host(validation, name, index))
    write_json(os.path.join(validation, "result.json"), {
        "headline": "Attack success 22.0 % in Cycles with realistic returns.", "run": "out/attack", "placement": "roof",
        "clusters": {"by": "frame", "count": 10},
        "provenance": {"detector": "fusion", "weights": "fusion-kitti64.pt", "weights_hash": "8d1f", "defense": "none", "data": "kitti9",
                       "seed": 3, "version": "0.1.0", "commit": "ea8efec", "date": "2026-11-27", "command": "mirage validate --run out/attack"},
        "targets": [{"place": place, "target": 0, "met": True} for place in ("matched.mask_iou", "matched.mae",
                    "matched.hit_disagreements", "matched.range_error_m")],
        "hosts": names, "vehicles": 2, "frames": 2, "test_frames": 1, "reference": {"name": "Blender Cycles", "version": "3.4.1", "losses": []}, "samples": 64,
        "samples_used": {"least": 9, "most": 13}, "failed": [], "unseen": [],
        "attack": {"detected_clean": 2, "hidden_raster": 1, "hidden_cycles": 1, "hidden_both": 1, "asr_raster": 0.5,
                   "asr_cycles": 0.5},
        "full": {"relative": 0.1, "ssim": 0.9, "flip": 0.1, "error_plain": 0.13, "floor": 0.05, "error_unbiased": 0.12,
                 "interval": share(0.12, 0.03)},
        "matched": {"mask_iou": 1.0, "mask_iou_worst": 1.0, "mae": 1e-5, "pixels": 2000, "pixels_off": 0, "rays": 500,
                    "hit_disagreements": 0, "range_error_m": 1e-5, "depth_error_m": 1e-5},
        "reliance": reliance(uses_picture), "ladder": ladder(), "verdict": verdict(names, vacuous), "budget": budget(),
        "lidar_ladder": [{"effect": "noise", "returns": 100, "changed": 0.9, "returns_change": 0, "detected": 2, "hidden": 1,
                          "mean_score": 0.6, "score_change": 0.01, "seconds": 0.02, "vehicles": 2}], **more})
    with open(os.path.join(run, "loss.csv"), "w", encoding="utf-8") as file:
        file.write("iteration,loss\n" + "".join(f"{k},{2 + math.exp(-k / 10)}\n" for k in range(50)))
    glb(os.path.join(run, "adversary.glb"))
    iou = [k / 10 for k in range(11)]
    write_json(os.path.join(folder, "evaluation.json"), {
        "asr": 0.4, "fn_asr": 0.3, "fp_asr": 0.2, "vehicles": 20, "hosts": 22, "detected_iou": 0.7, "outcomes": [],
        "arms": [{"name": name, "asr": share(value)} for name, value in (("learned", 0.4), ("sized", 0.1), ("cuboid", 0.05))],
        "hidden": {"vanished": {**share(0.15), "vehicles": 21}}, "net": {"vanished": share(0.1), "asr": share(0.2)},
        "recall_iou": {"iou": iou, "clean": [1 - 0.3 * k * k for k in iou], "attacked": [0.8 - 0.5 * k for k in iou]}})
    write_json(os.path.join(folder, "tradeoff.json"), tradeoff())
    return validation, run
