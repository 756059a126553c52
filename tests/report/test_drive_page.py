"""The page of `mirage drive` in headless Chromium: test_drive_page.py SOURCE. Exit code 77: skipped, with why.

Opens without console errors and without asking for anything but itself, every figure stands in result.json, and a strip
shows what was found when."""

import json
import os
import subprocess
import sys
import tempfile
import unittest

import browser

SOURCE = os.path.abspath(sys.argv[1])
VERSIONS = ("clean", "attacked", "random")


def interval(value):
    return {"value": value, "low": None if value > 2 else value - 0.1, "high": None if value > 2 else value + 0.4}


def vehicle(track, found, states, confirmed):
    count = len(found["clean"])
    strip = {"index": list(range(count)), "time_s": [5 + 0.1 * i for i in range(count)],
             "range_m": [47 - i for i in range(count)]}
    for v in VERSIONS:
        strip[v] = {"found": found[v], "track": states[v], "phantoms": [0] * count, "in_lane": [0] * count}
    return {"sequence": "0003", "track": track, "type": "Car", "frames": count, "strip": strip,
            "gap_s": {"clean": 0.1, "attacked": 0.7, "random": 0.2},
            "confirmed_s": {v: None if confirmed[v] is None else 0.1 * confirmed[v] for v in VERSIONS},
            "confirmed_m": {v: None if confirmed[v] is None else 47.0 - confirmed[v] for v in VERSIONS},
            "reserve_m": {v: None if confirmed[v] is None else {"4": 1.5, "6": -3.25, "8": 9.0} for v in VERSIONS},
            "phantoms": {v: {"tracks": int(v == "attacked"), "frames": 2, "seconds": 0.2, "in_lane_s": 0.1} for v in VERSIONS}}


def result():
    found = {"clean": "ffffffffff", "attacked": "f-------ff", "random": "fff--fffff"}
    states = {"clean": "llffffffff", "attacked": "llcllllllf", "random": "llfclfffff"}
    medians = {key: interval(1 + i) for i, key in enumerate((*VERSIONS, "attacked_less_clean", "attacked_less_random"))}
    return {"detector": "fusion", "score_threshold": 0.3, "drive": {
        "frames": 144, "gap_s": medians, "track_gap_s": medians, "confirmed_m": medians,
        "later_m": {"than_clean": interval(1.4), "than_random": interval(0.6)},
        "near": {"metres": 10, "vehicles": 2, "clean": 0, "attacked": 1, "random": 0},
        "deaths": [{"death": 2, "track_gap_s": {v: interval(0.6) for v in VERSIONS},
                    "phantom_share": {v: {"value": 0.25, "low": 0.1, "high": 0.5} for v in VERSIONS}}],
        "never_confirmed": {"clean": 0, "attacked": 1, "random": 0},
        "survival": [{"seconds": 0.5, **{v: {"value": 0.25, "low": 0.1, "high": 0.5} for v in VERSIONS}}],
        "tracker": {"mota": 0.71, "hota": 0.61, "switches": 2, "fragments": 3},
        "vehicles": [vehicle(1, found, states, {"clean": 2, "attacked": 2, "random": 2}),
                     vehicle(2, found, {**states, "attacked": "l" * 10}, {"clean": 2, "attacked": None, "random": 2})]}}


class Page(browser.PageChecks, unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="mirage-drive-")
        cls.addClassCleanup(cls.folder.cleanup)
        cls.result = result()
        with open(os.path.join(cls.folder.name, "result.json"), "w", encoding="utf-8") as file:
            json.dump(cls.result, file)
        subprocess.run([sys.executable, os.path.join(SOURCE, "validation", "report", "command_page.py"), cls.folder.name], check=True)
        cls.browser = browser.Browser()
        cls.addClassCleanup(cls.browser.__exit__)
        cls.browser.open(os.path.join(cls.folder.name, "drive.html"))

    def tearDown(self):
        self.assertEqual(self.browser.errors, [])

    def test_asks_for_nothing_but_itself(self):
        outside = [url for url in self.browser.requests if not url.startswith(("data:", "blob:"))]
        self.assertEqual([url for url in outside if not url.endswith("drive.html")], [])

    def test_every_figure_is_in_the_result(self):
        shown = self.browser.run("[...document.querySelectorAll('data')].map(d => [d.dataset.at, d.value, d.textContent])")
        self.assertGreater(len(shown), 60)
        for place, value, text in shown:
            self.assertEqual(str(browser.at(self.result, place)), value, place)
            self.assertTrue(text)

    def test_the_lead_and_the_curve_say_how_much_later(self):
        lead = self.browser.run("document.querySelector('.lead').textContent").split()
        self.assertIn("confirmed 1.4 (1.3–1.8) m later at the median, and 1 of 2 not before 10 m", " ".join(lead))
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
        # One that is never confirmed has no circle and a dash.
        circles = self.browser.run("[...document.querySelectorAll('.strip')].map(s => s.querySelectorAll('circle').length)")
        self.assertEqual(circles, [3, 2])
        self.assertIn("with the object – m", self.browser.run("document.querySelectorAll('.strip')[1].textContent"))


if __name__ == "__main__":
    if not browser.find():
        print("skipped: no Chromium")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
