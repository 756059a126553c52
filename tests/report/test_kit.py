"""`mirage export --kit`: test_kit.py SOURCE BUILD. Parts are closed and make up the object, sheets hold each face once at true size."""

import collections
import json
import os
import re
import subprocess
import sys
import tempfile
import unittest
import zipfile
import zlib
from xml.etree import ElementTree

import numpy

SOURCE, BUILD = (os.path.abspath(path) for path in sys.argv[1:3])
sys.path.insert(0, os.path.join(SOURCE, "validation", "report"))
import kit_sheets  # noqa: E402

FOLDER = tempfile.TemporaryDirectory(prefix="mirage-kit-")
BED = (0.6, 0.5, 0.4)


def at(*names):
    return os.path.join(FOLDER.name, *names)


def mirage(*arguments):
    return subprocess.run([os.path.join(BUILD, "mirage"), *arguments, "--quiet"], capture_output=True, text=True,
                          env={**os.environ, "MIRAGE_CACHE": "off"})


def setUpModule():
    for arguments in (("generate", "--frames", "2", "--seed", "5", "--out", at("data")),
                      ("attack", "--data", at("data"), "--detector", "lidar", "--target", "random", "--out", at("run")),
                      ("export", "--run", at("run"), "--kit", "--bed", ",".join(map(str, BED)), "--sheet", "A0", "--out", at("out"))):
        done = mirage(*arguments)
        if done.returncode:
            raise RuntimeError(done.stderr)


def tearDownModule():
    FOLDER.cleanup()


def stl(path):
    """Corners, faces × 3 × 3, in metres."""
    with open(path, "rb") as file:
        data = file.read()
    rows = numpy.frombuffer(data[84:], numpy.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")]))
    assert len(rows) == int.from_bytes(data[80:84], "little")
    return rows["corners"].astype(float) / 1000


def volume(corners):
    return numpy.einsum("ij,ij->", corners[:, 0], numpy.cross(corners[:, 1], corners[:, 2])) / 6


def distance(points, triangles):
    """Distance of each point to the nearest triangle, m."""
    nearest = numpy.full(len(points), numpy.inf)
    for a, b, c in triangles:
        normal = numpy.cross(b - a, c - a)
        normal = normal / numpy.linalg.norm(normal)
        inside = numpy.ones(len(points), bool)
        to_rim = numpy.full(len(points), numpy.inf)
        for p, q in ((a, b), (b, c), (c, a)):
            side = q - p
            inside &= (points - p) @ numpy.cross(normal, side) >= 0
            along = numpy.clip((points - p) @ side / (side @ side), 0, 1)
            to_rim = numpy.minimum(to_rim, numpy.linalg.norm(points - p - along[:, None] * side, axis=1))
        nearest = numpy.minimum(nearest, numpy.where(inside, abs((points - a) @ normal), to_rim))
    return nearest


class Kit(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with open(at("out", "kit", "kit.json"), encoding="utf-8") as file:
            cls.kit = json.load(file)
        with open(at("out", "kit", "object.json"), encoding="utf-8") as file:
            cls.object = json.load(file)
        cls.vertices, cls.faces = numpy.array(cls.object["vertices"]), numpy.array(cls.object["faces"])
        cls.parts = {part["name"]: stl(at("out", "kit", part["file"])) for part in cls.kit["parts"]}

    def test_each_part_is_closed_and_fits_the_bed(self):
        self.assertGreater(len(self.parts), 4)
        for name, corners in self.parts.items():
            sides = collections.Counter()
            for triangle in numpy.round(corners * 1e6).astype(int):
                points = [tuple(p) for p in triangle]
                for k in range(3):
                    sides[points[k], points[(k + 1) % 3]] += 1
            for (a, b), count in sides.items():
                self.assertEqual(sides[b, a], count, name)
            self.assertTrue(numpy.all(numpy.ptp(corners.reshape(-1, 3), 0) <= numpy.array(BED) + 1e-6), name)
            self.assertGreater(volume(corners), 0)

    def test_together_they_are_the_object(self):
        whole = volume(self.vertices[self.faces])
        self.assertAlmostEqual(sum(map(volume, self.parts.values())) / whole, 1, delta=1e-5)
        self.assertAlmostEqual(self.kit["volume_m3"] / whole, 1, delta=1e-5)
        points = numpy.unique(numpy.round(numpy.concatenate([c.reshape(-1, 3) for c in self.parts.values()]), 6), axis=0)
        for vertex in self.vertices:
            self.assertLess(numpy.linalg.norm(points - vertex, axis=1).min(), 1e-5)
        # A corner within the object lies on a plane of the cut, which it shares with another part.
        far = distance(points, self.vertices[self.faces]) > 1e-3
        inner = points[far]
        owners = sum(numpy.array([numpy.linalg.norm(numpy.round(c.reshape(-1, 3), 6) - p, axis=1).min() < 1e-5 for p in inner])
                     for c in self.parts.values()) if len(inner) else numpy.array([2])
        self.assertGreaterEqual(owners.min(), 2)

    def test_the_3mf_holds_the_same_parts(self):
        with zipfile.ZipFile(at("out", "kit", "object.3mf")) as archive:
            self.assertIn("[Content_Types].xml", archive.namelist())
            root = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
        self.assertEqual(root.get("unit"), "millimeter")
        space = root.tag.split("}")[0] + "}"
        objects = root.findall(f"{space}resources/{space}object")
        self.assertEqual([each.get("name") for each in objects], list(self.parts))
        self.assertEqual(len(root.findall(f"{space}build/{space}item")), len(self.parts))
        for each in objects:
            vertices = numpy.array([[float(v.get(k)) for k in "xyz"] for v in each.iter(space + "vertex")]) / 1000
            faces = numpy.array([[int(t.get(k)) for k in ("v1", "v2", "v3")] for t in each.iter(space + "triangle")])
            self.assertLess(abs(vertices[faces] - self.parts[each.get("name")]).max(), 1e-6)

    def test_sheets_hold_each_face_once_at_true_size(self):
        size = numpy.array(kit_sheets.SHEETS["A0"]) - 2 * kit_sheets.MARGIN
        sheets = kit_sheets.packed(kit_sheets.nets(self.vertices, self.faces, size), size)
        self.assertEqual(len(sheets), self.kit["sheets"])
        seen = []
        for sheet in sheets:
            placed = [(g, triangle) for net in sheet for g, triangle in net.items()]
            seen += [g for g, _ in placed]
            for k, (g, triangle) in enumerate(placed):
                for i in range(3):
                    true = numpy.linalg.norm(self.vertices[self.faces[g][i]] - self.vertices[self.faces[g][(i + 1) % 3]])
                    self.assertAlmostEqual(numpy.linalg.norm(triangle[i] - triangle[(i + 1) % 3]), true, delta=1e-6)
                (ax, ay), (bx, by), (cx, cy) = triangle
                self.assertGreater((bx - ax) * (cy - ay) - (by - ay) * (cx - ax), 0, "seen from outside, not mirrored")
                self.assertTrue(numpy.all(triangle >= -1e-9) and numpy.all(triangle <= size + 1e-9))
                for _, other in placed[:k]:
                    self.assertFalse(kit_sheets.overlap(triangle, other, 1e-5))
        self.assertEqual(sorted(seen), list(range(len(self.faces))))
        # Each cut edge has the same number on its two sides.
        numbers = kit_sheets.numbers_of(self.faces, [net for sheet in sheets for net in sheet])
        sides = collections.Counter(edge for edge, _ in kit_sheets.rims(self.faces, [net for sheet in sheets for net in sheet]))
        self.assertEqual(set(sides.values()), {2})
        self.assertEqual(sorted(numbers.values()), list(range(1, len(sides) + 1)))

    def test_the_pdf_has_pages_at_true_scale_and_every_texels_colour(self):
        with open(at("out", "kit", "sheets.pdf"), "rb") as file:
            data = file.read()
        boxes = re.findall(rb"/MediaBox \[ ([^\]]+) \]", data)
        self.assertEqual(len(boxes), self.kit["sheets"])
        for box in boxes:
            for points, metres in zip(map(float, box.split()[2:]), kit_sheets.SHEETS["A0"]):
                self.assertAlmostEqual(points / 72 * 0.0254, metres, delta=1e-4)
        drawn = set()
        for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.S):
            try:
                text = zlib.decompress(stream)
            except zlib.error:
                continue
            for colour in re.findall(rb"([\d.]+)\s([\d.]+)\s([\d.]+)\srg", text):
                drawn.add(tuple(round(100 * float(c)) for c in colour))
        texels = {tuple(round(100 * c) for c in texel) for texel in self.object["texels"]}
        self.assertGreater(len(texels), 300)
        self.assertEqual(texels - drawn, set())

    def test_loads_are_those_of_its_size(self):
        extents = numpy.ptp(self.vertices, 0)
        self.assertLess(self.kit["frontal_area_m2"], extents[1] * extents[2])
        self.assertGreater(self.kit["frontal_area_m2"], 0.4 * extents[1] * extents[2])
        speed = 50 / 3.6
        self.assertAlmostEqual(self.kit["drag_at_50_kmh_n"], 1.225 / 2 * speed * speed * 1.2 * self.kit["frontal_area_m2"], places=6)
        foam = next(each for each in self.kit["masses"] if each["made_of"] == "foam")
        self.assertAlmostEqual(foam["kg"], 30 * self.kit["volume_m3"], places=9)
        with open(at("out", "kit", "plate.svg"), encoding="utf-8") as file:
            plate = file.read()
        self.assertIn(f'width="{1000 * self.kit["plate_m"][0]:.1f}mm"', plate)
        self.assertEqual(plate.count("<rect"), 1 + 4)

    def test_twice_the_same_bytes(self):
        again = at("again")
        self.assertEqual(mirage("export", "--run", at("run"), "--kit", "--bed", ",".join(map(str, BED)), "--sheet", "A0", "--out", again).returncode, 0)
        for name in ("object.3mf", "sheets.pdf", "plate.svg", "kit.json"):
            with open(os.path.join(again, "kit", name), "rb") as one, open(at("out", "kit", name), "rb") as other:
                self.assertEqual(one.read(), other.read(), name)

    def test_what_cannot_be_built_is_refused_in_a_line(self):
        done = mirage("export", "--run", at("run"), "--kit", "--bed", "0.05,0.05,0.05", "--out", at("small"))
        self.assertEqual(done.returncode, 1)
        self.assertIn("use a larger bed", done.stderr)
        done = mirage("export", "--run", at("run"), "--kit", "--sheet", "A9", "--out", at("small"))
        self.assertEqual(done.returncode, 2)
        self.assertIn("A3", done.stderr)
        os.makedirs(at("large"))
        with open(at("large", "object.json"), "w", encoding="utf-8") as file:
            json.dump({**self.object, "vertices": (5 * self.vertices).tolist(), "sheet": "A4"}, file)
        done = subprocess.run([sys.executable, os.path.join(SOURCE, "validation", "report", "kit_sheets.py"), at("large")],
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 3)
        self.assertIn("larger than the sheet", done.stdout)
        self.assertEqual(os.listdir(at("large")), ["object.json"])


class Nets(unittest.TestCase):
    def test_a_cube_unfolds_into_one_net(self):
        corners = numpy.array([[x, y, z] for z in (0, 0.1) for y in (0, 0.1) for x in (0, 0.1)])
        faces = numpy.array([[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2],
                             [1, 3, 7], [1, 7, 5]])
        found = kit_sheets.nets(corners, faces, numpy.array([0.6, 0.6]))
        self.assertEqual([len(net) for net in found], [12])
        # 12 faces in one net: 11 folds, and of 18 edges 7 are cut, on two sides each.
        self.assertEqual(len(list(kit_sheets.rims(faces, found))), 14)
        with self.assertRaisesRegex(ValueError, "larger than the sheet"):
            kit_sheets.nets(corners, faces, numpy.array([0.09, 0.09]))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
