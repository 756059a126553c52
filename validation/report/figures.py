"""The figures of the page, each from result.json or from a file beside it (a vehicle, the evaluation, the trade-off): the
page names for every figure the file and the place that it was read from. This file judges nothing."""

import csv
import math
import os

import jinja2
from markupsafe import Markup, escape

import charts

# Format of the targets of result.json: place: (name, format, target).
TARGETS = {
    "matched.mask_iou": ("Mask IoU", "f6", "≥ 0.9999"),
    "matched.mae": ("Mean colour error, scene-linear", "sci", "≤ 10⁻⁴"),
    "matched.hit_disagreements": ("Hit disagreements of LiDAR rays", "int", "0"),
    "matched.range_error_m": ("Largest LiDAR range error, m", "sci", "≤ 10⁻⁴"),
}
# How the result was made, for the page's head: (name, places in result.json; the first that exists counts).
MADE_OF = [
    ("detector", ("provenance.detector", "provenance.settings.detector")),
    ("weights", ("provenance.weights", "provenance.settings.weights")),
    ("weights, hash", ("provenance.weights_hash", "provenance.inputs.weights")),
    ("defence", ("provenance.defense", "provenance.settings.defense")),
    ("data", ("provenance.data", "provenance.settings.data")),
    ("data, hash", ("provenance.data_hash", "provenance.inputs.data")),
    ("run", ("run",)),
    ("place", ("placement",)),
    ("object as built", ("expect",)),
    ("run's seed", ("provenance.settings.seed",)),
    ("seed", ("provenance.seed",)),
    ("program", ("provenance.version", "provenance.program")),
    ("commit", ("provenance.commit",)),
    ("made on", ("provenance.date",)),
    ("command", ("provenance.command",)),
    ("identity", ("provenance.identity",)),
]
LOSS_POINTS = 200
VANISHED_IOU = 0.1  # the rule "vanished" of src/attack/host_outcome.h

FORMATS = {
    "pct": lambda v: f"{100 * v:.1f}\u202f%", "pct2": lambda v: f"{100 * v:.2f}", "points": lambda v: f"{100 * v:.1f}", "pct0": lambda v: f"{100 * v:.0f}\u202f%", "int": lambda v: f"{v:,.0f}",
    "sci": charts.scientific, "f6": lambda v: f"{v:.6f}", "f4": lambda v: f"{v:.4f}",
    "f3": lambda v: f"{v:.3f}", "f2": lambda v: f"{v:.2f}", "f1": lambda v: f"{v:.1f}",
    "um": lambda v: f"{1e6 * v:.1f}", "g3": lambda v: charts.short(v, 3), "g2": lambda v: charts.short(v, 2), "text": str,
}


def templates(*folders):
    """The environment in which pages are filled; templates are looked for in these folders."""
    return jinja2.Environment(loader=jinja2.FileSystemLoader(folders), autoescape=True)


def asset(folder, name):
    """A text that is inserted into a page unchanged."""
    with open(os.path.join(folder, name), encoding="utf-8") as file:
        return Markup(file.read())


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


def figure_function(tree, origin=str):
    """`fig(place, format)` for the template: the formatted value and where it stands; a dash without one. `origin(place)`:
    "place" of result.json, "FILE#place" of another file."""

    def fig(place, form="g3"):
        if not has(tree, place):
            return Markup('<span class="none">–</span>')
        value = at(tree, place)
        if isinstance(value, float) and not math.isfinite(value):
            return Markup('<span class="none">–</span>')
        return Markup(f'<data value="{escape(value)}" data-at="{escape(origin(place))}">{escape(written(value, form))}</data>')

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
    span = max(1, len(values) // 5)
    sums = [0.0]
    for value in values:
        sums.append(sums[-1] + value)
    mean = [(sums[i + 1] - sums[max(0, i + 1 - span)]) / min(i + 1, span) for i in range(len(values))]
    first = min(span, len(values)) - 1  # before, the mean is of fewer and swings
    kept = sorted({first + round(k * (len(values) - 1 - first) / (LOSS_POINTS - 1)) for k in range(LOSS_POINTS)})
    return {"window": span, "iteration": [float(rows[k]["iteration"]) for k in kept], "loss": [mean[k] for k in kept]}


def outcome(host, key):
    """(text, class): the detector's result for the attacked vehicle."""
    if not host["detected"]:
        return "not found clean", "none"
    if not host[key]["hidden"]:
        return "found", "good"
    return ("vanished" if host[key]["iou"] <= VANISHED_IOU else "misplaced"), "bad"


def realistic(host, light):
    """The detector's result for a vehicle found clean, under that light and with realistic returns."""
    return next(arm for arm in host["arms"] if arm["light"] == light and arm["returns"] == "realistic")


def judges_object(result):
    """Whether the object itself is judged: then a plain cuboid in its place counts as clean."""
    return result.get("placed", {}).get("victim") == "object"


def title(result, host):
    """The name of the judged thing: the host, its neighbour, or the object."""
    name, victim = host["name"], host.get("victim", -1)
    if victim >= 0:
        return f"{name.rpartition('_')[0]}_{victim} (host {name})"
    return f"object at {name}" if judges_object(result) else name


def made_of(result):
    """[(name, place)] of the known provenance."""
    rows = [(what, next((place for place in places if has(result, place) and at(result, place) not in ("", {}, [])), None))
            for what, places in MADE_OF]
    return [(what, place) for what, place in rows if place]


SAID = {True: ("met", "good"), False: ("missed", "bad"), None: ("nothing measured", "none")}


def targets(result):
    """[{place, met, name, format, target_text, said, tag}]; met None: nothing was measured"""
    rows = []
    for target in result.get("targets", []):
        camera = target.get("camera")
        name, form, text = TARGETS.get("matched." + target["place"].split(".")[-1] if camera else target["place"], [None] * 3)
        if name:
            said, tag = SAID[target["met"]]
            rows.append({"name": f"{name}, {camera}" if camera else name, "format": form, "target_text": text, "said": said, "tag": tag, **target})
    return rows


def gather(result, hosts, loss, evaluation, tradeoff):
    """All that the page shows: result, and other files under "beside"; parts without data are absent."""
    parts = {"vehicles": hosts, "loss": loss, "evaluation": evaluation, "tradeoff": tradeoff}
    return {**result, "beside": {name: part for name, part in parts.items() if part}}


def origin_function(hosts, evaluation, tradeoff):
    """For figure_function: where a place of gather()'s tree was read from. `evaluation`, `tradeoff`: their files."""
    files = {"evaluation": evaluation, "tradeoff": tradeoff}

    def origin(place):
        parts = place.split(".")
        if parts[0] != "beside":
            return place
        if parts[1] == "vehicles":
            return f"hosts/{hosts[int(parts[2])]['name']}.json#{'.'.join(parts[3:])}"
        return f"{files[parts[1]]}#{'.'.join(parts[2:])}"

    return origin
