"""The pages of `mirage audit`, compare, drive and score in headless Chromium: test_command_pages.py SOURCE. Exit code 77: skipped, with
why.

They open without console errors and without asking for anything but themselves, nothing overflows at either width, and every
figure stands in result.json. A drive's strip shows what was found when.
"""

import base64
import json
import os
import re
import subprocess
import sys
import tempfile
import unittest

import browser

SOURCE = os.path.abspath(sys.argv[1])


def interval(value, reach=0.05):
    return {"value": value, "low": value - reach, "high": value + reach}


def audit():
    def row(name, change, drop):
        lost = [{"stratum": s, "vehicles": 40, **interval(drop)} for s in ("all", "0-20 m", "20-40 m", "40-70 m")]
        return {"input": name, "change": change, "frames": 44, "vehicles": 120, "ap70_right": 0.7, "ap70": 0.7 - drop,
                "drop": drop, "low": drop - 0.1, "high": drop + 0.1, "delta_logit": 5 * drop, "delta_score": drop / 2,
                "recall_lost": lost}

    rows = [row("picture", "another frame's", 0.4), row("picture", "blurred by 8 px", -0.02),
            {"input": "picture", "change": "none", "refused": "plugin: no picture; give one"},
            row("points", "another frame's", 0.69), row("points", "2 beams", 0.5),
            row("calibration", "turned by 0.5°", 0.01), row("calibration", "turned by 10°", 0.6)]
    return {"detector": "fusion", "frames": 44, "frames_left_out": 0, "vehicles": 120, "clusters": {"by": "frame", "count": 44},
            "intervals_over": "44 frames", "ap70": 0.7, "uses": {"image": True, "points": None}, "audit": rows,
            "answer": ["Another frame's picture costs 40.0 points of AP 0.7 (30.0 to 50.0): it uses its picture."],
            "provenance": {"command": "mirage audit --data kitti", "identity": "a" * 64}}


def compare():
    def part(by, name, difference):
        return {"by": by, "name": name, "vehicles": 60, "first": interval(0.2), "second": interval(0.2 + difference),
                "difference": interval(difference), "p": 0.031}

    bound = {"at_most": 0.31, "value": 0.2, "within_m": 40, "vehicles": 50, "clusters": {"by": "frame", "count": 30}, "needed": []}
    return {"compare": {
        "detectors": ["fusion", "refined"], "objects": ["kayak", "a/long/path/to/some/run/of/an/attack"], "hosts": 80,
        "vehicles": 60, "clusters": {"by": "frame", "count": 40}, "difference": 0.12, "low": 0.07, "high": 0.17, "told": "more",
        "first": interval(0.2), "second": interval(0.32), "detectable": 0.08, "bounds": [bound, bound],
        "needed": [{"difference": d, "vehicles": round(60 * (0.08 / d)**2)} for d in (0.02, 0.05, 0.1)],
        "parts": [part("all", "", 0.12), part("object", "kayak", 0.01), part("object", "a/long/path/to/some/run/of/an/attack", 0.2),
                  part("range", "15-30 m", -0.04)],
        "worse": [{"frame": "000012", "label": 3, "object": "kayak", "range": 21.5, "first_score": 0.6, "second_clean_score": 0.7}]}}


def score(grade="C", detector="fusion", value=0.012):
    def cell(held, value, vehicles=90):
        return {"held": held, "value": value, "at_most": value + 0.03, "at_least": max(0, value - 0.03), "vehicles": vehicles, "from_m": 0,
                "within_m": 20, "needed_vehicles": 240 if held == "cannot be told" else None, "clusters": {"by": "frame", "count": 60}}

    def row(level, name, *cells):
        return {"level": level, "name": name, "objects": ["a"], "cells": list(cells), "phantoms": interval(0.07)}

    rows = [row("recorded", "no object, as recorded", *[cell("holds", 0.0)] * 3),
            row("loads", "loads that people carry", *[cell("holds", value)] * 3),
            row("shapes", "shapes that nobody learned", cell("cannot be told", 0.04), cell("holds", 0.01), cell("cannot be told", 0, 0)),
            row("learned", "learned against it, 1.6 × 1.6 × 1 m", *[cell("does not hold", 0.3)] * 3)]
    del rows[0]["phantoms"]
    return {"score": {
        "detector": detector, "weights": "", "defense": "none", "grade": grade, "by_band": ["C", "B", "C"] if grade else ["", "", ""],
        "answer": ["Grade C: within 40 m at most 5 % of cars vanish under loads that people carry (95 %, exact)." if grade else "No grade.",
                   "shapes that nobody learned, 0–20 m: cannot be told: of 90 cars 4.0 % vanish, at most 7.0 %; about 240 would tell."],
        "limit": 0.05, "within_m": 40, "bands": [0, 20, 40, 70], "rows": rows, "frames": 120, "frames_needed": 320, "hosts": 700,
        "vehicles": 640, "clusters": {"by": "frame", "count": 120}, "reliance": {"reads_picture": True, "uses_picture": True},
        "reliance_words": "AP 0.7 76.8 % with the right picture, 50.1 % with another frame's: it uses its picture",
        "points_words": "Another frame's sweep costs 60.0 points of AP 0.7 (50.0 to 70.0): it uses its sweep.",
        "certified": [{"size": 0.8, "bands": [{"hosts": hosts, "known50": {"certified": interval(0.5), "attacked": interval(0.6)},
                                               "lattice50": {"certified": interval(0.4)}} for hosts in (700, 200, 300, 0)]}],
        "learned": [{"size": 0.8, "attack": "plain", "steps": 60, "vehicles": 90}]},
        "provenance": {"command": "mirage score --detector fusion", "identity": "b" * 64, "date": "2026-01-01T00:00:00Z", "seed": 0,
                       "version": "0.1.0", "weights_hash": "c" * 64, "inputs": {"data": "d" * 64}}}


def untold():
    """Two learned objects, and every cell but two cannot be told."""
    result = score()
    told = result["score"]
    told["rows"].append(dict(told["rows"][-1]))
    open_cell = told["rows"][2]["cells"][0]
    for row in told["rows"]:
        row["cells"] = [dict(open_cell) for _ in row["cells"]]
    told["rows"][1]["cells"][2]["vehicles"], told["rows"][1]["cells"][1]["held"] = 0, "does not hold"
    told["answer"] += told["answer"][1:] * 2
    for name in ("learned", "certified"):
        told[name] *= 2
    return result


VERSIONS = ("clean", "attacked", "random")


def with_open_ends(value):
    return {"value": value, "low": None if value > 2 else value - 0.1, "high": None if value > 2 else value + 0.4}


def vehicle(track, found, states, confirmed, left=None):
    """left: the frame after which it is away for three seconds."""
    count = len(found["clean"])
    strip = {"index": list(range(count)), "time_s": [5 + 0.1 * i + (3 if left is not None and i > left else 0) for i in range(count)],
             "stands_s": [0.1] * count, "away": [int(i == left) for i in range(count)], "range_m": [47 - i for i in range(count)]}
    for v in VERSIONS:
        strip[v] = {"found": found[v], "track": states[v], "phantoms": [0] * count, "in_lane": [0] * count}
    return {"sequence": "0003", "track": track, "type": "Car", "frames": count, "strip": strip,
            "gap_s": {"clean": 0.1, "attacked": 0.7, "random": 0.2},
            "confirmed_s": {v: None if confirmed[v] is None else 0.1 * confirmed[v] for v in VERSIONS},
            "confirmed_m": {v: None if confirmed[v] is None else 47.0 - confirmed[v] for v in VERSIONS},
            "reserve_m": {v: None if confirmed[v] is None else {"4": 1.5, "6": -3.25, "8": 9.0} for v in VERSIONS},
            "phantoms": {v: {"tracks": int(v == "attacked"), "frames": 2, "seconds": 0.2, "in_lane_s": 0.1} for v in VERSIONS}}


def drive():
    found = {"clean": "ffffffffff", "attacked": "f-------ff", "random": "fff--fffff"}
    states = {"clean": "llffffffff", "attacked": "llcllllllf", "random": "llfclfffff"}
    medians = {key: with_open_ends(1 + i) for i, key in enumerate((*VERSIONS, "attacked_less_clean", "attacked_less_random"))}
    return {"detector": "fusion", "score_threshold": 0.3, "drive": {
        "frames": 144, "gap_s": medians, "track_gap_s": medians, "confirmed_m": medians,
        "later_m": {"than_clean": with_open_ends(1.4), "than_random": with_open_ends(0.6)},
        "near": {"metres": 10, "vehicles": 2, "clean": 0, "attacked": 1, "random": 0},
        "deaths": [{"death": 2, "track_gap_s": {v: with_open_ends(0.6) for v in VERSIONS},
                    "phantom_share": {v: {"value": 0.25, "low": 0.1, "high": 0.5} for v in VERSIONS}}],
        "never_confirmed": {"clean": 0, "attacked": 1, "random": 0},
        "survival": [{"seconds": 0.5, **{v: {"value": 0.25, "low": 0.1, "high": 0.5} for v in VERSIONS}}],
        "tracker": {"mota": 0.71, "hota": 0.61, "switches": 2, "fragments": 3},
        "cycles": {"vehicles": [{}], "gap_s": medians, "raster_gap_s": medians, "kept": {"value": 0.9, "low": 0.8, "high": 1.1}},
        "vehicles": [vehicle(1, found, states, {"clean": 2, "attacked": 2, "random": 2}),
                     vehicle(2, found, {**states, "attacked": "l" * 10}, {"clean": 2, "attacked": None, "random": 2}, left=5)]}}


class CommandPage(browser.ReportChecks):
    """For a TestCase with `page`, and `told`, the content of result.json."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="mirage-decide-")
        cls.addClassCleanup(cls.folder.cleanup)
        with open(os.path.join(cls.folder.name, "result.json"), "w", encoding="utf-8") as file:
            json.dump(cls.told, file)
        subprocess.run([sys.executable, os.path.join(SOURCE, "validation", "report", "command_page.py"), cls.folder.name], check=True)
        cls.show(os.path.join(cls.folder.name, cls.page))

    def test_plots_stay_within_their_frames(self):
        for name, left, right, width in self.browser.run(
                "[...document.querySelectorAll('svg.plot text.name')].map(t => [t.textContent, t.getBBox().x, "
                "t.getBBox().x + t.getBBox().width, t.ownerSVGElement.viewBox.baseVal.width])"):
            self.assertGreaterEqual(left, 0, name)
            self.assertLessEqual(right, width, name)


class AuditPage(CommandPage, unittest.TestCase):
    page, told = "audit.html", audit()


class ComparePage(CommandPage, unittest.TestCase):
    page, told = "compare.html", compare()

    def test_the_head_says_the_answer(self):
        self.assertIn("easier to fool: 12.0 points (7.0 to 17.0)", self.browser.run("document.querySelector('h1').textContent"))


class ScorePage(CommandPage, unittest.TestCase):
    page, told = "score.html", score()

    def test_is_one_sheet_of_a4_that_says_what_counts(self):
        text = self.browser.run("document.body.innerText")
        for part in ("Grade C: within 40 m", "about 240 would tell", "does not hold", "no cars", "What was not tested", "certified, 0.8 m", "45.0 to 65.0", "it uses its sweep", "b" * 64):
            self.assertIn(part, text)
        self.assertEqual(self.sheets(), 1)

    def sheets(self):
        sheet = base64.b64decode(self.browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
        return len(re.findall(rb"/Type\s*/Page\b", sheet))


class FullScorePage(ScorePage):
    """Nothing can be told, of two objects, and all of it is said."""

    told = untold()


class BoardPage(CommandPage, unittest.TestCase):
    page = "board.html"
    told = {"board": [score(None, "exec:python3 mine.py", 0.001), score(), score("A", "refined", 0.002)]}

    def test_the_best_grade_is_first_and_none_is_last(self):
        rows = self.browser.run("[...document.querySelectorAll('#board tbody tr')].map(r => r.innerText.replace(/\\s+/g, ' '))")
        self.assertEqual([row.split(" ")[:2] for row in rows[:2]], [["refined", "A"], ["fusion", "C"]])
        self.assertTrue(rows[2].startswith("exec:python3 mine.py –"), rows[2])
        self.assertIn("✗", rows[1])
        self.assertIn("same frames", self.browser.run("document.body.innerText"))


class DrivePage(CommandPage, unittest.TestCase):
    page, told, least = "drive.html", drive(), 60

    def test_the_lead_and_the_curve_say_how_much_later(self):
        lead = self.browser.run("document.querySelector('.lead').textContent").split()
        self.assertIn("confirmed 1.4 (1.3–1.8) m later at the median, and 1 of 2 not before 10 m", " ".join(lead))
        cycles = self.browser.run("document.querySelectorAll('.lead')[1].textContent").split()
        self.assertIn("Cycles keeps 90.0 % (80.0–110.0 %) of the gap that the object adds", " ".join(cycles).replace("\u202f", " "))
        curves = self.browser.run("[...document.querySelectorAll('.gaps')].map(c => c.getAttribute('points'))")
        xs = [[float(p.split(",")[0]) for p in c.split()] for c in curves]
        # Both vehicles' gaps are 0.1, 0.7 and 0.2 s: the curves fall there, from all to none.
        falls = [x[1] - x[0] for x in xs]
        self.assertAlmostEqual(falls[1] / falls[0], 7, places=1)
        self.assertAlmostEqual(falls[2] / falls[0], 2, places=1)
        ys = [float(p.split(",")[1]) for p in curves[1].split()]
        self.assertLess(ys[0], ys[-1])

    def test_a_strip_shows_what_was_found_when(self):
        self.assertEqual(self.browser.run("document.querySelectorAll('.strip').length"), 2)
        bars = self.browser.run("[...document.querySelector('.strip').querySelectorAll('rect:not(.seen)')].map(r => "
                                "[r.getAttribute('class'), +r.getAttribute('width')])")
        self.assertEqual([state for state, _ in bars], list("lf" + "lclf" + "lfclf"))
        widths = [width for _, width in bars]
        self.assertAlmostEqual(widths[0] / widths[1], 2 / 8, places=2)
        self.assertAlmostEqual(widths[4] / widths[3], 6, places=1)
        seen = self.browser.run("[...document.querySelector('.strip').querySelectorAll('rect.seen')].length")
        self.assertEqual(seen, 1 + 2 + 2)
        # While the vehicle is away nothing is drawn.
        bars = self.browser.run("[...document.querySelectorAll('.strip')[1].querySelectorAll('rect:not(.seen)')].map(r => "
                                "[r.getAttribute('class'), +r.getAttribute('x'), +r.getAttribute('width')])")
        self.assertEqual([state for state, *_ in bars], list("lff" + "ll" + "lfclff"))
        (_, before, wide), (_, after, same) = bars[1:3]
        self.assertAlmostEqual(wide / same, 1, places=2)
        self.assertAlmostEqual((after - before) / wide, 3.4 / 0.4, places=1)
        # One that is never confirmed has no circle and a dash.
        circles = self.browser.run("[...document.querySelectorAll('.strip')].map(s => s.querySelectorAll('circle').length)")
        self.assertEqual(circles, [3, 2])
        self.assertIn("with the object – m", self.browser.run("document.querySelectorAll('.strip')[1].textContent"))

    def test_a_result_without_the_strips_seconds_is_refused(self):
        told = drive()
        del told["drive"]["vehicles"][1]["strip"]["stands_s"]
        with tempfile.TemporaryDirectory(prefix="mirage-drive-") as folder:
            with open(os.path.join(folder, "result.json"), "w", encoding="utf-8") as file:
                json.dump(told, file)
            refused = subprocess.run([sys.executable, os.path.join(SOURCE, "validation", "report", "command_page.py"), folder],
                                     stderr=subprocess.PIPE, text=True)
        self.assertEqual(refused.returncode, 1)
        self.assertRegex(refused.stderr, r"^result\.json: .* lacks stands_s; [^\n]*\n$")


if __name__ == "__main__":
    if not browser.find():
        print("skipped: no Chromium")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
