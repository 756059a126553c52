"""Plots of `mirage reproduce`'s page as inline SVG, with the report's own (report/charts.py)."""

from markupsafe import Markup

import charts
import plots

KINDS = [("as recorded", "clean"), ("random", "rung"), ("image", "image"), ("both", "both"), ("LiDAR", "lidar")]
RIGS = {"kitti64": "KITTI rig", "xenith": "Xenith rig", "real": "real KITTI frames"}
SHORT = {"LiDAR-only detector, ": "LiDAR-only, "}


def kind(label):
    """The class of a row's attack, from the words after the comma."""
    attack = label.split(", ", 1)[-1]
    return next((name for word, name in KINDS if word in attack), "both")


def short(label):
    for long, word in SHORT.items():
        label = label.replace(long, word)
    return label


def words(value):
    return plots.interval_text(value) if "low" in value else plots.percent(value["value"])


def success(rows, key="asr", label="attack success rate (95 % interval); ring: the paper's"):
    """One line per row: our share with its interval, and the paper's as a ring."""
    rows = [row for row in rows if key in row["values"]]
    if not rows:
        return None
    high = max([row["values"][key].get("high", row["values"][key]["value"]) for row in rows] +
               [row["paper"].get(key, 0) for row in rows])
    names = [short(row["label"]) for row in rows]
    left = max(200, 20 + 6 * max(map(len, names)))  # pixels; a letter takes six at most, on average
    plot = charts.Plot((0, min(1.0, max(0.1, 1.08 * high))), None, "Attack success", label, size=(560, 62 + 30 * len(rows)),
                       left=left, tick=charts.percent)
    for index, row in enumerate(rows):
        value, y, name = row["values"][key], plot.row(index, len(rows)), kind(row["label"])
        plot.text("name", plot.left - 12, y + 4, names[index], "end")
        if "low" in value:
            plot.line(f"interval {name}", plot.x(value["low"]), y, plot.x(value["high"]), y)
        if key in row["paper"]:
            plot.add(f'<circle class="ring" cx="{plot.x(row["paper"][key])}" cy="{y}" r="5"/>',
                     f"{row['label']}: the paper's {100 * row['paper'][key]:.2f} %")
        plot.add(f'<circle class="dot {name}" cx="{plot.x(value["value"])}" cy="{y}" r="5"/>',
                 f"{row['label']}: {words(value)}, {row.get('vehicles', 0)} vehicles")
    return plot.svg()


def band(plot, name, xs, low, high):
    points = " ".join(f"{plot.x(a)},{plot.y(b)}" for a, b in
                      list(zip(xs, high)) + list(zip(reversed(xs), reversed(low))))
    plot.parts.append(f'<polygon class="band {name}" points="{points}"/>')


def recall(rows):
    """Curves of one rig; those of the LiDAR-only detector are dashed."""
    rows = [row for row in rows if "curve" in row]
    if not rows:
        return None
    plot = charts.Plot((0, 1), (0, 1.02), "Recall over IoU", "IoU asked for", "share of vehicles found", size=(560, 330))
    plot.line("rule", plot.x(0.7), plot.top, plot.x(0.7), plot.bottom)
    for row in rows:
        curve = row["curve"]
        if "LiDAR-only" not in row["label"] and "low" in curve:
            band(plot, kind(row["label"]), curve["iou"], curve["low"], curve["high"])
    for row in rows:
        dashed = " dashed" if "LiDAR-only" in row["label"] else ""
        plot.curve(kind(row["label"]) + dashed, row["curve"]["iou"], row["curve"]["recall"])
    return plot.svg()


def legend(rows):
    """[(class, label)] of rows, each once."""
    seen = []
    for row in rows:
        entry = (kind(row["label"]) + (" dashed" if "LiDAR-only" in row["label"] else ""), row["label"])
        if entry not in seen:
            seen.append(entry)
    return seen


def size(rows):
    """Success over L; misses and false positives besides their sum."""
    rows = sorted((row for row in rows if "asr" in row["values"]), key=lambda row: row["size"])
    if not rows:
        return None
    high = max(row["values"][key]["high"] for row in rows for key in ("asr", "fn_asr", "fp_asr"))
    plot = charts.Plot((0.1, 1.1), (0, max(0.05, 1.08 * high)), "Attack success over size", "L, m", "share of vehicles",
                       size=(560, 330), top=30, tick=lambda v: f"{v:.1f}")
    plot.y.label = charts.percent
    plot.parts = []
    plot.frame("L, m", "share of vehicles")
    for key, name, shift in (("fp_asr", "rung", -5), ("fn_asr", "image", 0), ("asr", "both", 5)):
        plot.curve(name, [row["size"] for row in rows], [row["values"][key]["value"] for row in rows])
        for row in rows:
            value, x = row["values"][key], plot.x(row["size"]) + shift
            plot.line(f"interval {name}", x, plot.y(value["low"]), x, plot.y(value["high"]))
            plot.add(f'<circle class="dot {name}" cx="{x}" cy="{plot.y(value["value"])}" r="3.6"/>',
                     f"L = {row['size']:.1f} m, {key.replace('_', ' ').upper()}: {words(value)}")
    plot.legend([("both", "ASR"), ("image", "FN ASR"), ("rung", "FP ASR")])
    return plot.svg()


def matrix(rows):
    """{sources, targets, cells: {(source, target): index of the row}} of the transfer table."""
    each_once = lambda key: list(dict.fromkeys(row[key] for row in rows))
    return {"sources": each_once("source"), "targets": each_once("target"),
            "cells": {(row["source"], row["target"]): index for index, row in enumerate(rows)}}


def shade(value):
    """The shade of a matrix cell, by its ASR."""
    return f"color-mix(in srgb, var(--raster) {round(85 * value)}%, transparent)"


def distances(rows):
    """Distances of false positives from the host, as a step curve per attack."""
    edges = list(range(0, 75, 5))
    series = []
    for row in rows:
        values = row.get("false_positive_distances", [])
        if not values:
            continue
        counts = [sum(a <= v < b for v in values) for a, b in zip(edges, edges[1:])]
        counts[-1] += sum(v >= edges[-1] for v in values)
        series.append((row, counts))
    if not series:
        return None
    rate = lambda row, count: 100 * count / max(1, row["false_positives_of"])
    high = max(rate(row, count) for row, counts in series for count in counts)
    plot = charts.Plot((0, edges[-1]), (0, 1.1 * high or 1), "Distance of false positives", "distance from the host, m",
                       "false positives, 100 vehicles", size=(560, 300))
    for row, counts in series:
        xs, ys = [], []
        for index, count in enumerate(counts):
            xs += [edges[index], edges[index + 1]]
            ys += [rate(row, count)] * 2
        plot.curve(kind(row["label"]) + (" dashed" if "LiDAR-only" in row["label"] else ""), xs, ys)
    return plot.svg()
