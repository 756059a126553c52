"""The pages of `mirage audit` and `mirage compare` in headless Chromium: test_decision_pages.py SOURCE. Exit code 77: skipped,
with why.

They open without console errors and without asking for anything but themselves, nothing sticks out at either width, and every
figure stands in result.json.
"""

import json
import os
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


class Decision(browser.PageChecks):
    """For a TestCase with `script`, `page` and `result`."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="mirage-decide-")
        cls.addClassCleanup(cls.folder.cleanup)
        with open(os.path.join(cls.folder.name, "result.json"), "w", encoding="utf-8") as file:
            json.dump(cls.result, file)
        subprocess.run([sys.executable, os.path.join(SOURCE, "validation", "report", cls.script), cls.folder.name], check=True)
        cls.browser = browser.Browser()
        cls.addClassCleanup(cls.browser.__exit__)
        cls.browser.open(os.path.join(cls.folder.name, cls.page))

    def tearDown(self):
        self.assertEqual(self.browser.errors, [])

    def test_asks_for_nothing_but_itself(self):
        outside = [url for url in self.browser.requests if not url.startswith(("data:", "blob:"))]
        self.assertEqual([url for url in outside if not url.endswith(self.page)], [])

    def test_every_figure_is_in_the_result(self):
        shown = self.browser.run("[...document.querySelectorAll('data')].map(d => [d.dataset.at, d.value, d.textContent])")
        self.assertGreater(len(shown), 30)
        for place, value, text in shown:
            self.assertEqual(str(browser.at(self.result, place)), value, place)
            self.assertTrue(text)

    def test_plots_stay_within_their_frames(self):
        for name, left, right, width in self.browser.run(
                "[...document.querySelectorAll('svg.plot text.name')].map(t => [t.textContent, t.getBBox().x, "
                "t.getBBox().x + t.getBBox().width, t.ownerSVGElement.viewBox.baseVal.width])"):
            self.assertGreaterEqual(left, 0, name)
            self.assertLessEqual(right, width, name)


class AuditPage(Decision, unittest.TestCase):
    script, page, result = "audit_page.py", "audit.html", audit()


class ComparePage(Decision, unittest.TestCase):
    script, page, result = "compare_page.py", "compare.html", compare()

    def test_the_head_says_the_answer(self):
        self.assertIn("easier to fool: 12.0 points (7.0 to 17.0)", self.browser.run("document.querySelector('h1').textContent"))


if __name__ == "__main__":
    if not browser.find():
        print("skipped: no Chromium")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
