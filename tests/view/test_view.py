"""The page of `mirage view` in headless Chromium: test_view.py SOURCE BUILD. Exit code 77: skipped, with why.

Of a folder of a hundred frames, of one with a detector's boxes, of a run and of a drive: the page opens without console errors and
asks for nothing but itself, frames show, slider, keys and mouse do what they say, what is drawn is what the files
hold, and both themes draw."""

import json
import math
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest

from PIL import Image

SOURCE, BUILD = (os.path.abspath(path) for path in sys.argv[1:3])
sys.path.insert(0, os.path.join(SOURCE, "tests", "report"))
import browser  # noqa: E402

FRAMES = 100
PARTS = (("image_2", ".png"), ("velodyne", ".bin"), ("calib", ".txt"), ("label_2", ".txt"), ("lighting", ".json"))
FOLDER = tempfile.TemporaryDirectory(prefix="mirage-view-")


def at(*names):
    return os.path.join(FOLDER.name, *names)


def mirage(*arguments):
    """(exit code, standard error)"""
    done = subprocess.run([os.path.join(BUILD, "mirage"), *arguments], capture_output=True, text=True,
                          env={**os.environ, "MIRAGE_CACHE": "off"})
    return done.returncode, done.stderr


def made(*arguments):
    code, said = mirage(*arguments, "--quiet")
    if code:
        raise RuntimeError(f"mirage {' '.join(arguments)}: {said}")


def read(*names):
    with open(at(*names), encoding="utf-8") as file:
        return json.load(file)


def streets():
    """A generated drive of two seconds, in KITTI's tracking layout."""
    if not os.path.exists(at("streets")):
        made("generate", "--drives", "1", "--seconds", "2", "--seed", "5", "--out", at("streets"))


def change_return(sweep):
    """Changes the reflectance of its first return."""
    with open(sweep, "rb") as file:
        points = bytearray(file.read())
    points[12] ^= 1
    with open(sweep, "wb") as file:
        file.write(points)


def setUpModule():
    """data: the three frames that ctest makes (frames.generated); many: a hundred that are these by turns."""
    os.symlink(os.path.join(BUILD, "test_data"), at("data"))
    for index in range(FRAMES):
        for part, extension in PARTS:
            os.makedirs(at("many", "training", part), exist_ok=True)
            os.symlink(at("data", "training", part, f"{index % 3:06d}{extension}"),
                       at("many", "training", part, f"{index:06d}{extension}"))


def tearDownModule():
    FOLDER.cleanup()


class Opened(unittest.TestCase):
    """A page in a browser; `arguments` of mirage view, `name` of the page."""

    arguments = ()
    size = (1440, 900)

    @classmethod
    def setUpClass(cls):
        cls.path = at(cls.__name__ + ".html")
        made("view", *(argument.format(FOLDER.name) for argument in cls.arguments), "--out", cls.path)
        with open(cls.path.replace(".html", ".result.json"), encoding="utf-8") as file:
            cls.result = json.load(file)
        cls.browser = browser.Browser(cls.size)
        cls.addClassCleanup(cls.browser.__exit__)
        cls.browser.theme("light")
        cls.browser.open(cls.path)
        cls.browser.wait_for("document.documentElement.dataset.frame !== undefined")

    @classmethod
    def shown(cls, frame):
        cls.browser.wait_for(f"document.documentElement.dataset.frame === {json.dumps(frame)}")

    def setUp(self):
        self.key("Home")
        self.shown(self.browser.run("about().frames[0]"))
        self.key("0")

    def tearDown(self):
        self.assertEqual(self.browser.errors, [])
        self.assertEqual([url[:99] for url in self.browser.requests
                          if not url.startswith(("data:", "blob:")) and not url.endswith(self.path)], [])

    def key(self, key, **more):
        codes = {"Home": 36, "End": 35, "ArrowLeft": 37, "ArrowRight": 39, " ": 32, "[": 219, "]": 221}
        for kind in ("keyDown", "keyUp"):
            self.browser.call("Input.dispatchKeyEvent", type=kind, key=key,
                              windowsVirtualKeyCode=codes.get(key, ord(key[0].upper())), **more)

    def settle(self):
        self.browser.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def place(self, selector):
        """Left, top, width, height in the window, scrolled into it."""
        return self.browser.run(f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
                                "e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
                                "return [r.x, r.y, r.width, r.height] })()")

    def pixels(self, selector):
        """{colour: how often} of a canvas."""
        return self.browser.run(
            f"(() => {{ const c = document.querySelector({json.dumps(selector)}), d = c.getContext('2d')"
            ".getImageData(0, 0, c.width, c.height).data, found = {};"
            "for (let i = 0; i < d.length; i += 4) { const k = d[i] + ',' + d[i + 1] + ',' + d[i + 2];"
            "if (d[i + 3] > 250) found[k] = (found[k] ?? 0) + 1 } return found })()")


class HundredFrames(browser.PageChecks, Opened):
    arguments = ("{}/many", "--size", "60")

    def test_every_tenth_frame_shows(self):
        seconds = self.browser.run("""(async () => {
          const times = [], root = document.documentElement;
          for (let k = 10; k < about().frames.length; k += 10) {
            const start = performance.now();
            dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowRight", shiftKey: true}));
            while (root.dataset.frame !== about().frames[k]) await new Promise(done => setTimeout(done, 2));
            times.push((performance.now() - start) / 1000);
          }
          return times })()""")
        self.assertEqual(len(seconds), FRAMES // 10 - 1)
        print(f"\n100 frames: {self.result['bytes'] / 1e6:.1f} MB, a frame {sum(seconds) / len(seconds):.3f} s, "
              f"the slowest {max(seconds):.3f} s")

    def test_size_is_bounded_and_told(self):
        self.assertLessEqual(os.path.getsize(self.path), 60e6)
        self.assertEqual(os.path.getsize(self.path), self.result["bytes"])
        said = self.browser.run("document.getElementById('about-page').textContent")
        self.assertIn(f"{self.browser.run('about().megabytes')} MB", said)
        self.assertAlmostEqual(self.browser.run("about().megabytes"), self.result["bytes"] / 1e6, delta=0.15)

    def test_frames_are_decoded_when_they_are_looked_at(self):
        self.assertLessEqual(self.browser.run("decoded.size"), 6)

    def test_slider_and_keys_choose_the_frame(self):
        x, y, width, height = self.place("#slider")
        self.browser.drag((x + 8, y + height / 2), (x + width / 2, y + height / 2))
        middle = self.browser.run("+document.getElementById('slider').value")
        self.assertTrue(40 < middle < 60, middle)
        self.shown(f"{middle:06d}")
        self.key("ArrowLeft")
        self.shown(f"{middle - 1:06d}")
        self.key("ArrowRight", modifiers=8)  # Shift
        self.shown(f"{middle + 9:06d}")
        self.key("End")
        self.shown(f"{FRAMES - 1:06d}")
        self.key("ArrowRight")
        self.assertEqual(self.browser.run("document.getElementById('place').textContent"), f"{FRAMES - 1:06d} · 100 of 100")

    def test_it_plays_and_stops(self):
        self.key(" ")
        self.shown("000002")
        self.key(" ")
        self.assertEqual(self.browser.run("document.getElementById('play').textContent"), "Play")

    def test_points_are_those_of_the_sweep(self):
        with open(at("data", "training", "velodyne", "000000.bin"), "rb") as file:
            sweep = list(struct.iter_unpack("<4f", file.read()))
        self.assertEqual(self.result["kept_points"], self.result["points"])
        shown = self.browser.run("frameAt(0).then(f => ['x', 'y', 'z', 'reflectance'].map(k => [...f.points[k]]))")
        self.assertEqual(len(shown[0]), len(sweep))
        for k, least in ((0, 0.00501), (1, 0.00501), (2, 0.00501), (3, 0.002)):
            self.assertLess(max(abs(a - b[k]) for a, b in zip(shown[k], sweep)), least)

    def test_picture_is_the_photograph(self):
        with Image.open(at("data", "training", "image_2", "000000.png")) as image:
            real = image.convert("RGB").resize((62, 19), Image.BOX).tobytes()
        seen = self.browser.run("frameAt(0).then(f => { const c = new OffscreenCanvas(62, 19), x = c.getContext('2d');"
                                "x.imageSmoothingQuality = 'high'; x.drawImage(f.cameras[0].photo, 0, 0, 62, 19);"
                                "return [...x.getImageData(0, 0, 62, 19).data].filter((_, i) => i % 4 < 3) })")
        self.assertLess(sum(abs(a - b) for a, b in zip(real, seen)) / len(seen), 6)

    def test_boxes_lie_where_the_labels_are(self):
        # Each label's 2-D box holds the middle of its projected box; the two come from different numbers.
        pairs = self.browser.run("columns[0].views[0].drawn.filter(d => d.box.box && !d.box.truncated && !d.box.occluded)"
                                 ".map(d => { const v = columns[0].views[0], w = v.window(v.canvas.clientWidth, v.canvas.clientHeight);"
                                 "return [d.left, d.top, d.right, d.bottom].map((x, i) => (x - (i % 2 ? w.top : w.left)) / w.s)"
                                 ".concat(d.box.picture) })")
        self.assertGreater(len(pairs), 0)
        for left, top, right, bottom, *label in pairs:
            self.assertTrue(label[0] <= (left + right) / 2 <= label[2], (left, right, label))
            self.assertTrue(label[1] <= (top + bottom) / 2 <= label[3], (top, bottom, label))
            self.assertLess(abs((right - left) - (label[2] - label[0])), 0.25 * (label[2] - label[0]) + 4)

    def test_colours(self):
        seen = {}
        for key in "hri":
            self.key(key)
            self.settle()
            seen[key] = self.pixels(".top canvas")
            self.assertEqual(self.browser.run("document.querySelector('#colour [aria-pressed=true]').value")[0], key)
            self.assertGreater(sum(seen[key].values()), 3000)
        self.assertNotEqual(seen["h"], seen["r"])
        hues = self.browser.run("INSTANCES.light.map(c => rgb(c).join())")
        self.assertTrue(any(seen["i"].get(hue, 0) > 20 for hue in hues))
        self.assertIn("labelled boxes", self.browser.run("document.getElementById('ramp-name').textContent"))
        self.key("h")

    def test_layers_and_views(self):
        green = self.browser.run("rgb(css('truth')).join()")
        drawn = "columns[0].views[1].drawn.length"
        self.assertGreater(self.browser.run(drawn), 0)
        self.key("l")
        self.settle()
        self.assertEqual(self.browser.run(drawn), 0)
        self.assertNotIn(green, self.pixels(".top canvas"))
        self.key("l")
        widths = lambda: self.browser.run("['.top', '.orbit'].map(s => document.querySelector(s).offsetWidth)")
        for expected in ((True, False), (False, True), (True, True)):
            self.key("v")
            self.settle()
            self.assertEqual(tuple(width > 0 for width in widths()), expected)

    def test_scale_bar_is_true(self):
        bar = self.browser.run("columns[0].views[1].bar")
        apart = self.browser.run("(() => { const v = columns[0].views[1], a = v.place(10, 0, 0), b = v.place(20, 0, 0);"
                                 "return a[1] - b[1] })()")
        self.assertAlmostEqual(bar["pixels"] / bar["metres"], apart / 10, places=6)

    def test_mouse_turns_moves_and_zooms(self):
        x, y, width, height = self.place(".orbit canvas")
        before = self.browser.run("({...eyes.orbit})")
        self.browser.drag((x + width / 2, y + height / 2), (x + width / 2 + 80, y + height / 2 + 20))
        self.assertNotEqual(self.browser.run("eyes.orbit.heading"), before["heading"])
        self.browser.call("Input.dispatchMouseEvent", type="mouseWheel", x=x + width / 2, y=y + height / 2, deltaX=0, deltaY=-300)
        self.settle()
        self.assertLess(self.browser.run("eyes.orbit.distance"), before["distance"])
        x, y, width, height = self.place(".top canvas")
        # The place under the pointer stays fixed when it zooms.
        under = ("(() => { const v = columns[0].views[1]; v.look(v.canvas.clientWidth, v.canvas.clientHeight);"
                 "return [v.eye.x - (60 - v.canvas.clientHeight / 2) / v.scale, v.eye.y - (90 - v.canvas.clientWidth / 2) / v.scale] })()")
        place = self.browser.run(under)
        self.browser.call("Input.dispatchMouseEvent", type="mouseWheel", x=round(x) + 90, y=round(y) + 60, deltaX=0, deltaY=-200)
        self.settle()
        for a, b in zip(place, self.browser.run(under)):
            self.assertAlmostEqual(a, b, delta=0.2)
        self.key("0")
        self.assertEqual(self.browser.run("({...eyes.orbit})"), before)

    def test_pointing_at_a_box_tells_about_it(self):
        x, y, *_ = self.place(".top canvas")
        u, v = self.browser.run("(() => { const v = columns[0].views[1], d = v.drawn.find(d => d.left > 0 && d.top > 0 && d.right < v.canvas.clientWidth && d.bottom < v.canvas.clientHeight); return [(d.left + d.right) / 2, (d.top + d.bottom) / 2] })()")
        self.browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + u, y=y + v)
        said = self.browser.run("document.getElementById('tip').hidden ? '' : document.getElementById('tip').textContent")
        self.assertIn("m away", said)
        self.assertIn("returns", said)

    def test_theme_switch(self):
        papers = []
        for _ in range(3):
            self.browser.run("document.getElementById('theme').click()")
            papers.append(self.browser.run("getComputedStyle(document.body).backgroundColor"))
        self.assertEqual(len(set(papers)), 2)
        self.assertIn("System", self.browser.run("document.getElementById('theme').textContent"))

    def test_keys_are_listed(self):
        listed = self.browser.run("[...document.querySelectorAll('.keys kbd')].map(k => k.textContent.toLowerCase())")
        for key in self.browser.run("Object.keys(KEYS)"):
            self.assertIn({"ArrowRight": "→", "ArrowLeft": "←", " ": "space"}.get(key, key.lower()), listed)


class WithDetections(Opened):
    """The boxes that detect --kitti writes are drawn as those that it writes in JSON."""

    arguments = ("{}/data", "--detections", "{}/kitti")

    @classmethod
    def setUpClass(cls):
        made("detect", "--data", at("data"), "--detector", "lidar", "--kitti", at("kitti"), "--out", at("detect"))
        super().setUpClass()

    BOXES = "Promise.all(about().frames.map((_, k) => frameAt(k).then(f => f.file.map(d => [...d.box, d.score]))))"

    def test_both_formats_are_the_same_boxes(self):
        from_kitti = self.browser.run(self.BOXES)
        with open(at("detect", "detections.json"), encoding="utf-8") as file:
            frames = json.load(file)["frames"]
        self.assertGreater(sum(map(len, from_kitti)), 3)
        for shown, frame in zip(from_kitti, frames):
            self.assertEqual(len(shown), len(frame["detections"]))
            for box, found in zip(shown, frame["detections"]):
                for a, b in zip((box[0], box[1], box[3], box[4], box[7]), (found[k] for k in ("x", "y", "length", "width", "score"))):
                    self.assertAlmostEqual(a, b, delta=2e-4)
        made("view", at("data"), "--detections", at("detect"), "--out", at("json.html"))
        with browser.Browser() as other:
            other.open(at("json.html"))
            other.wait_for("!!document.documentElement.dataset.frame")
            for shown, frame in zip(other.run(self.BOXES), from_kitti, strict=True):
                for box, same in zip(shown, frame, strict=True):
                    self.assertLess(max(abs(a - b) for a, b in zip(box, same)), 2e-4)

    def test_score_slider(self):
        count = "columns[0].views[1].drawn.filter(d => d.box.kind === 'file').length"
        all_of = self.browser.run("current.file.length")
        for _ in range(20):
            self.key("[")
        self.settle()
        self.assertEqual(self.browser.run(count), all_of)
        for _ in range(20):
            self.key("]")
        self.settle()
        self.assertLess(self.browser.run(count), all_of)


class WithLogits(Opened):
    """A file's scores may be negative: the slider covers them."""

    arguments = ("{}/data", "--detections", "{}/logits")

    @classmethod
    def setUpClass(cls):
        os.mkdir(at("logits"))
        with open(at("logits", "000000.txt"), "w", encoding="utf-8") as file:
            file.write("Car -1 -1 -10 600 180 700 240 1.5 1.6 3.9 1 1.7 15 0 -2.52\n")
        super().setUpClass()

    def test_score_slider_reaches_the_lowest(self):
        for _ in range(80):
            self.key("[")
        self.settle()
        self.assertAlmostEqual(self.browser.run("state.score"), -2.55)
        self.assertAlmostEqual(self.browser.run("+document.querySelector('#score input').value"), -2.55)
        self.assertEqual(self.browser.run("columns[0].views[1].drawn.filter(d => d.box.kind === 'file').length"), 1)

    def test_a_frame_without_a_file_is_told_from_one_without_detections(self):
        self.assertEqual((self.result["frames"], self.result["frames_in_file"]), (3, 1))
        said = "document.querySelector('.column.clean h2 span').textContent"
        self.settle()
        self.assertEqual(self.browser.run(said), "")
        self.browser.run("show(1)")
        self.shown("000001")
        self.assertEqual(self.browser.run(said), "this frame is not in logits")

    def test_an_address_that_is_none_of_ours_shows_a_frame(self):
        self.browser.run("show(1)")
        self.shown("000001")
        self.browser.run("location.hash = '#%'")
        self.shown("000000")


class ByTruth(Opened):
    """The generator's true owners of returns are preferred to the labelled boxes."""

    arguments = ("{}/truth",)

    @classmethod
    def setUpClass(cls):
        made("generate", "--frames", "1", "--seed", "5", "--truth", "--out", at("truth"))
        super().setUpClass()

    def test_instances(self):
        with open(at("truth", "training", "instance_velodyne", "000000.label"), "rb") as file:
            true = [word >> 16 for word, in struct.iter_unpack("<I", file.read())]
        self.assertEqual(self.browser.run("frameAt(0).then(f => [...f.points.instance])"), true)
        self.key("i")
        self.assertIn("generator's truth", self.browser.run("document.getElementById('ramp-name').textContent"))


class OfARun(browser.PageChecks, Opened):
    arguments = ("--run", "{}/run", "--frames", "2")

    @classmethod
    def setUpClass(cls):
        made("attack", "--iterations", "2", "--detector", "lidar", "--data", at("data"), "--out", at("run"))
        super().setUpClass()

    def test_clean_and_attacked_stand_side_by_side(self):
        self.assertEqual(self.browser.run("[...document.querySelectorAll('h2')].map(h => h.firstChild.textContent)"),
                         ["As recorded", "Attacked"])
        self.assertGreater(self.result["vehicles"], 0)
        told = self.browser.run("current.attacks[0].outcome")
        self.assertEqual(self.browser.run("current.attacks[0].added.n"), told["returns"])
        self.assertEqual(self.browser.run("current.attacks[0].removed.length"), told["removed"])
        hit = self.browser.run("rgb(css('hit')).join()")
        self.assertNotIn(hit, self.pixels(".clean .top canvas"))
        if told["returns"]:
            self.assertIn(hit, self.pixels(".attacked .top canvas"))
        # The pictures differ only where the object is.
        u, v, w, h = self.browser.run("current.attacks[0].patches[0].rect")
        apart = self.browser.run("(() => { const [a, b] = [null, current.attacks[0].patches[0]].map(t => {"
                                 "const {size: [w, h], photo} = current.cameras[0];"
                                 "const c = new OffscreenCanvas(w, h), x = c.getContext('2d');"
                                 "x.drawImage(photo, 0, 0); if (t) x.drawImage(t.patch, t.rect[0], t.rect[1]);"
                                 "return x.getImageData(0, 0, w, h).data }); let n = 0;"
                                 "for (let i = 0; i < a.length; ++i) n += Math.abs(a[i] - b[i]) > 24; return n })()")
        self.assertGreater(apart, 30)
        self.assertLess(w * h, 0.6 * 1242 * 375)

    def test_views_are_linked(self):
        x, y, width, height = self.place(".attacked .orbit canvas")
        self.browser.drag((x + width / 2, y + height / 2), (x + width / 2 + 60, y + height / 2))
        self.settle()
        look = self.browser.run("columns.map(c => c.views[2].place(20, 3, 0).slice(0, 2))")
        for a, b in zip(*look):
            self.assertAlmostEqual(a, b, delta=1)

    def test_the_next_vehicle(self):
        count = self.browser.run("current.attacks.length")
        names = []
        for _ in range(count + 1):
            names.append(self.browser.run("current.attacks[state.vehicle].name"))
            self.key("a")
            self.settle()
        self.assertEqual(len(set(names)), count)
        self.assertEqual(names[0], names[-1])
        self.assertRegex(self.browser.run("document.getElementById('outcome').textContent"), "ound as recorded|Vanished|Misplaced|Still found")

    def test_the_nearest_vehicle_comes_first(self):
        ranges = self.browser.run("Promise.all(about().frames.map((_, k) => frameAt(k).then(f => f.attacks.map("
                                  "a => Math.hypot(...f.labels[a.label].box.slice(0, 2))))))")
        self.assertGreater(max(map(len, ranges)), 1)
        for of_frame in ranges:
            self.assertEqual(of_frame, sorted(of_frame))
        listed = self.browser.run("[...document.querySelectorAll('#vehicle option')].map(o => +/([0-9]+) m/.exec(o.textContent)[1])")
        self.assertEqual(listed, [math.floor(value + 0.5) for value in ranges[0]])
        names = self.browser.run("[...document.querySelectorAll('#vehicle option')].map(o => o.textContent.split(':')[0])")
        self.assertEqual(names, self.browser.run("current.attacks.map(a => `${current.id}_${a.label}`)"))

    def test_opens_at_the_vehicle(self):
        self.browser.open(self.path)
        self.browser.wait_for("document.documentElement.dataset.frame !== undefined")
        first = self.browser.run("AMONG[1].vehicles[0]?.slice(0, 2) ?? [0, state.vehicle]")  # a hidden one, if any is
        self.assertEqual(self.browser.run("[state.index, state.vehicle]"), first)
        away = self.browser.run("(() => { const [x, y] = current.labels[current.attacks[state.vehicle].label].box;"
                                "return Math.hypot(eyes.top.x - x, eyes.top.y - y) })()")
        self.assertLess(away, 1e-6)
        spans = [self.browser.run("eyes.top.span")]
        self.key("0")
        self.settle()
        spans.append(self.browser.run("eyes.top.span"))
        self.assertLess(spans[0], 0.5 * spans[1])

    def test_a_phone_has_room_for_one_side(self):
        shown = "[...document.querySelectorAll('.column')].filter(c => c.querySelector('.picture').offsetParent).map(c => c.classList[1])"
        self.assertEqual(self.browser.run(shown), ["clean", "attacked"])
        self.browser.resize(420)
        self.settle()
        try:
            self.assertEqual(self.browser.run(shown), ["attacked"])
            self.key("s")
            self.assertEqual(self.browser.run(shown), ["clean"])
            self.browser.run("[...document.querySelectorAll('#side button')].find(b => b.value === 'attacked').click()")
            self.settle()
            self.assertEqual(self.browser.run(shown), ["attacked"])
        finally:
            self.browser.resize(*self.size)
            self.settle()
        self.assertEqual(self.browser.run(shown), ["clean", "attacked"])

    def test_steps_through_all_vehicles_and_the_address_names_them(self):
        counts = {"hidden": 0, "found": 0, "unfound": 0, "learned": 0}
        for of in self.browser.run("about().attacks"):
            for word, _ in of:
                counts[word] += 1
        self.assertEqual(sum(counts.values()), self.result["vehicles"])
        self.assertEqual(counts["hidden"], self.result["hidden"])
        self.assertEqual(counts["learned"], self.result["learned_on"])
        clean = counts["hidden"] + counts["found"]
        self.assertEqual(self.browser.run("[...document.querySelectorAll('#among option')].map(o => o.textContent)"),
                         [f"All vehicles ({self.result['vehicles']})", f"Hidden ({counts['hidden']} of {clean})",
                          f"Still found ({counts['found']} of {clean})", f"Not found as recorded ({counts['unfound']})"] +
                         [f"Learned on ({counts['learned']})"] * (counts["learned"] > 0))
        for of in self.browser.run("AMONG.slice(1).map(group => group.vehicles)"):
            self.assertEqual([distance for _, _, distance in of], sorted(distance for _, _, distance in of))
        self.browser.run("among.selectedIndex = 0")
        seen, address = [], "'#' + current.attacks[state.vehicle].name"
        for _ in range(self.result["vehicles"] + 1):
            self.browser.wait_for(f"location.hash === {address}")
            seen.append(self.browser.run("location.hash"))
            self.browser.run("jump(true)")
            self.browser.wait_for(f"{address} !== {json.dumps(seen[-1])}" if self.result["vehicles"] > 1 else "true")
        self.assertEqual(len(set(seen)), self.result["vehicles"])
        self.assertEqual(seen[0], seen[-1])
        for one in seen[-2:]:
            self.browser.run(f"location.hash = {json.dumps(one)}")
            self.browser.wait_for(f"{address} === {json.dumps(one)}")
        # By their labels, as every result names them.
        split = read("run", "run.json")
        self.assertLessEqual({one[1:] for one in seen}, {f"{host['frame']}_{host['label']}" for host in split["test"] + split["train"]})


class BesideTheRoad(Opened):
    """The neighbour is judged, not the host: the page frames and names it."""

    arguments = ("--run", "{}/kerb", "--frames", "9")

    @classmethod
    def setUpClass(cls):
        made("attack", "--iterations", "1", "--target", "random", "--detector", "lidar", "--place", "kerb", "--data", at("data"),
             "--out", at("kerb"))
        super().setUpClass()

    def test_the_victim_is_framed_and_named(self):
        made("evaluate", "--run", at("kerb"), "--hosts", "all", "--random-meshes", "0", "--out", at("kerb-evaluate"))
        outcomes = {f"{of['frame']}_{of['label']}": of for of in read("kerb-evaluate", "result.json")["outcomes"]}
        self.assertEqual(len(outcomes), self.result["vehicles"])
        for name, of in outcomes.items():
            self.assertNotEqual(of["victim"], of["label"])
            self.browser.run(f"show(about().frames.indexOf({json.dumps(of['frame'])}), {json.dumps(name)})")
            self.browser.wait_for(f"current.attacks[state.vehicle]?.name === {json.dumps(name)}")
            self.browser.run("closeUp()")
            shown = self.browser.run("current.attacks[state.vehicle]")
            self.assertEqual(shown["victim"], of["victim"])
            self.assertAlmostEqual(shown["outcome"]["clean_iou"], of["clean_iou"], delta=1e-5)
            victim = f"{of['frame']}_{of['victim']}"
            self.assertIn(f"The victim {victim}: ", self.browser.run("document.getElementById('outcome').textContent"))
            self.assertIn(f", victim {victim}", self.browser.run("document.querySelector('#vehicle option:checked').textContent"))
            box = self.browser.run(f"current.labels[{of['victim']}].box")
            self.assertEqual(self.browser.run("[eyes.top.x, eyes.top.y]"), box[:2])


class ItselfOnTheRoad(Opened):
    """The object itself is judged, beside a plain cuboid in its place; overlaps are by distance."""

    arguments = ("--run", "{}/debris", "--frames", "9")

    @classmethod
    def setUpClass(cls):
        made("generate", "--frames", "2", "--seed", "1", "--out", at("roads"))
        made("attack", "--iterations", "1", "--target", "random", "--detector", "lidar", "--matching", "centre", "--place", "debris",
             "--data", at("roads"), "--out", at("debris"))
        super().setUpClass()

    def test_the_object_is_framed_and_named(self):
        self.assertGreater(self.result["vehicles"], 0)
        self.browser.run("closeUp()")
        self.settle()
        x, y, *_ = self.browser.run("current.attacks[state.vehicle].object.box")
        self.assertEqual(self.browser.run("[eyes.top.x, eyes.top.y]"), [x, y])
        hits = self.browser.run("(() => { const {added: p} = current.attacks[state.vehicle]; return Array.from({length: p.n}, (_, i) => [p.x[i], p.y[i]]) })()")
        for hit in hits:
            self.assertLess(math.dist(hit, (x, y)), 1.5)
        drawn = "columns.map(c => c.views[1].drawn.filter(d => d.box.tag === 'object').length)"
        self.assertEqual(self.browser.run(drawn), [0, 1])
        said = self.browser.run("document.getElementById('outcome').textContent")
        self.assertIn("The object: ", said)
        self.assertIn("as a plain cuboid", said)
        self.assertNotIn("as recorded", said)

    def test_overlaps_by_distance_are_no_iou(self):
        said = self.browser.run("document.getElementById('outcome').textContent")
        self.assertIn("Found means overlap > 0.7", said)
        self.assertNotIn("IoU", said)


class ChangedFrames(unittest.TestCase):
    def test_other_vehicles_than_the_run_chose_are_refused(self):
        shutil.copytree(os.path.join(BUILD, "test_data"), at("changing"))
        made("attack", "--iterations", "1", "--target", "random", "--detector", "lidar", "--data", at("changing"), "--out", at("before"))
        view = ("view", "--run", at("before"), "--no-detector", "--out", at("before.html"))
        made(*view)
        label = at("changing", "training", "label_2", read("before", "run.json")["test"][0]["frame"] + ".txt")
        with open(label, encoding="utf-8") as file:
            rows = file.readlines()
        with open(label, "w", encoding="utf-8") as file:
            file.writelines(rows[1:] + rows[:1])
        code, said = mirage(*view)
        self.assertEqual(code, 2, said)
        self.assertEqual(said.count("\n"), 1, said)
        self.assertIn("frames: have changed", said)


class LearnedOnInOtherFrames(unittest.TestCase):
    """A vehicle in the run's training frames counts as seen in other frames, too."""

    @classmethod
    def setUpClass(cls):
        streets()
        made("attack", "--iterations", "1", "--target", "random", "--detector", "lidar", "--data", at("streets"), "--out", at("met"))
        cls.split = read("met", "run.json")

    def track(self, host):
        """As the tracking layout's label file says it."""
        sequence, index = host["frame"].split("_")
        with open(at("streets", "training", "label_02", sequence + ".txt"), encoding="utf-8") as file:
            rows = [row.split() for row in file]
        return [row[1] for row in rows if int(row[0]) == int(index)][host["label"]]

    def test_they_are_marked(self):
        made("view", "--run", at("met"), "--out", at("met.html"))
        result = read("met.result.json")
        learned = {self.track(host) for host in self.split["train"]}
        expected = sum(self.track(host) in learned for host in self.split["test"])
        self.assertGreater(expected, 0)
        self.assertEqual((result["vehicles"], result["learned_on"]), (len(self.split["test"]), expected))
        with browser.Browser() as opened:
            opened.open(at("met.html"))
            opened.wait_for("!!document.documentElement.dataset.frame")
            groups = opened.run("Object.fromEntries(AMONG.map(group => [group.name, group.vehicles.length]))")
            self.assertEqual((groups["all"], groups["learned"]), (result["vehicles"], expected))
            self.assertEqual(groups["hidden"] + groups["found"] + groups["unfound"], result["vehicles"] - expected)
            self.assertEqual(groups["hidden"], result["hidden"])
            self.assertEqual(opened.run("[...document.querySelectorAll('#among option')].at(-1).textContent"), f"Learned on ({expected})")

    def test_a_drive_marks_them_too(self):
        made("drive", "--run", at("met"), "--data", at("streets"), "--least-frames", "12", "--out", at("met-drive"))
        self.assertEqual(read("met-drive", "result.json")["frames_trained_on"], len({host["frame"] for host in self.split["train"]}))
        met = {"0000_" + self.track(host) for host in self.split["train"]}
        vehicle = next(name for name in (f"{of['sequence']}_{of['track']}" for of in read("met-drive", "result.json")["drive"]["vehicles"])
                       if name in met)
        made("view", "--drive", at("met-drive"), "--vehicle", vehicle, "--out", at("met-drive.html"))
        result = read("met-drive.result.json")
        self.assertEqual(result["learned_on"], result["frames"])
        with browser.Browser() as opened:
            opened.open(at("met-drive.html"))
            opened.wait_for("!!document.documentElement.dataset.frame")
            self.assertEqual(opened.run("document.getElementById('outcome').textContent"), "Seen in training, so no evidence.")

    def test_frames_of_the_same_names_are_not_those_that_it_learned_on(self):
        shutil.copytree(at("streets"), at("namesakes"))
        for frame in {host["frame"] for host in self.split["train"]}:
            change_return(at("namesakes", "training", "velodyne", *frame.split("_")) + ".bin")
        made("drive", "--run", at("met"), "--data", at("namesakes"), "--frames", "0:4", "--least-frames", "3", "--out", at("other-drive"))
        self.assertEqual(read("other-drive", "result.json")["frames_trained_on"], 0)


def surround(folder):
    """A set in nuScenes' layout of one sample, of the first frame: its picture in front, the third's behind; a car before and
    one behind."""
    tables = {name: [] for name in ("sensor", "calibrated_sensor", "sample_data", "ego_pose", "category", "instance",
                                    "sample_annotation")}
    tables["ego_pose"].append({"token": "pose", "translation": [0, 0, 0], "rotation": [1, 0, 0, 0]})
    with Image.open(at("data", "training", "image_2", "000000.png")) as image:
        width, height = image.size
    lens = [[0.58 * width, 0, width / 2], [0, 0.58 * width, height / 2], [0, 0, 1]]
    for channel, turn, name in (("LIDAR_TOP", [1, 0, 0, 0], "0.bin"), ("CAM_FRONT", [0.5, -0.5, 0.5, -0.5], "0.png"),
                                ("CAM_BACK", [0.5, -0.5, -0.5, 0.5], "0.png")):
        lidar = channel == "LIDAR_TOP"
        tables["sensor"].append({"token": channel, "channel": channel})
        tables["calibrated_sensor"].append({"token": channel, "sensor_token": channel, "translation": [0, 0, 1.8],
                                            "rotation": turn, "camera_intrinsic": [] if lidar else lens})
        tables["sample_data"].append({"token": channel, "sample_token": "one", "ego_pose_token": "pose",
                                      "calibrated_sensor_token": channel, "is_key_frame": True,
                                      "filename": f"samples/{channel}/{name}"})
        os.makedirs(os.path.join(folder, "samples", channel))
    tables["category"].append({"token": "car", "name": "vehicle.car"})
    for place, x in (("before", 12), ("behind", -12)):
        tables["instance"].append({"token": place, "category_token": "car"})
        tables["sample_annotation"].append({"token": place, "sample_token": "one", "instance_token": place,
                                            "visibility_token": "4", "size": [1.8, 4.2, 1.5], "translation": [x, 0, 0.75],
                                            "rotation": [1, 0, 0, 0], "num_lidar_pts": 9})
    os.makedirs(os.path.join(folder, "v1.0-mini"))
    for name, rows in tables.items():
        with open(os.path.join(folder, "v1.0-mini", name + ".json"), "w", encoding="utf-8") as file:
            json.dump(rows, file)
    for channel, frame in (("CAM_FRONT", "000000"), ("CAM_BACK", "000002")):
        os.symlink(at("data", "training", "image_2", frame + ".png"), os.path.join(folder, "samples", channel, "0.png"))
    with open(at("data", "training", "velodyne", "000000.bin"), "rb") as file:
        points = [point for point in struct.iter_unpack("<4f", file.read())]
    with open(os.path.join(folder, "samples", "LIDAR_TOP", "0.bin"), "wb") as file:
        for x, y, z, reflectance in points:
            file.write(struct.pack("<5f", x, y, z, 255 * reflectance, 1))


class OfADrive(browser.PageChecks, Opened):
    """The vehicles that a drive judged: boxes and tracks from its files, gaps as bars, played in real time."""

    arguments = ("--drive", "{}/drive", "--animation", "{}/film.webp")

    @classmethod
    def setUpClass(cls):
        streets()
        made("drive", "--mesh", os.path.join(SOURCE, "scenes", "objects", "kayak.glb"), "--data", at("streets"), "--detector", "lidar",
             "--least-frames", "12", "--out", at("drive"))
        super().setUpClass()
        with open(at("drive", "result.json"), encoding="utf-8") as file:
            vehicles = json.load(file)["drive"]["vehicles"]
        cls.names = [f"{of['sequence']}_{of['track']}" for of in vehicles]
        cls.added = [of["gap_s"]["attacked"] - of["gap_s"]["clean"] for of in vehicles]
        with open(at("drive", "vehicles", cls.result["vehicle"] + ".json"), encoding="utf-8") as file:
            cls.vehicle = json.load(file)

    def test_the_vehicle_that_is_hidden_longest_in_its_own_frames(self):
        self.assertEqual(self.added[self.names.index(self.result["vehicle"])], max(self.added))
        self.assertEqual(self.result["frames"], self.vehicle["frames"])
        self.assertEqual(self.result["learned_on"], 0)
        self.assertEqual(self.browser.run("[...document.querySelectorAll('h2')].map(h => h.firstChild.textContent)"),
                         ["As recorded", "With the object"])

    def test_boxes_and_tracks_are_those_that_were_judged(self):
        shown = self.browser.run("Promise.all(about().frames.map((_, k) => frameAt(k).then(f => [f, f.attacks[0]].map(of => "
                                 "[of.found.map(d => [...d.box, d.score]), of.tracks.map(t => [t.identity, ...t.box, +t.detected])]))))")
        self.assertGreater(sum(len(tracks) for frame in shown for _, tracks in frame), 0)
        for k, version in enumerate(("clean", "attacked")):
            for part, name in enumerate(("boxes", "tracks")):
                for frame, judged in zip(shown, self.vehicle["shown"][version][name], strict=True):
                    for row, same in zip(frame[k][part], judged, strict=True):
                        self.assertLess(max(abs(a - b) for a, b in zip(row, same, strict=True)), 1e-4)

    def test_bars_are_the_letters(self):
        self.assertEqual(self.browser.run("[...document.querySelectorAll('#strip .names span')].map(s => s.textContent)"),
                         ["as recorded", "with the object", "random of its size"])
        for version in ("clean", "attacked", "random"):
            of = self.vehicle["strip"][version]
            for letters, letter, state in ((of["track"], "f", "found"), (of["track"], "c", "coasting"), (of["track"], "l", "lost"),
                                           (of["found"], "f", "seen")):
                widths = self.browser.run(f"[...document.querySelectorAll('.bar.{version} .{state}')].map(i => parseFloat(i.style.width))")
                runs = [run for run in "".join(x if x == letter else " " for x in letters).split(" ") if run]
                self.assertEqual(len(widths), len(runs))
                self.assertAlmostEqual(sum(widths), 100 * letters.count(letter) / len(letters), delta=1)

    def test_the_line_counts_up_to_the_longest_gap(self):
        for version in ("clean", "attacked"):
            seconds = self.browser.run(f"drive.times.map((_, i) => drive.unseen('{version}', i))")
            self.assertAlmostEqual(max(seconds), self.vehicle["gap_s"][version], places=6)
            index = seconds.index(max(seconds))
            self.browser.run(f"show({index})")
            self.shown(self.browser.run(f"about().frames[{index}]"))
            said = self.browser.run(f"document.querySelector('.said.{version}').textContent")
            self.assertIn(f"not found for {max(seconds):.1f} s so far" if max(seconds) else "found", said)
            self.assertRegex(self.browser.run("document.querySelector('.said.away').textContent"), r"^\d+ m away, ")

    def test_it_plays_in_its_own_time(self):
        seen = self.browser.run("""(async () => {
          const seen = [], start = performance.now(), root = document.documentElement;
          play();
          while ((seen.at(-1)?.index ?? 0) < 6 && performance.now() - start < 30000) {
            const index = about().frames.indexOf(root.dataset.frame), began = drive.clock?.began;
            if (drive.clock && index !== seen.at(-1)?.index)
              seen.push({index, began, due: drive.playtimes[index], shown: performance.now() / 1000 - began});
            await new Promise(done => setTimeout(done, 2));
          }
          play();
          return seen })()""")
        self.assertGreaterEqual(seen[-1]["index"], 6)  # of 15
        for frame in seen:
            self.assertGreater(frame["shown"], frame["due"] - 0.02)
        for before, frame in zip(seen, seen[1:]):
            if before["began"] != frame["began"]:  # so slow a machine that the drive began again
                continue
            self.assertGreater(frame["index"], before["index"])
            self.assertGreater(frame["due"], before["shown"] - 0.3)  # what the machine can't show in time is left out
        print(f"\nplayed {len(seen)} of {seen[-1]['index'] + 1} frames")

    def test_it_begins_while_a_frame_is_on_its_way(self):
        self.browser.run("(() => { const shown = show(4); play(); return shown })()")
        self.key(" ")
        self.assertEqual(self.browser.run("document.getElementById('play').textContent"), "Play")

    def test_the_strip_seeks(self):
        x, y, width, height = self.place(".scale")
        for share in (0.5, 0.25):
            self.browser.drag((x + 3, y + 9), (x + share * width, y + 9))
            index = self.browser.run(f"drive.nearest({share} * drive.length)")
            self.shown(self.browser.run(f"about().frames[{index}]"))
            cursor = self.browser.run("parseFloat(document.querySelector('.cursor').style.left)")
            self.assertAlmostEqual(cursor, 100 * share, delta=5)
        self.key("ArrowRight")
        self.shown(self.browser.run(f"about().frames[{index + 1}]"))

    def test_tracks_are_a_layer(self):
        last = len(self.vehicle["strip"]["index"]) - 1
        self.key("End")
        self.shown(self.browser.run(f"about().frames[{last}]"))
        self.settle()
        count = "columns[1].views[1].drawn.filter(d => d.box.kind === 'track').length"
        self.assertEqual(self.browser.run(count), len(self.vehicle["shown"]["attacked"]["tracks"][last]))
        marked = self.browser.run("columns.map(c => c.views[1].drawn.find(d => d.box.kind === 'mark').box.colour)")
        states = {"f": "found", "c": "coasting", "l": "lost"}
        self.assertEqual(marked, [states[self.vehicle["strip"][version]["track"][last]] for version in ("clean", "attacked")])
        self.key("k")
        self.settle()
        self.assertEqual(self.browser.run(count), 0)
        self.key("k")

    def test_what_it_did_not_judge_is_refused(self):
        shutil.copytree(at("streets"), at("other-streets"))
        change_return(at("other-streets", "training", "velodyne", "0000", "000000.bin"))
        ladder = os.path.join(SOURCE, "scenes", "objects", "ladder.glb")
        for arguments, word in ((("--run", ladder), "is not the object that"), (("--data", at("other-streets")), "are not the frames that"),
                                (("--place", "trailer"), "--place"), (("--cameras", "all"), "--cameras"),
                                (("--depth", "guided"), "--depth"), (("--rig", "kitti64"), "--rig")):
            code, said = mirage("view", "--drive", at("drive"), *arguments, "--out", at("refused.html"))
            self.assertEqual(code, 2, said)
            self.assertEqual(said.count("\n"), 1, said)
            self.assertIn(word, said)
            self.assertFalse(os.path.exists(at("refused.html")))
        shutil.copytree(at("streets"), at("same-streets"))
        made("view", "--drive", at("drive"), "--data", at("same-streets"), "--out", at("same.html"))

    def test_the_report_names_the_returns_under_cycles(self):
        told = read("drive", "result.json")
        some = {"value": 1.0, "low": 0.5, "high": 1.5}
        for effects, words in (("as-recorded", "with returns as recorded the"), ("ideal", "with ideal returns the"),
                               ("noise,motion", "with the LiDAR effects noise,motion the")):
            told["drive"]["cycles"] = {"vehicles": [1], "gap_s": {"attacked": some}, "raster_gap_s": {"attacked": some}, "kept": some,
                                       "lidar_effects": effects}
            os.makedirs(at("under-cycles"), exist_ok=True)
            with open(at("under-cycles", "result.json"), "w", encoding="utf-8") as file:
                json.dump(told, file)
            subprocess.run([sys.executable, "-B", os.path.join(SOURCE, "validation", "report", "command_page.py"), at("under-cycles")],
                           check=True)
            with open(at("under-cycles", "drive.html"), encoding="utf-8") as file:
                self.assertIn(f"Under Blender Cycles {words}", file.read())

    def test_the_animation(self):
        self.assertLessEqual(self.result["animation"], 1.5e6)
        with Image.open(at("film.webp")) as film:
            self.assertEqual(film.n_frames, self.vehicle["frames"])
            self.assertLessEqual(film.width, 720)


class SeveralCameras(Opened):
    """Each camera is shown by its name, with the boxes in it."""

    arguments = ("{}/surround",)

    @classmethod
    def setUpClass(cls):
        surround(at("surround"))
        super().setUpClass()

    def photo(self):
        """The recorded picture of the shown camera, small."""
        return self.browser.run("(() => { const c = new OffscreenCanvas(62, 19), x = c.getContext('2d');"
                                "x.drawImage(current.cameras[state.camera].photo, 0, 0, 62, 19);"
                                "return [...x.getImageData(0, 0, 62, 19).data].filter((_, i) => i % 4 < 3) })()")

    def drawn(self):
        self.settle()
        return self.browser.run("columns[0].views[0].drawn.map(one => one.box.box[0] > 0)")

    def test_they_are_chosen_by_name_and_by_key(self):
        self.browser.run("lookAt(0), refresh()")
        self.assertEqual(self.browser.run("current.cameras.map(camera => camera.name)"), ["CAM_FRONT", "CAM_BACK"])
        self.assertNotEqual(self.browser.run("getComputedStyle(byId('camera')).display"), "none")
        for shown, frame in ((0, "000000"), (1, "000002"), (0, "000000")):
            self.assertEqual(self.browser.run("+document.querySelector('#camera select').value"), shown)
            seen, apart = self.photo(), {}
            for name in ("000000", "000002"):
                with Image.open(at("data", "training", "image_2", name + ".png")) as image:
                    real = image.convert("RGB").resize((62, 19), Image.BOX).tobytes()
                apart[name] = sum(abs(a - b) for a, b in zip(real, seen))
            self.assertLess(2 * apart.pop(frame), *apart.values())
            self.assertEqual(self.drawn(), [shown == 0])
            self.key("c")

    def test_a_close_up_looks_through_the_camera_that_sees_it(self):
        self.browser.run("current.labels.reverse(), current.labels[0].box[1] = 0.01")  # the rear one is the nearest by now
        self.browser.run("current.labels[1].box[0] = 20")
        self.key("z")
        self.assertEqual(self.browser.run("[state.camera, current.labels[0].camera]"), [1, 1])


class BoxesInTwoPictures(Opened):
    """A box is drawn in the picture of the camera that it names, by default in the first one."""

    arguments = ("{}/both", "--detections", "{}/both.json")

    @classmethod
    def setUpClass(cls):
        surround(at("both"))
        box = {"left": 100, "top": 90, "right": 200, "bottom": 160}
        boxes = [{**box, "score": 0.9}, {**box, "score": 0.8, "camera": "CAM_BACK", "type": "Van"}, {**box, "score": 0.7, "camera": "CAM_NONE"}]
        with open(at("both.json"), "w", encoding="utf-8") as file:
            json.dump({"frames": [{"frame": "one", "detections": boxes}]}, file)
        super().setUpClass()

    def test_each_in_its_own(self):
        drawn = "columns[0].views[0].drawn.filter(d => d.box.kind === 'file').map(d => d.box.score)"
        for camera, scores in ((0, [0.9]), (1, [0.8])):
            self.browser.run(f"state.camera = {camera}, draw()")
            self.settle()
            self.assertEqual(self.browser.run(drawn), scores)
        self.assertEqual(self.browser.run("current.file.map(found => found.type)"), ["Car", "Van", "Car"])


class BoxesOfAPluginInTwoPictures(Opened):
    """The boxes that detect writes for a detector of two cameras."""

    arguments = ("{}/around", "--detections", "{}/around-found")
    PLUGIN = os.path.join(BUILD, "test_plugins", "named.so")

    @classmethod
    def setUpClass(cls):
        if not os.path.exists(cls.PLUGIN):
            raise unittest.SkipTest("the plugins of the tests are not built")
        with open(os.path.join(SOURCE, "tests", "faults", "small-rig.toml"), encoding="utf-8") as file:
            front, lidar = file.read().split("[lidar]")
        back = front[front.index("[camera]"):].replace("[camera]", "[cameras.back]").replace("0, -1, 0, 0, 0, 0, -1", "0, 1, 0, 0, 0, 0, -1")
        with open(at("around.toml"), "w", encoding="utf-8") as file:
            file.write(front + back.replace("-0.08, 1, 0, 0", "-0.08, -1, 0, 0") + "[lidar]" + lidar)
        with open(at("around.weights"), "w", encoding="utf-8") as file:
            file.write("weights")
        made("generate", "--rig", at("around.toml"), "--frames", "1", "--seed", "5", "--out", at("around"))
        made("detect", "--detector", cls.PLUGIN, "--weights", at("around.weights"), "--cameras", "all", "--data", at("around"),
             "--out", at("around-found"))
        super().setUpClass()

    def test_they_name_their_cameras(self):
        car, = read("around-found", "detections.json")["frames"][0]["detections"]
        self.assertEqual(car["picture"]["camera"], "back")
        self.assertEqual(self.browser.run("current.file.map(found => found.camera)"), [1])


class WrongInput(unittest.TestCase):
    def test_is_one_line(self):
        with open(at("other.json"), "w", encoding="utf-8") as file:
            json.dump({"frames": [{"frame": "777777", "detections": []}]}, file)
        for arguments, word in (((), "DIR"), ((at("none"),), "none"), ((at("data"), "--run", at("none")), "none"),
                                ((at("data"), "--detections", at("none.json")), "none.json"),
                                ((at("data"), "--detections", at("other.json")), "other.json"),
                                ((at("data"), "--detector", "lidar"), "--detector"), ((at("data"), "--weights", "real"), "--weights"),
                                ((at("data"), "--defense", "ceiling"), "--defense"), ((at("data"), "--no-detector"), "--no-detector"),
                                (("--run", at("none"), "--no-detector", "--detector", "lidar"), "--no-detector"),
                                (("--run", at("none"), "--no-detector", "--weights", "real"), "--no-detector"),
                                (("--run", at("none"), "--no-detector", "--defense", "ceiling"), "--no-detector"),
                                ((at("data"), "--depth", "ip-basic"), "--depth"), ((at("data"), "--place", "roof"), "--place"),
                                ((at("data"), "--size", "0.2"), "--size"), ((at("data"), "--size", "0"), "--size")):
            code, said = mirage("view", *arguments, "--out", at("wrong"))
            self.assertEqual(code, 2, said)
            self.assertEqual(said.count("\n"), 1, said)
            self.assertIn(word, said)
            self.assertFalse(os.path.exists(at("wrong", "view.html")))

    def test_a_small_page_keeps_what_matters(self):
        made("view", at("data"), "--size", "0.6", "--out", at("small"))
        with open(at("small", "result.json"), encoding="utf-8") as file:
            result = json.load(file)
        self.assertLessEqual(os.path.getsize(at("small", "view.html")), 0.6e6)
        self.assertGreater(result["step"], 1)
        self.assertLess(result["kept_points"], result["points"])


if __name__ == "__main__":
    if not browser.find():
        print("skipped: chromium is not installed (package chromium)")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1] + sys.argv[3:], verbosity=2)
