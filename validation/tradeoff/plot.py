"""Draws the speed-accuracy study of `mirage tradeoff`.

    python3 plot.py DIR

Reads DIR/tradeoff.json; writes DIR/tradeoff.png, tradeoff.svg and tradeoff.html (the plot inlined; opens offline).
Ends with status 3, silently, when matplotlib is missing.
"""

import html
import io
import os
import sys

try:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
except ImportError:
    sys.exit(3)

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "report"))
import atomic  # noqa: E402

INK, MUTED, LINE = "#1c2430", "#667085", "#e4e7ec"
COLOURS = ["#2563eb", "#dc2626", "#16a34a", "#d97706", "#7c3aed", "#db2777", "#0891b2", "#65a30d"]
NAMES = {"sigma": "σ", "gamma": "γ", "cut_off": "cut-off", "edges": "hard edges", "samples": "samples a pixel",
         "image_scale": "image scale", "arithmetic": "arithmetic", "grid": "joint grid", "quality": "--quality",
         "rays": "rays left out", "beam": "rays a beam", "back_end": "back-end", "passes": "passes", "precision": "--precision",
         "locality": "--locality", "rung": "light effects"}
# group, error, title, label of the error's axis
PANELS = [("camera", "image_levels", "Camera: image error", "mean |Δ| of the object, levels of 255"),
          ("camera", "gradient", "Camera: gradient error", "1 − cosine with finite differences"),
          ("lidar", "range_error_m", "LiDAR: range error", "mean |Δ range|, m"),
          ("lidar", "gradient", "LiDAR: gradient error", "1 − cosine with the double reference"),
          ("depth", "mae_mm", "Depth completion", "mean |Δ depth|, mm"),
          ("detector", "gradient", "Detector: gradient error of a step", "1 − cosine with whole passes in double"),
          ("cycles", "image_levels", "Cycles: light and samples", "mean |Δ| of the object, levels of 255")]

plt.rcParams.update({
    "font.family": "DejaVu Sans", "font.size": 9, "axes.edgecolor": LINE, "axes.labelcolor": MUTED,
    "xtick.color": MUTED, "ytick.color": MUTED, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": LINE, "grid.linewidth": 0.7, "axes.axisbelow": True, "svg.fonttype": "path",
    "svg.hashsalt": "mirage",
})


def floor(points, error):
    """The place of zero errors on a logarithmic axis."""
    positive = [p["errors"][error] for p in points if p["errors"][error] > 0]
    return min(positive) / 3 if positive else 1e-12


def draw(axes, points, error, title, label):
    zero = floor(points, error)
    at = lambda p: max(p["errors"][error], zero)
    order = []
    for point in points:
        if point["axis"] not in order:
            order.append(point["axis"])
    colour = 0
    for axis in order:
        own = [p for p in points if p["axis"] == axis]
        if axis == "quality":
            for p in own:
                axes.plot(p["ms"], at(p), "*", color=INK, markersize=11, zorder=5)
                axes.annotate(p["label"], (p["ms"], at(p)), xytext=(7, 5), textcoords="offset points", color=INK,
                              fontsize=8, fontweight="bold")
            continue
        if axis == "grid":
            axes.plot([p["ms"] for p in own], [at(p) for p in own], ".", color="#c3cad5", markersize=5,
                      label=NAMES[axis], zorder=1)
            continue
        joined = "o" if axis == "back_end" else "o-"
        axes.plot([p["ms"] for p in own], [at(p) for p in own], joined, color=COLOURS[colour % len(COLOURS)],
                  linewidth=1, markersize=4, alpha=0.85, label=NAMES.get(axis, axis), zorder=3)
        if len(points) <= 16:
            for p in own:
                axes.annotate(p["label"], (p["ms"], at(p)), xytext=(5, 3), textcoords="offset points", color=MUTED,
                              fontsize=7)
        colour += 1
    front = sorted((p for p in points if error in p["front"]), key=lambda p: p["ms"])
    axes.plot([p["ms"] for p in front], [at(p) for p in front], drawstyle="steps-post", color=INK, linewidth=1.1,
              linestyle="--", label="front", zorder=2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_title(title, loc="left", fontsize=11, color=INK)
    axes.set_xlabel("ms a vehicle" if points[0]["group"] != "depth" else "ms a frame")
    axes.set_ylabel(label)
    axes.legend(fontsize=7, frameon=False, labelcolor=MUTED, loc="best")


def plot(data, folder):
    panels = []
    for group, error, title, label in PANELS:
        points = [p for p in data["points"] if p["group"] == group and error in p["errors"]]
        if points:
            panels.append((points, error, title, label))
    rows = (len(panels) + 1) // 2
    figure, grid = plt.subplots(rows, 2, figsize=(12, 4.6 * rows), squeeze=False)
    for axes in list(grid.flat)[len(panels):]:
        axes.set_axis_off()
    for axes, panel in zip(grid.flat, panels):
        draw(axes, *panel)
    figure.tight_layout()
    for kind, options in (("png", {"dpi": 130}), ("svg", {"metadata": {"Date": None}})):
        path = os.path.join(folder, "tradeoff." + kind)
        atomic.save_figure(figure, path, kind, **options)
    text = io.StringIO()
    figure.savefig(text, format="svg", facecolor="white", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg"):]


def number(value):
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (int, float)):
        return f"{value:.3g}"
    return html.escape(str(value))


def table(head, rows):
    cells = lambda row, tag: "".join(f"<{tag}>{cell}</{tag}>" for cell in row)
    return ("<table><thead><tr>" + cells(head, "th") + "</tr></thead><tbody>" +
            "".join("<tr>" + cells(row, "td") + "</tr>" for row in rows) + "</tbody></table>")


def recommended(data):
    head = ["", "σ", "γ", "cut-off", "samples", "× default's time", "image error /255", "gradient cosine | norm",
            "on the front of", "rule"]
    rows = []
    for one in data["recommended"]:
        kinds = [("shipped as --quality " + one["name"], one["shipped"], "")]
        if one["name"] != "default":
            kinds.append((one["name"] + " by these points", one if "settings" in one else None, one["rule"]))
        for name, figures, rule in kinds:
            if figures is None:
                rows.append([html.escape(name)] + ["–"] * 8 + [html.escape(rule)])
                continue
            s, e = figures["settings"], figures["errors"]
            drawing = (["exact areas", "–", "–", "–"] if s.get("exact_coverage") else
                       [number(s["sigma"]), number(s["gamma"]), number(s["dist_eps"]),
                        f"{s['supersampling']}×{s['supersampling']}"])
            rows.append([html.escape(name), *drawing, f"{figures['ratio']:.2f}",
                         f"{e['image_levels']:.2f}", f"{e['gradient_cosine']:.3f} | {e['gradient_norm']:.2f}",
                         html.escape(", ".join(figures["on_front"]) or "–"), html.escape(rule)])
    return table(head, rows)


def page(data, svg):
    reference = data["reference"]
    differences = reference["finite_differences"]
    groups = {}
    for point in data["points"]:
        groups.setdefault(point["group"], []).append(point)
    parts = [f"<h1>Speed against accuracy</h1><p>{data['vehicles']} vehicles in {data['frames']} frames of "
             f"{html.escape(data['data'])}; every time beside the default's, in alternation, medians of "
             f"{data['repeats']}. Camera and LiDAR: CPU time of one thread, forward and derivative; default "
             f"{data['baseline']['camera_ms']:.2f} ms a vehicle in the camera. Depth completion and Cycles: wall clock.</p>"]
    if data["recommended"]:
        parts += ["<h2>Recommended settings</h2>", recommended(data)]
    if data["attack"]:
        parts += ["<h2>Attack success at equal time</h2>",
                  table(["attack", "seconds", "iterations", "vehicles", "ASR", "FN", "FP"],
                        [[html.escape(a["name"]), number(a["seconds"]), a["iterations"], a["vehicles"], f"{100 * a['asr']:.1f} % ({100 * a['asr_interval'][0]:.1f}–{100 * a['asr_interval'][1]:.1f})",
                          f"{100 * a['fn_asr']:.1f} %", f"{100 * a['fp_asr']:.1f} %"] for a in data["attack"]])]
    parts += ["<h2>Fronts</h2>", svg, "<h2>References</h2><ul>",
              f"<li>Image: {html.escape(reference['image'])}.</li>",
              f"<li>Gradient: central differences of the hard render along {differences['directions']} directions of "
              f"{1000 * differences['step_m']:g} mm; with half the step they agree to cosine "
              f"{differences['self_cosine']:.4f}. Double reference: {html.escape(reference['gradient'])}; its cosine with the "
              f"differences is {reference['gradient_cosine']:.3f}.</li>"]
    if reference["depth"]:
        parts.append(f"<li>Depth completion: {html.escape(reference['depth'])}.</li>")
    parts.append("</ul><h2>All points</h2>")
    for group, points in groups.items():
        errors = sorted({name for p in points for name in p["errors"]})
        rows = [[NAMES.get(p["axis"], p["axis"]), html.escape(p["label"]), number(p["ms"]), number(p["ratio"])] +
                [number(p["errors"][name]) if name in p["errors"] else "–" for name in errors] +
                [html.escape(", ".join(p["front"]))] for p in points]
        parts.append(f"<details><summary>{group}: {len(points)} points</summary>" +
                     table(["axis", "setting", "ms", "ratio"] + errors + ["front"], rows) + "</details>")
    return ("<!doctype html><html lang='en'><head><meta charset='utf-8'><title>Mirage: speed against accuracy</title><style>"
            "body{font:15px/1.5 system-ui,sans-serif;color:#1c2430;max-width:1180px;margin:2rem auto;padding:0 1rem}"
            "h1{font-size:1.6rem}h2{font-size:1.15rem;margin-top:2rem}svg{width:100%;height:auto}"
            "table{border-collapse:collapse;font-size:12.5px;display:block;overflow-x:auto}"
            "th,td{padding:.3rem .6rem;border-bottom:1px solid #e4e7ec;text-align:left;vertical-align:top}"
            "th{color:#667085;font-weight:600}summary{cursor:pointer;margin:.5rem 0}"
            "</style></head><body>" + "\n".join(parts) + "</body></html>\n")


def main(folder):
    data = atomic.read_json(folder, "tradeoff.json")
    atomic.write(os.path.join(folder, "tradeoff.html"), page(data, plot(data, folder)))


if __name__ == "__main__":
    atomic.run(main, sys.argv[1])
