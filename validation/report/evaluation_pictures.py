"""Draws the pictures of `mirage evaluate --pictures N`.

    python3 evaluation_pictures.py DIR

Reads DIR/data/pictures.json and the images, points and feature maps that it names; writes DIR/hidden_HOST.png,
DIR/false_positives_HOST.png and DIR/features_HOST.png. Ends with status 3, silently, when matplotlib is missing.
"""

import os
import sys

try:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator
except ImportError:
    sys.exit(3)

sys.dont_write_bytecode = True
import atomic  # noqa: E402

TEXT, MUTED, LINE = "#1c2430", "#667085", "#e4e7ec"
TRUTH, CLEAN, ATTACKED, NEW, HOST = "#98a2b3", "#2563eb", "#d97706", "#dc2626", "#16a34a"
DISTANT = 12.0  # m from the host
READABLE = 35  # pixels high: smaller boxes have their score in close-ups only
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]

plt.rcParams.update({"font.family": "DejaVu Sans", "font.size": 9, "axes.edgecolor": LINE, "axes.labelcolor": MUTED,
                     "xtick.color": MUTED, "ytick.color": MUTED, "text.color": TEXT, "axes.titlesize": 10})


def floats(folder, about):
    return np.fromfile(os.path.join(folder, about["file"]), dtype="<f4").reshape(about["height"], about["width"])


def box_lines(axes, pixels, colour, width=1.4, style="-"):
    if pixels is None:
        return
    edges = EDGES if len(pixels) == 8 else EDGES[:4]  # a box in the picture has four corners
    axes.add_collection(LineCollection([[pixels[a], pixels[b]] for a, b in edges], colors=colour, linewidths=width,
                                       linestyles=style))


def show_image(axes, image, boxes, host, colour, window=None):
    """The image with the detections' boxes and the judged box; `window`: (left, right, bottom, top) of a close-up."""
    axes.imshow(image, interpolation="nearest" if window else "antialiased")
    box_lines(axes, host["pixels"], HOST, 1.6, ":")
    for box in boxes:
        box_lines(axes, box["pixels"], colour, 1.4 if window else 0.9)
        if box["pixels"] is None or not window and np.ptp([p[1] for p in box["pixels"]]) < READABLE:
            continue
        u, v = min(p[0] for p in box["pixels"]), min(p[1] for p in box["pixels"])
        left, right, bottom, top = window or (0, image.shape[1], image.shape[0], 0)
        if left <= u <= right and top <= v <= bottom:
            axes.text(u, v - 3, f"{box['score']:.2f}", color="white", fontsize=7, va="bottom",
                      bbox={"facecolor": colour, "edgecolor": "none", "pad": 0.8})
    if window:
        axes.set_xlim(window[0], window[1])
        axes.set_ylim(window[2], window[3])
    else:
        axes.set_xlim(-0.5, image.shape[1] - 0.5)
        axes.set_ylim(image.shape[0] - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks([])


def close_up(window, size, aspect):
    """A window of the given width/height around that 2-D box with room for an object on its roof."""
    left, top, right, bottom = window
    top -= 0.6 * (bottom - top)
    height = max(1.25 * (bottom - top), 1.3 * (right - left) / aspect, 60)
    height = min(height, size[0], size[1] / aspect)
    u = np.clip((left + right) / 2, height * aspect / 2, size[1] - height * aspect / 2)
    v = np.clip((top + bottom) / 2, height / 2, size[0] - height / 2)
    return u - height * aspect / 2, u + height * aspect / 2, v + height / 2, v - height / 2


def legend(figure, entries, y=0.0):
    handles = [Line2D([], [], color=colour, linestyle=style, linewidth=1.8, marker=marker, markersize=10 if marker == "o" else 8,
                      markerfacecolor="none" if marker == "o" else colour, label=label)
               for label, colour, style, marker in entries]
    figure.legend(handles=handles, loc="lower left", ncols=len(handles), frameon=False, fontsize=8.5,
                  bbox_to_anchor=(0.01, y), labelcolor=MUTED)


def judged(data):
    """The judged thing, in one word."""
    return {"neighbour": "neighbour", "object": "object"}.get(data["victim"], "host")


def in_picture(data):
    """Whether the detector is judged in the picture."""
    return data["plane"] == "picture"


def hidden(data, host, folder, path):
    images = [plt.imread(os.path.join(folder, name)) for name in ("clean.png", "attacked.png")]
    size = images[0].shape
    aspect, wide = 1.5, 11.0  # of a close-up; inches of the whole image
    row = wide * size[0] / size[1]
    margin, gap, head, foot = 0.12, 0.08, 0.28, 0.36
    width, height = 2 * margin + wide + gap + aspect * row, 2 * (row + head) + foot + 0.3
    figure = plt.figure(figsize=(width, height))
    window = close_up(host["window"], size, aspect)
    found = f"IoU {host['attacked_iou']:.2f} is too little" if host["attacked_iou"] > 0 else "no detection overlaps it"
    clean = "a plain cuboid in the object's place" if data["victim"] == "object" else "clean: the vehicle"
    titles = [f"{clean} is found, IoU {host['clean_iou']:.2f}, score {host['clean_score']:.2f}",
              f"with the adversary: {found}" + (f" (limit {data['detected_iou']:g})" if host["attacked_iou"] > 0 else "")]
    for k, (image, boxes, colour) in enumerate(zip(images, (host["clean"], host["attacked"]), (CLEAN, ATTACKED))):
        bottom = foot + (1 - k) * (row + head)
        whole = figure.add_axes((margin / width, bottom / height, wide / width, row / height))
        near = figure.add_axes(((margin + wide + gap) / width, bottom / height, aspect * row / width, row / height))
        show_image(whole, image, boxes, host["host"], colour)
        show_image(near, image, boxes, host["host"], colour, window)
        whole.set_title(titles[k], loc="left")
    figure.text(margin / width, 1 - 0.09 / height, f"{host['title']}: hidden, {host['range']:.0f} m away" + (f", {host['camera']}" if host.get("camera") else ""), va="top", fontsize=12)
    legend(figure, [(judged(data) + ("" if data["victim"] == "object" else ", as labelled"), HOST, ":", ""), ("detections, clean", CLEAN, "-", ""),
                    ("detections, attacked", ATTACKED, "-", "")])
    note = ("a box around vehicle and object is not a miss" if in_picture(data) else
            f"boxes have the height of the label they overlap, else {data['nominal_height']} m on the host's ground")
    figure.text(1 - margin / width, 0.12 / height, note, ha="right", color=MUTED, fontsize=8)
    save(figure, path)


def outline(axes, points, colour, width=1.3, style="-", fill=False, order=3):
    points = np.array(points + points[:1])
    # Forward is up, left is left.
    axes.plot(-points[:, 1], points[:, 0], style, color=colour, linewidth=width, zorder=order)
    if fill:
        axes.fill(-points[:, 1], points[:, 0], color=colour, alpha=0.3, zorder=order, linewidth=0)


def view_from_above(axes, region):
    axes.set_xlim(-region[3], -region[2])
    axes.set_ylim(region[0], region[1])
    axes.set_aspect("equal")
    axes.set_xlabel("to the right, m")
    axes.set_ylabel("ahead, m")


def false_positives_in_picture(data, host, folder, path):
    image = plt.imread(os.path.join(folder, "attacked.png"))
    wide = 11.0
    figure, axes = plt.subplots(figsize=(wide, wide * image.shape[0] / image.shape[1] + 0.7))
    axes.imshow(image)
    for boxes, colour, width, style in ((host["truth"], TRUTH, 1.6, "-"), ([b["outline"] for b in host["clean"]], CLEAN, 1.1, "-"),
                                        ([b["outline"] for b in host["attacked"]], ATTACKED, 1.1, "--"),
                                        ([b["outline"] for b in host["new"]], NEW, 1.8, "-")):
        for corners in boxes:
            box_lines(axes, corners, colour, width, style)
    for box in host["new"]:
        axes.text(min(p[0] for p in box["outline"]), min(p[1] for p in box["outline"]) - 3,
                  f"{box['distance']:.0f} px, {box['score']:.2f}", color="white", fontsize=7, va="bottom",
                  bbox={"facecolor": NEW, "edgecolor": "none", "pad": 0.8})
    box_lines(axes, host["host"]["pixels"], HOST, 1.6, ":")
    axes.set_xlim(-0.5, image.shape[1] - 0.5)
    axes.set_ylim(image.shape[0] - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks([])
    made = "one detection made" if len(host["new"]) == 1 else f"{len(host['new'])} detections made"
    axes.set_title(f"{host['title']}: {made}; beside: distance from the {judged(data)}, score", loc="left", fontsize=9.5)
    legend(figure, [("ground truth", TRUTH, "-", ""), ("clean", CLEAN, "-", ""), ("attacked", ATTACKED, "--", ""),
                    ("made by the adversary", NEW, "-", ""), (judged(data), HOST, ":", "")])
    figure.subplots_adjust(left=0.01, right=0.99, top=0.93, bottom=0.1)
    save(figure, path)


def false_positives(data, host, folder, path):
    if in_picture(data):
        false_positives_in_picture(data, host, folder, path)
        return
    region = data["region"]
    points = np.fromfile(os.path.join(folder, "points.f32"), dtype="<f4").reshape(-1, 3)
    shape = (region[3] - region[2]) / (region[1] - region[0])
    figure, axes = plt.subplots(figsize=(7.6 * shape + 1, 8.9))
    scene, mesh = points[points[:, 2] == 0], points[points[:, 2] == 1]
    axes.plot(-scene[:, 1], scene[:, 0], ",", color="#667085", alpha=0.6, zorder=1, rasterized=True)
    for box in host["truth"]:
        outline(axes, box, TRUTH, 2.4, order=2)
    for box in host["clean"]:
        outline(axes, box["outline"], CLEAN, order=3)
    for box in host["attacked"]:
        outline(axes, box["outline"], ATTACKED, 1.6, "--", order=4)
    for box in host["new"]:
        outline(axes, box["outline"], NEW, 1.8, fill=True, order=5)
        distant = box["distance"] >= DISTANT
        if distant:
            axes.plot(-box["y"], box["x"], "o", markersize=20, markerfacecolor="none", markeredgecolor=NEW, zorder=6)
            axes.plot([-host["host"]["y"], -box["y"]], [host["host"]["x"], box["x"]], ":", color=NEW, linewidth=0.9,
                      zorder=4)
        right = -box["y"] < -region[2] - 16
        axes.annotate(f"{box['distance']:.0f} m, {box['score']:.2f}", (-box["y"], box["x"]),
                      xytext=(13 if right else -13, 7), textcoords="offset points", ha="left" if right else "right",
                      color=NEW, fontsize=8.5, zorder=7,
                      bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.5})
    axes.plot(-host["host"]["y"], host["host"]["x"], "*", color=HOST, markersize=12, markeredgecolor="white", zorder=8)
    axes.plot(-mesh[:, 1], mesh[:, 0], ".", color=HOST, markersize=2, zorder=7)
    view_from_above(axes, region)
    made = "one detection made" if len(host["new"]) == 1 else f"{len(host['new'])} detections made"
    axes.set_title(f"{host['title']}: {judged(data)} {host['range']:.0f} m away, {made}; beside: distance from the {judged(data)}, score",
                   loc="left", fontsize=9.5)
    legend(figure, [("ground truth", TRUTH, "-", ""), ("clean", CLEAN, "-", ""), ("attacked", ATTACKED, "--", ""),
                    ("made by the adversary", NEW, "-", ""), (f"{DISTANT:.0f} m or more away", NEW, "", "o"),
                    ("adversary", HOST, "", "*")])
    figure.subplots_adjust(left=0.09, right=0.985, top=0.955, bottom=0.105)
    save(figure, path)


def mark_host(axes, host, colour, stride):
    """The 2-D box of the judged thing."""
    left, top, right, bottom = (value / stride - 0.5 for value in host["window"])
    axes.plot([left, right, right, left, left], [top, top, bottom, bottom, top], color=colour, linewidth=0.9)


def features(data, host, folder, path):
    about = host["features"]
    region = data["region"]
    rows = [("image", [floats(folder, about[k]) for k in ("clean", "attacked")])]
    if "bev" in about:
        rows.append(("bev", [floats(folder, about["bev"][k]) for k in ("clean", "attacked")]))
    image = rows[0][1][0]
    across, along = region[3] - region[2], region[1] - region[0]
    wide, margin, bar, gap, head = 4.8, 0.55, 0.62, 0.12, 0.34  # inches; bar: a colour scale with its numbers
    heights = [wide * image.shape[0] / image.shape[1], wide * along / across][:len(rows)]
    foot = 0.5 if len(rows) > 1 else 0.15
    width, height = margin + 3 * wide + gap + 2 * bar, sum(heights) + len(rows) * head + foot + 0.35
    figure = plt.figure(figsize=(width, height))
    top = height - 0.35
    for (kind, (clean, attacked)), tall in zip(rows, heights):
        top -= head + tall
        most = max(float(np.percentile(m[m > 0], 99.8)) if (m > 0).any() else 1.0 for m in (clean, attacked))
        lefts = (margin, margin + wide + gap, margin + 2 * wide + gap + bar)
        for k, (title, values) in enumerate((("clean", clean), ("attacked", attacked),
                                             ("attacked − clean", attacked - clean))):
            axes = figure.add_axes((lefts[k] / width, top / height, wide / width, tall / height))
            scale = {"cmap": "magma", "vmin": 0, "vmax": most} if k < 2 else {"cmap": "seismic", "vmin": -most, "vmax": most}
            axes.set_title(("image: " if kind == "image" else "bird's-eye view: ") + title, loc="left")
            if kind == "image":
                shown = axes.imshow(values, interpolation="nearest", aspect="auto", **scale)
                if not host.get("camera"):  # otherwise its 2-D box is in another camera than these features
                    mark_host(axes, host, "white" if k < 2 else TEXT, about["stride"])
                axes.set_xticks([])
                axes.set_yticks([])
            else:
                # Columns run ahead, rows to the left: turned so that ahead is up.
                shown = axes.imshow(values.T[:, ::-1], interpolation="nearest", origin="lower",
                                    extent=(-region[3], -region[2], region[0], region[1]), **scale)
                outline(axes, host["host"]["outline"], "white" if k < 2 else TEXT, 0.9)
                view_from_above(axes, region)
                if k > 0:
                    axes.set_ylabel("")
                    axes.set_yticklabels([])
                axes.xaxis.set_major_locator(MaxNLocator(8, prune="both"))
            if k > 0:
                beside = figure.add_axes(((lefts[k] + wide + 0.06) / width, top / height, 0.09 / width, tall / height))
                figure.colorbar(shown, cax=beside).outline.set_visible(False)
                beside.tick_params(labelsize=7)
    figure.text(0.12 / width, 1 - 0.09 / height, f"{host['title']}: magnitude (Euclidean norm over the channels) of the image "
                f"features, and where fusion carries them; outlined: the {judged(data)}", va="top", fontsize=11)
    save(figure, path)


def save(figure, path):
    atomic.save_figure(figure, path, "png", dpi=130)
    plt.close(figure)


def main(out):
    folder = os.path.join(out, "data")
    data = atomic.read_json(folder, "pictures.json")
    draw = {"hidden": hidden, "false_positives": false_positives, "features": features}
    for host in data["hosts"]:
        for kind in host["pictures"]:
            draw[kind](data, host, os.path.join(folder, host["folder"]),
                       os.path.join(out, f"{kind}_{host['name']}.png"))


if __name__ == "__main__":
    atomic.run(main, sys.argv[1])
