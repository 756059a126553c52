"""The page of `mirage validate` in headless Chromium: test_report.py SOURCE BUILD. Exit code 77: skipped, with why.

Opens without console errors and without asking for anything but itself, the model loads, the sliders move by mouse
and by key, every figure stands in result.json, and both themes draw."""

import base64
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import unittest

from PIL import Image

import browser
import fixture

SOURCE, BUILD = (os.path.abspath(path) for path in sys.argv[1:3])
VIEWER = os.path.join(BUILD, "report", "model-viewer.min.js")


def write_report(folder, viewer, uses_picture=True, vacuous=False, change=None, **more):
    """`change`: {file: function that changes its JSON}, for files in the folder."""
    validation, run = fixture.make(folder, uses_picture, vacuous, **more)
    for name, edit in (change or {}).items():
        path = os.path.join(folder, name)
        with open(path, encoding="utf-8") as file:
            content = json.load(file)
        edit(content)
        fixture.write_json(path, content)
    arguments = [sys.executable, os.path.join(SOURCE, "validation", "report", "report.py"), "--validation", validation, "--run", run,
                 "--evaluation", os.path.join(folder, "evaluation.json"), "--tradeoff",
                 os.path.join(folder, "tradeoff.json")]
    if viewer:
        arguments += ["--viewer", viewer]
    subprocess.run(arguments + ["--sign-off"], check=True)
    return os.path.join(validation, "report.html")


class Page(browser.ReportChecks, unittest.TestCase):
    """The page with all its parts."""

    viewer = VIEWER if os.path.isfile(VIEWER) else None
    least, cells = 100, "td:not(.quiet)"

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="mirage-report-")
        cls.addClassCleanup(cls.folder.cleanup)
        cls.show(write_report(cls.folder.name, cls.viewer))

    def test_model_loads(self):
        if not self.viewer:
            self.skipTest("model-viewer is not in the build folder (npm registry out of reach)")
        self.browser.wait_for("document.querySelector('model-viewer').loaded")
        self.assertGreater(self.browser.run("document.querySelector('model-viewer').getDimensions().x"), 0)
        # It draws only while it is in view; a drag turns it, but for one that begins on its very middle, where it has a
        # mark of its own (for panning) that takes the pointer.
        self.browser.run("document.getElementById('model').scrollIntoView({block: 'center'})")
        x, y = self.browser.run("(() => { const r = document.getElementById('model').getBoundingClientRect();"
                                "return [r.x + r.width / 3, r.y + r.height / 3]})()")
        angle = "document.getElementById('model').getCameraOrbit().theta"
        before = self.browser.run(angle)
        turned = f"Math.abs({angle} - {before}) > 0.2"
        for _ in range(40):  # before its first frame it takes no drag
            self.browser.drag((x, y), (x + 120, y))
            time.sleep(0.5)
            if self.browser.run(turned):
                break
        self.assertTrue(self.browser.run(turned))

    def rect(self, index):
        """The bar of the first vehicle, in the window's pixels."""
        self.browser.run("document.querySelector('.swipe.wide').scrollIntoView({block: 'center'})")
        return self.browser.run("(() => { const bar = document.querySelectorAll('.swipe.wide input')[%d],"
                                "r = bar.getBoundingClientRect(), w = 26;"
                                "return [r.x + w / 2 + bar.value / 1000 * (r.width - w), r.y + r.height / 2, r.width]})()" % index)

    def values(self):
        return self.browser.run("[...document.querySelector('.swipe.wide').querySelectorAll('input')].map(i => +i.value)")

    def cuts(self):
        return self.browser.run("['--at1', '--at2'].map(n => parseFloat(document.querySelector('.swipe.wide').style"
                                ".getPropertyValue(n)))")

    def test_sliders_move(self):
        first, cut = self.values(), self.cuts()
        x, y, width = self.rect(1)
        self.browser.drag((x, y), (x + 0.1 * width, y))
        moved = self.values()
        self.assertEqual(moved[0], first[0])
        self.assertGreater(moved[1], first[1] + 50)
        self.assertGreater(self.cuts()[1], cut[1] + 5)
        self.browser.press("ArrowLeft", 37)  # the bar that was dragged has the focus
        self.assertEqual(self.values()[1], moved[1] - 5)

    def test_zz_bar_does_not_pass_its_neighbour(self):
        x, y, width = self.rect(0)
        self.browser.drag((x, y), (x + width, y))
        self.assertLessEqual(*self.values())

    def test_swipe_shows_three_pictures(self):
        self.browser.call("Page.bringToFront")
        x, y, width, height = self.browser.run("(() => { const r = document.querySelector('.swipe.wide')"
                                               ".getBoundingClientRect(); return [r.x + scrollX, r.y + scrollY, r.width, "
                                               "r.height]})()")
        path, cuts = os.path.join(self.folder.name, "swipe.png"), [cut / 100 for cut in self.cuts()]
        self.browser.screenshot(path, (x, y, width, height))
        with Image.open(path) as image:
            for share, kind in ((cuts[0] / 2, "clean"), (sum(cuts) / 2, "attacked"), ((1 + cuts[1]) / 2, "cycles")):
                pixel = image.convert("RGB").getpixel((int(share * image.width), int(0.8 * image.height)))
                self.assertLess(max(abs(a - b) for a, b in zip(pixel, fixture.COLORS[kind])), 8, kind)

    def test_head_says_of_what_and_how_often(self):
        said = lambda selector: " ".join(self.browser.run(f"document.querySelector('{selector}').innerText").replace("\u202f", " ").split())
        for part in ("fusion", "8d1f", "kitti9", "out/attack", "seed 3", "ea8efec", "2026-11-27", "mirage validate --run"):
            self.assertIn(part, said("#made-of"))
        rate = said("#rate")
        self.assertIn("22.0 % (12.0–32.0 %) of 20 held-back vehicles", rate)
        self.assertIn("over 10 frames only: wide and approximate", rate)
        self.assertIn("−13.0 (−18.0 to −8.0) points: less", rate)
        self.assertIn("this object 40.0 % (30.0–50.0 %), a random mesh of its size 10.0 % (0.0–20.0 %), a cuboid that fills the box 5.0 % (", rate)
        self.assertIn("Decision Open", rate)
        self.assertIn("with 9 to 13 samples a pixel", said(".meta"))
        self.assertIn("mean absolute difference is 0.010", said("#attack"))

    def test_says_what_became_of_a_vehicle(self):
        tags = self.browser.run("[...document.querySelectorAll('article.vehicle .tag')].slice(0, 4).map(t => t.innerText)")
        self.assertEqual(tags, ["rasteriser: vanished", "Cycles: misplaced (IoU 0.62)", "rasteriser: found", "Cycles: found"])
        rows = self.browser.run("[...document.querySelectorAll('#all tbody tr')].map(r => [0, 1, 3, 4].map(k => r.cells[k].innerText))")
        self.assertEqual(rows, [["000002_1", "19.0", "found", "found"],
                                ["000001_0", "20.0", "vanished", "misplaced (IoU 0.62)"]])  # the nearest first
        self.assertEqual(self.browser.run("document.querySelector('#hidden').innerText"),
                         "Not found any more in Cycles, the nearest first: 000001_0 (20 m, misplaced).")

    def test_of_a_detector_that_sees_it_is_whole(self):
        text, count = (lambda selector, what=what: self.browser.run(what % json.dumps(selector))
                       for what in ("document.querySelector(%s).textContent", "document.querySelectorAll(%s).length"))
        for said in (OfADetectorThatDoesNotSee.NOTE, "acuous for"):
            self.assertNotIn(said, text("body"))
        self.assertIn("in Cycles with realistic returns", text("h1"))
        self.assertEqual((count("#arms tbody tr"), count("#controls tbody tr")), (7, 3))

    def test_report_writes_the_page_alone(self):
        with open(os.path.join(os.path.dirname(self.path), "result.json"), encoding="utf-8") as file:
            self.assertNotIn("beside", json.load(file))
        self.assertIn("no flips", self.browser.run("document.querySelector('#arms tbody tr:nth-child(2)').textContent"))
        self.assertNotIn("no flips", self.browser.run("document.querySelector('#arms tbody tr').textContent"))  # with itself

    def test_parts_are_there(self):
        sections = self.browser.run("[...document.querySelectorAll('section')].map(s => s.id)")
        self.assertEqual(sections, ["verdict", "vehicles", "attack", "adversary", "ladder", "budget", "tradeoff", "all"])
        self.assertGreaterEqual(self.browser.run("document.querySelectorAll('svg.plot').length"), 9)
        self.check_floors()
        self.assertEqual(self.browser.run("document.querySelectorAll('svg.bev').length"), 6)
        self.assertEqual(self.browser.run("document.querySelectorAll('svg.seen').length"), 3)  # of the second vehicle
        self.assertEqual(self.browser.run("document.querySelectorAll('svg.seen rect.box').length"), 3 * 3 + 2)
        self.assertEqual(self.browser.run("[...document.images].filter(i => !i.naturalWidth).length"), 0)


    def check_floors(self):
        """Every rung with noise has its band, from 0 to its floor on the axis of the dots."""
        bands = self.browser.run("[...document.querySelectorAll('rect.floor')].map(r => [r.x.baseVal.value, r.width.baseVal.value,"
                                 "r.parentNode.querySelector('title').textContent])")
        floors = [rung["floor"] for rung in fixture.ladder() if rung["floor"] > 0]
        self.assertEqual(len(bands), len(floors))
        self.assertEqual(len({start for start, _, _ in bands}), 1)
        for (_, width, tip), floor in zip(bands, floors):
            self.assertAlmostEqual(width / bands[0][1], floor / floors[0], places=1)
            self.assertIn(f"{100 * floor:.1f}", tip)
        below = self.browser.run("[...document.querySelectorAll('#ladder circle.dot')].map(c => c.cx.baseVal.value)")
        self.assertLess(min(below), bands[0][0])  # what came out negative stands left of zero


class WithoutViewer(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="mirage-report-")
        cls.addClassCleanup(cls.folder.cleanup)
        cls.path = write_report(cls.folder.name, None)
        cls.browser = browser.Browser()
        cls.addClassCleanup(cls.browser.__exit__)

    def tearDown(self):
        self.assertEqual(self.browser.errors, [])

    def test_opens_and_says_so(self):
        self.browser.open(self.path)
        self.assertIn("3-D view is missing", self.browser.run("document.getElementById('no-viewer').textContent"))
        self.assertEqual(self.browser.run("document.querySelectorAll('model-viewer').length"), 0)

    def test_what_is_signed_is_one_sheet_of_a4_that_says_what_counts(self):
        self.browser.open(self.path.replace("report.html", "sign-off.html"))
        text = self.browser.run("document.body.innerText")
        for part in ("Attack success 22.0 % in Cycles", "fusion-kitti64.pt", "8d1f", "ea8efec", "mirage validate --run out/attack",
                     "15–30 m\t2\t1\t1", "Hidden in Cycles: 000001_0 (20 m).", "a random mesh of its size\t10.0\u202f%", "one front camera", "What was not tested", "signature"):
            self.assertIn(part, text)
        sheet = base64.b64decode(self.browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
        self.assertEqual(len(re.findall(rb"/Type\s*/Page\b", sheet)), 1)
        self.assertRegex(sheet, rb"/MediaBox\s*\[0 0 59[45][^ ]* 84[12]")


class OfADetectorThatDoesNotSee(unittest.TestCase):
    """A note replaces every statement about images."""

    NOTE = "his detector does not use its picture, so this says nothing about images"

    def test_says_so_and_nothing_about_cycles(self):
        with tempfile.TemporaryDirectory(prefix="mirage-report-") as folder, browser.Browser() as chromium:
            chromium.open(write_report(folder, None, uses_picture=False))
            text = lambda selector: chromium.run(f"document.querySelector({json.dumps(selector)}).textContent")
            for part in ("#picture-note", "#attack", "#vehicles", "#ladder"):
                self.assertIn(self.NOTE, text(part), part)
            self.assertNotIn("flips", text("#verdict"))
            # Returns are another matter: the rasteriser's two arms stay, and no other.
            self.assertEqual(chromium.run("document.querySelectorAll('#attack svg, #attack .cards').length"), 0)
            self.assertEqual(chromium.run("document.querySelectorAll('#arms tbody tr').length"), 3)
            self.assertNotIn("Cycles", text("#arms"))
            self.assertNotIn("score change", chromium.run("document.querySelector('#ladder thead').textContent"))
            self.assertEqual(chromium.errors, [])


class OfAnAttackWhoseObjectNobodySees(unittest.TestCase):
    def test_says_vacuous(self):
        with tempfile.TemporaryDirectory(prefix="mirage-report-") as folder, browser.Browser() as chromium:
            chromium.open(write_report(folder, None, vacuous=True))
            text = lambda selector: chromium.run(f"document.querySelector({json.dumps(selector)}).textContent")
            self.assertIn("Vacuous for the camera", text("#verdict"))
            self.assertNotIn("acuous for the LiDAR", chromium.run("document.body.textContent"))
            self.assertEqual(chromium.errors, [])


class WhatSpeaksAgainst(unittest.TestCase):
    """Limitations of the figures are in the report and on the page to sign."""

    def test_is_on_both_pages(self):
        names, judged = ["000001_0", "000002_1"], fixture.verdict(["000001_0", "000002_1"], vacuous=True)
        judged["pairs"][0]["split"] = "train"  # the vehicle that vanishes is one that the attack learned on
        targets = [{"place": place, "target": 0, "met": met} for place, met in
                   (("matched.mask_iou", None), ("matched.mae", None), ("matched.hit_disagreements", True), ("matched.range_error_m", False))]
        with tempfile.TemporaryDirectory(prefix="mirage-report-") as folder, browser.Browser() as chromium:
            path = write_report(folder, None, verdict=judged, targets=targets, unseen=["000003_0"], hosts=names,
                                failed=[{"name": "000004_2", "problem": "was lost"}],
                                evaluation_differences=["detector: lidar there, fusion here"])
            said = lambda: " ".join(chromium.run("document.body.innerText").replace("\u202f", " ").split())
            chromium.open(path)
            report = said()
            chromium.open(path.replace("report.html", "sign-off.html"))
            page = said()
            self.assertEqual(chromium.errors, [])
        for text in (report, page):
            for part in ("000003_0", "Vacuous for the camera", "used other settings: detector: lidar there, fusion here", "nothing measured", "missed"):
                self.assertIn(part, text)
        self.assertIn("Blender was lost on 1 vehicle;", report)
        self.assertIn("000001_0 (20 m, misplaced, learned on)", report)
        self.assertIn("Blender was lost on 1 vehicle, in no figure: 000004_2.", page)
        self.assertIn("Held-back vehicles by distance", page)
        self.assertIn("15–30 m 1 0 0", page)  # the held-back one alone
        self.assertNotIn("Hidden in Cycles", page)
        self.assertIn("Mask IoU – to reach ≥ 0.9999: nothing measured", page)

    def both(self, **more):
        """The texts of the report and of the page to sign."""
        with tempfile.TemporaryDirectory(prefix="mirage-report-") as folder, browser.Browser() as chromium:
            path, texts = write_report(folder, None, **more), []
            for page in (path, path.replace("report.html", "sign-off.html")):
                chromium.open(page)
                texts.append(" ".join(chromium.run("document.body.innerText").replace("\u202f", " ").split()))
            self.assertEqual(chromium.errors, [])
        return texts

    def test_held_back_vehicles_that_were_learned_on_are_counted(self):
        report, page = self.both(hosts_trained_on=12)
        self.assertIn("The attack was learned on 12 of the 20 held-back vehicles, in other frames of their drive.", report)
        self.assertIn("The attack was learned on 12 of these 20 held-back vehicles, in other frames of their drive.", page)
        for text in self.both(hosts_trained_on=0):
            self.assertNotIn("The attack was learned on 0", text)

    def test_what_is_signed_is_of_realistic_returns_as_its_headline(self):
        def change(host):
            for arm in host["arms"]:
                arm["hidden"] = arm["returns"] == "realistic" and arm["light"] == "cycles"
        _, page = self.both(change={f"validation/hosts/{name}.json": change for name in ("000001_0", "000002_1")})
        self.assertIn("15–30 m 2 0 2", page)
        self.assertIn("Hidden in Cycles: 000002_1 (19 m), 000001_0 (20 m).", page)

    def test_who_is_judged_is_named_with_the_place(self):
        victims = {f"validation/hosts/{name}.json": lambda host: host.update(victim=4) for name in ("000001_0", "000002_1")}
        for text in self.both(change=victims, placement="kerb", placed={"victim": "neighbour"}):
            self.assertIn("000001_4 (host 000001_0) (20 m", text)
            self.assertIn("place kerb", text)
            self.assertIn("found without the object", text)
        report, page = self.both(placement="debris", placed={"victim": "object"})
        for text in (report, page):
            self.assertIn("object at 000001_0 (20 m", text)
            self.assertIn("found with a plain cuboid in the object's place", text)
        self.assertIn("With a plain cuboid", report)
        self.assertNotIn("recorded,", report)

    def test_the_overlap_that_counts_as_found_is_not_rounded_away(self):
        report, _ = self.both(change={"evaluation.json": lambda evaluation: evaluation.update(detected_iou=0.85)})
        self.assertIn("dotted: 0.85, what counts as found", report)

    def test_a_ladder_without_any_error_is_drawn(self):
        sys.path.insert(0, os.path.join(SOURCE, "validation", "report"))
        import plots
        nothing = [{**rung, "floor": 0, "error_plain": 0, "interval": {"value": 0, "low": 0, "high": 0}} for rung in fixture.ladder()]
        self.assertIn("<svg", plots.remaining({"ladder": nothing}))


if __name__ == "__main__":
    if not browser.find():
        print("skipped: chromium is not installed (package chromium)")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1] + sys.argv[3:], verbosity=2)
