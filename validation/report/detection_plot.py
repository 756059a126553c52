"""Draws the precision-recall curves of `mirage detect`.

    python3 detection_plot.py DIR

Reads DIR/precision_recall.json; writes DIR/precision_recall.png and .svg. Ends with status 3, silently, when
matplotlib is missing.
"""

import os
import sys

try:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
except ImportError:
    sys.exit(3)

sys.dont_write_bytecode = True
import atomic  # noqa: E402

MUTED, LINE = "#667085", "#e4e7ec"
COLOURS = {"all": "#1c2430", "easy": "#16a34a", "moderate": "#d97706", "hard": "#dc2626", "0-20 m": "#2563eb",
           "20-40 m": "#7c3aed", "40-70 m": "#db2777"}
PANELS = [("by difficulty", ["all", "easy", "moderate", "hard"]), ("by range", ["all", "0-20 m", "20-40 m", "40-70 m"])]

plt.rcParams.update({
    "font.family": "DejaVu Sans", "font.size": 9, "axes.edgecolor": LINE, "axes.labelcolor": MUTED,
    "xtick.color": MUTED, "ytick.color": MUTED, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": LINE, "grid.linewidth": 0.7, "axes.axisbelow": True, "svg.fonttype": "path",
    "svg.hashsalt": "mirage",
})


def draw(axes, curves, names, overlap):
    for name in names:
        curve = curves[name][overlap]
        if not curve["vehicles"]:
            continue
        # The first hit's precision holds from recall 0, and nothing is found beyond the last.
        recall = [0] + curve["recall"] + curve["recall"][-1:]
        precision = curve["precision"][:1] + curve["precision"] + [0] if curve["recall"] else [0]
        dashes = "--" if name == "hard" else "-"  # hard counts nearly the same vehicles as all
        axes.step(recall, precision, dashes, where="pre", color=COLOURS[name], linewidth=2 if name == "all" else 1.4,
                  label=f"{name}: AP {100 * curve['ap']:.1f}  ({curve['vehicles']} vehicles)")
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1.02)
    if axes.get_legend_handles_labels()[0]:  # matplotlib warns of a legend without entries
        axes.legend(loc="lower left", fontsize=8, frameon=False, labelcolor=MUTED)


def main(folder):
    data = atomic.read_json(folder, "precision_recall.json")
    curves = {curve["name"]: curve for curve in data["curves"]}
    figure, grid = plt.subplots(2, 2, figsize=(9, 7.4), sharex=True, sharey=True)
    for row, (overlap, label) in enumerate((("iou50", "overlap 0.5"), ("iou70", "overlap 0.7"))):
        for column, (title, names) in enumerate(PANELS):
            draw(grid[row][column], curves, names, overlap)
            grid[row][column].set_title(f"{label}, {title}", loc="left", fontsize=10)
        grid[row][0].set_ylabel("precision")
    for axes in grid[1]:
        axes.set_xlabel("recall")
    figure.suptitle(f"{data['title']}, 40-point AP", x=0.02, ha="left", fontsize=12)
    figure.tight_layout()
    for kind, options in (("png", {"dpi": 150}), ("svg", {"metadata": {"Date": None}})):
        path = os.path.join(folder, "precision_recall." + kind)
        atomic.save_figure(figure, path, kind, **options)


if __name__ == "__main__":
    atomic.run(main, sys.argv[1])
