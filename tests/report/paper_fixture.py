"""A small reproduce.json made up for tests of the page of `mirage reproduce`: paper_fixture.make(FOLDER). Nothing in it
was measured."""

import json
import os

from PIL import Image

ATTACKS = [("LiDAR-only detector, LiDAR", "lidar-lidar"), ("fusion, random mesh", "fusion-both"),
           ("fusion, LiDAR", "fusion-lidar"), ("fusion, image", "fusion-image"), ("fusion, both", "fusion-both")]
SUCCESS = [{"key": "fn_asr", "title": "FN ASR"}, {"key": "fp_asr", "title": "FP ASR"}, {"key": "asr", "title": "ASR"}]


def share(value):
    return {"value": value, "low": max(0, value - 0.06), "high": min(1, value + 0.07)}


def row(label, rig, case, values, **more):
    return {"label": label, "rig": rig, "case": "evaluations/" + case, "values": values, "paper": {}, "vehicles": 170,
            "hosts": 200, "frames": 36, "meshes": 1, "minutes": 3.25, **more}


def success(value):
    return {"fn_asr": share(0.8 * value), "fp_asr": share(0.3 * value), "asr": share(value)}


def attack_table(name, rig):
    rows = [row(label, rig, f"{rig}-{case}", success(0.1 + 0.1 * k), paper={"asr": 0.08 + 0.1 * k},
                false_positive_distances=[3.0 * i + k for i in range(3 * k)], false_positives_of=340, runs=2) for k, (label, case) in enumerate(ATTACKS)]
    rows[3]["note"] = "this detector does not use its picture, so this says nothing about images"
    rows[2] = {**row("fusion, LiDAR", rig, f"{rig}-fusion-lidar", {}), "error": "runs/x: made to fail"}
    for key in ("vehicles", "hosts", "frames", "meshes"):
        del rows[2][key]
    return {"name": name, "title": f"Attack success, {rig}", "note": "Made up.", "columns": SUCCESS, "rows": rows}


def recall_table():
    iou = [k / 20 for k in range(21)]
    rows = []
    for rig in ("kitti64", "xenith"):
        for k, (label, case) in enumerate([("fusion, as recorded", "fusion-both"), *ATTACKS]):
            recall = [max(0.0, 0.95 - 0.05 * k - u**(4 - 0.3 * k)) for u in iou]
            curve = {"iou": iou, "recall": recall, "low": [max(0, r - 0.05) for r in recall],
                     "high": [min(1, r + 0.05) for r in recall]}
            rows.append(row(label, rig, f"{rig}-{case}", {"recall70": share(recall[14])}, curve=curve))
    return {"name": "fig3", "title": "Recall over IoU", "note": "", "rows": rows,
            "columns": [{"key": "recall70", "title": "recall at IoU 0.7"}]}


def size_table():
    rows = [row(f"L = {size:.1f} m", "kitti64", f"kitti64-fusion-both-size{size:.1f}", success(0.4 * size), size=size,
                false_positive_distances=[]) for size in (0.2, 0.4, 0.6, 0.8, 1.0)]
    return {"name": "fig4", "title": "Attack success against the size of the box", "note": "Made up.", "columns": SUCCESS,
            "rows": rows}


def transfer_table():
    ends = ["KITTI rig, fusion", "Xenith rig, fusion", "KITTI rig, LiDAR-only", "Xenith rig, LiDAR-only"]
    rows = [row(f"{a} → {b}", "kitti64", f"{a}--on--{b}", success(0.5 if a == b else 0.15), source=a, target=b,
                false_positive_distances=[]) for b in ends for a in ends]
    return {"name": "table3", "title": "Transfer of the learned mesh, black box", "note": "", "columns": SUCCESS,
            "rows": rows}


def defence_table():
    rows = [row(label, "kitti64", f"kitti64-fusion-both-{k}", {**success(0.5 - 0.12 * k), "ap70": {"value": 0.8 - 0.01 * k}},
                paper={"asr": 0.4976 - 0.1 * k, "ap70": 0.8464}, false_positive_distances=[])
            for k, label in enumerate(("none", "JPEG, quality 50", "adversarial training"))]
    return {"name": "table4", "title": "Defences of the fusion detector", "note": "", "rows": rows,
            "columns": [*SUCCESS, {"key": "ap70", "title": "clean AP 0.7"}]}


def parts_table():
    rows = [row(label, "kitti64", f"kitti64-fusion-{k}", {**success(0.2 + 0.05 * k), "vanished": share(0.1 + 0.05 * k)},
                false_positive_distances=[])
            for k, label in enumerate(("shape and texture, image", "texture alone, image"))]
    return {"name": "parts", "title": "What of the object hides", "note": "Made up.", "rows": rows,
            "columns": [{"key": "vanished", "title": "vanished"}, *SUCCESS]}


def fusions_table():
    """Two attacks and a cuboid before three judges; one cell failed, and one detector does not use its picture."""
    judges = ["lidar", "camera", "late"]
    rows = []
    for k, source in enumerate(("lidar, LiDAR", "late, image", "no learning: cuboid")):
        for j, judge in enumerate(judges):
            value = 0.1 + 0.05 * k
            values = {"vanished": share(value), "net_vanished": {"value": 0.08 * (j - 1), "low": 0.08 * (j - 1) - 0.05,
                                                                 "high": 0.08 * (j - 1) + 0.05},
                      "fn_asr": share(2 * value), "net_fn_asr": {"value": 0.0, "low": -0.03, "high": 0.03}}
            rows.append(row(f"{source} → {judge}", "kitti64", f"{k}-{judge}", values, source=source, target=judge))
    rows[4] = {**row(rows[4]["label"], "kitti64", "1-camera", {}, source="late, image", target="camera"), "error": "runs/x: made to fail"}
    for key in ("vehicles", "hosts", "frames", "meshes"):
        del rows[4][key]
    rows[5]["note"] = "this detector does not use its picture, so this says nothing about images"
    columns = [{"key": key, "title": key.replace("_", " ")} for key in ("vanished", "net_vanished", "fn_asr", "net_fn_asr")]
    return {"name": "fusions", "title": "Which fusion is weak where", "note": "Made up.", "matrix": True, "columns": columns,
            "rows": rows}


def findings():
    verdicts = ["holds", "does not hold", "cannot be told", "holds in part"]
    list_ = [{"name": f"f{k}", "claim": f"Made-up claim {k}", "verdict": verdict,
              "checks": [{"rig": "KITTI rig", "verdict": "holds" if k == 3 else verdict,
                          "sentence": "ASR 28.4 % (20.1–37.0) and 10.1 % (5.2–16.0): +18.3 (+9.9 to +26.0) points",
                          "why": "made-up evidence", "vehicles": 170, "comparisons": []}]}
             for k, verdict in enumerate(verdicts)]
    list_.append({"name": "f9", "claim": "Not measured here", "verdict": "not measured", "checks": []})
    return list_


def make(folder):
    pictures = os.path.join(folder, "evaluations", "kitti64-fusion-both", "pictures")
    os.makedirs(pictures)
    for kind in ("hidden", "false_positives", "features"):
        Image.new("RGB", (900, 300), (70, 110, 160)).save(os.path.join(pictures, f"{kind}_000001_0.png"))
    tables = [attack_table("table1", "kitti64"), attack_table("table2", "xenith"), recall_table(), size_table(),
              transfer_table(), defence_table(), parts_table(), fusions_table()]
    for table in tables:
        table.setdefault("matrix", False)
        for row in table["rows"]:
            if "vehicles" in row:
                row.setdefault("runs", 1)
    result = {"what": "all", "tables": tables, "findings": findings(),
              "reliance": [{"case": "kitti64-fusion-both", "reads_picture": True, "uses_picture": False, "ap70": 0.8,
                            "ap70_swapped": 0.79, "ap70_black": 0.7, "drop": 0.01, "drop_low": -0.02, "drop_high": 0.03,
                            "mean_delta_logit": 0.1, "words": "made-up words"},
                           {"case": "kitti64-lidar-lidar", "reads_picture": False, "uses_picture": False, "words": "no camera"}],
              "settings": {"iterations": 400, "batch": 8, "vertex_rate": 0.02, "texel_rate": 0.02, "seed": 0, "random_meshes": 3, "quick": False, "kitti64": "k", "xenith": "x",
                           "real": "", "confidence": 0.95},
              "steps": {"runs/kitti64-fusion-both": {"status": "done", "seconds": 61.5},
                        "runs/kitti64-fusion-lidar": {"status": "failed", "error": "made to fail"}}}
    with open(os.path.join(folder, "reproduce.json"), "w", encoding="utf-8") as file:
        json.dump(result, file)
    return result
