"""The figures of the page. All of them stand in result.json: what other files hold (vehicles, evaluation, trade-off,
loss) is copied into its `report_figures`, and the page names for every figure the place it was read from."""

import csv
import json
import math
import os

from markupsafe import Markup, escape

import charts

# To reach in matched light: (what, place, format, target, unit, passes).
TARGETS = [
    ("Mask IoU", "matched.mask_iou", "f6", 0.9999, "≥ 0.9999", lambda value, target: value >= target),
    ("Mean colour error, scene-linear", "matched.mae", "sci", 1e-4, "≤ 10⁻⁴", lambda value, target: value <= target),
    ("Hit disagreements of LiDAR rays", "matched.hit_disagreements", "int", 0, "0",
     lambda value, target: value <= target),
    ("Largest LiDAR range error, m", "matched.range_error_m", "sci", 1e-4, "≤ 10⁻⁴",
     lambda value, target: value <= target),
]
LOSS_POINTS = 200

FORMATS = {
    "pct": lambda v: f"{100 * v:.1f}\u202f%", "pct2": lambda v: f"{100 * v:.2f}", "points": lambda v: f"{100 * v:.1f}", "pct0": lambda v: f"{100 * v:.0f}\u202f%", "int": lambda v: f"{v:,.0f}",
    "sci": charts.scientific, "f6": lambda v: f"{v:.6f}", "f4": lambda v: f"{v:.4f}",
    "f3": lambda v: f"{v:.3f}", "f2": lambda v: f"{v:.2f}", "f1": lambda v: f"{v:.1f}",
    "um": lambda v: f"{1e6 * v:.1f}", "g3": lambda v: charts.short(v, 3), "g2": lambda v: charts.short(v, 2), "text": str, "signed": lambda v: f"{v:+.3f}",
}


def read_json(path):
    with open(path, encoding="utf-8") as file:
        return json.load(file)


def at(tree, place):
    """The value at "a.b.0.c"; KeyError without one."""
    for part in place.split("."):
        tree = tree[int(part)] if isinstance(tree, list) else tree[part]
    return tree


def has(tree, place):
    try:
        return at(tree, place) is not None
    except (KeyError, IndexError, ValueError, TypeError):
        return False


def written(value, form):
    """With a real minus sign, but for names."""
    text = FORMATS[form](value)
    return text if form == "text" else text.replace("-", "−")


def figure_function(result):
    """`fig(place, format)` for the template: the formatted value and where it stands; a dash without one."""

    def fig(place, form="g3"):
        if not has(result, place):
            return Markup('<span class="none">–</span>')
        value = at(result, place)
        if isinstance(value, float) and not math.isfinite(value):
            return Markup('<span class="none">–</span>')
        return Markup(f'<data value="{escape(value)}" data-at="{escape(place)}">{escape(written(value, form))}</data>')

    return fig


def interval_function(result, fig):
    """`interval(place)`: a share with its bounds, "25.0 % (8.3–41.7 %)"."""

    def interval(place, form="pct"):
        if not has(result, place + ".low"):
            return fig(place + ".value" if has(result, place + ".value") else place, form)
        low, high = fig(place + ".low", form), fig(place + ".high", form)
        low = Markup(str(low).replace("\u202f%", ""))
        to = " to " if at(result, place + ".low") < 0 else "–"
        return Markup(f'{fig(place + ".value", form)} <span class="bounds">({low}{to}{high})</span>')

    return interval


def loss_curve(path):
    """{window, iteration, loss}: a running mean, thinned; None without a readable file."""
    if not os.path.exists(path):
        return None
    with open(path, newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row.get("loss")]
    if len(rows) < 2:
        return None
    values = [float(row["loss"]) for row in rows]
    span = max(1, len(values) // 20)
    sums = [0.0]
    for value in values:
        sums.append(sums[-1] + value)
    mean = [(sums[i + 1] - sums[max(0, i + 1 - span)]) / min(i + 1, span) for i in range(len(values))]
    first = min(span, len(values)) - 1  # before, the mean is of fewer and swings
    kept = sorted({first + round(k * (len(values) - 1 - first) / (LOSS_POINTS - 1)) for k in range(LOSS_POINTS)})
    return {"window": span, "iteration": [float(rows[k]["iteration"]) for k in kept], "loss": [mean[k] for k in kept]}


def outcome(host, key):
    """(text, class): what the detector makes of the attacked vehicle."""
    if not host["detected"]:
        return "not found clean", "none"
    if host[key]["hidden"]:
        return "hidden", "bad"
    return "found", "good"


def vehicle(host):
    """A vehicle's figures that the page shows."""
    kept = {key: host[key] for key in ("name", "range", "visible_share", "adversary_points", "detected", "clean",
                                       "raster", "cycles", "matched", "full", "samples", "noise") if key in host}
    if host["full"].get("mean", 0) > 0:
        kept["full_relative"] = host["full"]["mae"] / host["full"]["mean"]
    return kept


def without_lists(evaluation):
    """Without the outcome of every vehicle and every false positive."""
    kept = {key: value for key, value in evaluation.items() if key != "outcomes"}
    if "false_positives" in kept:
        kept["false_positives"] = {key: value for key, value in kept["false_positives"].items() if key != "list"}
    return kept


def evaluation_figures(evaluation):
    if not evaluation:
        return None
    kept = without_lists(evaluation)
    for control in ("random", "sized", "ellipsoid", "cuboid"):
        if isinstance(kept.get(control), dict):
            kept[control] = without_lists(kept[control])
    return kept


def gather(result, hosts, loss, evaluation, tradeoff):
    """result with `report_figures`; parts without data are absent."""
    parts = {"vehicles": [vehicle(host) for host in hosts], "loss": loss,
             "evaluation": evaluation_figures(evaluation), "tradeoff": tradeoff}
    checks = []
    for name, place, form, target, text, passes in TARGETS:
        if has(result, place):
            checks.append({"name": name, "place": place, "format": form, "target": target, "target_text": text,
                           "met": bool(passes(at(result, place), target))})
    parts["targets"] = checks
    return {**result, "report_figures": {name: part for name, part in parts.items() if part}}
