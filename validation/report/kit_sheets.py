"""Writes a kit's sheets: the object's skin as nets to print, cut and glue, at true scale, and a plate to mount it on.

    python3 kit_sheets.py DIR

Reads DIR/object.json (`mirage export --kit` writes it); writes DIR/sheets.pdf, DIR/plate.svg and DIR/kit.json. Exit code 3, with why: the
sheet is too small.
"""

import io
import json
import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.dont_write_bytecode = True
sys.path.insert(0, HERE)

try:
    import matplotlib
    import numpy
    from PIL import Image, ImageDraw
    matplotlib.use("Agg")
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure

    import atomic
except ImportError as error:
    sys.exit(f"kit_sheets.py: {error.name}: not installed; install python3-matplotlib and python3-pil")

SHEETS = {"A0": (0.841, 1.189), "A1": (0.594, 0.841), "A2": (0.42, 0.594), "A3": (0.297, 0.42), "A4": (0.21, 0.297)}  # m
MARGIN = 0.012  # m, of a sheet: printers leave it white; two lines of text stand in it
GAP = 0.004  # m between nets
MATERIALS = (("foam", 30, None), ("shell of 2 mm", 1270, 0.002))  # kg/m³, and the wall (None: solid): EPS, PETG
AIR, FAST, BLUFF = 1.225, 50 / 3.6, 1.2  # kg/m³, m/s, drag coefficient of a bluff body (Hoerner, Fluid-Dynamic Drag, 1965)
BRAKE = 8.0  # m/s², an emergency stop
STRAP = 0.025  # m


def flat(a, b, c):
    """A triangle in the plane as seen from outside: a at 0, b on the x axis."""
    ab, ac = b - a, c - a
    length = numpy.linalg.norm(ab)
    x = ac @ ab / length
    return numpy.array([[0, 0], [length, 0], [x, numpy.sqrt(max(ac @ ac - x * x, 0))]])


def beside(start, end, place_a, place_b, place_c):
    """The third corner of a triangle that is unfolded over the edge start–end in the plane, on its right."""
    net = flat(place_a, place_b, place_c)
    along = (end - start) / numpy.linalg.norm(end - start)
    across = numpy.array([along[1], -along[0]])
    # From outside, the next face traverses its edge in the other direction.
    return start + along * (numpy.linalg.norm(end - start) - net[2, 0]) + across * net[2, 1]


def overlap(one, other, least=1e-6):
    """Whether two triangles share more than their rims (separating axes)."""
    for triangle in (one, other):
        for k in range(3):
            edge = triangle[(k + 1) % 3] - triangle[k]
            axis = numpy.array([edge[1], -edge[0]]) / max(numpy.linalg.norm(edge), 1e-12)
            first, second = one @ axis, other @ axis
            if first.max() <= second.min() + least or second.max() <= first.min() + least:
                return False
    return True


def turned(points, turn):
    c, s = numpy.cos(turn), numpy.sin(turn)
    return points @ numpy.array([[c, s], [-s, c]])


def fitted(triangles, size):
    """The turn by which the triangles fit a sheet, or None."""
    points = numpy.concatenate(list(triangles))
    for k in range(12):
        extent = numpy.ptp(turned(points, numpy.pi * k / 12), 0)
        if numpy.all(extent <= size):
            return numpy.pi * k / 12
    return None


def nets(vertices, faces, size):
    """[{face: its triangle in the plane}]: each face once, none over another, each net within `size`. ValueError for a face that
    is too large for it."""
    across = {}
    for f, face in enumerate(faces):
        for k in range(3):
            across.setdefault(frozenset((face[k], face[(k + 1) % 3])), []).append(f)
    area = numpy.linalg.norm(numpy.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]), axis=1)
    free, found = set(range(len(faces))), []
    for seed in numpy.argsort(-area, kind="stable"):
        if seed not in free:
            continue
        net = {int(seed): flat(*vertices[faces[seed]])}
        if fitted(net.values(), size) is None:
            raise ValueError(f"a face of {' x '.join(f'{x:.2f}' for x in numpy.ptp(net[int(seed)], 0))} m is larger than the sheet")
        free.discard(int(seed))
        rim = [(int(seed), k) for k in range(3)]
        while rim:
            f, k = rim.pop(0)
            i, j = faces[f][k], faces[f][(k + 1) % 3]
            for g in across[frozenset((i, j))]:
                if g not in free:
                    continue
                # Its corners, ordered so that the shared edge is j–i.
                at = [n for n in range(3) if faces[g][n] == j and faces[g][(n + 1) % 3] == i]
                if not at:
                    continue
                n = at[0]
                start, end = net[f][k], net[f][(k + 1) % 3]
                apex = beside(start, end, *vertices[[faces[g][n], faces[g][(n + 1) % 3], faces[g][(n + 2) % 3]]])
                triangle = numpy.empty((3, 2))
                triangle[n], triangle[(n + 1) % 3], triangle[(n + 2) % 3] = end, start, apex
                if any(overlap(triangle, placed) for placed in net.values()) or fitted([*net.values(), triangle], size) is None:
                    continue
                net[g] = triangle
                free.discard(g)
                rim += [(g, m) for m in range(3) if m != n]
        turn = fitted(net.values(), size)
        low = numpy.min([turned(t, turn).min(0) for t in net.values()], 0)
        found.append({g: turned(t, turn) - low for g, t in net.items()})
    return found


def packed(found, size):
    """[[net]] for each sheet, moved to their places: rows of nets, the tallest first."""
    sheets, row = [], None
    extents = [numpy.max([t.max(0) for t in net.values()], 0) for net in found]
    for k in sorted(range(len(found)), key=lambda k: -extents[k][1]):
        wide, high = extents[k]
        if row is None or row["x"] + wide > size[0]:
            y = row["y"] + row["high"] + GAP if row else 0
            if row is None or y + high > size[1]:
                sheets.append([])
                y = 0
            row = {"x": 0, "y": y, "high": high}
        sheets[-1].append({g: t + (row["x"], row["y"]) for g, t in found[k].items()})
        row["x"] += wide + GAP
    return sheets


def numbers_of(faces, found):
    """{edge: number} of the edges where nets are glued together."""
    numbers = {}
    for edge, _ in rims(faces, found):
        numbers.setdefault(edge, len(numbers) + 1)
    return numbers


def edges(faces, net):
    """(edge, its place, whether it is folded there) of a net; a fold once, a cut on each of its sides."""
    sides = {}
    for g, triangle in net.items():
        for k in range(3):
            edge = frozenset((int(faces[g][k]), int(faces[g][(k + 1) % 3])))
            sides.setdefault(edge, []).append((triangle[k], triangle[(k + 1) % 3]))
    for edge, places in sides.items():
        folded = len(places) == 2 and numpy.allclose(places[0][0], places[1][1], atol=1e-7) and numpy.allclose(places[0][1], places[1][0], atol=1e-7)
        for place in places[:1] if folded else places:
            yield edge, place, folded


def rims(faces, found):
    """(edge, its place) of every side that is cut."""
    return ((edge, place) for net in found for edge, place, folded in edges(faces, net) if not folded)


def draw(sheets, faces, colours, corners, paper, name, path):
    """One page a sheet, 1:1. `colours` [face][texel], `corners`: barycentrics of a texel's triangle, with its number."""
    numbers = numbers_of(faces, [net for sheet in sheets for net in sheet])
    inch = 0.0254
    points = 72 / inch  # of a metre
    out = io.BytesIO()
    with PdfPages(out, metadata={"CreationDate": None, "Title": name}) as pages:
        for number, sheet in enumerate(sheets, 1):
            figure = Figure(figsize=(paper[0] / inch, paper[1] / inch))
            axes = figure.add_axes([0, 0, 1, 1])
            axes.set_xlim(-MARGIN, paper[0] - MARGIN)
            axes.set_ylim(-MARGIN, paper[1] - MARGIN)
            axes.axis("off")
            polygons, fills, lines, cuts = [], [], [], []
            for net in sheet:
                for g, triangle in net.items():
                    for (b0, b1, b2), texel in corners:
                        polygons.append([b[0] * triangle[0] + b[1] * triangle[1] + (1 - b[0] - b[1]) * triangle[2] for b in (b0, b1, b2)])
                        fills.append(colours[g][texel])
                for edge, place, folded in edges(faces, net):
                    if folded:
                        lines.append(place)
                        continue
                    cuts.append(place)
                    middle, along = (place[0] + place[1]) / 2, place[1] - place[0]
                    inside = middle + numpy.array([-along[1], along[0]]) / numpy.linalg.norm(along) * 0.003
                    turn = numpy.degrees(numpy.arctan2(along[1], along[0]))
                    axes.text(*inside, str(numbers[edge]), fontsize=6, ha="center", va="center", rotation=turn,
                              bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.4})
            # Neighbours are drawn over a hair of each other, so that no paper shows between texels.
            axes.add_collection(PolyCollection(polygons, facecolors=fills, edgecolors=fills, linewidths=0.05 * points / 1000))
            axes.add_collection(LineCollection(lines, colors="#888888", linewidths=0.4, linestyles=(0, (4, 3))))
            axes.add_collection(LineCollection(cuts, colors="black", linewidths=0.5))
            axes.plot([0, 0.1], [-0.006, -0.006], color="black", linewidth=0.8)
            axes.text(0.103, -0.006, f"100 mm · {name} · sheet {number} of {len(sheets)} · cut along lines, fold along dashes, join equal numbers",
                      fontsize=9, va="center")
            pages.savefig(figure)
    atomic.write(path, out.getvalue())


def frontal_area(vertices, faces):
    """m² of the silhouette seen from ahead, at 2 mm."""
    step = 0.002
    low = vertices.min(0)
    size = numpy.ceil(numpy.ptp(vertices, 0) / step).astype(int) + 1
    picture = Image.new("1", (int(size[1]), int(size[2])))
    pen = ImageDraw.Draw(picture)
    for face in faces:
        pen.polygon([tuple((vertices[v][1:] - low[1:]) / step) for v in face], fill=1)
    return float(numpy.count_nonzero(numpy.asarray(picture)) * step * step)


def plate(vertices, faces, path, name):
    """The base's outline and four slots for two straps, in millimetres; returns its extents (m)."""
    floor = vertices[:, 2].min() + 1e-4
    base = [face for face in faces if numpy.all(vertices[face][:, 2] <= floor)]
    sides = {}
    for face in base:
        for k in range(3):
            sides.setdefault(frozenset((int(face[k]), int(face[(k + 1) % 3]))), []).append((face[k], face[(k + 1) % 3]))
    outline = [pair[0] for pair in sides.values() if len(pair) == 1]
    points = vertices[numpy.unique(base)][:, :2] if base else vertices[:, :2]
    low, high = points.min(0) - 0.06, points.max(0) + 0.06
    size = high - low
    millimetres = lambda point: ((point - low) * 1000).round(2)
    shapes = []
    for a, b in outline:
        (x1, y1), (x2, y2) = millimetres(vertices[a][:2]), millimetres(vertices[b][:2])
        shapes.append(f'<path d="M{x1} {size[1] * 1000 - y1:.2f}L{x2} {size[1] * 1000 - y2:.2f}"/>')
    for x in (0.25, 0.75):
        for y in (0.015, size[1] - 0.015 - 0.006):
            shapes.append(f'<rect x="{1000 * (x * size[0] - STRAP / 2):.1f}" y="{1000 * y:.1f}" width="{1000 * STRAP:.0f}" height="6"/>')
    w, h = size * 1000
    atomic.write(path, f'<svg xmlns="http://www.w3.org/2000/svg" width="{w:.1f}mm" height="{h:.1f}mm" viewBox="0 0 {w:.1f} {h:.1f}" fill="none" '
                 f'stroke="#000" stroke-width="0.5"><title>{name}: plate under the base, slots for straps</title>'
                 f'<rect x="0" y="0" width="{w:.1f}" height="{h:.1f}"/>{"".join(shapes)}</svg>\n')
    return size.tolist()


def main(folder):
    told = atomic.read_json(folder, "object.json")
    vertices, faces = numpy.array(told["vertices"], float), numpy.array(told["faces"], int)
    paper = SHEETS[told["sheet"]]
    size = numpy.array(paper) - 2 * MARGIN
    sheets = packed(nets(vertices, faces, size), size)
    count = len(told["texels"]) // len(faces)
    colours = [told["texels"][f * count:(f + 1) * count] for f in range(len(faces))]
    draw(sheets, faces, colours, [(each["corners"], each["texel"]) for each in told["triangles"]], paper, told["name"],
         os.path.join(folder, "sheets.pdf"))
    crossed = numpy.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    area = float(numpy.linalg.norm(crossed, axis=1).sum() / 2)
    volume = sum(part["volume_m3"] for part in told["parts"])
    front = frontal_area(vertices, faces)
    drag = AIR / 2 * FAST**2 * BLUFF * front
    masses = [{"made_of": name, "density": density, "kg": density * (volume if wall is None else area * wall)} for name, density, wall in MATERIALS]
    kit = {"parts": told["parts"], "bed_m": told["bed"], "sheet": told["sheet"], "sheets": len(sheets), "files": ["object.3mf", "sheets.pdf", "plate.svg"],
           "volume_m3": volume, "area_m2": area, "masses": masses, "frontal_area_m2": front, "drag_at_50_kmh_n": drag,
           "plate_m": plate(vertices, faces, os.path.join(folder, "plate.svg"), told["name"]),
           "strap_force_n": max(each["kg"] for each in masses) * BRAKE + drag, "judged_shape_m": told["judged_shape_m"]}
    atomic.write(os.path.join(folder, "kit.json"), json.dumps(kit, indent=1) + "\n")


if __name__ == "__main__":
    try:
        atomic.run(main, sys.argv[1])
    except ValueError as error:
        print(error)
        sys.exit(3)  # the sheet is wrong, not this
