"""Pictures of a vehicle for the page: windows of the photographs, enlarged crops, the sweep from above."""

import base64
import io
import math
import os

from markupsafe import Markup, escape
from PIL import Image

WIDE = 1100  # pixels of a window of the photograph, at most
WINDOW = 2.25  # width over height of a window of the photograph
BEV = 520  # pixels of the map's side


def data_uri(data, kind):
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def photo(path, box):
    """A window of a photograph as JPEG, enlarged by a whole factor as far as WIDE allows."""
    with Image.open(path) as file:
        image = file.convert("RGB").crop(box)
    factor = max(1, WIDE // image.width)
    if factor > 1:
        image = image.resize((image.width * factor, image.height * factor), Image.BICUBIC)
    out = io.BytesIO()
    image.save(out, "JPEG", quality=86)
    return data_uri(out.getvalue(), "image/jpeg")


def pixels(path):
    """A crop as PNG; the page enlarges it without smoothing."""
    with Image.open(path) as file:
        image = file.convert("RGB")
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    return {"uri": data_uri(out.getvalue(), "image/png"), "width": image.width, "height": image.height}


def window(host, size):
    """A wide window (WINDOW : 1) of the photograph around the vehicle and the object on it."""
    (l, t, r, b), (cl, ct, cr, cb) = host["host_rect"], host["crop_rect"]
    left, top, right, bottom = min(l, cl), min(t, ct), max(r, cr), max(b, cb)
    width = max(300, 2.4 * (right - left), 2.6 * (bottom - top))
    width = min(width, size[0], WINDOW * size[1])
    height = width / WINDOW
    x, y = (left + right) / 2, (top + bottom) / 2
    x = min(max(x, width / 2), size[0] - width / 2)
    y = min(max(y, height / 2), size[1] - height / 2)
    return int(x - width / 2), int(y - height / 2), int(x + width / 2), int(y + height / 2)


def triptych(folder, host):
    """Clean, attacked and Cycles on top of one another, and the initial places of the bars between them."""
    files = {name: os.path.join(folder, host["pictures"][name]) for name in ("clean", "attacked", "cycles")}
    with Image.open(files["clean"]) as image:
        box = window(host, image.size)
    # The first bar stands beside the object, the second through its middle.
    width, (left, _, right, _) = box[2] - box[0], host["crop_rect"]
    middle = min(max(((left + right) / 2 - box[0]) / width, 0.2), 0.85)
    beside = min(max((left - box[0]) / width - 0.05, 0.12), middle - 0.06)
    return {**{name: photo(path, box) for name, path in files.items()}, "bars": [round(beside, 3), round(middle, 3)],
            "window": box}


def crops(folder, host):
    return {name: pixels(os.path.join(folder, host["pictures"][name]))
            for name in ("raster_crop", "cycles_crop", "difference", "matched_raster", "matched_cycles",
                         "matched_difference")}


def place(x, y, view):
    """velo (x ahead, y left) to the map: x up, y to the left, the vehicle in the middle."""
    reach, (cx, cy) = view["reach"], view["host"][:2]
    return BEV / 2 - (y - cy) / reach * BEV / 2, BEV / 2 - (x - cx) / reach * BEV / 2


def point_map(points, view):
    """Returns as a see-through PNG of one grey, which both themes can show."""
    image = Image.new("LA", (BEV, BEV), (128, 0))
    data = image.load()
    for x, y in points:
        u, v = place(x, y, view)
        if 0 <= u < BEV and 0 <= v < BEV:
            data[int(u), int(v)] = (128, 255)
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    return data_uri(out.getvalue(), "image/png")


def box_mark(box, view, kind, tip=""):
    x, y, length, breadth, yaw = box
    c, s = math.cos(yaw), math.sin(yaw)
    corners = [(dx * length / 2, dy * breadth / 2) for dx, dy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    points = [place(x + c * a - s * b, y + s * a + c * b, view) for a, b in corners]
    text = " ".join(f"{u:.1f},{v:.1f}" for u, v in points)
    return f'<polygon class="box {kind}" points="{text}"><title>{escape(tip)}</title></polygon>'


def picture_mark(box, kind, tip):
    left, top, right, bottom = box
    return (f'<rect class="box {kind}" x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}">'
            f'<title>{escape(tip)}</title></rect>')


def in_picture(host, scenes, words):
    """[(class, title, SVG)]: the same windows as in the triptych with the boxes that the detector finds there. `words`: report.words."""
    view = host["picture_boxes"]
    left, top, right, bottom = scenes["window"]
    panels = []
    for key, kind, title, scene in (("clean", "clean", words["recorded"].capitalize(), "clean"),
                                    ("raster", "raster", "Attacked, rasteriser", "attacked"),
                                    ("cycles", "cycles", "Attacked, Cycles", "cycles")):
        parts = [f'<image href="{scenes[scene]}" x="{left}" y="{top}" width="{right - left}" height="{bottom - top}"/>']
        parts += [picture_mark(box, "truth", "label") for box in view["truth"]]
        parts.append(picture_mark(view["host"], "host", words["judged"]))
        parts += [picture_mark(found["box"], kind, f"score {found['score']:.2f}") for found in view[key]]
        panels.append((kind, title, Markup(f'<svg class="bev seen" viewBox="{left} {top} {right - left} {bottom - top}" role="img" '
                                           f'aria-label="{escape(title)}">{"".join(parts)}</svg>')))
    return panels


def bev(host, words):
    """[(class, title, SVG)]: the sweep from above as recorded, attacked, and attacked with the Cycles picture. `words`: report.words."""
    view = host["bev"]
    sweep = point_map(view["points"], view)
    panels = []
    for key, kind, title in (("clean", "clean", words["recorded"].capitalize()), ("raster", "raster", "Attacked, rasteriser"),
                             ("cycles", "cycles", "Attacked, Cycles")):
        parts = []
        if key == "clean":  # the other two maps show the same picture
            parts.append(f'<image id="sweep-{escape(host["name"])}" href="{sweep}" width="{BEV}" height="{BEV}"/>')
        else:
            parts.append(f'<use href="#sweep-{escape(host["name"])}"/>')
            for x, y in view["adversary_points"]:
                u, v = place(x, y, view)
                parts.append(f'<circle class="hit" cx="{u:.1f}" cy="{v:.1f}" r="1.6"/>')
        for box in view["truth"]:
            parts.append(box_mark(box, view, "truth", "label"))
        parts.append(box_mark(view["host"], view, "host", words["judged"]))
        for found in view[key]:
            parts.append(box_mark(found["box"], view, kind, f"score {found['score']:.2f}"))
        scale = 5 / view["reach"] * BEV / 2
        parts.append(f'<line class="scale" x1="16" y1="{BEV - 16}" x2="{16 + scale:.1f}" y2="{BEV - 16}"/>'
                     f'<text class="tick" x="16" y="{BEV - 24}">5 m</text>')
        panels.append((kind, title, Markup(f'<svg class="bev" viewBox="0 0 {BEV} {BEV}" role="img" aria-label='
                                           f'"{escape(title)}">{"".join(parts)}</svg>')))
    return panels
